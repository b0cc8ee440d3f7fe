"""Errors of a sensor that differ between sightings: a sensor that was turned, a lens, and ranges of single landmarks.

Where the sensor of a drive is turned on its robot, as a camera that something bumps into, all bearings are off by one angle s
from then on. One bias of the whole drive does not explain it: the headings turn with the sensor instead, and the robot seems
to drive askew. So each moment is tested for a step of the bearings. With e, W and J the
residuals, the information and the Jacobians of nodes and biases at the solution, Omega the information matrix of all, and D
the derivative of the residuals by s, 1 in the bearings of later sightings,

    u = D' W e,   P = D' W D - D' W J Omega^-1 J' W D,   s = -u / P,   z = |u| / sqrt(P).

Noise that was fitted to a drive with such a step is too large, and z too small. So z only suggests a step, which counts where
the restricted likelihood with the bearings corrected, each with the noise that fits best, is larger by enough.

The error of a lens or a wrong focal length grows with the bearing c: a c + b c (c / edge)². It is tested in the same way with
the two columns D = [c, c (c / edge)²], and z² = u' P^-1 u. As the correction shrinks or stretches what was measured, the
likelihood then contains log |d corrected / d measured|.

Ranges to a landmark may be off by s, a part of them (a tag of another size) or a length (a thick pole). The columns
D have the range, or 1, in the rows of one landmark each. Either all landmarks are off, s ~ N(0, d² I) with the most probable
d, or some: these are added one after the other, the largest z first. An error in common is left to the scale of the wheels or
the bias of the ranges. Errors that last for a while look like those of a landmark, but stay correlated after the correction.
So gains are divided by the number of sightings that then count as one (`sighting_errors.inflation`).

Source: Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import GraphError
from ..log import Log
from ..se2 import Array, wrap
from .restricted_likelihood import DETERMINED, each_alone, gain_over, refitted, scores, with_wide_prior
from .sighting_errors import MOST_CORRECTED, OFFSET, SCALE, SETTLED, RangeErrors, evened, with_sightings_in
from .unknowns import BEARING, OVERSTATED_SIGHTINGS, RANGE, Unknowns

#: how many moments are tried
MOMENTS = 60
#: a z above the first number suggests a step, and a step that explains as much as so many standard errors is one:
#: docs/decisions.md
SUGGESTED, SURELY = 3.5, 5.0
#: the standard deviation of the prior of the bias of the whole drive [rad]. With the usual one, a sensor that is mounted
#: askew by ten degrees seems to have been turned in the first seconds
ASKEW = np.pi
#: the most turns of one drive
MOST = 3
#: bearings below this quantile are in the field of view, which ends before the second number [rad] for an error that grows
EDGE, BEHIND = 0.99, 1.92
#: the standard deviation of the priors of such an error near the axis and of what the edge adds, the gain of the log
#: likelihood with which it counts, and the largest standard errors: where the place of the sensor looks much like it, small
#: errors of other kinds do, too (docs/decisions.md)
USUAL, GROWS, LARGEST_ERROR = 0.03, 8.0, 0.01


@dataclass(frozen=True)
class Turn:
    """A moment at which the sensor was turned.

    Attributes:
        time: [s] since the first pose.
        angle: by how much bearings are larger afterwards [rad].
        error: its standard error.
    """

    time: float
    angle: float
    error: float

    def sentence(self, log: Log) -> str:
        """For the notes of an estimate; ``log`` is that of the drive."""
        assert log.times is not None
        step = int(np.searchsorted(log.times - log.times[0], self.time))
        return (
            f"from step {step} ({self.time:.0f} s after the start) on, bearings are off by {self.angle:+.3g} rad (standard "
            f"error {self.error:.1g}) against those before: the sensor was turned on the robot, or the robot drives "
            "askew since then. They are corrected for a turned sensor; if it was not turned, the headings are off by as much"
        )


def turned_back(log: Log, turns: Iterable[Turn]) -> Log:
    """The log with the bearings that the sensor would have had without these turns."""
    if log.times is None or not (turns := tuple(turns)):
        return log
    times = log.times - log.times[0]
    off = np.sum([turn.angle * (times > turn.time) for turn in turns], axis=0)
    return with_sightings_in(log, BEARING, lambda bearings, steps, _: wrap(bearings - off[steps]))


def turn_of(fitted: Unknowns, whole: Callable[[Unknowns], Unknowns]) -> Turn | None:
    """The moment at which the sensor was turned, if any.

    Args:
        fitted: the solution with few sightings, whose errors are nearly independent.
        whole: the same problem with all sightings, which show the moment best.
    """
    fitted = with_wide_prior(fitted, ["bearing_bias"], ASKEW)
    end = _times(fitted).max()
    limits = np.linspace(0.0, end, MOMENTS + 1)[1:-1]
    z, angles, _ = _steps(fitted, limits)
    k = int(np.argmax(z))
    if z[k] < SUGGESTED:
        return None
    turn = Turn(float(limits[k]), float(angles[k]), 0.0)
    turned, same = refitted(fitted, turned_back(fitted.log, [turn])), refitted(fitted, fitted.log)
    if gain_over(turned, same) < SURELY**2 / 2:
        return None
    z, rest, errors = _steps(turned, limits[[k]])
    every = whole(turned)
    times = np.unique(_times(every))
    near = np.flatnonzero(np.abs(times - turn.time) <= end / MOMENTS)
    time = turn.time
    if len(near) and (near := near[near + 1 < len(times)]).size:
        between = (times[near] + times[near + 1]) / 2
        time = float(between[np.argmax(_steps(every, between)[0])])
    return Turn(time, turn.angle + float(rest[0]), float(errors[0]))


def _times(solved: Unknowns) -> Array:
    """The time (M,) of each sighting since the first pose [s]."""
    assert solved.log.times is not None
    return solved.log.times[solved.seen_from] - solved.log.times[0]


def _steps(solved: Unknowns, moments: Array) -> tuple[Array, Array, Array]:
    """z, s and its standard error of a step of the bearings at each of some moments (K,); zero where it is not determined."""
    return each_alone(*_scores(solved, BEARING, (_times(solved)[:, None] > moments).astype(float)))


def _scores(solved: Unknowns, row: int, derivatives: Array) -> tuple[Array, Array, Array]:
    """u (K,), P and D' W D (K, K) for derivatives (M, K) of the residuals of all ranges, or of all bearings."""
    D = np.zeros((len(derivatives), solved.sightings.shape[1], derivatives.shape[1]))
    D[:, row] = derivatives
    return scores(solved, 1, D)


