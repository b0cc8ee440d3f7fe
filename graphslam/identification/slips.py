"""Stretches of a drive on which the odometry is wrong: wheels slip or are blocked, or a gyroscope misreads.

The noise models say how much all motions scatter. Wheels that slip for ten seconds are off by metres in one direction there,
and a solution that believes the models spreads the error over poses and landmarks. So every stretch is tested for an error of
its own. With e, W and B the residuals, the information and the Jacobians of the motions at the solution, Omega its
information matrix, and D the error of each motion for one unit of s,

    u = D' W e,   P = D' W D - D' W B Omega^-1 B' W D,   s = -u / P,   z = |u| / sqrt(P):

s is the result of one Gauss-Newton step of the poses and s together, and z a standard normal number where the odometry is
right. D is one of four (`_errors`): a constant error of the speed or of the turn rate, or a part of what was recorded of
them. Sums of u and P over cells of a second give all stretches at once. What is constant over the whole drive is a bias, and
is projected out.

`without_contradicted` finds slips that this test cannot see, because nearly all sightings of the stretch count little.

`uneven_of` tests in the same way whether a scale of the odometry differs between driving forward and in reverse, or between
left and right turns. D is the derivative by a part of |u| of the controls u. Such a difference counts where the likelihood
with the controls corrected is larger by enough, each with the noise that fits best.

**Remedy.** The controls of a stretch have an additional variance, with which the error of the whole stretch has the standard
deviation that was found. What is left then tells how much z is to be trusted: where models are too narrow, or errors
correlated, all stretches have a large z. So z counts in units of the median of those that are left.

Sources: Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948; Kulldorff, *A spatial scan
statistic*, 1997 (the largest z of all stretches).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..errors import GraphError, LogError
from ..linear.cholesky import Factor
from ..log import Log
from ..models import additional_variances
from ..se2 import Array, perpendicular
from .corrections import averaged_controls
from .odometry import Edges, Odometry
from .restricted_likelihood import DETERMINED, each_alone, gain_over, refitted, scores
from .sighting_errors import BURST, CONTRADICTS, of_rate
from .unknowns import Unknowns

Problem = TypeVar("Problem")
#: a slip, if any, and the median of z of all stretches over the usual one
Found = tuple["Slip | None", float]

#: the least length of a cell [s], and the most cells of a drive, also where it is only asked whether there may be a slip
CELL, CELLS, ROUGH_CELLS = 1.0, 120, 30
#: the longest stretch, as a part of the drive
LONGEST = 1 / 3
#: a stretch whose z is above this has an error of its own; and one above the second number where the likelihood gains enough
#: with it: weights of Student's t make the z of large errors small; see docs/decisions.md
SLIPPED, SUSPECTED = 6.0, 4.0
#: the same where noise is given, which does not contain the slow errors of real wheels: z is up to 7.5 on MR.CLAM 6, where a
#: correction makes the ATE larger, and was above 9 on all but three of 90 simulated drives with a slip
SLIPPED_GIVEN = 8.0
#: an error beyond so many times the largest speed, or turn rate, is none of wheels or gyroscopes
FASTEST = 3.0
#: the most stretches of one drive, and the part of it that they may have together
MOST, WRONG = 3, 0.4
#: a part of the way or of the turn is that of the mean over a cell that is above so many standard deviations: the noise of a
#: recorded control is in the residual of its motion, too, so that controls that are mostly noise explain it
MOVED = 3.0
#: stretches whose z² are so near fit as well: the quantile 0.95 of chi-square for both ends
ROUGHLY = 6.0
#: the standard deviations of what is constant over the whole drive, for each of the four errors. Wheels have no constant
#: error. At a constant speed, that and a part of the way would together be any stretch that is recorded as faster
BIASES = (0.0, 0.1, 0.01, 0.1)
#: a z above the first number suggests a difference between two directions, which counts where the log likelihood gains the
#: second
SUGGESTED, GAINED = 3.5, 12.5
#: the least part of the way, or of all turns, in each direction: on a circle |u| is u, and a difference is a scale
BOTH_WAYS = 0.05
#: for notes of both kinds of such differences: what is larger, where it is negative, and why
LARGER = (
    "forward speeds are recorded larger than backward ones by", "backward speeds are recorded larger than forward ones by",
    "as where wheels slip more in that direction",
), (
    "left turns are recorded larger than right ones by", "right turns are recorded larger than left ones by",
    "as where one of two wheels slips more",
)  # fmt: skip
#: the median of the absolute value of a standard normal number
MEDIAN = 0.6745


@dataclass(frozen=True)
class Motions:
    """What the odometry says of motions: ``measured`` (E, 3), the noise models their ``variances`` (E, 3), and the ``times``
    (E+1,) of the poses that they join [s]."""

    measured: Array
    variances: Array
    times: Array


@dataclass(frozen=True)
class Slip:
    """A stretch on which the odometry is wrong.

    Attributes:
        begin, end: [s] since the first pose.
        column: 0 where the speed is wrong, 1 where the turn rate is.
        rate: by how much, the root of the mean square [m/s or rad/s].
        z: the error in standard deviations; of the stretch with the ends that it may have.
    """

    begin: float
    end: float
    column: int
    rate: float
    z: float

    def sentence(self, log: Log, *, corrected: bool = True) -> str:
        """For the notes of a solution or of an estimate.

        Args:
            log: the log of the drive.
            corrected: whether its controls there have more noise (`with_slip`).
        """
        assert log.times is not None
        times = log.times - log.times[0]
        begin = int(np.searchsorted(times, self.begin, side="right")) - 1
        end = min(int(np.searchsorted(times, self.end)), len(times) - 1)
        unit = ("m/s", "rad/s")[self.column]
        found, rest = (
            f"between steps {begin} and {end} ({self.begin:.0f} to {self.end:.0f} s after the start) the odometry "
            f"contradicts the other measurements by about {self.rate:.2g} {unit}, {self.z:.1f} times the standard error: "
            "wheels slipped or were blocked, a gyroscope misread, the robot was moved, or many ids are wrong. ",
            "The poses there may be off, those after it and landmarks, too, and covariances do not contain it. Controls that "
            "are wrong need more noise (Log.control_variances); where the robot was carried, cut the log there and solve "
            "both parts as two drives (join_logs)",
        )
        if corrected:
            rest = (
                "The controls there count as uncertain by as much (Log.control_variances), and covariances contain it"
            )
        return found + rest


def with_slip(log: Log, slip: Slip) -> Log:
    """The log with the variance of a slip in the controls of its stretch."""
    assert log.controls is not None and log.dt is not None
    middle = (log.control_times[1:] + log.control_times[:-1]) / 2
    rows = (middle > slip.begin) & (middle < slip.end)
    variances = additional_variances(log.control_variances, len(log.controls))
    variances[rows, slip.column] += slip.rate**2 * (slip.end - slip.begin) / log.dt[rows]
    return log.replace(control_variances=variances)


def largest_slip(motions: Edges, ways: Motions, factor: Factor, fixed: np.ndarray, least: float = 0.0) -> Found:
    """The stretch with the largest z, and the median of all z over the usual one.

    Args:
        motions: in the order of time, in the axes of the pose that each starts from, with their information.
        ways: what the odometry says of them.
        factor: of Omega.
        fixed: the nodes that do not move.
        least: where no z of constant errors over few long cells is above this, which takes an eighth of the time, no other
            stretch is looked for.
    """
    tested = _Tested(motions, ways, factor, fixed)
    if least:
        rough, usual = tested.largest(ROUGH_CELLS, (0, 2))
        if rough is None or rough.z < least:
            return None, usual
    return tested.largest(CELLS, (0, 1, 2, 3))


@dataclass(frozen=True)
class _Tested:
    """The arguments of `largest_slip`."""

    motions: Edges
    ways: Motions
    factor: Factor
    fixed: np.ndarray

    def largest(self, cells: int, kinds: tuple[int, ...]) -> Found:
        """`largest_slip` among stretches of cells of errors of some kinds."""
        times = self.ways.times - self.ways.times[0]
        count = int(np.clip(times[-1] / CELL, 1, cells))
        limits = np.linspace(0.0, times[-1], count + 1)
        cell = np.clip(np.searchsorted(limits, (times[:-1] + times[1:]) / 2) - 1, 0, count - 1)
        D = _errors(self.ways, cell, count)[:, :, kinds]
        a, b = np.triu_indices(count + 1, 1)
        a, b = (each[b - a <= max(1, LONGEST * count)] for each in (a, b))
        scores, information, exact = self._scores(D, kinds, cell, count, a, b)
        known = information > DETERMINED * exact
        if not known.any():
            return None, 1.0
        z = np.where(known, np.abs(scores) / np.sqrt(np.where(known, information, 1.0)), 0.0)
        k, kind = np.unravel_index(np.argmax(z), z.shape)
        # the ends are known roughly, and what is left of a slip does more harm than some right motions that are not believed;
        # it may also begin within the cell before
        around = (a <= a[k]) & (b >= b[k]) & (z[:, kind] ** 2 > z[k, kind] ** 2 - ROUGHLY)
        k = np.flatnonzero(around)[np.argmax((b - a)[around])]
        inside, length = (cell >= a[k]) & (cell < b[k]), float(limits[b[k]] - limits[a[k]])
        column = 0 if kinds[kind] < 2 else 1
        rates = scores[k, kind] / information[k, kind] * D[inside, 2 * column, kind]
        rate = float(np.sqrt(np.sum(rates**2 / np.diff(times)[inside]) / length))
        begin, end = limits[max(a[k] - 1, 0)], limits[min(b[k] + 1, count)]
        slip = Slip(float(begin), float(end), column, rate, float(z[k, kind]))
        return slip, float(np.median(z[known])) / MEDIAN

    def _scores(
        self, D: Array, kinds: tuple[int, ...], cell: np.ndarray, count: int, a: np.ndarray, b: np.ndarray
    ) -> tuple[Array, Array, Array]:
        """u, P and D' W D (each (stretches, k)) of the k errors in the stretches from cell a on to the one before b."""
        weighted = self.motions.information @ D
        # of constant errors of the whole drive
        following = self.factor.solve(self._pulled(weighted, np.zeros_like(cell), 1)[:, :, 0])
        crossed = self._summed(np.swapaxes(D, 1, 2) @ weighted - self._against(weighted, following), cell, count)
        allowed = np.array([BIASES[kind] for kind in kinds])
        whole = np.eye(len(kinds)) + crossed.sum(axis=0) * np.outer(allowed, allowed)
        bias = crossed * allowed @ np.linalg.inv(whole) * allowed
        u = np.einsum("eik,ei->ek", weighted, self.motions.residuals)
        own = self._summed(np.einsum("eik,eik->ek", D, weighted), cell, count)
        information = np.zeros((len(a), D.shape[2]))
        u = self._summed(u, cell, count)
        parts = []
        for kind in range(D.shape[2]):
            following = self.factor.solve(self._pulled(weighted[:, :, [kind]], cell, count)[:, :, :, 0])
            P = np.diag(own[:, kind]) - self._summed(
                self._against(weighted[:, :, [kind]], following)[:, 0], cell, count
            )
            parts.append(P - bias[:, kind] @ crossed[:, kind].T)
        u -= np.einsum("ckm,m->ck", bias, u.sum(axis=0))
        for kind, P in enumerate(parts):
            grid = np.zeros((count + 1, count + 1))
            grid[1:, 1:] = P.cumsum(axis=0).cumsum(axis=1)
            information[:, kind] = grid[a, a] + grid[b, b] - 2 * grid[a, b]
        total, exact = (np.concatenate([np.zeros((1, D.shape[2])), np.cumsum(each, axis=0)]) for each in (u, own))
        return total[b] - total[a], information, exact[b] - exact[a]

    def _pulled(self, weighted: Array, cell: np.ndarray, count: int) -> Array:
        """B' W D (n, 3, count, k) of each cell."""
        moved = np.zeros((len(self.factor.symbolic.indptr) - 1, count, 3, weighted.shape[2]))
        for at, jacobians in (
            (self.motions.first, self.motions.by_first),
            (self.motions.second, self.motions.by_second),
        ):
            # no two motions begin, or end, at one node
            moved[at, cell] += np.swapaxes(jacobians, 1, 2) @ weighted
        moved[self.fixed] = 0.0
        return moved.transpose(0, 2, 1, 3)

    def _against(self, weighted: Array, following: Array) -> Array:
        """D' W B x (E, k, c) of each motion, for moves x (n, 3, c) of the nodes."""
        one, two = following[self.motions.first], following[self.motions.second]
        return np.swapaxes(weighted, 1, 2) @ (self.motions.by_first @ one + self.motions.by_second @ two)

    def _summed(self, values: Array, cell: np.ndarray, count: int) -> Array:
        """The sums (count, ...) of values (E, ...) over cells."""
        total = np.zeros((count, *values.shape[1:]))
        np.add.at(total, cell, values)
        return total


