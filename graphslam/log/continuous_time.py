"""Poses along the whole drive: between two poses of a log a path follows the recorded controls.

A log has poses only where something was seen, and several controls may lie between two of them. The path there is the
mean of the motion model given both poses: the controls are followed from the first one, and what is missing at the
second one is shared among them by their noise.

`with_poses_every` and `with_poses_at` give a log further poses: where nothing was seen for a while, or at given times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LogError
from ..errors.checks import check_positive, first
from ..models import MotionModel, additional_variances
from ..se2 import Array, between, compose, difference, lever_matrix, perpendicular
from .log import Log
from .measurements import MEASURED
from .streams import Stream, filled, truth_at

#: rounding of sums of durations, as a part of an interval
_TIE = 1e-6


@dataclass(frozen=True, eq=False)
class ControlPath:
    """The controls of a log, prepared to lead through the poses of any estimate; made by `control_path`.

    The path has K rows: the poses of the log, and between them the ends of controls.

    Attributes:
        times: (K,) [s]; the numbers of the steps in a log without controls.
        rows: (T+1,) the rows that are poses of the log, increasing.
        driven: (K-1, 3) each row but the first, reached by the controls alone, seen from the pose before it.
        gain: (K-1, 3, 3) the part of what is missing at the next pose that is added to ``driven``.
    """

    times: Array
    rows: np.ndarray
    driven: Array
    gain: Array

    @property
    def motions(self) -> np.ndarray:
        """The motion to which each row but the first belongs, (K-1,)."""
        return np.repeat(np.arange(len(self.rows) - 1), np.diff(self.rows))

    def through(self, poses: ArrayLike) -> Array:
        """The path (rows of the last pose + 1, 3) through the first poses (n, 3) of a drive, n at most T+1.

        Between poses of which one is NaN the path is NaN.
        """
        poses = np.asarray(poses, dtype=float)
        rows = self.rows[: len(poses)]
        motion = self.motions[: rows[-1]]
        path = np.empty((rows[-1] + 1, 3))
        missing = difference(between(poses[:-1], poses[1:]), self.driven[rows[1:] - 1])
        correction = (self.gain[: rows[-1]] @ missing[motion][:, :, None])[:, :, 0]
        path[1:] = compose(poses[motion], self.driven[: rows[-1]] + correction)
        path[rows] = poses
        return path


def control_path(
    log: Log, motion: MotionModel | None = None, *, interval: float = 0.0, most_turn: float = np.inf
) -> ControlPath:
    """The path between the poses of a log that follows its controls.

    Motion t begins at x_t and follows its controls u_1 ... u_k, each with noise of covariance M_i, to d_k in the axes of
    x_t. It should end at y = x_t^-1 x_{t+1}. To first order the noise n_i of control i moves the later pose d_k by
    S_k B_i n_i, where S_k = [[1, 0, -d_ky], [0, 1, d_kx], [0, 0, 1]] and B_i does not depend on k. Hence the mean given y
    is d_k + S_k C_k S_e' (S_e C_e S_e')^-1 (y - d_e), with C_k = sum over i <= k of B_i M_i B_i' and the slip of i, and e
    the last control. The part epsilon of the motion model is spread evenly over time.

    Args:
        log: without controls there is nothing to follow, and the path consists of the poses.
        motion: default: that of the log, else the book's.
        interval: leave out ends of controls that follow the row before them by less [s].
        most_turn: a control that turns farther [rad] is divided, so that lines through the rows follow its arc.

    Source: the conditional mean of a Gaussian; Thrun, Burgard and Fox, *Probabilistic Robotics*, section 3.2.
    """
    if log.controls is None or log.dt is None or log.times is None or len(log.controls) == 0:
        T = log.num_poses - 1
        return ControlPath(np.arange(T + 1.0), np.arange(T + 1), np.zeros((T, 3)), np.tile(np.eye(3), (T, 1, 1)))
    motion, _ = log.noise_models(motion)
    pieces = np.maximum(1, np.ceil(np.abs(log.controls[:, 1]) * log.dt / most_turn)).astype(np.int64)
    controls, dt = np.repeat(log.controls, pieces, axis=0), np.repeat(log.dt / pieces, pieces)
    rows = np.concatenate([[0], np.cumsum(pieces)])[log.control_starts]
    recorded = log.dt if log.recorded_dt is None else log.recorded_dt
    M = motion.M(controls, dt, np.repeat(recorded, pieces))
    V = np.repeat(additional_variances(log.control_variances, len(log.dt)), pieces, axis=0)
    M[:, [0, 1], [0, 1]] += V[:, :2]

    # f is affine in (x, y): each control begins at the origin, with the heading that it has within its motion
    first, last, motion_of = rows[:-1], rows[1:] - 1, np.repeat(np.arange(len(rows) - 1), np.diff(rows))
    before = np.zeros((len(controls), 3))
    before[:, 2] = _sums(controls[:, 1] * dt, first, motion_of) - controls[:, 1] * dt
    driven = _sums(motion.f(before, controls, dt) - before, first, motion_of)
    B = motion.A(before, controls, dt)
    B = lever_matrix(-perpendicular(driven[:, :2])) @ B
    each = B @ M @ np.swapaxes(B, 1, 2)
    if motion.slip or V[:, 2].any():
        each += motion.sideways(before, controls, dt, V[:, 2])
    C = _sums(each, first, motion_of)
    elapsed = _sums(dt, first, motion_of)
    share = elapsed / elapsed[last][motion_of]

    kept = np.ones(len(controls), dtype=bool)
    if interval > 0:
        kept[1:] = (motion_of[1:] != motion_of[:-1]) | np.diff(np.floor(elapsed / interval + _TIE)).astype(bool)
        kept[last] = True
    S = lever_matrix(perpendicular(driven[:, :2]))
    end = S[last]
    covariance = end @ C[last] @ np.swapaxes(end, 1, 2) + motion.epsilon * np.eye(3)
    inverse = np.linalg.inv(covariance)
    toward, even = np.swapaxes(end, 1, 2) @ inverse, motion.epsilon * np.linalg.inv(end) @ inverse
    of_kept = motion_of[kept]
    gain = S[kept] @ (C[kept] @ toward[of_kept] + share[kept, None, None] * even[of_kept])
    rows = np.concatenate([[0], np.cumsum(kept)])[rows]
    times = log.start_time + np.concatenate([[0.0], np.cumsum(dt)[kept]])
    times[rows] = log.times
    return ControlPath(times, rows, driven[kept], gain)


def _sums(values: Array, first: np.ndarray, group: np.ndarray) -> Array:
    """The sums of the values (S, ...) from the first one of their group on."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return total[1:] - total[first][group]


