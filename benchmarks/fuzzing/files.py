"""Damaged files: they are read and used, or refused in one sentence."""

from __future__ import annotations

import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from scipy.io import savemat

from comparisons.estimators.config import read_config
from comparisons.options.toml_files import read_noise
from comparisons.studies.plan import read_study
from graphslam import Graph, load, save, simulate, solve

from .attempt import Case
from .graphs import wrong_with
from .hostile import HOSTILE, WORDS


def seeds_of_formats(folder: Path) -> dict[str, Path]:
    """Small valid files of every format: {format: file, or folder of files}."""
    log = simulate(seed=1, steps=12)
    plain = log.without_orientation()
    places = {name: folder / f"{name}{suffix}" for name, suffix in (("lnpr", ".txt"), ("npz", ".npz"))}
    save(log.replace(true_poses=None, true_landmarks=None), places["lnpr"])
    save(log, places["npz"])
    for name, tags in DIALECTS.items():
        places[name] = folder / f"{name}.{'g2o' if name == 'g2o' else 'graph'}"
        places[name].write_text(tags)
    times = log.times
    assert times is not None and log.controls is not None and log.true_poses is not None
    mrclam = places["mrclam"] = folder / "mrclam"
    mrclam.mkdir()
    rows = {
        "Robot1_Odometry": np.column_stack([times[:-1], log.controls]),
        "Robot1_Measurement": np.column_stack([times[log.steps] + 0.01, 10 + log.landmarks, log.sightings[:, :2]]),
        "Robot1_Groundtruth": np.column_stack([times, log.true_poses]),
        "Barcodes": np.column_stack([6 + np.arange(20), 10 + np.arange(20)]),
        "Landmark_Groundtruth": np.array([[6 + j, *m[:2], 0.01, 0.01] for j, m in (log.true_landmarks or {}).items()]),
    }
    for name, table in rows.items():
        text = "\n".join("\t".join(f"{x:g}" if x % 1 else str(int(x)) for x in row) for row in table.tolist())
        (mrclam / f"{name}.dat").write_text(f"# {name}\n{text}\n")
    huang = places["huang"] = folder / "huang"
    huang.mkdir()
    steps, marks = len(log.controls), np.array([m[:2] for m in (log.true_landmarks or {}).values()])
    beacons = np.column_stack([np.arange(1, len(marks) + 1), marks])
    sensor = np.column_stack([plain.steps + 1, 1 + plain.landmarks, plain.sightings, np.zeros((len(plain.steps), 3))])
    of_huang = {"store_speed": log.controls[:, :1].T, "store_turnrate": log.controls[:, 1:].T, "sensor_data": sensor}
    of_huang |= {"store_robotTrue": log.true_poses.T, "store_beaconsTrue": beacons}
    for name, value in of_huang.items():
        savemat(huang / f"{name}.mat", {name: value})
    seen = {key: np.zeros((steps, 20)) for key in ("r", "b")}
    for t, j, z in zip(plain.steps.tolist(), plain.landmarks.tolist(), plain.sightings):
        if t < steps:
            seen["r"][t, j], seen["b"][t, j] = z
    places["lost_in_the_woods"] = folder / "dataset2.mat"
    of_woods = {
        "t": times[:-1, None], "v": log.controls[:, :1], "om": log.controls[:, 1:], "d": 0.2, "l": np.zeros((20, 2)),
        "r_var": 0.01, "b_var": 0.01, "v_var": 0.01, "om_var": 0.01, "true_valid": np.ones((steps, 1)), **seen,
        **{f"{axis}_true": log.true_poses[:-1, k : k + 1] for k, axis in enumerate(("x", "y", "th"))},
    }  # fmt: skip
    savemat(places["lost_in_the_woods"], of_woods)
    tables = places["tables"] = folder / "tables"
    tables.mkdir()
    (tables / "odometry.csv").write_text(_csv("t,v,w", np.column_stack([times[:-1], log.controls])))
    seen_rows = np.column_stack([times[plain.steps], plain.landmarks, plain.sightings])
    (tables / "sightings.csv").write_text(_csv("t,id,range,bearing", seen_rows))
    for name, text in TOML.items():
        places[name] = folder / f"{name}.toml"
        places[name].write_text(text)
    return places


def _csv(head: str, rows: np.ndarray) -> str:
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n"