def _errors(ways: Motions, cell: np.ndarray, count: int) -> Array:
    """D (E, 3, 4): a constant error of the speed, a part of the way, a constant one of the turn rate, a part of the turn."""
    half, dt = ways.measured[:, 2] / 2, np.diff(ways.times)
    ahead = np.column_stack([np.cos(half), np.sin(half), np.zeros(len(dt))])
    turned = np.column_stack([perpendicular(ways.measured[:, :2]) / 2, np.ones(len(dt))])

    def surely(values: Array, variances: Array) -> Array:
        total, noise, duration = (np.bincount(cell, each, count) for each in (values, variances, dt))
        moved = np.where(np.abs(total) > MOVED * np.sqrt(noise), total, 0.0)
        return moved[cell] / duration[cell] * dt

    way = surely(np.einsum("ei,ei->e", ahead, ways.measured), ways.variances[:, 0])
    turn = surely(ways.measured[:, 2], ways.variances[:, 2])
    return np.stack([ahead * dt[:, None], ahead * way[:, None], turned * dt[:, None], turned * turn[:, None]], axis=-1)


def slip_of_drive(solved: Unknowns) -> Found:
    """`largest_slip` of a drive whose noise and biases are unknown."""
    linear, times = solved.linearized(), solved.log.times
    assert times is not None
    # after the next step of the poses and biases: what a search has not reached yet looks like slips
    motions, (nodes, values) = linear.edges[0], linear.step()
    motions = replace(motions, residuals=motions.residuals + motions.moved(nodes[:, :, None], values[:, None])[:, :, 0])
    ways = Motions(solved.measured()[0], np.diagonal(solved.covariances(motions), axis1=1, axis2=2), times)
    return largest_slip(motions, ways, linear.factor, np.zeros(1, dtype=np.int64))


