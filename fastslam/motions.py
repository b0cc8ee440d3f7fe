"""The motion of the particles in one step: drawn from a noisy control, or from the Gaussian of a whole motion.

Source: Thrun, Burgard and Fox, *Probabilistic Robotics*, section 5.3; `MotionModel.accumulate` for whole motions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphslam.errors import OptionError
from graphslam.models import SensorModel
from graphslam.se2 import Array, transform

from . import motion_kernels as kernels
from .threads import Job

#: a larger turn in one step [rad] is an error in the input, and the compiled sine is not made for it
LARGEST_TURN = 1e5
#: a longer way in one step [m], 25 times round the Earth, is an error in the input
LARGEST_WAY = 1e9


class ControlMotion(NamedTuple):
    """Each particle draws its own control u' ~ N(u, diag(std²)) and moves to f(x, u') + e, e ~ N(0, epsilon I)."""

    poses: Array
    key: np.uint64
    nu: float
    omega: float
    nu_std: float
    omega_std: float
    dt: float
    epsilon: float

    def draw(self, moved: Array) -> Job:
        """Return the job that writes the moved poses (3, N)."""
        return kernels.draw_by_control, (*self[:7], self.epsilon**0.5, moved)

    def predict(self, belief: Array) -> Job:
        """Return the job that writes the predicted poses as Gaussians (9, N)."""
        chord = kernels.chord_gaussian(self.nu, self.omega, self.nu_std**2, self.omega_std**2, self.dt)
        return kernels.predict, (self.poses, *chord, self.epsilon, belief)


class GaussianMotion(NamedTuple):
    """Each particle moves, in its own axes, by a draw of N(mean, covariance); (3,) and (3, 3)."""

    poses: Array
    key: np.uint64
    mean: Array
    covariance: Array

    def draw(self, moved: Array) -> Job:
        """Return the job that writes the moved poses (3, N)."""
        root = np.linalg.cholesky(self.covariance)[np.tril_indices(3)]
        return kernels.draw_by_gaussian, (self.poses, self.key, tuple(self.mean.tolist()), tuple(root.tolist()), moved)

    def predict(self, belief: Array) -> Job:
        """Return the job that writes the predicted poses as Gaussians (9, N)."""
        covariance = tuple(self.covariance[np.triu_indices(3)].tolist())
        return kernels.predict, (self.poses, 0.0, tuple(self.mean.tolist()), covariance, 0.0, belief)


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
