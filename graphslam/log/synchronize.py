"""`synchronize`: odometry, sightings and ground truth with separate times, brought together in one `Log`.

There are poses only where something was seen. Between them nothing is rounded to a grid: a control holds from its own
time to that of the next, an event in between divides it, and the pieces stay in the log (`Log.control_starts`), so that
motions and their covariances are accumulated exactly.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LogError, decimals
from ..models import MotionModel
from ..se2 import Array, mounted
from .log import Log
from .measurements import AbsolutePositions, PartialSightings, PoseRelations
from .rows import ReadOptions
from .streams import TRUTH_GAP, Stream, distinct, divide, gap_note, in_order, pieces_of, truth_at

#: a note tells where more than this part of the time of the odometry has no pose, because nothing was seen
UNUSED = 0.1


def synchronize(
    odometry: Stream,
    sightings: Stream,
    landmarks: np.ndarray,
    *,
    options: ReadOptions | None = None,
    truth: Stream | None = None,
    relations: Stream | None = None,
    positions: Stream | None = None,
    truth_offset: tuple[float, float] = (0.0, 0.0),
    true_landmarks: Mapping[int, Array] | None = None,
    classes: ArrayLike | None = None,
    start: ArrayLike | None = None,
    origin: float = 0.0,
    name: str = "log",
    notes: tuple[str, ...] = (),
    **models: Any,
) -> Log:
    """The log of a robot whose odometry, sightings and ground truth have separate times.

    Args:
        odometry: controls (nu, omega) (N, 2), each held until the time of the next one. Rows of every stream that are out
            of order by at most `MOST_DISORDER` are sorted, with a note.
        sightings: (K, 2 or 3); those before the first or after the last odometry are left out, with a note.
        landmarks: (K,) ids.
        options: ``keep_every``, the greatest time between poses; default: poses only where something was seen.
        truth: poses (G, 3), interpolated in SE(2), or positions (G, 2), interpolated along lines.
        relations: at the time of the first pose: (time of the second pose, dx, dy, dtheta, C), C the nine numbers of the
            covariance. There are poses at the times of relations and positions, too.
        positions: (x, y, theta, C, lever).
        truth_offset: the point of the robot to which the truth belongs, see `Log`.
        true_landmarks: {id: position}.
        classes: (K,) what each sighting looks like, see `Log`.
        start: the first pose (3,); default: the true one, or (0, 0, 0) where it is unknown.
        origin: the time from which the times of the streams count [s]; it is added to ``start_time`` of the log only.
        name, notes, models: of the `Log`.

    Odometry that is silent for longer than `BRIDGED_GAP` is bridged by `bridge`, with noise and a warning. The truth is
    unknown between samples farther apart than `TRUTH_GAP`.

    Raises:
        LogError: nothing is seen while there is odometry, or times run backwards by more than `MOST_DISORDER`.
    """
    remarks = list(notes)
    odometry = in_order("odometry", odometry, remarks)[0]
    sightings, order = in_order("sightings", sightings, remarks)
    landmarks = np.asarray(landmarks)[order]
    if truth is not None:
        truth = in_order("truth", truth, remarks)[0]
    if len(odometry) < 2:
        raise LogError(f"the odometry has {len(odometry)} rows, but motion takes two")
    inside = (sightings.times >= odometry.times[0]) & (sightings.times <= odometry.times[-1])
    if not inside.any():
        raise LogError("no landmark is seen while there is odometry, so the log would have no pose")
    if not inside.all():
        remarks.append(f"{np.sum(~inside)} of {len(inside)} sightings are from before or after the odometry: left out")
    seen = sightings.times[inside]
    measured = {
        what: _inside(what, stream, odometry, remarks)
        for what, stream in (("relations", relations), ("positions", positions))
        if stream is not None
    }
    others = [each.times for each in measured.values()] + [
        each.rows[:, 0] for what, each in measured.items() if what == "relations"
    ]
    times = distinct(np.sort(np.concatenate([seen, *others]), kind="stable"))
    if options is not None and options.keep_every is not None:
        times = _filled(times, options.keep_every)
    controls, dt, recorded_dt, starts, variances, gaps = divide(odometry, times)
    if gaps:
        remarks.append(gap_note(gaps))
        warnings.warn(f"{name}: {remarks[-1]}", UserWarning, stacklevel=3)
    before, after = times[0] - odometry.times[0], odometry.times[-1] - times[-1]
    if before + after > UNUSED * (odometry.times[-1] - odometry.times[0]):
        what = "measurement" if others else "sighting"
        ends = ((before, f"before the first {what}"), (after, f"after the last {what}"))
        unseen = " and ".join(f"{decimals(lasting, 1)} s {where}" for lasting, where in ends if lasting > 0)
        remarks.append(
            f"the odometry of {unseen} is left out: poses are where something was {'measured' if others else 'seen'}"
        )
    true_poses = None if truth is None else truth_at(times, truth)
    if truth is not None and true_poses is not None:
        covered = np.isfinite(true_poses[:, 0])
        if not covered.any():
            true_poses = None
            remarks.append("the truth covers no pose" + _why_not_covered(times, truth))
        elif not covered.all():
            remarks.append(f"the truth covers {covered.sum()} of {len(covered)} poses")
    true_path = None
    if true_poses is not None and truth is not None:
        true_path = truth_at(times[0] + np.concatenate([[0.0], np.cumsum(dt)]), truth)
        true_path[starts] = true_poses
    if start is None:
        start = np.zeros(3)
        if true_poses is not None and not np.isnan(true_poses[0]).any():
            start = mounted(true_poses[0], (-truth_offset[0], -truth_offset[1]))
    steps, ids = np.searchsorted(times, seen), landmarks[inside]
    classes = None if classes is None else np.asarray(classes)[order][inside]
    rows = sightings.rows[inside]
    if (alone := np.isnan(rows[:, :2]).any(axis=1)).any():
        have = "has" if np.sum(alone) == 1 else "have"
        remarks.append(f"{np.sum(alone)} of {len(alone)} sightings {have} a range or a bearing alone")
        measured_alone = PartialSightings(
            steps=steps[alone], landmarks=ids[alone], ranges=rows[alone, 0], bearings=rows[alone, 1]
        )
        models["partial_sightings"] = measured_alone
        steps, ids, rows = steps[~alone], ids[~alone], rows[~alone]
        classes = None if classes is None else classes[~alone]
    return Log(
        dt=dt,
        controls=controls,
        control_starts=starts,
        control_variances=variances,
        recorded_dt=recorded_dt,
        steps=steps,
        landmarks=ids,
        sightings=rows,
        classes=classes,
        relations=_relations(measured.get("relations"), times),
        positions=_positions(measured.get("positions"), times),
        initial_poses=MotionModel().dead_reckoning(start, controls, dt)[starts],
        true_poses=true_poses,
        true_path=true_path,
        truth_offset=truth_offset,
        true_landmarks=None if true_landmarks is None else {**true_landmarks},
        start_time=origin + float(times[0]),
        name=name,
        notes=tuple(remarks),
        **models,
    )


def _inside(what: str, stream: Stream, odometry: Stream, remarks: list[str]) -> Stream:
    """The rows of relations or positions within the time of the odometry, with a remark about the others."""
    begin, end = odometry.times[0], odometry.times[-1]
    inside = (stream.times >= begin) & (stream.times <= end)
    if what == "relations":
        inside &= (stream.rows[:, 0] >= begin) & (stream.rows[:, 0] <= end)
    if not inside.any():
        raise LogError(f"no row of the {what} is within the time of the odometry: is its clock another one?")
    if not inside.all():
        remarks.append(f"{np.sum(~inside)} of {len(inside)} {what} are from before or after the odometry: left out")
    return Stream(stream.times[inside], stream.rows[inside])


def _relations(stream: Stream | None, times: Array) -> PoseRelations | None:
    """The relations of a log with poses at ``times`` (T+1,)."""
    if stream is None:
        return None
    first, second = (np.searchsorted(times, each) for each in (stream.times, stream.rows[:, 0]))
    covariances = stream.rows[:, 4:].reshape(-1, 3, 3)
    return PoseRelations(first=first, second=second, motions=stream.rows[:, 1:4], covariances=covariances)


def _positions(stream: Stream | None, times: Array) -> AbsolutePositions | None:
    """The positions of a log with poses at ``times`` (T+1,)."""
    if stream is None:
        return None
    steps, places, covariances, levers = np.searchsorted(times, stream.times), *np.split(stream.rows, [3, 12], axis=1)
    return AbsolutePositions(steps=steps, places=places, covariances=covariances.reshape(-1, 3, 3), levers=levers)


def _why_not_covered(times: Array, truth: Stream) -> str:
    """The cause why `truth_at` finds nothing: rows too far apart, or another time; empty for fewer than two rows."""
    if len(truth) < 2:
        return ""
    at = np.unique(truth.times)
    if len(at) < 2 or at[0] > times[-1] or at[-1] < times[0]:
        return ": its times lie before or after the poses"
    spacing = float(np.median(np.diff(at)))
    return f": its rows are {spacing:.3g} s apart (median), and it is interpolated between rows at most {TRUTH_GAP:g} s apart"


def _filled(times: Array, most: float) -> Array:
    """The times with others inserted, so that neighbours are at most ``most`` apart."""
    pieces = pieces_of(np.diff(times), most)
    first = np.repeat(times[:-1], pieces)
    part = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    between = first + part * np.repeat(np.diff(times) / pieces, pieces)
    return np.append(between, times[-1])