@dataclass(frozen=True)
class Uneven:
    """A scale of the odometry that differs between two directions.

    Attributes:
        column: 0 for speeds forward and in reverse, 1 for turns to the left and to the right.
        difference: the part by which forward speeds, or left turns, are recorded larger than the others.
        error: its standard error.
    """

    column: int
    difference: float
    error: float

    @property
    def sentence(self) -> str:
        """For the notes of an estimate."""
        *larger, cause = LARGER[self.column]
        return (
            f"{larger[self.difference < 0]} {100 * abs(self.difference):.2g} % (standard error {100 * self.error:.1g} %), "
            f"{cause}. They are corrected in this log, and files of the robot do not contain the correction"
        )


def levelled(log: Log, uneven: Iterable[Uneven]) -> Log:
    """The log with the controls u - difference |u| / 2.

    Raises:
        LogError: there are no controls to correct.
    """
    if not (uneven := tuple(uneven)):
        return log
    if log.controls is None:
        raise LogError(
            f"{log.name} has no controls, and scales that differ between two directions cannot be taken out of them"
        )
    controls, sizes = log.controls.copy(), np.abs(averaged_controls(log))
    for each in uneven:
        controls[:, each.column] -= each.difference / 2 * sizes[:, each.column]
    return log.replace(controls=controls)