@dataclass(frozen=True)
class Lens:
    """An error of the bearings that grows with them: near the axis of the sensor a scale, with more or less at the edge.

    With c the measured bearing, at most `edge`, the bearing is too large by near c + bend c (c / edge)².

    Attributes:
        near: the part of bearings near the axis.
        bend: what is added to this part at the edge.
        edge: where the field of view ends, in effect [rad].
        errors: (2,) standard errors of the part near the axis, and of that at the edge.
    """

    near: float
    bend: float
    edge: float
    errors: tuple[float, float] = (0.0, 0.0)

    @property
    def sentence(self) -> str:
        """For the notes of an estimate."""
        near, edge = 100 * self.near, 100 * (self.near + self.bend)
        return (
            f"measured bearings are off by {near:+.2g} % of their size (standard error {100 * self.errors[0]:.1g} %) near "
            f"the axis of the sensor and by {edge:+.2g} % (standard error {100 * self.errors[1]:.1g} %) at "
            f"{self.edge:.2g} rad from it, as with a wrong focal length or the distortion of a lens. They are corrected in "
            "this log; files of the robot do not contain the correction, so calibrate the sensor"
        )

    def shapes(self, bearings: Array) -> Array:
        """The derivative (M, 2) of the error by `near` and `bend` at measured bearings (M,)."""
        c = np.clip(bearings, -self.edge, self.edge)
        return np.column_stack([c, c**3 / self.edge**2])

    def corrected(self, bearings: Array) -> Array:
        """The bearings (M,) without the error."""
        return np.asarray(bearings - self.shapes(bearings) @ [self.near, self.bend])

    def log_density(self, bearings: Array) -> float:
        """The sum of log |d corrected / d measured|: densities of measured bearings from those of corrected ones."""
        inside = bearings[np.abs(bearings) < self.edge]
        return float(np.sum(np.log(np.abs(1 - self.near - 3 * self.bend * (inside / self.edge) ** 2))))


