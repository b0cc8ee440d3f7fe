"""The motion of the particles in one step: drawn from a noisy control, or from the Gaussian of a whole motion.

FastSLAM 2.0 predicts the same motions as Gaussians. Blocks and the order of the axes are described in `blocks`, the
random numbers n in `noise`.

Source: Thrun, Burgard and Fox, *Probabilistic Robotics*, section 5.3; `MotionModel.accumulate` for whole motions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from graphslam.errors import OptionError
from graphslam.models import SensorModel
from graphslam.se2 import Array, transform

from . import proposal
from .blocks import BLOCK, Three, copy_in, copy_out, get_nine
from .fast_math import OPTIONS, sincos, wrap_angle
from .kalman import draw_pose
from .noise import normal_pair, three_normals
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
        return draw_by_control, (*self[:7], self.epsilon**0.5, moved)

    def predict(self, belief: Array, exact: bool) -> Job:
        """Return the job that writes the predicted poses as Gaussians (9, N); ``exact``: those that `weighted` weighs."""
        angle, mean, covariance = chord_gaussian(self.nu, self.omega, self.nu_std**2, self.omega_std**2, self.dt)
        epsilon = self.epsilon
        if exact:
            epsilon = proposal.widened(epsilon, covariance[0] + covariance[3] + covariance[5])
        return predict, (self.poses, angle, mean, covariance, epsilon, belief)

    def weighted(self) -> proposal.Motion:
        """Return what a draw with its exact weight needs of the motion."""
        return proposal.Motion(*proposal.control_motion(*self[2:], *chord(self.nu, self.omega, self.dt)))


class GaussianMotion(NamedTuple):
    """Each particle moves, in its own axes, by a draw of N(mean, covariance); (3,) and (3, 3)."""

    poses: Array
    key: np.uint64
    mean: Array
    covariance: Array

    def draw(self, moved: Array) -> Job:
        """Return the job that writes the moved poses (3, N)."""
        root = np.linalg.cholesky(self.covariance)[np.tril_indices(3)]
        return draw_by_gaussian, (self.poses, self.key, tuple(self.mean.tolist()), tuple(root.tolist()), moved)

    def predict(self, belief: Array, exact: bool) -> Job:  # noqa: ARG002, as in `ControlMotion`
        """Return the job that writes the predicted poses as Gaussians (9, N), ``exact`` or not."""
        covariance = tuple(self.covariance[np.triu_indices(3)].tolist())
        return predict, (self.poses, 0.0, tuple(self.mean.tolist()), covariance, 0.0, belief)

    def weighted(self) -> proposal.Motion:
        """Return what a draw with its exact weight needs of the motion."""
        covariance = tuple(self.covariance[np.triu_indices(3)].tolist())
        mean = tuple(self.mean.tolist())
        return proposal.Motion._make((0.0, mean, *proposal.whiten(covariance), *proposal.NO_CONTROL))


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


@njit(**OPTIONS)
def draw_by_control(
    lo: int, hi: int, poses: Array, key: np.uint64, nu: float, omega: float, nu_std: float, omega_std: float, dt: float,
    pose_std: float, moved: Array,
) -> None:  # fmt: skip
    """x_t = f(x_{t-1}, u + std n_01) + pose_std n_234, the heading wrapped; poses (3, N)."""
    b = np.empty((6, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            n0, n1 = normal_pair(key, start + i, 0)
            n2, n3 = normal_pair(key, start + i, 1)
            n4, _ = normal_pair(key, start + i, 2)
            a = (omega + omega_std * n1) * dt / 2
            sine, _ = sincos(a)
            chord = (nu + nu_std * n0) * dt * (sine / a if a != 0.0 else 1.0)
            s, c = sincos(b[2, i] + a)
            b[3, i] = b[0, i] + chord * c + pose_std * n2
            b[4, i] = b[1, i] + chord * s + pose_std * n3
            b[5, i] = wrap_angle(b[2, i] + 2 * a + pose_std * n4)
        copy_out(b, 3, moved, start, n)


@njit(**OPTIONS)
def draw_by_gaussian(
    lo: int, hi: int, poses: Array, key: np.uint64, mean: Three, root: tuple[float, ...], moved: Array
) -> None:
    """Move each pose in its own axes by a draw of N(mean, L L'); root: the lower triangle of L, row by row."""
    dx, dy, turn = mean
    l00, l10, l11, l20, l21, l22 = root
    b = np.empty((6, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            n0, n1, n2 = three_normals(key, start + i)
            ahead, left = dx + l00 * n0, dy + l10 * n0 + l11 * n1
            s, c = sincos(b[2, i])
            b[3, i] = b[0, i] + c * ahead - s * left
            b[4, i] = b[1, i] + s * ahead + c * left
            b[5, i] = wrap_angle(b[2, i] + turn + l20 * n0 + l21 * n1 + l22 * n2)
        copy_out(b, 3, moved, start, n)


@njit(**OPTIONS)
def chord(nu: float, omega: float, dt: float) -> tuple[float, Three, tuple[float, float, float, float]]:
    """Return the motion of a control in the axes of its chord, which lies at omega dt / 2.

    The result is that angle, the motion (chord, 0, turn), and the entries of A = df/du that are not zero: nu moves along
    the chord; omega moves along and across it, and turns.
    """
    a = omega * dt / 2
    sine, cosine = sincos(a)
    if a * a < 0.09:
        # d/da (sin(a) / a) as a series, exact to rounding where the difference below would cancel
        q = a * a
        slope = -1 / 3 + q * (1 / 30 + q * (-1 / 840 + q * (1 / 45360 + q * (-1 / 3991680 + q / 518918400))))
        slope *= a
    else:
        slope = (cosine - sine / a) / a
    sinc = sine / a if a != 0.0 else 1.0
    return a, (nu * dt * sinc, 0.0, 2 * a), (dt * sinc, nu * dt * dt / 2 * slope, nu * dt * dt / 2 * sinc, dt)


@njit(**OPTIONS)
def chord_gaussian(
    nu: float, omega: float, nu_var: float, omega_var: float, dt: float
) -> tuple[float, Three, tuple[float, ...]]:
    """Return the angle and the motion of `chord`, and the upper triangle of A M A', for `predict`."""
    angle, mean, (by_nu, along, across, turn) = chord(nu, omega, dt)
    return angle, mean, (
        by_nu * by_nu * nu_var + along * along * omega_var, along * across * omega_var, along * turn * omega_var,
        across * across * omega_var, across * turn * omega_var, turn * turn * omega_var,
    )  # fmt: skip


@njit(**OPTIONS)
def predict(
    lo: int, hi: int, poses: Array, angle: float, mean: Three, covariance: tuple[float, ...], epsilon: float, belief: Array
) -> None:  # fmt: skip
    """Predict each pose as a Gaussian (9, N): moved by N(mean, covariance) in axes turned by ``angle``, plus epsilon I."""
    dx, dy, turn = mean
    p_aa, p_ac, p_at, p_cc, p_ct, p_tt = covariance
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i] + angle)
            b[3, i] = b[0, i] + c * dx - s * dy
            b[4, i] = b[1, i] + s * dx + c * dy
            b[5, i] = wrap_angle(b[2, i] + turn)
            b[6, i] = c * c * p_aa - 2 * c * s * p_ac + s * s * p_cc + epsilon
            b[7, i] = c * s * (p_aa - p_cc) + (c * c - s * s) * p_ac
            b[8, i] = c * p_at - s * p_ct
            b[9, i] = s * s * p_aa + 2 * c * s * p_ac + c * c * p_cc + epsilon
            b[10, i] = s * p_at + c * p_ct
            b[11, i] = p_tt + epsilon
        copy_out(b, 3, belief, start, n)


@njit(**OPTIONS)
def draw(lo: int, hi: int, belief: Array, key: np.uint64, poses: Array) -> None:
    """Draw each pose from its Gaussian, x_t ~ N(mean, P), with the first three numbers of the motion."""
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, belief, start, n)
        for i in range(n):
            n0, n1, n2 = three_normals(key, start + i)
            b[9, i], b[10, i], b[11, i] = draw_pose(get_nine(b, 0, i), n0, n1, n2)
        copy_out(b, 9, poses, start, n)