def uneven_of(fitted: Unknowns) -> Uneven | None:
    """The larger difference between two directions of the odometry, if any; ``fitted`` is the solution with few sightings."""
    log, (z, differences, _) = fitted.odometry.log, _differences(fitted)
    assert log.dt is not None
    ways = averaged_controls(log) * log.dt[:, None]
    least = np.minimum(np.maximum(ways, 0).sum(axis=0), np.maximum(-ways, 0).sum(axis=0))
    z = np.where(least > BOTH_WAYS * np.abs(ways).sum(axis=0), z, 0.0)
    column = int(np.argmax(z))
    if z[column] < SUGGESTED:
        return None
    found = Uneven(column, float(differences[column]), 0.0)

    def again(log: Log) -> Unknowns:
        start = copy(fitted)
        start.odometry = Odometry(log)
        return refitted(start, fitted.log)

    even, same = again(levelled(log, [found])), again(log)
    if gain_over(even, same) < GAINED:
        return None
    _, rest, errors = _differences(even)
    return replace(found, difference=found.difference + float(rest[column]), error=float(errors[column]))


def _differences(solved: Unknowns) -> tuple[Array, Array, Array]:
    """z, the difference and its standard error (2,) of speeds and of turn rates; zero where it is not determined."""
    return each_alone(*scores(solved, 0, -solved.by_differences()))


