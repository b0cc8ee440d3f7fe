"""Poses along the whole drive: between two poses of a log a path follows the recorded controls.

A log has poses only where something was seen, and several controls may lie between two of them. The path there is the
mean of the motion model given both poses: the controls are followed from the first one, and what is missing at the
second one is shared among them by their noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .log import Log
from .models import MotionModel
from .se2 import Array, between, compose, wrap


@dataclass(frozen=True, eq=False)
class DensePath:
    """A path at the end of every control.

    Attributes:
        times: (K,) [s]; the numbers of the steps in a log without controls.
        poses: (K, 3); NaN between poses of which one is.
        rows: (T+1,) the rows of the poses of the log.
    """

    times: Array
    poses: Array
    rows: np.ndarray


def dense_path(
    log: Log, poses: ArrayLike, motion: MotionModel | None = None, *, most_turn: float = np.inf
) -> DensePath:
    """The path of an estimate at the end of every control.

    Motion t begins at x_t and follows its controls u_1 ... u_k, each with noise of covariance M_i, to d_k in the axes of
    x_t. Its last pose should be y = x_t^-1 x_{t+1}. To first order the noise n_i of control i moves the later pose d_k by
    S_k B_i n_i, where S_k = [[1, 0, -d_ky], [0, 1, d_kx], [0, 0, 1]] and B_i does not depend on k. Hence the mean given y
    is d_k + S_k C_k S_e' (S_e C_e S_e')^-1 (y - d_e), with C_k = sum over i <= k of B_i M_i B_i' and e the last control.
    The part epsilon of the motion model is spread evenly over time.

    Args:
        log: without controls there is nothing to follow, and the path consists of the poses.
        poses: (T+1, 3), such as the ``poses`` of a solution; rows may be NaN.
        motion: default: that of the log, else the book's.
        most_turn: a control that turns farther [rad] is divided, so that lines through the poses follow its arc.

    Source: the conditional mean of a Gaussian; Thrun, Burgard and Fox, *Probabilistic Robotics*, section 3.2.
    """
    poses = np.array(poses, dtype=float)
    if log.controls is None or log.dt is None or log.times is None or len(log.controls) == 0:
        return DensePath(np.arange(len(poses), dtype=float), poses, np.arange(len(poses)))
    motion = motion or log.motion or MotionModel()
    pieces = np.maximum(1, np.ceil(np.abs(log.controls[:, 1]) * log.dt / most_turn)).astype(np.int64)
    controls, dt = np.repeat(log.controls, pieces, axis=0), np.repeat(log.dt / pieces, pieces)
    rows = np.concatenate([[0], np.cumsum(pieces)])[log.control_starts]
    recorded = log.dt if log.recorded_dt is None else log.recorded_dt
    M = motion.M(controls, dt, np.repeat(recorded, pieces))
    if log.control_variances is not None:
        M[:, [0, 1], [0, 1]] += np.repeat(log.control_variances, pieces, axis=0)

    # f is affine in (x, y): each control begins at the origin, with the heading that it has within its motion
    first, last, motion_of = rows[:-1], rows[1:] - 1, np.repeat(np.arange(len(rows) - 1), np.diff(rows))
    before = np.zeros((len(controls), 3))
    before[:, 2] = _sums(controls[:, 1] * dt, first, motion_of) - controls[:, 1] * dt
    driven = _sums(motion.f(before, controls, dt) - before, first, motion_of)
    B = motion.A(before, controls, dt)
    B[:, 0, :] += driven[:, 1, None] * B[:, 2, :]
    B[:, 1, :] -= driven[:, 0, None] * B[:, 2, :]
    C = _sums(B @ M @ np.swapaxes(B, 1, 2), first, motion_of)
    share = _sums(dt, first, motion_of)
    share /= share[last][motion_of]

    S = _moved(driven)
    end = S[last]
    missing = between(poses[:-1], poses[1:]) - driven[last]
    missing[:, 2] = wrap(missing[:, 2])
    covariance = end @ C[last] @ np.swapaxes(end, 1, 2) + motion.epsilon * np.eye(3)
    weighted = np.linalg.solve(covariance, missing[:, :, None])
    even = motion.epsilon * np.linalg.solve(end, weighted)
    toward = (np.swapaxes(end, 1, 2) @ weighted)[motion_of]
    correction = S @ (C @ toward + share[:, None, None] * even[motion_of])
    path = np.concatenate([poses[:1], compose(poses[motion_of], driven + correction[:, :, 0])])
    path[rows] = poses
    times = log.start_time + np.concatenate([[0.0], np.cumsum(dt)])
    times[rows] = log.times
    return DensePath(times, path, rows)


def _sums(values: Array, first: np.ndarray, group: np.ndarray) -> Array:
    """The sums of the values (S, ...) from the first one of their group on."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return total[1:] - total[first][group]


def _moved(poses: Array) -> Array:
    """[[1, 0, -y], [0, 1, x], [0, 0, 1]] of poses (S, 3): how a turn about the origin moves them."""
    S = np.tile(np.eye(3), (len(poses), 1, 1))
    S[:, 0, 2], S[:, 1, 2] = -poses[:, 1], poses[:, 0]
    return S
