"""The limits of a motion, and motions of a sensor that sits at an offset to the robot."""

from __future__ import annotations

import numpy as np

from graphslam.errors import OptionError
from graphslam.models import SensorModel
from graphslam.se2 import Array, transform

#: a larger turn in one step [rad] is an error in the input, and the engine's sine is not made for it
LARGEST_TURN = 1e5
#: a longer way in one step [m], 25 times round the Earth, is an error in the input
LARGEST_WAY = 1e9


def check_motion(step: int, way: float, turn: float) -> None:
    """Raise `OptionError` where the way [m] or the turn [rad] of a step, with its noise, is an error in the input."""
    if not (way <= LARGEST_WAY and turn <= LARGEST_TURN):
        raise OptionError(
            f"step {step}: the control and its noise move the robot by up to {way:g} m and turn it by up to {turn:g} rad; "
            f"more than {LARGEST_WAY:g} m or {LARGEST_TURN:g} rad is refused"
        )


def sensor_motions(sensor: SensorModel, motions: Array, covariances: Array) -> tuple[Array, Array]:
    """Return the motions (T, 3) and covariances (T, 3, 3) of the sensor, given those of the robot that carries it."""
    if sensor.centred:
        return motions, covariances
    end = sensor.mount(motions)
    lever = end[:, :2] - motions[:, :2]
    J = np.broadcast_to(np.eye(3), (len(motions), 3, 3)).copy()
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    return end - np.array([*sensor.offset, 0.0]), J @ covariances @ np.swapaxes(J, 1, 2)


def robot_poses(sensor: SensorModel, poses: Array) -> Array:
    """Return the poses (..., 3) of the robot, given those of the sensor that it carries."""
    if sensor.centred:
        return poses
    ahead, left = sensor.offset
    return np.concatenate([transform(poses, np.array([-ahead, -left])), poses[..., 2:]], axis=-1)