def contradicted(solved: Unknowns) -> tuple[float, float] | None:
    """The begin and the end [s] of the stretch in which sightings contradict much more often than elsewhere, if any.

    A slip makes nearly all sightings wrong where odometry is believed to be exact, such as that of wheels that read zero.
    Weights of Student's t then hide it from `slip_of_drive`. With k of n sightings of a stretch that contradict, and K of all
    N, its gain (Kulldorff) is l(k, n) + l(K - k, N - n) - l(K, N), l(k, n) = k log(k/n) + (n - k) log(1 - k/n).
    """
    log = solved.log
    assert log.times is not None
    times = log.times - log.times[0]
    count = int(np.clip(times[-1] / CELL, 1, CELLS))
    limits = np.linspace(0.0, times[-1], count + 1)
    cell = np.clip(np.searchsorted(limits, times[solved.seen_from]) - 1, 0, count - 1)
    wrong = solved.linearized().edges[1].squares > CONTRADICTS
    N, K = (np.concatenate([[0], np.cumsum(np.bincount(cell, each, count))]) for each in (np.ones(len(cell)), wrong))
    a, b = np.triu_indices(count + 1, 1)
    a, b = (each[b - a <= max(1, LONGEST * count)] for each in (a, b))
    n, k = N[b] - N[a], K[b] - K[a]
    gain = of_rate(k, n) + of_rate(K[-1] - k, N[-1] - n) - of_rate(K[-1:], N[-1:])
    gain[k * N[-1] <= n * K[-1]] = 0.0
    best = int(np.argmax(gain))
    if gain[best] < BURST:
        return None
    return float(limits[max(a[best] - 1, 0)]), float(limits[min(b[best] + 1, count)])


