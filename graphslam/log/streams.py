"""Rows with times: their order, controls divided between poses, silences of the odometry, and the truth at other times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import LogError, OptionError, decimals
from ..errors.checks import first
from ..se2 import Array, interpolate
from .rows import MOST_POSES

#: odometry that is silent for longer [s], and for so many times the usual time between rows, is bridged: its last control
#: fades with this time constant [s]
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
        raise LogError(
            f"the times of the {what} run backwards in row {k + 1}: {stream.times[k]:.3f} s comes {behind[k]:.3f} s too late"
        )
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
    following = np.minimum(row + 1, len(odometry) - 1)
    silence = odometry.times[following] - odometry.times[row]
    lasting = np.diff(cuts)
    bridged = silent(silence, odometry.times)
    gaps = silence[bridged][np.unique(row[bridged], return_index=True)[1]].tolist()
    controls, variances = bridge(
        odometry.rows[row], cuts[:-1] - odometry.times[row], lasting, silence, bridged, odometry.rows
    )
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
    variances = (
        share[:, None] * np.column_stack([np.full(len(share), speed), turn_rate, np.full(len(share), speed)]) ** 2
    )
    left = FADING / lasting * (np.exp(-begin / FADING) - np.exp(-(begin + lasting) / FADING))
    return controls * np.where(bridged, left, 1.0)[:, None], variances


def gap_note(gaps: list[float]) -> str:
    """The note about bridged gaps [s]."""
    return f"{_lengths(gaps)}: bridged, with the noise of a robot that moved and turned at will at its usual speeds"


def _lengths(gaps: list[float]) -> str:
    shortest, longest = decimals(min(gaps), 1), decimals(max(gaps), 1)
    lengths = longest if shortest == longest else f"{shortest} to {longest}"
    return f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} of {lengths} s in the odometry"


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


def pieces_of(durations: Array, most: float) -> np.ndarray:
    """Into how many pieces each duration (N,) [s] is divided, so that no piece lasts longer than ``most``.

    Raises:
        OptionError: there would be more than `MOST_POSES`.
    """
    with np.errstate(over="ignore"):
        pieces = np.maximum(1.0, np.ceil(durations / most - 1e-9))
    if pieces.sum() - len(pieces) > MOST_POSES:
        raise OptionError(
            f"keep_every = {most:g} s would make {pieces.sum():.3g} poses, more than {MOST_POSES:,}; choose a longer time"
        )
    return pieces.astype(np.int64)
