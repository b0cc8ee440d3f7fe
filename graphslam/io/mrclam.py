"""UTIAS MR.CLAM: five robots and fifteen landmarks in an arena, nine data sets, one folder each.

Source: Leung, Halpern, Barfoot and Liu, *The UTIAS multi-robot cooperative localization and mapping dataset*, IJRR 30(8),
2011; http://asrl.utias.utoronto.ca/datasets/mrclam/. Terms: free for educational and research use, with citation; no
licence to redistribute.

Files of a folder (``#`` lines are comments; times are Unix seconds)::

    Barcodes.dat               subject, barcode
    Landmark_Groundtruth.dat   subject, x, y [m], standard deviations of x, y [m]
    RobotN_Odometry.dat        time, forward velocity [m/s], angular velocity [rad/s]; about 67 Hz
    RobotN_Measurement.dat     time, barcode, range [m], bearing [rad]
    RobotN_Groundtruth.dat     time, x, y [m], heading [rad]; about 65 Hz (Vicon)

Subjects 1 to 5 are robots, 6 to 20 landmarks; ids of landmarks are their subject numbers. Peculiarities: the measurement
files give *barcodes*, not subjects as their header says. Some sightings are of other robots or of unknown barcodes; both
are left out and counted, except that `load_robots` keeps those of robots. The odometry is the commanded velocity, at most
0.086 m/s in set 6, silent for up to 1 s at a time, and of several rows with one time the last holds. The truth may end
before the odometry (robot 1 of set 6: 772 of 900 s). No noise is published.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, OptionError, checks, decimals, quoted
from ..log import UNIDENTIFIED, Log
from ..log.cells import time_faults
from ..log.rows import NO_CLASS, Fault, ReadOptions, finite_fault, range_faults, robot_class, sound_rows
from ..log.streams import MOST_DISORDER, Stream, disorder, synchronize
from ..log.text_table import TextTable
from ..se2 import Array
from .base import NO_SIGHTING, Format, errors_name, member, optional_member

#: subjects up to this number are robots
ROBOTS = 5

_LANDMARKS = ("subject", "x", "y", "standard deviation of x", "standard deviation of y")


def robots(folder: Path) -> list[int]:
    """The numbers of the robots that a folder has any file of."""
    form = re.compile(r"Robot(\d+)_(Odometry|Measurement|Groundtruth)\.dat")
    matches = (form.fullmatch(path.name) for path in folder.iterdir())
    return sorted({int(match[1]) for match in matches if match})


def _recognises(path: Path, _: bytes) -> bool:
    return path.is_dir() and bool(robots(path) or (path / "Barcodes.dat").exists())


def _robot(folder: Path, robot: int | None) -> int:
    """The number of the robot to read."""
    there = robots(folder)
    names = ", ".join(map(str, there))
    if robot is None and len(there) > 1:
        raise OptionError(f"{folder} has robots {names}: say which (robot=N)")
    if robot is not None and there and robot not in there:
        raise OptionError(f"{folder} has no files of robot {quoted(robot)}; its robots are {names}")
    return robot if robot is not None else (there or [1])[0]


def _read_robots(folder: Path, options: ReadOptions) -> dict[int, Log]:
    return {n: _read(folder, replace(options, robot=n), with_robots=True) for n in robots(folder)}


def _read(folder: Path, options: ReadOptions, *, with_robots: bool = False) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "an MR.CLAM log is a folder (of RobotN_Odometry.dat and so on), not a file")
    robot = _robot(folder, options.robot)
    barcodes = _subjects(member(folder, "Barcodes.dat", "which barcode each robot and landmark has"))
    odometry_path = member(folder, f"Robot{robot}_Odometry.dat", "the velocities of the robot")
    notes: list[str] = []
    ways: dict[str, Any] = {"notes": notes, "strict": options.strict}
    odometry = _stream(odometry_path, "velocity", "angular velocity", **ways)
    path = member(folder, f"Robot{robot}_Measurement.dat", "the ranges and bearings that the robot measured")
    seen = _stream(path, "barcode", "range", "bearing", noun="sightings", faults=_faults, **ways)
    subject = np.array([barcodes.get(int(code), 0) for code in seen.rows[:, 0].tolist()], dtype=np.int64)
    of_robots = (subject > 0) & (subject <= ROBOTS)
    unused = {"of unknown barcodes": subject == 0}
    if not with_robots:
        unused = {"of other robots": of_robots} | unused
    for what, rows in unused.items():
        if rows.any():
            notes.append(f"{rows.sum()} of {len(seen)} sightings are {what}: left out")
    if not np.any(subject > ROBOTS):
        raise FormatError(path, None, NO_SIGHTING)
    kept = subject > (0 if with_robots else ROBOTS)
    classes = np.where(of_robots, [robot_class(number) for number in subject.tolist()], NO_CLASS)
    landmarks_path = optional_member(folder, "Landmark_Groundtruth.dat", "the true landmarks", notes)
    truth_path = optional_member(folder, f"Robot{robot}_Groundtruth.dat", "the true poses", notes)
    truth = None if truth_path is None else _stream(truth_path, "x", "y", "heading", **ways)
    landmarks = None if landmarks_path is None else _table(landmarks_path, _LANDMARKS)[1]
    with errors_name(odometry_path):
        return synchronize(
            odometry,
            Stream(seen.times[kept], seen.rows[kept, 1:]),
            np.where(of_robots, UNIDENTIFIED, subject)[kept],
            classes=classes[kept] if with_robots else None,
            options=options,
            truth=truth,
            true_landmarks=None if landmarks is None else {int(row[0]): row[1:3] for row in landmarks},
            name=f"{folder.resolve().name}-robot{robot}",
            notes=tuple(notes),
        )


def _faults(rows: Array) -> list[Fault]:
    """The sightings (N, 4) whose barcode or range cannot be."""
    code, what = rows[:, 1], "a barcode that is no whole number"
    wrong = Fault(code % 1 != 0, what, lambda k: f"the barcode should be a whole number, not {code[k]:g}")
    return [wrong, *range_faults(rows[:, 2], rows[:, 3])]


def _stream(
    path: Path, *columns: str, notes: list[str], strict: bool, noun: str = "rows",
    faults: Callable[[Array], list[Fault]] = lambda _: [],
) -> Stream:  # fmt: skip
    """The rows of a file with times; those that cannot be are left out, with notes, or the first of them is refused.

    Raises:
        FormatError: too many rows cannot be, or times run backwards by more than `MOST_DISORDER`; with the line.
    """
    table = TextTable(path, ("time", *columns))
    rows = table.numbers(range(table.width))
    finite = [finite_fault(rows[:, k], name) for k, name in enumerate(columns, start=1)]
    wrong = [*time_faults(rows[:, 0], "the time", "s", MOST_DISORDER), *finite, *faults(rows)]
    kept, about = sound_rows(len(rows), noun, wrong, table.error, strict=strict, source=path.name)
    rows, numbers = rows[kept], np.flatnonzero(kept)
    notes += about
    if (k := checks.first(disorder(rows[:, 0]) > MOST_DISORDER)) is not None:
        order = f"{decimals(rows[k, 0])} s comes after {decimals(np.max(rows[:k, 0]))} s"
        raise table.error(int(numbers[k]), f"time runs backwards: {order}; sort the lines by time")
    return Stream(rows[:, 0], rows[:, 1:])


def _table(path: Path, columns: tuple[str, ...]) -> tuple[TextTable, Array]:
    """A file and its numbers, which are finite."""
    table = TextTable(path, columns)
    rows = table.numbers(range(table.width))
    faults = [finite_fault(column, name) for name, column in zip(columns, rows.T)]
    sound_rows(len(rows), "rows", faults, table.error, strict=True)
    return table, rows


def _subjects(path: Path) -> dict[int, int]:
    """{barcode: subject}."""
    table, rows = _table(path, ("subject", "barcode"))
    # beyond 2^53 floating-point numbers leave out whole numbers
    if (k := checks.first(np.any((rows % 1 != 0) | (np.abs(rows) > 2**53), axis=1))) is not None:
        subject, barcode = rows[k].tolist()
        raise table.error(k, f"expected two whole numbers, subject and barcode, not {subject:g} and {barcode:g}")
    subjects = {int(barcode): int(subject) for subject, barcode in rows.tolist()}
    if len(subjects) < len(rows):
        raise FormatError(path, None, "two subjects have the same barcode, so a sighting of it could be of either")
    return subjects


FORMAT = Format("mrclam", _recognises, _read, robots=robots, read_robots=_read_robots, separate_times=True)
