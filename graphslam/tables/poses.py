"""Headings of quaternions, and motions between poses of odometry."""

from __future__ import annotations

import numpy as np

from ..checks import first
from ..models import sinc
from ..se2 import Array, between
from .table import Table

#: quaternions may be this far from length 1; a robot may be tilted by at most this angle [rad]
_LENGTH, _TILT = 0.02, np.deg2rad(45)


def heading(quaternions: Array) -> Array:
    """The direction of the x axis in the plane (N,) [rad] of quaternions (N, 4), x, y, z, w."""
    x, y, z, w = quaternions.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def checked_heading(table: Table, quaternions: Array) -> Array:
    """The headings (N,) of the quaternions (N, 4) of a table, of a robot that stands on the ground.

    Raises:
        LogError: a quaternion is not of length 1, or tilts the robot.
    """
    length = np.linalg.norm(quaternions, axis=1)
    if (k := first(np.abs(length - 1) > _LENGTH)) is not None:
        cause = "no orientation was measured" if length[k] == 0 else "are its columns x, y, z, w in this order?"
        raise table.error(k, f"the quaternion has length {length[k]:.3g}, but a rotation has length 1: {cause}")
    x, y, _, _ = (quaternions / length[:, None]).T
    if (k := first(1 - 2 * (x * x + y * y) < np.cos(_TILT))) is not None:
        tilt = np.rad2deg(np.arccos(np.clip(1 - 2 * (x[k] ** 2 + y[k] ** 2), -1, 1)))
        raise table.error(
            k, f"the quaternion tilts the robot by {tilt:.0f} degrees: are its columns x, y, z, w in this order?"
        )
    return heading(quaternions)


def controls_between(poses: Array, dt: Array) -> tuple[Array, float]:
    """The controls (N, 2) that lead from each pose (N, 3) to the next on an arc, the last one zero.

    Args:
        poses: of the odometry.
        dt: (N-1,) [s], positive.

    Returns:
        The controls, and the share of the distance that is driven sideways, which arcs leave out.
    """
    relative = between(poses[:-1], poses[1:])
    half = relative[:, 2] / 2
    c, s = np.cos(half), np.sin(half)
    # the chord of an arc looks along half its turn
    along, across = c * relative[:, 0] + s * relative[:, 1], c * relative[:, 1] - s * relative[:, 0]
    controls = np.zeros((len(poses), 2))
    controls[:-1, 0] = along / (sinc(half) * dt)
    controls[:-1, 1] = relative[:, 2] / dt
    driven = float(np.sum(np.hypot(along, across)))
    return controls, float(np.sum(np.abs(across))) / driven if driven > 0 else 0.0
