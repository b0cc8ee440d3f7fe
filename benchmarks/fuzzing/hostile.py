"""Inputs that nobody writes by accident: endless, huge, deeply nested, or of the wrong type where a number is expected."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

#: what files are made of: the format that reads it, the path, and options of `load`
Made = tuple[str, Path, dict[str, Any]]
Maker = Callable[[Generator, Path, Mapping[str, Path]], Made]
#: words in place of numbers, ids and names
WORDS = [
    str(2**63), str(-(2**63)), str(2**64 + 1), "1e17", "1e300", "tag" + "9" * 25, "tag" + "1" * 5000, "9" * 5000, '"open',
    '"a\nb"', "x" * 200_000, '"' + "x" * 200_000 + '"', "1e400", "-inf", "1.2.3", "²", "٣", "\u2028", "\x85", "1e-400",
    "9223372036.9", "253402300800", "2262-04-12T00:00:00", "9999-12-31T23:59:59", "0001-01-01T00:00:00",
]  # fmt: skip
#: values of TOML that are of the wrong type or size for most keys
VALUES = [
    "[" * 2000 + "]" * 2000, "{a=" * 500 + "1" + "}" * 500, "9" * 5000, "9" * 400, "1e400", "nan", "-inf", "true", '""', "[]",
    "[[]]", "{}", "{odometry = [1]}", "2020-01-01", '"' + "x" * 200_000 + '"', "[1, 'a']", "-1", "1e-300", "0", "1.5",
    '"odometry=1"', '"\\u0000"', '"/dev/zero"', '"***"', '"**/[a*"', "[" + "'a'," * 20_000 + "]",
    "['*', '***', '/dev/zero']",
]  # fmt: skip
#: patterns of the logs of a study
PATTERNS = ["*", "**", "***", "**x", "[", "[!", "a[", "../*", "", "/", "~", "/dev/*", "//", "?"]
#: keys of configurations, noise files, studies and recipes
KEYS = [
    "seed", "seeds", "particles", "estimators", "noise", "edges", "kernel", "log", "logs", "robot", "keep_every", "database",
    "time_limit", "motion.nn", "sensor.offset", "sensor.range_rate", "ranges.scale", "simulate.steps", "simulate.vary.steps",
    "options.vary.kernel", "options.vary.motion_weight", "columns", "columns.odometry", "columns.odometry.nu", "clocks",
    "clocks.truth", "time", "angles.truth", "odometry.file", "odometry.clock", "sightings.range", "axes", "sensor_offset",
    "sensor_yaw", "estimate", "max_range", "stride", "dimensions", "way_points", "truth_offset",
]  # fmt: skip


def toml(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:
    """A TOML file of options with one or two keys of impossible values."""
    kind = str(rng.choice(["config", "noise", "study", "recipe"]))
    lines = [f"{rng.choice(KEYS)} = {VALUES[rng.integers(len(VALUES))]}" for _ in range(int(rng.integers(1, 3)))]
    if rng.random() < 0.1:
        lines += [f"# comment {k}" for k in range(20_000)] + ["zzz = 1"]
    text = "\n".join(lines) + "\n"
    if kind == "recipe":
        target = folder / "tables"
        shutil.copytree(seeds["tables"], target)
        (target / "import.toml").write_text(text)
        return "tables", target, {}
    path = folder / f"{kind}.toml"
    path.write_text(text + (seeds[kind].read_text() if rng.random() < 0.5 else ""))
    return kind, path, {}


def study(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:  # noqa: ARG001
    """A study of very many runs, or of patterns that match nothing or everything."""
    many = [int(10 ** rng.uniform(0, 6.5)) for _ in range(3)]
    values = [",".join(map(str, range(1, 1 + min(count, 3000)))) for count in many]
    text = f'seeds = {many[0]}\nestimators = ["graph", "fastslam1"]\n'
    if rng.random() < 0.3:
        text += f"logs = ['{rng.choice(PATTERNS)}']\n"
    text += f"[simulate]\nsteps = 5\nvary.landmarks = [{values[1]}]\n[options]\nvary.motion_weight = [{values[2]}]\n"
    if rng.random() < 0.5:
        text += f"vary.particles = [{values[1]}]\n"
    path = folder / "study.toml"
    path.write_text(text)
    return "study", path, {}


def arrays(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:
    """A log whose archive has arrays of odd types and shapes, or lacks some."""
    with np.load(seeds["npz"]) as archive:
        content = {name: archive[name] for name in archive.files}
    for _ in range(int(rng.integers(1, 3))):
        name = str(rng.choice([*content, "motion", "sensor", "classes", "notes", "doubts", "control_starts"]))
        old = content.get(name, np.zeros(3))
        content[name] = [
            old[:1] if old.ndim else np.zeros(2), np.array(1.0), np.zeros(0), np.zeros((2, 2, 2)), np.array(["x"]),
            np.array(True),
            np.ones(3, dtype=complex), np.array(["2020"], dtype="M8[s]"), np.zeros(3, dtype=[("a", "f8")]), old.astype(str),
            np.array(["x" * 100_000]), np.full(old.shape, 1e300), np.full(old.shape, 2**63, dtype=np.uint64), old.T,
            np.zeros((len(old) if old.ndim else 1, 1)), np.array(b"x"), np.float128(1) * np.ones(2),
        ][int(rng.integers(17))]  # fmt: skip
        if rng.random() < 0.1:
            del content[name]
    path = folder / "log.npz"
    np.savez(path, **content)
    return "npz", path, {}


@cache
def _zeros(size: int) -> bytes:
    """That many zeros, compressed."""
    packer = zlib.compressobj(9)
    first, again = (packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    # after a full flush every million compresses to the same bytes
    return first + again * ((size >> 20) - 1)


def bomb(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:
    """A small archive or MATLAB file that unpacks to gigabytes, or says so."""
    if rng.random() < 0.5:
        path = folder / "dataset2.mat"
        body = _zeros(1 << int(rng.choice([24, 32])))
        path.write_bytes(seeds["lost_in_the_woods"].read_bytes()[:128] + struct.pack("<II", 15, len(body)) + body)
        return "lost_in_the_woods", path, {}
    path = folder / "bomb.npz"
    claimed = int(10 ** rng.uniform(6, 15))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("steps.npy", "w") as entry:
        header = {"descr": "<f8", "fortran_order": False, "shape": (claimed,)}
        np.lib.format.write_array_header_2_0(entry, header)  # type: ignore[arg-type]
        entry.write(bytes(1 << 20))
    if rng.random() < 0.5:
        # the directory at its end claims any size
        data = bytearray(path.read_bytes())
        struct.pack_into("<I", data, data.rindex(b"PK\1\2") + 24, int(rng.integers(1 << 32)))
        path.write_bytes(bytes(data))
    return "npz", path, {}


def dense(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:  # noqa: ARG001
    """A log read with a pose after each very short time, or an option of another type."""
    name = str(rng.choice(["npz", "tables", "mrclam", "lost_in_the_woods", "huang", "lnpr"]))
    value = [1e-300, 1e-6, 1e-4, 0.0, -1.0, float("nan"), float("inf"), "1", True, [1], 10**400][int(rng.integers(11))]
    return name, seeds[name], {"keep_every": value} if rng.random() < 0.8 else {"robot": value}


def device(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:  # noqa: ARG001
    """A device, a pipe or no file where one is expected."""
    place = str(
        rng.choice(["/dev/zero", "/dev/full", "/dev/null", "/dev/random", "pipe", "x" * 300, "x" * 5000, "", "\0"])
    )
    path = Path(place)
    if place == "pipe":
        path = folder / "pipe"
        os.mkfifo(path)
    return str(rng.choice(["npz", "config", "noise", "study", "g2o"])), path, {}


def bag(rng: Generator, folder: Path, seeds: Mapping[str, Path]) -> Made:  # noqa: ARG001
    """A bag of ROS 2 in SQLite whose cells are of other types."""
    path = folder / "drive.db3"
    with sqlite3.connect(path) as base:
        base.executescript(
            "create table schema(schema_version integer, ros_distro text); insert into schema values(3, 'iron');"
            "create table metadata(id integer, metadata_version integer, metadata text);"
            "create table topics(id integer primary key, name text, type text, serialization_format text, "
            "offered_qos_profiles text, type_description_hash text);"
            "create table message_definitions(id integer, topic_type text, encoding text, encoded_message_definition text, "
            "type_description_hash text);"
            "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob);"
        )
        base.execute("insert into topics values(1, '/odom', 'nav_msgs/msg/Odometry', 'cdr', '', 'x')")
        base.execute("insert into messages values(1, 1, 5, ?)", (b"\0\1\0\0" + bytes(700),))
        table, columns = [
            ("topics", ["name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"]),
            ("messages", ["topic_id", "timestamp", "data"]), ("schema", ["schema_version", "ros_distro"]),
        ][int(rng.integers(3))]  # fmt: skip
        value = [b"\xff\xfe", None, 3, "", "x", 2**62, -(2**63), 1e300, b"", "x" * 100_000][int(rng.integers(10))]
        base.execute(f"update {table} set {rng.choice(columns)} = ?", (value,))
        if rng.random() < 0.1:
            base.execute(f"drop table {table}")
    base.close()
    return "bag", path, {}


#: the kinds of hostile inputs
HOSTILE: dict[str, Maker] = {
    "toml": toml, "runs": study, "arrays": arrays, "bomb": bomb, "keep_every": dense, "device": device, "bag": bag,
}  # fmt: skip
