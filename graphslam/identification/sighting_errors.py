"""What is wrong with sightings, judged from a solved drive: misread ids, clutter, and errors that last or that scans share.

The first two judgements compare a sighting with what the solution predicts for it. The covariance of the difference e is that
of the sensor plus that of the prediction, which comes from samples of the solution's covariance (`unknowns.Linear.samples`).

Errors that last: with the correlation rho(lag) of errors of one landmark, the mean of K sightings has the variance
sigma²/K (1 + the mean over sightings of the sum of rho to all others). If each has the variance sigma² times this factor,
they count as independent. rho is the mean of e_i e_j minus the covariance of both predictions, over pairs of sightings that
the solution has not used, because it follows those that it has used.

Ranges that are off for single landmarks (`RangeErrors`) are found in `sensor_errors`.

Errors of scans: a sensor that shakes, or inexact times, give all sightings of one scan the same error, see
`odometry.common_errors`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import named
from ..log import UNIDENTIFIED, Log
from ..se2 import Array
from .odometry import Edges, add_at, ordinary, sighting_times
from .unknowns import RANGE, Unknowns

#: samples of the covariance of the solution
SAMPLES = 24
#: a squared Mahalanobis distance beyond which a sighting contradicts its landmark, and below which it fits another one ...
CONTRADICTS, FITS = 25.0, 9.0
#: ... that is better than all others by this
BETTER = 9.0
#: the least probability with which the id of a sighting that stands alone is kept; and the squared Mahalanobis distance from
#: its landmark that it is given below that
BELIEVED, UNLIKELY = 0.5, 100.0
#: the number of right sightings that stand alone which is assumed before any is seen
RIGHT = 2.0
#: a landmark with fewer sightings than this part of the median may be made of misread ids
WEAK = 0.33
#: limits of the lags [s] over which correlations are averaged
LAGS = np.array([0.0, 0.15, 0.4, 1.0, 2.5, 6.0, 15.0, 40.0])
#: the largest rounding of times [s]: the lags of regular sightings are often one of these
ROUNDING = 1e-6
#: errors correlated by less than this count as independent, and correlations of fewer pairs than this are not computed
INDEPENDENT, FEWEST = 0.1, 20
#: errors are correlated where residuals are, at one of this number of the shortest lags, by more than the second number of
#: standard deviations
SHORT, SIGNIFICANT = 5, 4.0
#: residuals are clipped to this [standard deviations], and ranges beyond are far too long or too short
FAR = 3.0
#: bearings within this fit [standard deviations]. Long ranges are reflections where their excess over short ones is above so
#: many of its standard errors, and above this part of all
FITTING, ONE_SIDED, FEW_REFLECTED = 2.0, 5.0, 0.01
#: the kinds of errors of ranges; errors that change by less than this part of their standard errors are settled; a range is
#: corrected by this factor at most; and how many characters of a note name landmarks
SCALE, OFFSET = "scale", "offset"
SETTLED, MOST_CORRECTED, MOST_NAMED = 0.5, 2.0, 160
#: of each kind, for notes: the factor to its unit, the unit, the errors of all landmarks, those of single ones, and the cause
OF_KIND = {
    SCALE: (
        100.0, "%", "ranges are off by a part that differs from landmark to landmark",
        "landmark: error +- standard error [%]", "tags may have another size than the sensor believes, so measure them",
    ),
    OFFSET: (
        1.0, "m", "ranges are off by a length that differs from landmark to landmark",
        "landmark: error +- standard error [m]", "landmarks may be thick, or beacons late, so measure where they reflect",
    ),
}  # fmt: skip


class Predictions:
    """What a solved drive predicts for sightings of its landmarks."""

    def __init__(self, unknowns: Unknowns, rng: np.random.Generator) -> None:
        self._unknowns = unknowns
        linear = unknowns.linearized()
        self._nodes, self._values = linear.samples(SAMPLES, rng)

    def compare(self, log: Log, rows: np.ndarray, landmarks: np.ndarray) -> tuple[Edges, Array]:
        """The edges of sightings in rows (M,) with landmarks (M,), and samples (M, d, k) of the errors of the predictions."""
        steps, nodes = log.steps[rows].astype(np.int64), landmarks + self._unknowns.poses
        edges = self._unknowns.sighted(steps, nodes, log.sightings[rows])
        return edges, edges.moved(self._nodes, self._values)

    def distances(self, log: Log, rows: np.ndarray, landmarks: np.ndarray) -> tuple[Array, Array, Array]:
        """How well sightings in rows (M,) fit landmarks (M,), numbers of nodes.

        Returns:
            The squared Mahalanobis distances (M,), the logarithms (M,) of the densities of the differences, and these (M, d)
            themselves, measured minus predicted, over their standard deviations.
        """
        edges, errors = self.compare(log, rows, landmarks)
        covariances = self._unknowns.covariances(edges) + errors @ np.swapaxes(errors, 1, 2) / SAMPLES
        weighted = np.linalg.solve(covariances, edges.residuals[:, :, None])[:, :, 0]
        squares = np.einsum("ei,ei->e", edges.residuals, weighted)
        single = -edges.residuals / np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
        return squares, -0.5 * (squares + np.linalg.slogdet(2 * np.pi * covariances)[1]), single


#: the least gain of the log likelihood by a part of the sightings with a rate of contradictions of its own. A landmark was
#: moved where the gain is above the second number (22 by lasting errors of MR.CLAM) and the rate above the third, perhaps so
#: many seconds earlier or later, and the robot was where more than the last part of the landmarks seem to be
BURST, MOVED, ELSEWHERE, FOLLOWED, MOST_MOVED = 12.5, 25.0, 0.35, 10.0, 0.4
#: an id that so many sightings have which fit no landmark, and a quarter of these, is named: other objects may have it
FEWEST_DOUBLED = 10


@dataclass(frozen=True)
class Ids:
    """The ids of the sightings of a log, checked.

    Attributes:
        landmarks: (M,) ids, where another landmark fits clearly better that of the other one.
        changed, dropped: (M,) bool: those, and the sightings that fit no landmark.
        identified: (M,) bool, the sightings that have an id; the others are neither.
        by_range: of sightings whose bearing fits, how many ranges are far too long, far too short, and neither.
        moved: {an id that is not in the log: (that of the landmark, when it was moved [s] since the first pose)}.
    """

    landmarks: np.ndarray
    changed: np.ndarray
    dropped: np.ndarray
    identified: np.ndarray
    by_range: tuple[int, int, int] = (0, 0, 0)
    moved: Mapping[int, tuple[int, float]] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """The part of the sightings with ids whose id is wrong, or that show no landmark."""
        return float(np.mean((self.changed | self.dropped)[self.identified]))

    @property
    def sentence(self) -> str | None:
        """What was changed, for the notes of a table; None where nothing was."""
        changed, dropped, count = (int(each.sum()) for each in (self.changed, self.dropped, self.identified))
        if changed + dropped == 0:
            return None
        doubled = _doubled(self.landmarks, self.dropped)
        several = f"; several objects may have the id {named(doubled)}" if len(doubled) else ""
        return (
            f"{changed + dropped} of {count} sightings ({self.share:.1%}) contradict their id: {changed} got the id of the "
            f"landmark that fits, {dropped} fit none and were left out{several}"
        )

    @property
    def sentence_on_moved(self) -> str | None:
        """Which landmarks were moved, for the notes of an estimate; None where none was."""
        if not self.moved:
            return None
        each = named((f"{old} at {t:.0f} s ({new})" for new, (old, t) in self.moved.items()), MOST_NAMED)
        return (
            "landmarks are in other places before and after a moment, as if somebody had moved them (landmark, seconds after "
            f"the start, and a further id for its sightings on one side): {each}"
        )

    @property
    def reflections(self) -> str | None:
        """What ranges that are too long on one side only suggest; None where they are not."""
        long, short, fitting = self.by_range
        if long - short <= max(ONE_SIDED * (long + short) ** 0.5, FEW_REFLECTED * (long + short + fitting)):
            return None
        return (
            f"of {long + short + fitting} sightings whose bearing fits their landmark, {long} have a range that is far too "
            f"long, and {short} one that is far too short, as where signals are reflected or pass the landmark. They count "
            "little and are not corrected: leave out what the sensor marks as weak, or limit its range"
        )

    def within(self, landmarks: np.ndarray) -> Ids:
        """The ids of a whole log, given all of them (M,), of which these are the ones that are not `UNIDENTIFIED`."""
        identified = landmarks != UNIDENTIFIED
        whole, changed, dropped = landmarks.copy(), np.zeros_like(identified), np.zeros_like(identified)
        whole[identified], changed[identified], dropped[identified] = self.landmarks, self.changed, self.dropped
        return replace(self, landmarks=whole, changed=changed, dropped=dropped, identified=identified)

    def correct(self, log: Log) -> Log:
        """The log with these ids, without the sightings that fit no landmark."""
        return log.with_sightings(~self.dropped, landmarks=self.landmarks[~self.dropped])


def checked_ids(log: Log, unknowns: Unknowns, alone: np.ndarray, rng: np.random.Generator) -> Ids:
    """Compare every sighting with its landmark, and those that contradict it with all others.

    A landmark that was seen much less often than others may be made of misread ids alone, so its sightings are compared with
    the others as well. Where these do not fit, they keep their ids, as those of landmarks do that the solution does not have.
    The best of J landmarks fits where its density is above J times that of a sighting anywhere in view.

    Args:
        alone: (M,) bool, the sightings that stand alone in time, which the solution has not used. Before a loop is closed
            they fit everything, so they keep their ids only where these are more probably right than wrong (`_unlikely`).
    """
    predictions, ids = Predictions(unknowns, rng), unknowns.ids
    landmarks = log.landmarks.copy()
    changed, dropped = np.zeros(len(landmarks), dtype=bool), np.zeros(len(landmarks), dtype=bool)
    seen = np.bincount(np.searchsorted(ids, landmarks[np.isin(landmarks, ids)]), minlength=len(ids))
    strong = np.flatnonzero(seen >= WEAK * np.median(seen))
    own, density = np.full(len(landmarks), np.inf), np.full(len(landmarks), -np.inf)
    known = np.flatnonzero(np.isin(landmarks, ids))
    own[known], density[known], single = predictions.distances(log, known, np.searchsorted(ids, landmarks[known]))
    unlikely = _unlikely(log, np.flatnonzero(alone), density)
    own[unlikely] = UNLIKELY
    supported = np.isin(landmarks, ids[strong])
    tried = np.flatnonzero((own > CONTRADICTS) | ~supported)
    if len(tried) == 0 or len(strong) == 0:
        return Ids(landmarks, changed, dropped, np.ones_like(dropped), _by_range(single))
    each = [predictions.distances(log, tried, np.full(len(tried), j)) for j in strong.tolist()]
    others, densities, _ = (np.stack(values) for values in zip(*each))
    # an id that is more probably wrong than right does not come back
    others[np.isin(tried, unlikely) & (ids[strong][:, None] == landmarks[tried])] = UNLIKELY
    best = others.argmin(axis=0)
    nearest = np.sort(others, axis=0)
    # where the prediction is wide, one of many landmarks fits a sighting that is anywhere in view
    gain = densities[best, np.arange(len(tried))] - _anywhere(log)
    fits = (nearest[0] < FITS) & (gain > np.log(len(strong)))
    if len(strong) > 1:
        fits &= nearest[1] > nearest[0] + BETTER
    landmarks[tried[fits]] = ids[strong[best[fits]]]
    changed[tried[fits]] = True
    dropped[tried[~fits]] = np.isfinite(own[tried[~fits]]) & (own[tried[~fits]] > CONTRADICTS)
    parts = _moved(log, landmarks, dropped, len(ids))
    for new, (rows, (old, moment)) in parts.items():
        # poses of a robot that saw it being moved followed it for a while
        dropped |= (landmarks == old) & (np.abs(sighting_times(log) - moment) < FOLLOWED)
        landmarks[rows], dropped[rows] = new, False
    in_place = ~np.isin(
        log.landmarks[known], np.append(_doubled(landmarks, dropped), [old for _, (old, _) in parts.values()])
    )
    moved = {new: moment for new, (_, moment) in parts.items()}
    return Ids(landmarks, changed, dropped, np.ones_like(dropped), _by_range(single[in_place]), moved)


def _doubled(landmarks: np.ndarray, dropped: np.ndarray) -> np.ndarray:
    """The ids that several objects may have, because many of the sightings that were left out have them."""
    doubled, times = np.unique(landmarks[dropped], return_counts=True)
    return doubled[times >= max(FEWEST_DOUBLED, dropped.sum() / 4)]


def _moved(
    log: Log, landmarks: np.ndarray, dropped: np.ndarray, count: int
) -> dict[int, tuple[np.ndarray, tuple[int, float]]]:
    """{new id: (rows of the sightings of a landmark on one side of a moment, (its id, the moment [s] since the first pose))}.

    These contradict the place of the landmark, and those on the other side do not. Right sightings lose little by an id of
    their own. Where many of all ``count`` landmarks seem to be elsewhere, it is the robot that was moved.
    """
    times, found = sighting_times(log), {}
    # landmark 7 becomes 1000007: the next free id may be that of a landmark in the map, in the truth or in another log
    further = 10 ** max(6, 1 + len(str(np.abs(landmarks).max())))
    for id in np.unique(landmarks[dropped]).tolist():
        rows = np.flatnonzero(landmarks == id)
        k, n = np.cumsum(dropped[rows]), np.arange(1, len(rows) + 1)
        gain = of_rate(k, n) + of_rate(k[-1] - k, n[-1] - n) - of_rate(k[-1:], n[-1:])
        at = int(np.argmax(gain))
        if gain[at] < MOVED:
            continue
        side = max(rows[: at + 1], rows[at + 1 :], key=lambda part: dropped[part].mean())
        wrong = dropped[side]
        new = further + id
        if wrong.sum() >= FEWEST_DOUBLED and wrong.mean() > ELSEWHERE and new < np.iinfo(np.int64).max:
            found[new] = side, (id, float(times[rows[at : at + 2]].mean()))
    return found if len(found) <= MOST_MOVED * count else {}


def of_rate(k: Array, n: Array) -> Array:
    """The largest log likelihood k log(k/n) + (n - k) log(1 - k/n) of k of n events, both (K,)."""
    rate = np.clip(k / np.maximum(n, 1), 1e-12, 1 - 1e-12)
    return np.asarray(k * np.log(rate) + (n - k) * np.log1p(-rate))


def _by_range(single: Array) -> tuple[int, int, int]:
    """`Ids.by_range` of differences (M, d), over their standard deviations."""
    ranges = single[np.abs(single[:, 1]) < FITTING, 0]
    long, short = int(np.sum(ranges > FAR)), int(np.sum(ranges < -FAR))
    return long, short, len(ranges) - long - short


def _unlikely(log: Log, rows: np.ndarray, density: Array) -> np.ndarray:
    """Those of the sightings in rows (K,) whose id is right with less than the probability `BELIEVED`.

    A sighting with the right id has the density N(e; 0, S) of ``density`` (M,), logarithms; one with a wrong id is anywhere
    in view, and so is one of a landmark that the solution does not have (-inf). The part of the right ones is that with
    which the sightings of the others are most probable together (EM), as if `RIGHT` further ones were right.
    """
    if len(rows) == 0:
        return rows
    predicted = np.isfinite(density[rows])
    gain = np.where(predicted, np.exp(np.clip(density[rows] - _anywhere(log), -700, 700)), 1.0)
    part = 0.5
    for _ in range(50):
        right = part * gain / (part * gain + 1 - part)
        part = (float(right[predicted].sum()) + RIGHT) / (np.count_nonzero(predicted) + RIGHT)
    return rows[right < BELIEVED]


def _anywhere(log: Log) -> float:
    """The logarithm of the density of a sighting that is anywhere in view."""
    return -float(np.sum(np.log(np.maximum(np.ptp(log.sightings, axis=0), 1e-6))))


def _products(values: Array, landmarks: np.ndarray, t: Array) -> Array:
    """The means (B, d, k) over pairs of sightings of one landmark, for the lags between `LAGS`; NaN where there are too few.

    Args:
        values: (M, d, k), whose products with those of the other sighting count.
        landmarks, t: (M,), in the order of landmarks and times.
    """
    total, count, lag = np.zeros((len(LAGS) - 1, *values.shape[1:])), np.zeros(len(LAGS) - 1), 1
    while lag < len(t):
        lapse = t[lag:] - t[:-lag]
        first = np.flatnonzero((landmarks[lag:] == landmarks[:-lag]) & (lapse < LAGS[-1]))
        if len(first) == 0:
            break
        at = np.searchsorted(LAGS[1:-1], lapse[first] - ROUNDING)
        add_at(total, at, (values[first] * values[first + lag]).reshape(len(first), -1))
        count += np.bincount(at, minlength=len(count))
        # neighbours one by one, and then a part of the many that are far apart
        lag += 1 if lag < 8 else lag // 4
    return total / np.where(count < FEWEST, np.nan, count)[:, None, None]


def errors_last(every: Unknowns, rng: np.random.Generator) -> bool:
    """Whether residuals of one landmark are significantly more correlated in time than those of independent errors.

    Independent errors w have correlated residuals r = w - J Omega^-1 J' W w, because nodes and parameters are fitted to them.
    How much, and how much that varies between drives, comes from samples of r. With all sightings the fitted part is small,
    so that it hardly matters how well its covariance is known.

    Args:
        every: solved with all sightings, and with the noise of few that are far apart.
    """
    linear = every.linearized()
    sightings, (nodes, values, errors) = linear.edges[1], linear.drawn(SAMPLES, rng)
    e = np.concatenate([sightings.residuals[:, :, None], errors - sightings.moved(nodes, values)], axis=2)
    e /= np.sqrt(np.diagonal(every.covariances(sightings), axis1=1, axis2=2))[:, :, None]
    e = np.clip(e, -FAR, FAR)
    squares = np.mean(e**2, axis=0)
    if not squares.all():
        # sightings that are all alike
        return False
    order, t = np.argsort(every.seen, kind="stable"), sighting_times(every.log)[every.used]
    products = _products((e / np.sqrt(squares))[order], every.seen[order], t[order])
    rho, drawn = np.split(products.mean(axis=1), [1], axis=1)
    # too few pairs are NaN, and so is their comparison false
    significant = rho[:, 0] - drawn.mean(axis=1) > SIGNIFICANT * drawn.std(axis=1, ddof=1)
    return bool(significant[:SHORT].any())


def correlations(log: Log, unknowns: Unknowns, used: np.ndarray, rng: np.random.Generator) -> Array:
    """rho of the errors of one landmark for the lags between `LAGS`, NaN where there are too few pairs.

    The numbers of a sighting count together, each by how much of its residuals is the sensor's own noise.

    Args:
        used: (M,) bool: the sightings that the solution has used.
    """
    # beside a silence of the odometry, a pose follows its sightings, and the covariance of its prediction hides their errors
    reliable = np.ones(log.num_poses, dtype=bool)
    silent = np.flatnonzero(~ordinary(log))
    reliable[silent], reliable[silent + 1] = False, False
    rows = np.flatnonzero(np.isin(log.landmarks, unknowns.ids) & ~used & reliable[log.steps])
    rows = rows[np.argsort(log.landmarks[rows], kind="stable")]
    if len(rows) < FEWEST:
        return np.full(len(LAGS) - 1, np.nan)
    edges, errors = Predictions(unknowns, rng).compare(log, rows, np.searchsorted(unknowns.ids, log.landmarks[rows]))
    noise = np.sqrt(np.diagonal(unknowns.covariances(edges), axis1=1, axis2=2))
    e, errors = edges.residuals / noise, errors / noise[:, :, None]
    far = np.minimum(1.0, FAR / np.maximum(np.abs(e), 1e-9))
    e, errors = e * far, errors * far[:, :, None]
    whole, predicted = np.mean(e**2, axis=0), np.mean(errors**2, axis=(0, 2))
    if not whole.all():
        # sightings that are all alike, whose errors are exactly zero
        return np.full(len(LAGS) - 1, np.nan)
    own = np.maximum(whole - predicted, 1e-3 * whole)
    share = np.clip(own / whole, 0.02, 1.0) ** 2
    both = np.concatenate([e[:, :, None], errors], axis=2)
    products, predictions = np.split(_products(both, log.landmarks[rows], sighting_times(log)[rows]), [1], axis=2)
    return (products[:, :, 0] - predictions.mean(axis=2)) @ share / float(own @ share)


def smoothed(rho: Array) -> Array:
    """Correlations (B,) without gaps, between 0 and 0.95, falling with the lag, and zero from where they are small."""
    filled = np.zeros(len(rho))
    last = 0.0
    for b in range(len(rho) - 1, -1, -1):
        last = last if np.isnan(rho[b]) else float(np.clip(rho[b], 0.0, 0.95))
        filled[b] = last
    filled = np.minimum.accumulate(filled)
    return np.where(filled < INDEPENDENT, 0.0, filled)


def inflation(log: Log, rho: Array) -> float:
    """The factor on the variances with which correlated sightings count as independent, for `smoothed` correlations."""
    t, neighbours = sighting_times(log), np.zeros(len(LAGS) - 1)
    for j in log.landmark_ids.tolist():
        own = t[log.landmarks == j]
        within = np.array([np.searchsorted(own, own + lag + ROUNDING) for lag in LAGS])
        neighbours += 2 * np.diff(within, axis=0).sum(axis=1)
    return 1.0 + float(rho @ neighbours) / max(len(t), 1)


@dataclass(frozen=True)
class RangeErrors:
    """Ranges that are off for single landmarks, each by a part of its length, or by a length.

    Attributes:
        kind: `SCALE`: a range r to a landmark with the error s is measured as (1 + s) r; or `OFFSET`: as r + s [m].
        found: {id of the landmark: (s, its standard error)}.
        spread: the standard deviation of the errors where all landmarks may be off; None where only these are.
        alike: whether the other kind explains the log nearly as well.
    """

    kind: str
    found: Mapping[int, tuple[float, float]]
    spread: float | None = None
    alike: bool = False

    @property
    def uncertain(self) -> dict[str, float]:
        """As `Log.uncertain`: the mean of all scales counts as right, but is that of so many."""
        if self.kind == OFFSET or self.spread is None:
            return {}
        return {"range_scale": self.spread / len(self.found) ** 0.5}

    @property
    def sentences(self) -> tuple[str, ...]:
        """For the notes of an estimate."""
        size, unit, differ, head, cause = OF_KIND[self.kind]
        largest = sorted(self.found.items(), key=lambda item: -abs(item[1][0]))
        each = named((f"{id}: {size * s:+.2g} +- {size * e:.1g}" for id, (s, e) in largest), MOST_NAMED)
        said = "ranges of single landmarks are off against those of the others"
        if self.spread is not None:
            said = f"{differ}, with a standard deviation of {size * self.spread:.2g} {unit}"
        said += (
            f" ({head}): {each}. They are corrected in this log, and files of the robot do not contain the correction"
        )
        said += f": {cause}"
        if mean := self.uncertain:
            said += f". Their mean counts as right, so that all lengths may be off by {100 * mean['range_scale']:.1g} %"
        if not self.alike:
            return (said,)
        return (
            said,
            "whether ranges of landmarks are off by a part or by a length, this log does not tell: each landmark is seen "
            "from similar distances",
        )

    def of(self, landmarks: np.ndarray) -> Array:
        """The errors (M,) of ranges to landmarks (M,)."""
        ids, number = np.unique(landmarks, return_inverse=True)
        return np.array([self.found.get(id, (0.0, 0.0))[0] for id in ids.tolist()])[number.ravel()]

    def corrected(self, ranges: Array, landmarks: np.ndarray) -> Array:
        """The ranges (M,) to landmarks (M,) without the errors."""
        s = self.of(landmarks)
        right = ranges / (1 + s) if self.kind == SCALE else ranges - s
        return np.clip(right, ranges / MOST_CORRECTED, ranges * MOST_CORRECTED)

    def log_density(self, landmarks: np.ndarray) -> float:
        """The sum of log |d corrected / d measured| over ranges to landmarks (M,)."""
        return -float(np.sum(np.log1p(self.of(landmarks)))) if self.kind == SCALE else 0.0

    def settled(self, before: RangeErrors | None) -> bool:
        """Whether these are nearly the same as others."""
        if before is None or before.kind != self.kind or before.found.keys() != self.found.keys():
            return False
        return all(abs(s - before.found[id][0]) < SETTLED * error for id, (s, error) in self.found.items())


def evened(log: Log, ranges: RangeErrors | None) -> Log:
    """The log with the ranges without these errors."""
    if ranges is None:
        return log
    return with_sightings_in(log, RANGE, lambda r, _, landmarks: ranges.corrected(r, landmarks))


def with_sightings_in(log: Log, column: int, corrected: Callable[[Array, np.ndarray, np.ndarray], Array]) -> Log:
    """The log with other ranges, or other bearings, of whole sightings and of those alone.

    Args:
        column: `RANGE` or `BEARING`.
        corrected: (numbers, steps, landmarks) -> the numbers instead; (K,) all.
    """
    sightings, partial = log.sightings.copy(), log.partial_sightings
    sightings[:, column] = corrected(sightings[:, column], log.steps, log.landmarks)
    if partial is not None:
        name = ("ranges", "bearings")[column]
        partial = replace(partial, **{name: corrected(getattr(partial, name), partial.steps, partial.landmarks)})
    return log.replace(sightings=sightings, partial_sightings=partial)
