"""Victoria Park: a utility car between trees, its speed and steering at 40 Hz, trees found in laser scans, and GPS.

Source: José Guivant and Eduardo Nebot (University of Sydney), *Optimization of the simultaneous localization and
map-building algorithm for real-time implementation*, IEEE T-RA 17(3), 2001; this layout with trees already found in the
scans circulates with several SLAM codes. Terms: none stated; the usual citation.

Files: ``trees.mat``, or the folder that has it, and beside it ``aa3_gpsx.mat`` (optional here)::

    time (1, N) [s]; u (2, N) speed of the left rear wheel [m/s] and steering angle [rad]
    TLsr (1, K) times of the scans [s]; zt (1, K) cells (3, n) of range [m], bearing 0 to pi, diameter [m] of trees
    timeGps (G, 1) [ms]; Lo_m, La_m (G, 1) east and north [m]

Pose: the middle of the rear axle; x is east, y north. The car is an Ackermann one: the encoder sits on a rear wheel,
H = 0.76 m off the middle, and with L = 2.83 m between the axles nu = v / (1 - tan(alpha) H / L), omega = nu tan(alpha) /
L. Bearings have pi/2 straight ahead, and the laser sits a = 3.78 m ahead and b = 0.5 m to the left of the pose.
Oddities: a sighting does not tell its tree (`UNIDENTIFIED`); the sources differ on a (3.78 or 0.95 m); the first scans
come before the odometry and are left out. GPS gives positions only, of its own antenna, with jumps of metres and gaps
up to a minute: it is interpolated over at most `GPS_GAP` seconds. No noise is published: `SENSOR` has working values.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError
from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..sources.synchronize import Stream, join
from .base import Format
from .mat import is_mat, numbers, read_mat, variables

#: the car [m]: between the axles, encoder off the middle, laser ahead and to the left of the rear axle's middle
WHEEL_BASE, ENCODER, LASER = 2.83, 0.76, (3.78, 0.5)

#: where the drive begins: the first GPS position, and the heading that the sources give
START = (-67.6493, -41.7142, math.radians(35.5))

#: GPS is interpolated between positions at most so far apart [s]
GPS_GAP = 0.5

#: not published: what wheel slip on grass and the extraction of trees leave, set by hand
MOTION = MotionModel.constant(2.0, math.radians(10.0), epsilon=1e-6)
SENSOR = SensorModel(range_rate=0.0, range_std=0.5, bearing_std=math.radians(1.5), offset=LASER)


def _recognises(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return (path / "trees.mat").is_file()
    return is_mat(head) and {"zt", "TLsr"} <= variables(path)


def ackermann(speed: Array, steering: Array) -> Array:
    """(nu, omega) (N, 2) of the rear axle's middle, from the speed of the left rear wheel and the steering angle."""
    tangent = np.tan(steering)
    nu = speed / (1 - tangent * ENCODER / WHEEL_BASE)
    return np.column_stack([nu, nu * tangent / WHEEL_BASE])


def _read(path: Path, *, keep_every: float | None = None) -> Log:
    if path.is_dir():
        path = path / "trees.mat"
        if not path.is_file():
            raise FormatError(path, None, "this file of the data set is missing; it would hold the whole drive")
    content = read_mat(path, ("time", "u", "TLsr", "zt"))
    times = numbers(path, "time", content["time"], (1, None))[0]
    u = numbers(path, "u", content["u"], (2, len(times)))
    scan_times, scans = numbers(path, "TLsr", content["TLsr"], (1, None))[0], content["zt"].ravel()
    if len(scans) != len(scan_times):
        raise FormatError(path, None, f"zt has {len(scans)} scans, but TLsr {len(scan_times)} times")
    trees = [_trees(path, k, scan) for k, scan in enumerate(scans)]
    found = np.concatenate(trees, axis=1) if trees else np.empty((3, 0))
    if found.shape[1] == 0:
        raise FormatError(path, None, "no sighting of any landmark: nothing to estimate from")
    seen_at = np.repeat(scan_times, [scan.shape[1] for scan in trees])
    notes, gps, gps_path = [], None, path.parent / "aa3_gpsx.mat"
    if gps_path.is_file():
        gps = _gps(gps_path)
    else:
        notes.append("aa3_gpsx.mat, which would hold the GPS positions, is missing: read without truth")
    sightings = np.column_stack([found[0], found[1] - np.pi / 2])
    try:
        return join(
            Stream(times, ackermann(u[0], u[1])), Stream(seen_at, sightings),
            np.full(len(seen_at), UNIDENTIFIED), truth=gps, truth_gap=GPS_GAP, start=START, keep_every=keep_every,
            name="victoria-park", notes=tuple(notes), motion=MOTION, sensor=SENSOR,
        )  # fmt: skip
    except LogError as error:
        raise FormatError(path, None, str(error)) from None


def _trees(path: Path, k: int, scan: np.ndarray) -> Array:
    """The trees (3, n) of a scan; some empty scans are stored as 0 x 0."""
    return np.empty((3, 0)) if scan.size == 0 else numbers(path, f"zt{{{k + 1}}}", scan, (3, None))


def _gps(path: Path) -> Stream:
    content = read_mat(path, ("timeGps", "Lo_m", "La_m"))
    times = numbers(path, "timeGps", content["timeGps"], (None, 1))[:, 0] / 1000
    east, north = (numbers(path, name, content[name], (len(times), 1))[:, 0] for name in ("Lo_m", "La_m"))
    if np.any(np.diff(times) < 0):
        raise FormatError(path, None, f"timeGps runs backwards at row {int(np.argmax(np.diff(times) < 0)) + 2}")
    return Stream(times, np.column_stack([east, north]))


FORMAT = Format("victoria-park", (), _recognises, _read, options=("keep_every",))
