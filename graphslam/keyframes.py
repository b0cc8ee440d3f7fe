"""A log with further poses: where nothing was seen for a while, or at given times."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .checks import check_positive, first
from .continuous_time import control_path
from .errors import LogError
from .log import Log
from .measurements import MEASURED
from .se2 import Array
from .sources.streams import Stream, pieces_of, truth_at

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
    check_positive(keep_every=seconds)
    if log.controls is None or log.dt is None:
        raise LogError(f"{log.name} has no controls, so there is nothing between its poses to keep")
    # without the start time, which may be so large that fractions of a second are lost
    ends = np.concatenate([[0.0], np.cumsum(log.dt)])
    old = ends[log.control_starts]
    lasting = np.diff(old)
    parts = pieces_of(lasting, seconds)
    # between two sessions there is nothing to keep
    parts[[each.start - 1 for each in log.sessions[1:]]] = 1
    if np.all(parts == 1):
        return log
    motion = np.repeat(np.arange(len(parts)), parts)
    part = np.arange(len(motion)) - np.repeat(np.cumsum(parts) - parts, parts)
    return _with_poses(log, np.append(old[motion] + part * (lasting / parts)[motion], old[-1]))


def with_poses_at(log: Log, times: Array) -> Log:
    """The log with poses at further times (N,) [s] within those of its poses; the new ones have no sightings.

    Raises:
        LogError: the log has no controls, or a time is before its first or after its last pose.
    """
    if log.times is None or log.dt is None:
        raise LogError(f"{log.name} has no controls, so there is nothing between its poses to keep")
    begin, end = log.times[[0, -1]].tolist()
    if (k := first((times < begin) | (times > end))) is not None:
        raise LogError(f"{log.name} has no pose at {times[k]:.3f} s: its poses are from {begin:.3f} to {end:.3f} s")
    ends = np.concatenate([[0.0], np.cumsum(log.dt)])
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
    ends = np.concatenate([[0.0], np.cumsum(log.dt)])
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
    measured: dict[str, Any] = {
        name: each.moved({end: kept[getattr(each, end)] for end in each.ENDS}) for name, each in log.measured.items()
    }
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