def undistorted(log: Log, lens: Lens | None) -> Log:
    """The log with the bearings without this error."""
    return log if lens is None else with_sightings_in(log, BEARING, lambda bearings, *_: lens.corrected(bearings))


def lens_of(fitted: Unknowns) -> Lens | None:
    """The error of the bearings that grows with them, if any; ``fitted`` is the solution with few sightings.

    None for sensors that see to `BEHIND`, because such an error about their axis has a jump at pi, and for bearings of 0
    alone.
    """
    bearings = fitted.sightings[:, 1]
    edge = float(np.quantile(np.abs(bearings), EDGE))
    if not 0.0 < edge <= BEHIND:
        return None
    lens = Lens(0.0, 0.0, edge)
    z2, near, bend, _ = _growth(fitted, lens, bearings)
    if z2 < SUGGESTED**2:
        return None
    lens = replace(lens, near=near, bend=bend)
    straight, same = refitted(fitted, undistorted(fitted.log, lens)), refitted(fitted, fitted.log)
    if gain_over(straight, same) + lens.log_density(bearings) - (near**2 + bend**2) / (2 * USUAL**2) < GROWS:
        return None
    _, near, bend, errors = _growth(straight, lens, bearings)
    return replace(lens, near=near, bend=bend, errors=errors) if max(errors) < LARGEST_ERROR else None


def _growth(solved: Unknowns, lens: Lens, bearings: Array) -> tuple[float, float, float, tuple[float, float]]:
    """z², near, bend and `Lens.errors` of a solution whose recorded bearings (M,) are corrected for ``lens``."""
    u, P, _ = _scores(solved, BEARING, lens.shapes(bearings))
    prior, now = np.eye(2) / USUAL**2, np.array([lens.near, lens.bend])
    covariance = np.linalg.inv(P + prior)
    near, bend = now - covariance @ (u + prior @ now)
    errors = np.sqrt([covariance[0, 0], covariance.sum()])
    return float(u @ covariance @ u), float(near), float(bend), (float(errors[0]), float(errors[1]))


#: the standard deviation of the error of the ranges of a single landmark before the log is known, by its kind [part or m]
OF_ONE = {SCALE: 0.1, OFFSET: 0.5}
#: gains of the log likelihood, divided by the sightings that count as one, with which all landmarks count as off, a single
#: one does, and a further one; and the gain of the first test, undivided, that makes a try worth while (docs/decisions.md)
ALL_OFF, ONE_OFF, FURTHER_OFF, PROMISING = 16.0, 10.0, 6.0, 5.0
#: between kinds whose gains differ by less than this, the log does not decide
ALIKE = 3.0
#: standard deviations of the errors of all landmarks that are tried [parts or m]
SPREADS = np.geomspace(1e-4, 3.0, 150)
#: the most landmarks that are tested, those with most sightings; and rounds of improving the errors of all
MOST_TESTED, IMPROVED = 300, 4
#: more landmarks than this part of all are not single ones
MOST_SINGLE = 0.4


def range_errors_of(
    fitted: Unknowns, recorded: Log, before: RangeErrors | None, count_as_one: Callable[[Unknowns, RangeErrors], float]
) -> RangeErrors | None:
    """The errors of ranges that differ between landmarks, if any.

    Args:
        fitted: the solution with few sightings.
        recorded: its log with the ranges as they were measured.
        before: the errors for which the log of ``fitted`` was corrected.
        count_as_one: how many of its sightings count as one, by the correlations that a solution with corrected ranges
            leaves. Errors that last for a while look like those of a landmark, and are correlated after the correction, too.
    """
    try:
        found = _Trial(fitted, recorded, count_as_one).found(before)
    except (GraphError, np.linalg.LinAlgError):
        # a search that fails says nothing about the ranges
        return before
    if not found:
        return before
    gain, best = max(found, key=lambda each: each[0])
    if before is not None:
        return before if best.settled(before) else replace(best, alike=before.alike)
    return replace(best, alike=any(other.kind != best.kind and gain - less < ALIKE for less, other in found))


