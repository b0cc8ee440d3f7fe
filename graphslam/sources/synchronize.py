"""Data that come at their own times, odometry, sightings and truth, brought together in one `Log`.

Poses stand only where something was seen (keyframes). Between them nothing is rounded to a grid: a control holds from
its own time to that of the next, an event in between splits it, and the pieces stay in the log
(`Log.control_starts`), so that motions and their covariances are accumulated exactly.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_positive
from ..errors import LogError
from ..log import Log
from ..models import MotionModel
from ..se2 import Array, interpolate

#: odometry that is silent for longer [s] is bridged with grown noise, or refused
BRIDGED_GAP, LONGEST_GAP = 2.0, 30.0

#: truth is interpolated between samples that are at most so far apart [s]
TRUTH_GAP = 0.5


@dataclass(frozen=True)
class Stream:
    """Rows of numbers with their times: ``times`` (N,) [s], not decreasing, and ``rows`` (N, ...)."""

    times: Array
    rows: Array

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.times)


def join(
    odometry: Stream,
    sightings: Stream,
    landmarks: np.ndarray,
    *,
    truth: Stream | None = None,
    true_landmarks: Mapping[int, ArrayLike] | None = None,
    start: ArrayLike | None = None,
    keep_every: float | None = None,
    longest_gap: float = LONGEST_GAP,
    truth_gap: float = TRUTH_GAP,
    name: str = "log",
    notes: tuple[str, ...] = (),
    **models: Any,
) -> Log:
    """The log of a robot whose odometry, sightings and truth have each their own times.

    Args:
        odometry: controls (nu, omega) (N, 2), each held until the next one's time.
        sightings: (K, 2 or 3); those before the first or after the last odometry are left out, with a note.
        landmarks: (K,) ids.
        truth: poses (G, 3), interpolated in SE(2), or positions (G, 2), interpolated along lines.
        true_landmarks: {id: place}.
        start: the first pose (3,); default: the truth there, or (0, 0, 0) where it does not say.
        keep_every: also keep a pose at least every so many seconds; None keeps only those that saw something.
        longest_gap: odometry that is silent for longer [s] is refused. Above `BRIDGED_GAP` the last control is held on,
            with noise as large as the controls of the whole log differ, and a warning.
        truth_gap: no truth is known between samples farther apart than this [s].
        name, notes, models: of the `Log`.

    Raises:
        LogError: nothing is seen while there is odometry, times run backwards, or the odometry has too long a gap.
        OptionError: an option is not above zero.
    """
    check_positive(longest_gap=longest_gap, truth_gap=truth_gap)
    for what, stream in (("odometry", odometry), ("sightings", sightings), ("truth", truth)):
        check_times(what, stream)
    if len(odometry) < 2:
        raise LogError(f"the odometry has {len(odometry)} rows, but motion takes two")
    inside = (sightings.times >= odometry.times[0]) & (sightings.times <= odometry.times[-1])
    if not inside.any():
        raise LogError("no landmark is seen while there is odometry, so there is no pose to keep")
    said = list(notes)
    if not inside.all():
        said.append(f"{np.sum(~inside)} of {len(inside)} sightings are from before or after the odometry: left out")
    seen = sightings.times[inside]
    times = np.unique(seen)
    if keep_every is not None:
        check_positive(keep_every=keep_every)
        times = _filled(times, keep_every)
    controls, dt, starts, variances, gaps = divide(odometry, times, longest_gap)
    if gaps:
        said.append(told_of_gaps(gaps))
        warnings.warn(f"{name}: {said[-1]}", UserWarning, stacklevel=3)
    true_poses = None if truth is None else truth_at(times, truth, truth_gap)
    if true_poses is not None:
        covered = np.isfinite(true_poses[:, 0])
        if not covered.any():
            true_poses = None
            said.append("the truth covers no pose")
        elif not covered.all():
            said.append(f"the truth covers {covered.sum()} of {len(covered)} poses")
    if start is None:
        known = true_poses is not None and bool(np.all(np.isfinite(true_poses[0])))
        start = true_poses[0] if known and true_poses is not None else np.zeros(3)
    return Log(
        dt=dt,
        controls=controls,
        control_starts=starts,
        control_variances=variances,
        steps=np.searchsorted(times, seen),
        landmarks=np.asarray(landmarks)[inside],
        sightings=sightings.rows[inside],
        initial_poses=MotionModel().dead_reckoning(start, controls, dt)[starts],
        true_poses=true_poses,
        true_landmarks=dict(true_landmarks) if true_landmarks is not None else None,  # type: ignore[arg-type]
        start_time=float(times[0]),
        name=name,
        notes=tuple(said),
        **models,
    )


def divide(
    odometry: Stream, times: Array, longest_gap: float = LONGEST_GAP
) -> tuple[Array, Array, np.ndarray, Array | None, list[float]]:
    """The pieces of the controls between the poses at ``times`` (T+1,), increasing and within the odometry's.

    Returns:
        controls (S, 2), dt (S,), control_starts (T+1,), control_variances (S, 2) or None, and the bridged gaps [s].

    Raises:
        LogError: a gap is longer than ``longest_gap`` [s].
    """
    within = (odometry.times > times[0]) & (odometry.times < times[-1])
    cuts = np.union1d(odometry.times[within], times)
    # of several rows with one time the last holds
    row = np.searchsorted(odometry.times, cuts[:-1], side="right") - 1
    following = np.minimum(row + 1, len(odometry) - 1)
    silence = odometry.times[following] - odometry.times[row]
    if np.any(silence > longest_gap):
        k = int(np.argmax(silence))
        raise LogError(
            f"the odometry is silent for {silence[k]:.1f} s after t = {odometry.times[row[k]]:.3f} s, longer than "
            f"{longest_gap:g} s: cut the log there"
        )
    lasting = np.diff(cuts)
    bridged = silence > BRIDGED_GAP
    gaps = silence[bridged][np.unique(row[bridged], return_index=True)[1]].tolist()
    variances = bridging(odometry.rows, silence, lasting) if gaps else None
    return odometry.rows[row], lasting, np.searchsorted(cuts, times), variances, gaps


def bridging(controls: Array, silence: Array, lasting: Array) -> Array:
    """The variances (S, 2) of control pieces that last ``lasting`` (S,) within a silence of ``silence`` (S,) seconds.

    One unknown control holds throughout a silence: it moves the robot by an error of variance V silence², V the variance
    of all controls. Pieces are independent in a log, and each adds V_piece lasting²; with V_piece = V silence / lasting
    they sum up to the same, however many poses stand in the gap. Zero where there is no gap.
    """
    grown = np.where(silence > BRIDGED_GAP, silence / lasting, 0.0)
    return grown[:, None] * np.var(controls, axis=0)


def told_of_gaps(gaps: list[float]) -> str:
    """The sentence about bridged gaps [s]."""
    if len(gaps) == 1:
        what = f"1 gap of {gaps[0]:.1f} s"
    else:
        what = f"{len(gaps)} gaps of {min(gaps):.1f} to {max(gaps):.1f} s"
    return f"{what} in the odometry: bridged by the last control, with noise as large as the controls of the whole log differ"


def truth_at(times: Array, truth: Stream, gap: float = TRUTH_GAP) -> Array:
    """The true poses (T+1, 3) at ``times``, interpolated between samples at most ``gap`` [s] apart, NaN elsewhere.

    Positions without headings, (G, 2), become rows (x, y, NaN).
    """
    poses = np.full((len(times), 3), np.nan)
    if len(truth) < 2:
        return poses
    # of several samples with one time one is enough
    at, first = np.unique(truth.times, return_index=True)
    rows = truth.rows[first]
    after = np.clip(np.searchsorted(at, times, side="right"), 1, len(at) - 1)
    before = after - 1
    apart = at[after] - at[before]
    share = (times - at[before]) / apart
    # a sample at the very time needs no neighbour
    known = ((share >= 0) & (share <= 1) & (apart <= gap)) | (share == 0) | (share == 1)
    a, b, s = rows[before[known]], rows[after[known]], share[known]
    if rows.shape[1] == 2:
        poses[known, :2] = a + s[:, None] * (b - a)
    else:
        poses[known] = interpolate(a, b, s)
    return poses


def check_times(what: str, stream: Stream | None) -> None:
    """Raise `LogError` where times run backwards; readers that know the line say so first."""
    if stream is not None and np.any(np.diff(stream.times) < 0):
        k = int(np.argmax(np.diff(stream.times) < 0)) + 1
        raise LogError(
            f"the times of the {what} run backwards in row {k + 1}: {stream.times[k]:.3f} s comes after "
            f"{stream.times[k - 1]:.3f} s"
        )


def _filled(times: Array, most: float) -> Array:
    """The times with more of them in between, so that none is farther than ``most`` from the next."""
    pieces = np.maximum(1, np.ceil(np.diff(times) / most - 1e-9)).astype(int)
    first = np.repeat(times[:-1], pieces)
    part = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    between = first + part * np.repeat(np.diff(times) / pieces, pieces)
    return np.append(between, times[-1])
