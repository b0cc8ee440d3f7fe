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
Peculiarities: sightings have no id of their tree (`UNIDENTIFIED`); the sources differ on a (3.78 or 0.95 m); the first
scans come before the odometry and are left out. GPS gives positions only, of its own antenna, with jumps of metres and
gaps up to a minute: it is interpolated over short gaps only, as every truth (`synchronize`). The antenna sits at the
laser (`Log.truth_offset`): the errors of a trajectory that was estimated without GPS are smallest there, see
docs/results.md. No noise is published: `MOTION` is measured in the log, without GPS, and `SENSOR` is our choice.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..log import UNIDENTIFIED, Log
from ..log.rows import ReadOptions
from ..log.streams import Stream, synchronize
from ..models import MotionModel, SensorModel
from ..se2 import Array, mounted
from .base import NO_SIGHTING, Format, errors_name, member, optional_member
from .mat import Shape, has_variables, numbers, read_mat

#: the car [m]: distance of the axles, encoder off the middle, laser ahead and to the left of the rear axle's middle
WHEEL_BASE, ENCODER, LASER = 2.83, 0.76, (3.78, 0.5)

#: the first position of the antenna by GPS, with the heading that the sources give
START = (-67.6493, -41.7142, math.radians(35.5))
#: where the antenna is from the rear axle's middle [m], as the laser is
ANTENNA = LASER

#: no noise is published. That of motions has nearly the highest evidence of the log (`docs/results.md`); that of sightings
#: was chosen by hand, wider than their root mean square, 0.17 m and 0.43 degrees, because successive ones err alike
MOTION = MotionModel(nn=0.02, no=0.0, on=0.0025, oo=0.025, slip=0.05, epsilon=1e-6)
SENSOR = SensorModel.constant(0.5, math.radians(1.5), offset=LASER)

_SHAPES: dict[str, Shape | None] = {"time": (1, "times"), "u": (2, "times"), "TLsr": (1, "scans"), "zt": None}


def _recognises(path: Path, head: bytes) -> bool:
    return (path / "trees.mat").is_file() if path.is_dir() else has_variables(path, head, "zt", "TLsr")


def ackermann(speed: Array, steering: Array) -> Array:
    """(nu, omega) (N, 2) of the rear axle's middle, from the speed of the left rear wheel and the steering angle."""
    tangent = np.tan(steering)
    nu = speed / (1 - tangent * ENCODER / WHEEL_BASE)
    return np.column_stack([nu, nu * tangent / WHEEL_BASE])


def _read(path: Path, options: ReadOptions) -> Log:
    if path.is_dir():
        path = member(path, "trees.mat", "the whole drive")
    content = read_mat(path, _SHAPES)
    (times,), (scan_times,), scans = content["time"], content["TLsr"], content["zt"].ravel()
    if len(scans) != len(scan_times):
        raise FormatError(path, None, f"zt has {len(scans)} scans, but TLsr {len(scan_times)} times")
    # some empty scans are stored as 0 x 0
    trees = [numbers(path, f"zt{{{k}}}", scan, (3, "trees")).T for k, scan in enumerate(scans, start=1) if scan.size]
    if not trees:
        raise FormatError(path, None, NO_SIGHTING)
    seen = np.concatenate(trees)
    seen_at = np.repeat(scan_times, [scan.shape[1] if scan.size else 0 for scan in scans])
    notes: list[str] = []
    gps_path = optional_member(path.parent, "aa3_gpsx.mat", "the GPS positions as truth", notes)
    with errors_name(path):
        return synchronize(
            Stream(times, ackermann(*content["u"])),
            Stream(seen_at, seen[:, :2] - [0.0, np.pi / 2]),
            np.full(len(seen_at), UNIDENTIFIED),
            options=options,
            truth=None if gps_path is None else _gps(gps_path),
            truth_offset=ANTENNA,
            start=mounted(START, (-ANTENNA[0], -ANTENNA[1])),
            name="victoria-park",
            notes=tuple(notes),
            motion=MOTION,
            sensor=SENSOR,
        )


def _gps(path: Path) -> Stream:
    content = read_mat(path, dict.fromkeys(("timeGps", "Lo_m", "La_m"), ("rows", 1)))
    times, positions = content["timeGps"][:, 0] / 1000, np.column_stack([content["Lo_m"], content["La_m"]])
    return Stream(times, positions)


FORMAT = Format("victoria-park", _recognises, _read, separate_times=True)