DIALECTS = {
    "g2o": "".join(f"VERTEX_SE2 {k} {k} 0 0.1\n" for k in range(4)) + "VERTEX_XY 9 1 2\nFIX 0\n"
    + "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 9 0 0 9 0 20\n" for k in range(3)) + "EDGE_SE2_XY 0 9 1 2 4 0 4\n",
    "toro": "".join(f"VERTEX2 {k} {k} 0 0.1\n" for k in range(4))
    + "".join(f"EDGE2 {k} {k + 1} 1 0 0 9 0 9 20 0 0\n" for k in range(3)),
    "isam": "".join(f"ODOMETRY {k} {k + 1} 1 0 0 3 0 0 3 0 4\n" for k in range(4)) + "LANDMARK 0 9 1 2 2 0 2\n",
}  # fmt: skip
TOML = {
    "config": 'estimators = ["graph"]\nedges = "virtual"\nparticles = 10\n[motion]\nnn = 0.2\n[sensor]\nrange_rate = 0.1\n',
    "noise": "[motion]\nnn = 0.19\nepsilon = 1e-4\n[sensor]\nbearing_std = 0.05\n[ranges]\nscale = 1.02\nbias = 0.03\n",
    "study": 'seeds = 2\nestimators = ["graph"]\n[simulate]\nsteps = 5\n'
    'vary.landmarks = [3, 4]\n[options]\nvary.edges = ["virtual"]\n',
}
#: what a text is damaged with
TOKENS = ["nan", "inf", "-inf", "1e400", "1e308", "-1", "0", "1e-320", "", " ", "\t", "x", "1,5", "0x10", "9" * 30,
          "\0", "\ufeff", "ü",
          "1_0", "--", "[", "=", '"', "\r\n", "#", "VERTEX_SE2", "1e20", *WORDS]  # fmt: skip


def damaged(rng: Generator, data: bytes) -> bytes:
    """A file with one to four damages: bytes, words or lines changed, lost, moved or repeated."""
    for _ in range(int(rng.choice([1, 1, 2, 4]))):
        way, at = rng.integers(9), int(rng.integers(len(data) + 1))
        lines = data.split(b"\n")
        line = int(rng.integers(len(lines)))
        words = lines[line].split()
        if way == 0:
            data = data[:at]
        elif way == 1:
            data = data[:at] + rng.bytes(int(rng.integers(1, 9))) + data[at:]
        elif way == 2 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
        elif way == 3:
            data = b"\n".join(lines[:line] + lines[line + 1 :])
        elif way == 4:
            data = b"\n".join([*lines, lines[line]])
        elif way == 5:
            lines[line], lines[-1] = lines[-1], lines[line]
            data = b"\n".join(lines)
        elif way == 6 and words:
            del words[int(rng.integers(len(words)))]
            data = b"\n".join([*lines[:line], b" ".join(words), *lines[line + 1 :]])
        elif words:
            words[int(rng.integers(len(words)))] = TOKENS[rng.integers(len(TOKENS))].encode()
            data = b"\n".join([*lines[:line], (b"," if b"," in lines[line] else b" ").join(words), *lines[line + 1 :]])
    return data


def file_case(seed: int, number: int) -> Case:
    """A damaged file of one format: it is read, and used if it can be, or refused in a sentence."""
    rng = default_rng([seed, 1, number])
    seeds = originals()
    kinds = [*seeds, *HOSTILE]
    name = kinds[number % len(kinds)]

    def check() -> list[str]:
        with tempfile.TemporaryDirectory() as folder:
            if name in HOSTILE:
                kind, path, options = HOSTILE[name](rng, Path(folder), seeds)
                return _used(kind, path, **options)
            source, target = seeds[name], Path(folder) / seeds[name].name
            if source.is_dir():
                target.mkdir()
                victim = str(rng.choice(sorted(p.name for p in source.iterdir())))
                for path in source.iterdir():
                    content = path.read_bytes()
                    (target / path.name).write_bytes(damaged(rng, content) if path.name == victim else content)
            else:
                target.write_bytes(damaged(rng, source.read_bytes()))
            return _used(name, target)

    return f"file {number}: {name}", check


@cache
def originals() -> dict[str, Path]:
    """Small valid files, made once."""
    return seeds_of_formats(Path(tempfile.mkdtemp(prefix="fuzz-")))


def _used(name: str, path: Path, **options: Any) -> list[str]:
    """What is wrong after reading a file and using what it holds."""
    with warnings.catch_warnings():
        # readers warn of what they found
        warnings.simplefilter("ignore", UserWarning)
        if name == "config":
            read_config(path)
        elif name == "noise":
            read_noise(path)
        elif name == "study":
            read_study(path)
        elif name in DIALECTS:
            graph = Graph.from_g2o(path)
            return wrong_with(solve(graph, max_iterations=20), initialize="auto")
        else:
            log = load(path, **options)
            arrays = (log.initial_poses, log.sightings, log.dt, log.controls)
            if not all(np.isfinite(a).all() for a in arrays if a is not None):
                return ["the log holds numbers that are not finite"]
            save(log, path.parent / "again.npz")
            if not load(path.parent / "again.npz").equals(log):
                return ["the log is another one after saving"]
            if log.num_poses < 200 and len(log.steps) < 1000:
                edges = "landmark+motion" if log.controls is not None else "virtual"
                return wrong_with(solve(Graph.from_log(log, edges=edges), max_iterations=20), initialize="auto")
    return []
