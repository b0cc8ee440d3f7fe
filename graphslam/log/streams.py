"""Rows with times: their order, controls divided between poses, silences of the odometry, and the truth at other times.

`synchronize` brings odometry, sightings and ground truth with separate times together in one `Log`. There are poses only
where something was seen. Between them nothing is rounded to a grid: a control holds from its own time to that of the next, an
event in between divides it, and the pieces stay in the log (`Log.control_starts`), so that motions and their covariances are
accumulated exactly.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LogError, OptionError, decimals
from ..errors.checks import first
from ..models import MotionModel
from ..se2 import Array, interpolate, mounted
from .log import Log
from .measurements import AbsolutePositions, PartialSightings, PoseRelations
from .rows import MOST_POSES, NO_ID, UNIDENTIFIED, ReadOptions

#: odometry is bridged where it is silent for longer [s], and for longer than this number of usual times between rows: its
#: last control fades with this time constant [s]
BRIDGED_GAP, USUAL_GAPS, FADING = 2.0, 3.0, 2.0

#: rows that are out of order by at most this time [s] are sorted; more is another drive, or another clock
MOST_DISORDER = 1.0

#: truth is interpolated between samples that are at most this far apart [s]
TRUTH_GAP = 0.5


@dataclass(frozen=True)
class Stream:
    """Rows of numbers with their times: ``times`` (N,) [s] and ``rows`` (N, ...)."""

    times: Array
    rows: Array

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.times)


def disorder(times: Array) -> Array:
    """How far each time (N,) runs behind the latest one before it [s]; 0 where the times are in order."""
    return np.maximum.accumulate(times) - times if len(times) else times


def in_order(what: str, stream: Stream, remarks: list[str]) -> tuple[Stream, np.ndarray]:
    """The rows sorted by time, with a remark where that changes anything, and the row of each in the order given.

    Raises:
        LogError: rows run backwards by more than `MOST_DISORDER`.
    """
    behind = disorder(stream.times)
    if (k := first(behind > MOST_DISORDER)) is not None:
        late = f"{stream.times[k]:.3f} s comes {behind[k]:.3f} s too late"
        raise LogError(f"the times of the {what} run backwards in row {k + 1}: {late}")
    order = np.argsort(stream.times, kind="stable")
    if moved := np.count_nonzero(behind):
        rows = "row of the {} runs" if moved == 1 else "rows of the {} run"
        remarks.append(f"{moved} {rows.format(what)} backwards, by at most {behind.max():.3g} s: sorted by time")
    return Stream(stream.times[order], stream.rows[order]), order


def divide(odometry: Stream, times: Array) -> tuple[Array, Array, Array, np.ndarray, Array | None, list[float]]:
    """The pieces of the controls between poses at ``times`` (T+1,), which increase and lie within those of the odometry.

    Returns:
        controls (S, 2), dt (S,), recorded_dt (S,), control_starts (T+1,), control_variances (S, 2) or None, and the
        bridged gaps [s].
    """
    within = (odometry.times > times[0]) & (odometry.times < times[-1])
    # two sorted runs are merged, which np.union1d does not know
    cuts = distinct(np.sort(np.concatenate([odometry.times[within], times]), kind="stable"))
    # of several rows with one time the last holds
    row = np.searchsorted(odometry.times, cuts[:-1], side="right") - 1
    silence = odometry.times[np.minimum(row + 1, len(odometry) - 1)] - odometry.times[row]
    lasting = np.diff(cuts)
    bridged = silent(silence, odometry.times)
    gaps = silence[bridged][np.unique(row[bridged], return_index=True)[1]].tolist()
    begin = cuts[:-1] - odometry.times[row]
    controls, variances = bridge(odometry.rows[row], begin, lasting, silence, bridged, odometry.rows)
    return controls, lasting, silence, np.searchsorted(cuts, times), variances, gaps


def distinct(times: Array) -> Array:
    """Times (N,) in order, each once."""
    return times[np.append(True, np.diff(times) > 0)]


def silent(lapse: Array, times: Array) -> np.ndarray:
    """Whether times (N,) [s] from a row of odometry to the next are silences, given the times of all rows."""
    return lapse > max(BRIDGED_GAP, USUAL_GAPS * float(np.median(np.diff(times))))


def bridge(
    controls: Array, begin: Array, lasting: Array, silence: Array, bridged: np.ndarray, recorded: Array
) -> tuple[Array, Array | None]:
    """Control pieces, some of them within silences of the odometry, with honest noise.

    In a silence the robot may go anywhere and turn at will. The mean of its control u fades, u exp(-t / `FADING`) at the time
    t after the last row. The way has a standard deviation of v silence, ahead and to the side, and the heading one of w
    silence, at most pi, where v and w are the root mean squares of all speeds and turn rates.

    Pieces are independent in a log. With variances of one times silence / lasting their sum is the same, however many poses
    are in the silence.

    Args:
        controls: (S, 2) of the rows that the pieces belong to.
        begin, lasting, silence: (S,) how long after its row each piece begins, how long it lasts, and the time from its row
            to the next one [s].
        bridged: (S,) which of them are `silent`.
        recorded: (N, 2) all controls of the odometry.

    Returns:
        The controls (S, 2), and the ``control_variances`` (S, 3) of the `Log`, or None where there is no silence.
    """
    if not bridged.any():
        return controls, None
    share = np.where(bridged, silence / lasting, 0.0)
    speed, turn_rate = np.sqrt(np.mean(recorded**2, axis=0))
    turn_rate = np.minimum(turn_rate, np.pi / silence)
    way = np.full(len(share), speed)
    variances = share[:, None] * np.column_stack([way, turn_rate, way]) ** 2
    left = FADING / lasting * (np.exp(-begin / FADING) - np.exp(-(begin + lasting) / FADING))
    return controls * np.where(bridged, left, 1.0)[:, None], variances


def gap_note(gaps: list[float]) -> str:
    """The note about bridged gaps [s]."""
    lengths = " to ".join(dict.fromkeys((decimals(min(gaps), 1), decimals(max(gaps), 1))))
    which = f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} of {lengths} s in the odometry"
    return f"{which}: bridged, with the noise of a robot that moved and turned at will at its usual speeds"


def truth_at(times: Array, truth: Stream) -> Array:
    """The true poses (T+1, 3) at ``times``, interpolated between samples at most `TRUTH_GAP` apart, NaN elsewhere.

    Positions without headings, (G, 2), become rows (x, y, NaN).
    """
    if len(truth) < 2:
        return np.full((len(times), 3), np.nan)
    # samples with the same time count once
    at, first = np.unique(truth.times, return_index=True)
    rows = truth.rows[first]
    poses = rows if rows.shape[1] == 3 else np.column_stack([rows, np.full(len(rows), np.nan)])
    return poses_at(times, at, poses, TRUTH_GAP)


def poses_at(times: Array, at: Array, poses: Array, longest: float, same: float = 0.0) -> Array:
    """Poses (n, 3) at ``times`` (n,) from those (m, 3) at increasing times, in one unit; NaN where they are not known.

    They lie on the arc between two poses at most ``longest`` apart, on the line between poses without headings. A pose at a
    time that differs by at most ``same`` needs no neighbour.
    """
    after = np.clip(np.searchsorted(at, times, side="right"), min(1, len(at) - 1), len(at) - 1)
    before = np.maximum(after - 1, 0)
    begin, end = at[before], at[after]
    share = np.clip((times - begin) / np.where(end > begin, end - begin, 1), 0.0, 1.0)
    a, b = poses[before], poses[after]
    flat = ~np.isfinite(a[:, 2] + b[:, 2])
    found = np.column_stack([a[:, :2] + share[:, None] * (b - a)[:, :2], np.full(len(times), np.nan)])
    found[~flat] = interpolate(a[~flat], b[~flat], share[~flat])
    exact = (np.abs(times - begin) <= same) | (np.abs(times - end) <= same)
    inside = (times >= at[0]) & (times <= at[-1])
    found[~exact & ~(inside & (end - begin <= longest))] = np.nan
    return found


def filled(times: Array, most: float, whole: Sequence[int] = ()) -> Array:
    """Increasing times (N,) [s] with others inserted, so that neighbours are at most ``most`` apart.

    Args:
        whole: intervals in which nothing is inserted, by the number of the time that begins them.

    Raises:
        OptionError: there would be more than `MOST_POSES`.
    """
    durations = np.diff(times)
    with np.errstate(over="ignore"):
        pieces = np.maximum(1.0, np.ceil(durations / most - 1e-9))
    if pieces.sum() - len(pieces) > MOST_POSES:
        poses = f"{pieces.sum():.3g} poses, more than {MOST_POSES:,}"
        raise OptionError(f"keep_every of {most:g} s would make {poses}; choose a longer time")
    pieces[[*whole]] = 1
    of = np.repeat(np.arange(len(pieces)), pieces.astype(np.int64))
    part = np.arange(len(of)) - (np.cumsum(pieces) - pieces)[of]
    return np.append(times[of] + part * (durations / pieces)[of], times[-1])


#: a note is made where more than this share of the time of the odometry has no pose, because nothing was seen
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
        positions: (x, y, theta, C, lever), or (x, y, theta, C, lever, datum).
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
    if truth is not None:
        truth = in_order("truth", truth, remarks)[0]
    if len(odometry) < 2:
        raise LogError(f"the odometry has {len(odometry)} rows, but motion takes two")
    inside = _inside("sightings", odometry, remarks, sightings.times)
    seen, others = sightings.times[inside], list[Array]()
    measured: dict[str, Stream] = {}
    for what, stream in (("relations", relations), ("positions", positions)):
        if stream is not None:
            at = [stream.times, stream.rows[:, 0]] if what == "relations" else [stream.times]
            kept = _inside(what, odometry, remarks, *at)
            measured[what] = Stream(stream.times[kept], stream.rows[kept])
            others += [each[kept] for each in at]
    times = distinct(np.sort(np.concatenate([seen, *others]), kind="stable"))
    if options is not None and options.keep_every is not None:
        times = filled(times, options.keep_every)
    controls, dt, recorded_dt, starts, variances, gaps = divide(odometry, times)
    if gaps:
        remarks.append(gap_note(gaps))
        warnings.warn(f"{name}: {remarks[-1]}", UserWarning, stacklevel=3)
    _remark_unused(odometry, times, remarks, "measured" if others else "seen")
    true_poses, true_path = (None, None) if truth is None else _truth_of(truth, times, dt, starts, remarks)
    if start is None:
        start = np.zeros(3)
        if true_poses is not None and not np.isnan(true_poses[0]).any():
            start = mounted(true_poses[0], (-truth_offset[0], -truth_offset[1]))
    parts = {"steps": np.searchsorted(times, seen), "landmarks": np.asarray(landmarks)[order][inside]}
    parts["sightings"] = sightings.rows[inside]
    if classes is not None:
        parts["classes"] = np.asarray(classes)[order][inside]
    return Log(
        dt=dt,
        controls=controls,
        control_starts=starts,
        control_variances=variances,
        recorded_dt=recorded_dt,
        **_single_numbers_apart(parts, remarks),
        **{what: _READERS[what](stream, times) for what, stream in measured.items()},
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


def _remark_unused(odometry: Stream, times: Array, remarks: list[str], how: str) -> None:
    """A remark where much odometry lies before the first or after the last of the poses at ``times``."""
    before, after = times[0] - odometry.times[0], odometry.times[-1] - times[-1]
    if before + after > UNUSED * (odometry.times[-1] - odometry.times[0]):
        what = "sighting" if how == "seen" else "measurement"
        ends = ((before, f"before the first {what}"), (after, f"after the last {what}"))
        unseen = " and ".join(f"{decimals(lasting, 1)} s {where}" for lasting, where in ends if lasting > 0)
        remarks.append(f"the odometry of {unseen} is left out: poses are where something was {how}")


def _truth_of(
    truth: Stream, times: Array, dt: Array, starts: np.ndarray, remarks: list[str]
) -> tuple[Array | None, Array | None]:
    """The true poses (T+1, 3) at ``times``, and those (S+1, 3) between the pieces ``dt`` of the controls; None: not known."""
    true_poses = truth_at(times, truth)
    covered = np.isfinite(true_poses[:, 0])
    if not covered.all():
        few = f"{covered.sum()} of {len(covered)} poses" if covered.any() else "no pose"
        remarks.append(f"the truth covers {few}{_why_few(times, truth)}")
    if not covered.any():
        return None, None
    true_path = truth_at(times[0] + np.concatenate([[0.0], np.cumsum(dt)]), truth)
    true_path[starts] = true_poses
    return true_poses, true_path


def _single_numbers_apart(parts: dict[str, Any], remarks: list[str]) -> dict[str, Any]:
    """Steps, landmarks, sightings and classes of a log; ranges and bearings alone become its partial sightings."""
    rows, ids = parts["sightings"], parts["landmarks"]
    alone = np.isnan(rows[:, :2]).any(axis=1)
    if not alone.any():
        return parts
    have = "has" if np.sum(alone) == 1 else "have"
    remarks.append(f"{np.sum(alone)} of {len(alone)} sightings {have} a range or a bearing alone")
    nameless = alone & np.isin(ids, (NO_ID, UNIDENTIFIED))
    if nameless.any():
        remarks.append(f"{np.sum(nameless)} of these {np.sum(alone)} have no id, which they need, and are left out")
    kept = alone & ~nameless
    single = {"ranges": rows[kept, 0], "bearings": rows[kept, 1]}
    partial = PartialSightings(steps=parts["steps"][kept], landmarks=ids[kept], **single)
    return {name: each[~alone] for name, each in parts.items()} | {"partial_sightings": partial}


def _inside(what: str, odometry: Stream, remarks: list[str], *times: Array) -> np.ndarray:
    """Which rows (N,) have all their times (N,) within those of the odometry, with a remark about the others."""
    begin, end = odometry.times[0], odometry.times[-1]
    inside = np.all([(each >= begin) & (each <= end) for each in times], axis=0)
    if not inside.any():
        if what == "sightings":
            raise LogError("no landmark is seen while there is odometry, so the log would have no pose")
        raise LogError(f"no row of the {what} is within the time of the odometry: is its clock another one?")
    if not inside.all():
        remarks.append(f"{np.sum(~inside)} of {len(inside)} {what} are from before or after the odometry: left out")
    return np.asarray(inside)


def _relations(stream: Stream, times: Array) -> PoseRelations:
    """The relations of a log with poses at ``times`` (T+1,)."""
    first, second = (np.searchsorted(times, each) for each in (stream.times, stream.rows[:, 0]))
    covariances = stream.rows[:, 4:].reshape(-1, 3, 3)
    return PoseRelations(first=first, second=second, motions=stream.rows[:, 1:4], covariances=covariances)


def _positions(stream: Stream, times: Array) -> AbsolutePositions:
    """The positions of a log with poses at ``times`` (T+1,)."""
    steps, rows = np.searchsorted(times, stream.times), np.split(stream.rows, [3, 12, 14], axis=1)
    datums = {"datums": rows[3]} if rows[3].shape[1] else {}
    return AbsolutePositions(
        steps=steps, places=rows[0], covariances=rows[1].reshape(-1, 3, 3), levers=rows[2], **datums
    )


_READERS: dict[str, Callable[[Stream, Array], Any]] = {"relations": _relations, "positions": _positions}


def _why_few(times: Array, truth: Stream) -> str:
    """The cause why `truth_at` finds little or nothing: rows too far apart, or another time; empty where it is neither."""
    if len(truth) < 2:
        return ""
    at = np.unique(truth.times)
    if len(at) < 2 or at[0] > times[-1] or at[-1] < times[0]:
        return ": its times lie before or after the poses"
    if (spacing := float(np.median(np.diff(at)))) <= TRUTH_GAP:
        return ""
    return f": its rows are {spacing:.3g} s apart (median), and it is interpolated between rows at most {TRUTH_GAP:g} s apart"