def without_contradicted(
    problem: Unknowns, log: Log, again: Callable[[Unknowns, Log], Unknowns], most: int
) -> tuple[Unknowns, Log, tuple[Slip, ...]]:
    """The problem with more noise of the controls in at most so many stretches that `contradicted` finds.

    The speed or the turn rate there may have any error. The gain of the likelihood decides; z is the root of twice the gain.
    """
    found: tuple[Slip, ...] = ()
    while len(found) < most and (stretch := contradicted(problem)) is not None:
        begin, end = stretch
        if end - begin + sum(slip.end - slip.begin for slip in found) > WRONG * log.control_times[-1]:
            break
        assert log.controls is not None
        largest = np.abs(log.controls).max(axis=0).tolist()
        wide = [Slip(begin, end, column, size, 0.0) for column, size in enumerate(largest) if size > 0]
        if not wide:
            break
        try:
            same = again(problem, log)
            trials = [(again(problem, with_slip(log, slip)), slip) for slip in wide]
            gain, trial, slip = max(
                ((gain_over(each, same), each, slip) for each, slip in trials), key=lambda each: each[0]
            )
            if gain < GAINED:
                break
            assert trial.log.times is not None
            times = trial.log.times - trial.log.times[0]
            inside = (times[1:] > begin) & (times[:-1] < end)
            e = trial.motions().residuals[inside].sum(axis=0)
            size = np.hypot(*e[:2]) if slip.column == 0 else abs(e[2])
            slip = replace(slip, rate=float(size / (end - begin)), z=float((2 * gain) ** 0.5))
            solved = again(trial, with_slip(log, slip))
        except (GraphError, np.linalg.LinAlgError):
            break
        problem, log, found = solved, with_slip(log, slip), (*found, slip)
    return problem, log, found


def without_slips(
    problem: Problem,
    log: Log,
    test: Callable[[Problem], Found],
    again: Callable[[Problem, Log], Problem | None],
    gain: Callable[[Problem, Problem], float] | None = None,
    limit: float = SLIPPED,
) -> tuple[Problem, Log, tuple[Slip, ...], Slip | None]:
    """The problem of a log in which the stretches with errors of their own have more noise, these stretches, and another one
    that stays in it, if any.

    Args:
        test: the largest slip of a solved problem.
        again: the problem solved with another log; None where that explains too little of what is wrong.
        gain: the log likelihood of a problem over that of another one, by which stretches above `SUSPECTED` are judged.
        limit: z of a slip; `SLIPPED_GIVEN` where noise is given.

    One stays where its error is beyond all speeds, where the problem has no solution without it, or where it is one too many.
    """
    found: tuple[Slip, ...] = ()
    first, recorded = problem, log
    slip, usual = test(problem)
    while slip is not None and slip.z > (limit if gain is None else SUSPECTED):
        assert log.controls is not None
        if len(found) == MOST or slip.rate > FASTEST * np.abs(log.controls[:, slip.column]).max():
            # a robot that was carried far, or other units
            break
        noisier = with_slip(log, slip)
        try:
            trial = again(problem, noisier)
        except GraphError:
            break
        following, left = (None, np.inf) if trial is None else test(trial)
        z = slip.z / max(1.0, left)
        surely = z >= limit
        if not surely and trial is not None and gain is not None and z >= SUSPECTED:
            # without the slip as many rounds as with it
            same = again(problem, log)
            surely = same is not None and gain(trial, same) > GAINED
        if trial is None or not surely:
            slip = None
            break
        problem, log, found = trial, noisier, (*found, replace(slip, z=z))
        slip, usual = following, left
    if sum(slip.end - slip.begin for slip in found) > WRONG * log.control_times[-1]:
        # models or units that are wrong all the time
        return first, recorded, (), None
    stays = slip is not None and slip.z > limit * max(1.0, usual)
    return problem, log, found, slip if stays else None