#: times that are nearer than this [s] are the same
SAME = 1e-9
#: times that are given count as the same up to this [s]: those since 1970 are rounded to 0.2 µs
CLOCK = 1e-6


def with_poses_every(log: Log, seconds: float) -> Log:
    """The log with further poses, so that neighbours are at most ``seconds`` apart; the new ones have no sightings.

    A motion that lasts longer is divided into parts of equal duration, and a control in which such a part ends is divided,
    too. The true poses of the new ones are known where ``true_path`` is.

    Raises:
        LogError: the log has no controls.
        OptionError: ``seconds`` is not positive, or so short that there were too many poses.
    """
    check_positive(seconds=seconds)
    if log.controls is None or log.dt is None:
        raise LogError(f"{log.name} has no controls, so there is nothing between its poses to keep")
    # without the start time, which may be so large that fractions of a second are lost
    old = log.control_times[log.control_starts]
    # between two sessions there is nothing to keep
    times = filled(old, seconds, [each.start - 1 for each in log.sessions[1:]])
    return log if len(times) == len(old) else _with_poses(log, times)


def with_poses_at(log: Log, times: Array) -> Log:
    """The log with poses at further times (N,) [s] within those of its poses; the new ones have no sightings.

    Raises:
        LogError: the log has no controls, or a time is more than `CLOCK` before its first or after its last pose.
    """
    if log.times is None or log.dt is None:
        raise LogError(f"{log.name} has no controls, so there is nothing between its poses to keep")
    begin, end = log.times[[0, -1]].tolist()
    # a sum of durations is rounded: those of one second may end 4e-15 s apart
    if (k := first((times < begin - CLOCK) | (times > end + CLOCK))) is not None:
        raise LogError(f"{log.name} has no pose at {times[k]:.3f} s: its poses are from {begin:.3f} to {end:.3f} s")
    ends = log.control_times
    wanted = times - log.start_time
    there = ends[nearest_of(ends, wanted)]
    wanted = np.where(np.abs(there - wanted) <= CLOCK, there, wanted)
    every = np.union1d(ends[log.control_starts], wanted)
    return log if len(every) == log.num_poses else _with_poses(log, every)


