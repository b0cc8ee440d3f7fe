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

Subjects 1 to 5 are robots, 6 to 20 landmarks; ids of landmarks are their subject numbers. Oddities: the measurement
files give *barcodes*, not subjects as their header says; other robots are seen, too, and some barcodes belong to
nobody: both are left out and counted. The odometry is the commanded velocity, at most 0.086 m/s in set 6, silent for
up to 1 s at a time, and of several rows with one time the last holds. The truth may end before the odometry (robot 1
of set 6: 772 of 900 s). Nothing is said about noise.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError, OptionError
from ..log import Log
from ..sources.synchronize import Stream, join
from .base import Format
from .columns import line_of, read_columns

#: subjects up to this number are robots
ROBOTS = 5

_HOLDS = {
    "Barcodes.dat": "which barcode each robot and landmark wears",
    "Odometry": "the velocities of the robot",
    "Measurement": "the ranges and bearings that the robot saw",
}


def robots(folder: Path) -> list[int]:
    """The numbers of the robots that a folder has any file of."""
    found = (
        re.fullmatch(r"Robot(\d+)_(Odometry|Measurement|Groundtruth)\.dat", path.name) for path in folder.iterdir()
    )
    return sorted({int(match[1]) for match in found if match})


def _recognises(path: Path, head: bytes) -> bool:  # noqa: ARG001
    return path.is_dir() and bool(robots(path) or (path / "Barcodes.dat").exists())


def _required(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file():
        holds = _HOLDS.get(name) or _HOLDS[name.removesuffix(".dat").split("_")[1]]
        raise FormatError(path, None, f"this file of the data set is missing; it would hold {holds}")
    return path


def _read(folder: Path, *, robot: int | None = None, keep_every: float | None = None) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "an MR.CLAM log is a folder (of RobotN_Odometry.dat and so on), not a file")
    there = robots(folder)
    if robot is None:
        if len(there) > 1:
            raise OptionError(f"{folder} has robots {', '.join(map(str, there))}: say which (robot=N, or --robot N)")
        robot = there[0] if there else 1
    elif there and robot not in there:
        raise OptionError(f"{folder} has no files of robot {robot}; its robots are {', '.join(map(str, there))}")
    barcodes = _subjects(_required(folder, "Barcodes.dat"))
    odometry_path = _required(folder, f"Robot{robot}_Odometry.dat")
    odometry = read_columns(odometry_path, ("time", "velocity", "angular velocity"), times=True)
    seen_path = _required(folder, f"Robot{robot}_Measurement.dat")
    seen = read_columns(seen_path, ("time", "barcode", "range", "bearing"), times=True)

    wrong = {
        "the barcode should be a whole number": seen[:, 1] % 1 != 0,
        "the range should be above zero": seen[:, 2] <= 0,
    }
    for what, rows in wrong.items():
        if np.any(rows):
            k = int(np.argmax(rows))
            column = 1 if "barcode" in what else 2
            raise FormatError(seen_path, line_of(seen_path, k), f"{what}, not {seen[k, column]:g}")
    subject = np.array([barcodes.get(int(code), 0) for code in seen[:, 1].tolist()], dtype=np.int64)
    notes = []
    for count, what in (
        (np.sum((subject > 0) & (subject <= ROBOTS)), "of other robots"),
        (np.sum(subject == 0), "of barcodes that belong to nobody"),
    ):
        if count:
            notes.append(f"{count} of {len(seen)} sightings are {what}: left out")
    kept = subject > ROBOTS
    if not kept.any():
        raise FormatError(seen_path, None, "no sighting of any landmark: nothing to estimate from")

    landmarks_path, truth_path = folder / "Landmark_Groundtruth.dat", folder / f"Robot{robot}_Groundtruth.dat"
    landmarks, truth = None, None
    if landmarks_path.is_file():
        rows = read_columns(landmarks_path, ("subject", "x", "y", "standard deviation of x", "standard deviation of y"))
        landmarks = {int(row[0]): row[1:3] for row in rows}
    else:
        notes.append(f"{landmarks_path.name}, which would hold the true landmarks, is missing: read without")
    if truth_path.is_file():
        rows = read_columns(truth_path, ("time", "x", "y", "heading"), times=True)
        truth = Stream(rows[:, 0], rows[:, 1:])
    else:
        notes.append(f"{truth_path.name}, which would hold the true poses, is missing: read without")
    try:
        return join(
            Stream(odometry[:, 0], odometry[:, 1:]), Stream(seen[kept, 0], seen[kept, 2:]), subject[kept],
            truth=truth, true_landmarks=landmarks, keep_every=keep_every, name=f"{folder.resolve().name}-robot{robot}",
            notes=tuple(notes),
        )  # fmt: skip
    except LogError as error:
        raise FormatError(odometry_path, None, str(error)) from None


def _subjects(path: Path) -> dict[int, int]:
    """{barcode: subject}."""
    rows = read_columns(path, ("subject", "barcode"))
    subjects = dict(zip(rows[:, 1].astype(int).tolist(), rows[:, 0].astype(int).tolist()))
    if len(subjects) < len(rows):
        raise FormatError(path, None, "two subjects wear the same barcode, so a sighting of it could be of either")
    return subjects


FORMAT = Format("mrclam", (), _recognises, _read, options=("robot", "keep_every"))