class _Trial:
    """Solutions of a log with few sightings whose ranges are corrected for the errors of landmarks.

    The residual of a range grows with the correction s of its landmark by the range, or by 1. Beside `_scores`, s then has
    the vector b = P s - u and the information P about no correction, so that with a prior N(0, S) it is (P + S^-1)^-1 b.
    """

    def __init__(self, fitted: Unknowns, recorded: Log, count_as_one: Callable[[Unknowns, RangeErrors], float]) -> None:
        self._fitted, self._recorded, self._count_as_one = fitted, recorded, count_as_one
        tested = np.argsort(-np.bincount(fitted.seen - fitted.poses), kind="stable")[:MOST_TESTED]
        self._ids, self._seen = fitted.ids[tested], fitted.ids[fitted.seen - fitted.poses]
        own, ranges = fitted.seen[:, None] - fitted.poses == tested, recorded.sightings[fitted.used, :1]
        self._overstated = OVERSTATED_SIGHTINGS[fitted.numbers]
        self._columns = {SCALE: own * ranges, OFFSET: own * 1.0}

    def found(self, before: RangeErrors | None) -> list[tuple[float, RangeErrors]]:
        """The errors of all and of single landmarks that are large enough, each with its gain.

        Args:
            before: those that were found before, which become more exact; None: there are none.
        """
        if before is None and not any(map(self._promising, OF_ONE)):
            return []
        found = []
        for kind in OF_ONE if before is None else (before.kind,):
            if before is None or before.spread is not None:
                found += self._of_all(kind)
            if before is None or before.spread is None:
                found += self._of_single(kind)
        return found

    def _promising(self, kind: str) -> bool:
        """Whether the solution without further corrections suggests errors."""
        u, P = self._scores(self._fitted, kind)
        return bool(_spread(-u, P)[1] > PROMISING or each_alone(u, P, P)[0].max() > SUGGESTED)

    def _of_all(self, kind: str) -> list[tuple[float, RangeErrors]]:
        """The gain and the errors of all landmarks, drawn from one normal distribution; none where the gain is too small."""
        n = len(self._ids)
        if n < 2:
            return []
        # without an error in common, which is one of the wheels or of all ranges
        Q = np.linalg.svd(np.eye(n) - 1 / n)[0][:, :-1]
        s, solved = np.zeros(n), self._same
        for _ in range(IMPROVED):
            u, P = self._scores(solved, kind)
            b, P = Q.T @ (P @ s - u), Q.T @ P @ Q
            spread, gain = _spread(b, P)
            if gain <= 0:
                return []
            covariance = Q @ np.linalg.inv(P + np.eye(n - 1) / spread**2) @ Q.T
            best, deviations = covariance @ Q @ b, np.sqrt(np.diag(covariance))
            change, s = np.abs(best - s), best
            errors = self._errors(kind, s, deviations, spread)
            solved = self._solved(errors)
            if np.all(change < SETTLED * deviations):
                break
        u, P = self._scores(solved, kind)
        b, P = Q.T @ (P @ s - u), Q.T @ P @ Q
        total = gain_over(solved, self._same) + errors.log_density(self._seen) - float(s @ s) / (2 * spread**2)
        total -= float(np.linalg.slogdet(np.eye(n - 1) + spread**2 * P)[1]) / 2
        # what else the solution gains with the corrections, as from another minimum, is not due to them
        total = min(total, _spread(b, P)[1])
        if total < ALL_OFF or (gain := total / (count := self._count_as_one(solved, errors))) < ALL_OFF:
            return []
        return [(gain, self._errors(kind, s, deviations * (count * self._overstated) ** 0.5, spread))]

    def _of_single(self, kind: str) -> list[tuple[float, RangeErrors]]:
        """The gain and the errors of single landmarks, one after the other while each gains enough."""
        n = len(self._ids)
        s, errors, solved, total = np.zeros(n), self._errors(kind, np.zeros(n), np.zeros(n)), self._same, 0.0
        chosen, count = list[int](), 1.0
        while len(chosen) < MOST_SINGLE * n:
            u, P = self._scores(solved, kind)
            z = each_alone(u, P, P)[0]
            z[chosen] = 0.0
            k = int(np.argmax(z))
            if z[k] < SUGGESTED:
                break
            best, deviations = self._best(kind, s, u, P, [*chosen, k])
            tried = self._errors(kind, best, deviations)
            other = self._solved(tried)
            gain = gain_over(other, solved) + tried.log_density(self._seen) - errors.log_density(self._seen)
            gain -= float(best @ best - s @ s) / (2 * OF_ONE[kind] ** 2)
            after, errors_after = self._best(kind, best, *self._scores(other, kind), [*chosen, k])
            gain = min(gain, (after[k] / errors_after[k]) ** 2 / 2)
            least = FURTHER_OFF if chosen else ONE_OFF
            if gain < least or (gain := gain / (dependent := self._count_as_one(other, tried))) < least:
                break
            count = dependent
            chosen.append(k)
            # each landmark might have been another one
            total += gain - float(np.log(n))
            s, errors, solved = best, tried, other
        if not chosen:
            return []
        best, deviations = self._best(kind, s, *self._scores(solved, kind), chosen)
        return [(total, self._errors(kind, best, deviations * (count * self._overstated) ** 0.5))]

    def _best(self, kind: str, s: Array, u: Array, P: Array, chosen: list[int]) -> tuple[Array, Array]:
        """The errors (n,) of chosen landmarks, zero for the others, and their standard errors."""
        best, deviations, b = np.zeros(len(s)), np.zeros(len(s)), P @ s - u
        covariance = np.linalg.inv(P[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / OF_ONE[kind] ** 2)
        best[chosen], deviations[chosen] = covariance @ b[chosen], np.sqrt(np.diag(covariance))
        return best, deviations

    def _errors(self, kind: str, s: Array, deviations: Array, spread: float | None = None) -> RangeErrors:
        if kind == SCALE:
            s = np.clip(s, 1 / MOST_CORRECTED - 1, MOST_CORRECTED - 1)
        each = zip(self._ids.tolist(), s.tolist(), deviations.tolist())
        return RangeErrors(kind, {id: (value, error) for id, value, error in each if value}, spread)

    @cached_property
    def _same(self) -> Unknowns:
        """The solution without corrections."""
        return self._solved(None)

    def _solved(self, errors: RangeErrors | None) -> Unknowns:
        return refitted(self._fitted, evened(self._recorded, errors))

    def _scores(self, solved: Unknowns, kind: str) -> tuple[Array, Array]:
        """u (n,) and P (n, n), zero for landmarks whose error is not determined."""
        u, P, exact = _scores(solved, RANGE, self._columns[kind])
        known = np.diag(P) > DETERMINED * np.diag(exact)
        return u * known, P * np.outer(known, known)


def _spread(b: Array, P: Array) -> tuple[float, float]:
    """The standard deviation d of errors that is most probable, and the gain of its log likelihood over that of none.

    Errors N(0, d² I) with the vector b and the information P gain (b' (P + I / d²)^-1 b - log |I + d² P|) / 2.
    """
    values, axes = np.linalg.eigh(P)
    values, squares, variances = np.maximum(values, 0.0), (axes.T @ b) ** 2, SPREADS[:, None] ** 2
    gains = np.sum(squares * variances / (1 + variances * values) - np.log1p(variances * values), axis=1) / 2
    k = int(np.argmax(gains))
    return float(SPREADS[k]), float(gains[k])