def nearest_of(times: Array, wanted: Array) -> np.ndarray:
    """The rows of increasing times (N,) that are nearest to others (M,)."""
    return np.searchsorted((times[1:] + times[:-1]) / 2, wanted)


def _with_poses(log: Log, times: Array) -> Log:
    """The log with poses at these times since its first one, which contain those of its own poses."""
    assert log.dt is not None and log.controls is not None
    ends = log.control_times
    old = ends[log.control_starts]
    # a part that ends where a control does needs no further cut
    nearest = np.clip(np.searchsorted(ends, times - SAME), 0, len(ends) - 1)
    times = np.where(np.abs(ends[nearest] - times) <= SAME, ends[nearest], times)
    cuts = np.union1d(ends, times)
    control = np.searchsorted(ends, cuts[:-1], side="right") - 1
    whole = np.bincount(control, minlength=len(log.dt))[control] == 1
    dt = np.where(whole, log.dt[control], np.diff(cuts))
    changes: dict[str, Any] = {"dt": dt, "controls": log.controls[control]}
    changes["recorded_dt"] = (log.dt if log.recorded_dt is None else log.recorded_dt)[control]
    if log.control_variances is not None:
        # a variance V of a control that lasts D moves the robot by V D², and its parts together by as much
        changes["control_variances"] = log.control_variances[control] * (log.dt[control] / dt)[:, None]
    finer = replace(log, **changes, control_starts=np.searchsorted(cuts, old), true_path=_true_path(log, ends, cuts))
    starts, kept = np.searchsorted(cuts, times), np.searchsorted(times, old)
    true_poses = None
    if log.true_poses is not None:
        true_poses = np.full((len(times), 3), np.nan) if finer.true_path is None else finer.true_path[starts].copy()
        true_poses[kept] = log.true_poses
    measured: dict[str, Any] = {name: each.moved(lambda steps: kept[steps]) for name, each in log.measured.items()}
    finer = finer.replace(**dict.fromkeys(MEASURED))
    return replace(
        finer, **measured, control_starts=starts,
        sessions=tuple(replace(each, start=int(kept[each.start])) for each in log.sessions),
        steps=kept[log.steps], true_poses=true_poses,
        initial_poses=control_path(finer).through(log.initial_poses)[starts],
    )  # fmt: skip


def _true_path(log: Log, ends: Array, cuts: Array) -> Array | None:
    """The true poses at the cuts, interpolated within the controls that are divided."""
    if log.true_path is None:
        return None
    rows = log.true_path if np.isfinite(log.true_path[:, 2]).any() else log.true_path[:, :2]
    path = truth_at(cuts, Stream(ends, rows))
    path[np.searchsorted(cuts, ends)] = log.true_path
    return path
