"""Which landmark each sighting is of, and which landmarks are one: the answers with the most evidence, given a solved graph.

`evidence` compares whole associations, and `Candidates` finds the best joint hypothesis about sightings, tracks or landmarks.
`assign` gives all sightings of a log to the landmarks of one map, scan by scan, each landmark once in a scan. `merges` tests
jointly, with their covariance from the solved graph, which landmarks are one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..engine import engine
from ..graph.build import pieces
from ..log import UNIDENTIFIED, Log
from ..models import SensorModel
from ..se2 import Array, difference
from .map_solution import INDEPENDENT, MapSolution, Places, Problem, difference_covariance
from .problem import INSIDE, LEAST, AssociationOptions, Classes, Densities, Field


@dataclass(frozen=True, eq=False)
class Visibility:
    """Counts (L,) for each landmark: the scans in which it was well within the field of view, and in which it was seen.

    ``whole`` and ``anywhere`` count the same for the whole field, at whose border noise decides whether a landmark is in it.
    """

    views: np.ndarray
    within: np.ndarray
    whole: np.ndarray
    anywhere: np.ndarray

    @classmethod
    def of(cls, problem: Problem, solution: MapSolution) -> Visibility:
        """The counts for the landmarks of a solved graph."""
        log, field = problem.log, problem.field
        scans = np.unique(log.steps)
        limits = np.array(
            [[field.nearest / s, field.farthest * s, np.cos(min(field.bearing * s, np.pi))] for s in (INSIDE, 1.0)]
        )
        origin = np.array(problem.backbone.origin)
        everywhere = engine.count_views(solution.poses[scans], solution.landmarks, origin, limits)
        inside = _inside(solution.poses[log.steps[solution.rows]], solution.landmarks[solution.which], origin, limits)
        seen = [np.bincount(solution.which, each, len(solution.landmarks)).astype(np.int64) for each in inside]
        return cls(everywhere[0], seen[0], everywhere[1], seen[1])

    def misses(self, densities: Densities) -> Array:
        """The logarithm (L,) of the probability of the views without a sighting; half of it at the border of the field."""
        well = self.views - self.within
        border = np.maximum(self.whole - self.anywhere - well, 0)
        return well * densities.missed + border * np.log1p(-np.exp(densities.seen) / 2)


def _inside(poses: Array, landmarks: Array, origin: Array, limits: Array) -> np.ndarray:
    """For each of the limits (S, 3) whether a landmark (n, d) is inside seen from a pose (n, 3), (S, n)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = (landmarks[:, :2] - poses[:, :2]).T
    x, y = c * dx + s * dy - origin[0], c * dy - s * dx - origin[1]
    square, ahead = x * x + y * y, x * np.abs(x)
    low, high, cosine = limits.T[:, :, None]
    return np.asarray((square >= low**2) & (square <= high**2) & (ahead >= cosine * np.abs(cosine) * square))


#: the most hypotheses that one search compares; the best so far is then the result
MAX_HYPOTHESES = 20_000


@dataclass(frozen=True, eq=False)
class Candidates:
    """Which item (a sighting, a track of sightings, or a landmark) may be which landmark; `best` finds the joint hypothesis.

    Every candidate c pairs an item with a landmark: a residual nu_c that is zero if the two are one, Gaussian, and correlated
    with those of the other candidates. A hypothesis h chooses at most one candidate for each item and uses no landmark twice.
    Its evidence, over that of the hypothesis that all items are new, is

        E(h) = sum of w_c + log N(nu_h; 0, S_hh),

    with w_c = the logarithm of (probability of detection / density of what is new). Only hypotheses that are jointly
    compatible count, nu_h' S_hh^-1 nu_h within the gate. The search is depth first, branch and bound, with S_hh factorised
    row by row.

    Candidates are sorted by item: those of item i are ``starts[i]`` to ``starts[i+1]`` - 1.

    Source: Neira and Tardos, *Data association in stochastic mapping using the joint compatibility test*, T-RA 2001. There
    the number of pairings is maximised; here the evidence, which also decides whether an item is new.

    Attributes:
        starts: (I+1,).
        landmarks: (C,) the landmark of each, a number from 0.
        residuals: (C, d); ``covariance``: (C d, C d) of all of them.
        weights: (C,) w_c.
        bounds: (C,) the most that each can add to the evidence of a hypothesis.
    """

    starts: np.ndarray
    landmarks: np.ndarray
    residuals: Array
    covariance: Array
    weights: Array
    bounds: Array

    @classmethod
    def of(
        cls, items: np.ndarray, landmarks: np.ndarray, residuals: Array, covariance: Array, weights: Array, noise: Array
    ) -> tuple[Candidates, np.ndarray]:
        """Candidates (C,) of items, numbers from 0, in the order in which they are searched; and that order (C,).

        The search takes items with few and likely candidates first, and likely candidates of an item first, so that it
        finds a good hypothesis at once, and compares alternatives for the doubtful items before all others.

        Args:
            noise: (C, d, d) the least that S_cc can become when other candidates are known to be right.
        """
        count, d = residuals.shape
        own = covariance.reshape(count, d, count, d)[np.arange(count), :, np.arange(count)]
        evidence = weights + log_density(residuals, own)[0]
        total = int(items.max(initial=-1)) + 1
        likely = np.full(total, -np.inf)
        np.maximum.at(likely, items, evidence)
        rank = np.empty(total, dtype=np.int64)
        rank[np.lexsort((-likely, np.bincount(items, minlength=total)))] = np.arange(total)
        order = np.lexsort((-evidence, rank[items]))
        # items without a candidate come first, and take no place
        starts = np.append(np.flatnonzero(np.diff(rank[items[order]], prepend=-1)), count)
        columns = (order[:, None] * d + np.arange(d)).ravel()
        return cls(
            starts, np.unique(landmarks, return_inverse=True)[1][order], residuals[order],
            covariance[np.ix_(columns, columns)], weights[order], np.maximum(weights - 0.5 * log_volume(noise), 0.0)[order],
        ), order  # fmt: skip

    def best(
        self, gate: float, allowed: np.ndarray | None = None, most: int = MAX_HYPOTHESES
    ) -> tuple[np.ndarray, float]:
        """The candidate (I,) of each item that has some in the best hypothesis, -1 for none, and its evidence E.

        Args:
            gate: the share of correct hypotheses that should count.
            allowed: (C,) which candidates may be used; default: all.
            most: the most hypotheses to compare.
        """
        allowed = np.ones(len(self.landmarks), dtype=bool) if allowed is None else allowed
        items, d = len(self.starts) - 1, self.residuals.shape[1]
        if len(self.landmarks) == 0:
            return np.full(items, -1), 0.0
        return engine.best_hypothesis(
            self.starts, self.landmarks, self.residuals, self.covariance, self.weights, self.bounds, allowed,
            gates(gate, d, items), most,
        )  # fmt: skip

    def margins(self, chosen: np.ndarray, evidence: float, gate: float, most: int = MAX_HYPOTHESES) -> Array:
        """For each item (I,) how much worse the best hypothesis without its chosen candidate is; infinite for none."""
        margins = np.full(len(chosen), np.inf)
        for i in np.flatnonzero(chosen >= 0):
            allowed = np.ones(len(self.landmarks), dtype=bool)
            allowed[chosen[i]] = False
            margins[i] = evidence - self.best(gate, allowed, most)[1]
        return margins


@cache
def gates(probability: float, dimension: int, items: int) -> Array:
    """The quantile (I+1,) of chi-square for 0 to I residuals of a dimension."""
    from scipy.special import gammaincinv

    return np.array([2 * gammaincinv(dimension * n / 2, probability) if n else 0.0 for n in range(items + 1)])


def log_density(residuals: Array, covariances: Array) -> tuple[Array, Array]:
    """log N(nu; 0, S) (...) and nu' S^-1 nu (...), for residuals (..., d) and covariances (..., d, d)."""
    squares = np.einsum("...i,...i->...", residuals, np.linalg.solve(covariances, residuals[..., None])[..., 0])
    return -0.5 * (squares + log_volume(covariances)), squares


def log_volume(covariances: Array) -> Array:
    """log det(2 pi S) (...)."""
    return np.linalg.slogdet(covariances)[1] + covariances.shape[-1] * np.log(2 * np.pi)


def evidence(problem: Problem, solution: MapSolution) -> float:
    """The evidence E for the labels A of a solved graph, which compares the ends of different front ends and hypotheses.

    It is Laplace's approximation of log p(Z, A), without what all associations of a log have in common:

        E = -J/2 - 1/2 log det(Omega / 2 pi)
            + sum over sightings with a landmark of [log P_D - log c + 1/2 log det(Q^-1 / 2 pi)]
            + L log rho + (views without a sighting) log(1 - P_D),

    where L is the number of landmarks, rho their density and c that of clutter. Sightings that are clutter have the factor 1.
    Only differences between associations of one log, with the same densities, mean anything.
    """
    d, count, densities = solution.landmarks.shape[1], len(solution.landmarks), problem.densities
    Q = np.asarray(problem.backbone.places.covariances)[solution.rows]
    sightings = len(solution.rows) * (densities.seen - densities.clutter) - 0.5 * float(np.sum(log_volume(Q)))
    # poses are the same in number for all associations, so their powers of 2 pi are left out
    volume = 0.5 * d * count * np.log(2 * np.pi) - 0.5 * solution.log_determinant
    misses = float(Visibility.of(problem, solution).misses(densities).sum())
    return -0.5 * solution.cost + volume + sightings + count * densities.new + misses


def assign(
    world: Places, steps: np.ndarray, landmarks: Array, own: Array, gate: float,
    weights: Callable[[np.ndarray, np.ndarray], Array],
) -> tuple[np.ndarray, Array]:  # fmt: skip
    """The landmark (M,) of each sighting, -1 for none, and its margin: the assignment of every scan with most evidence.

    Args:
        world: the places of the sightings in world axes.
        steps: (M,) of the sightings.
        landmarks: (L, d), with covariances ``own`` (L, d, d).
        gate: share of correct sightings that are within the gate.
        weights: from the sightings (C,) and landmarks (C,) of pairs to what the evidence has beside log N.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial import cKDTree

    limit = float(gates(gate, world.means.shape[1], 1)[1])
    # the trace is no less than the largest variance in any direction
    spread, most = (np.trace(C[:, :2, :2], axis1=1, axis2=2) for C in (world.covariances, own))
    radius = np.sqrt(limit * (spread + np.max(most, initial=0.0)))
    lists = cKDTree(landmarks[:, :2]).query_ball_point(world.means[:, :2], radius)
    item = np.repeat(np.arange(len(lists)), [len(each) for each in lists])
    landmark = np.fromiter((j for each in lists for j in each), dtype=np.int64, count=len(item))
    nu = difference(world.means[item], landmarks[landmark])
    density, squares = log_density(nu, world.covariances[item] + own[landmark])
    evidence = density + weights(item, landmark)
    kept = (squares <= limit) & (evidence > 0)
    item, landmark, evidence = item[kept], landmark[kept], evidence[kept]
    chosen, margins = np.full(len(steps), -1), np.full(len(steps), np.inf)
    scan = np.unique(steps[item], return_inverse=True)[1]
    doubtful = np.unique(scan[_repeated(item) | _repeated(scan * len(landmarks) + landmark)])
    clear = ~np.isin(scan, doubtful)
    chosen[item[clear]], margins[item[clear]] = landmark[clear], evidence[clear]
    for number in doubtful:
        run = scan == number
        rows, row = np.unique(item[run], return_inverse=True)
        names, column = np.unique(landmark[run], return_inverse=True)
        table = np.zeros((len(rows), len(names) + len(rows)))
        table[row, column] = evidence[run]
        a, b = linear_sum_assignment(table, maximize=True)
        good = table[a, b] > 0
        a, b = a[good], b[good]
        chosen[rows[a]] = names[b]
        others = table[a].copy()
        others[np.arange(len(a)), b] = 0.0
        margins[rows[a]] = table[a, b] - others.max(axis=1)
    return chosen, margins


def _repeated(numbers: np.ndarray) -> np.ndarray:
    """(C,) whether a number occurs more than once."""
    _, of_each, times = np.unique(numbers, return_inverse=True, return_counts=True)
    return times[of_each] > 1


def ids_by_map(
    log: Log, poses: Array, means: Mapping[int, Array], covariances: Mapping[int, Array], sensor: SensorModel,
    classes: Classes | None = None, probabilities: Mapping[int, Array] | None = None,
) -> np.ndarray:  # fmt: skip
    """The id (M,) of the landmark of a map to which each sighting belongs, `UNIDENTIFIED` for none.

    Args:
        log: the sightings; their own ids are not used.
        poses: (T+1, 3) the trajectory to which the map belongs.
        means, covariances: the map, {id: (d,)} and {id: (d, d)}.
        sensor: the noise model.
        classes: of the sightings, with the ``probabilities`` {id: (n,)} that each landmark is of each class.
    """
    if not means or len(log.steps) == 0:
        return np.full(len(log.steps), UNIDENTIFIED)
    options, names = AssociationOptions(), np.array(list(means))
    densities = Densities.of(log, Field.of(log, sensor), options.clutter)
    world = Places.of(log, sensor).seen_at(np.asarray(poses)[log.steps])
    own = np.array([covariances[j] for j in means])

    def weights(item: np.ndarray, landmark: np.ndarray) -> Array:
        constant = np.full(len(item), densities.seen - densities.clutter)
        if classes is None or probabilities is None or classes.count == 1:
            return constant
        of_landmarks = np.log(np.maximum([probabilities[j] for j in means], LEAST))
        return constant + classes.together(classes.of_sightings(item), of_landmarks[landmark])

    chosen, _ = assign(world, log.steps, np.array(list(means.values())), own, options.gate, weights)
    return np.where(chosen < 0, UNIDENTIFIED, names[chosen])


#: the gate of `merges` with ``views``: where two landmarks divide the sightings of one, each has those nearer to itself, so
#: that they lie farther apart than independent errors would put them
SHARED = 1 - 1e-9
#: the most landmarks that one search merges; of more, each connected piece is searched by itself
MOST_ITEMS = 40
#: the most pairs in one search; their joint covariance has the square of this number of blocks
MOST_PAIRS = 1_000
#: the most hypotheses that a search for merges compares
MAX_MERGE_HYPOTHESES = 3_000


@dataclass(frozen=True)
class Merge:
    """Landmarks that are one, by their places in `MapSolution.landmarks`: ``item`` becomes ``into``.

    ``margin`` is the logarithm of the evidence for it over that for the best other hypothesis, ``evidence`` that for all
    merges found together over that for none.
    """

    item: int
    into: int
    margin: float
    evidence: float


def merges(problem: Problem, solution: MapSolution, items: np.ndarray, views: np.ndarray | None = None) -> list[Merge]:
    """The best joint hypothesis on which of the landmarks ``items`` (places in `MapSolution.landmarks`) are older landmarks.

    Two landmarks with difference delta ~ N(0, S) if they are one are merged where the evidence for it, log N(delta; 0, S) -
    log(density of landmarks), is positive. This is the Bayesian information criterion with its constants: the landmark that
    goes away saves -2 log(density) - log det(2 pi S), and J rises by delta' S^-1 delta. Without ``views``, landmarks that
    were seen in one scan are never one.

    Args:
        views: (L,) in how many scans each landmark was in the field of view, if poses are known well enough for that.
    """
    densities, classes = problem.densities, problem.classes
    seen = solution.seen(problem.log.steps)
    shown = classes.sums(solution.which, solution.rows, len(seen))
    d, probability = solution.landmarks.shape[1], problem.options.gate if views is None else SHARED
    gate = float(gates(probability, d, 1)[1])
    item, other, both = _near(solution, items, seen, gate, 0 if views is None else np.inf)
    if len(item) == 0:
        return []
    chosen = np.unique(np.concatenate([item, other]))
    P = solution.joint_covariance(chosen)
    a, b = np.searchsorted(chosen, item), np.searchsorted(chosen, other)
    nu = difference(solution.landmarks[item], solution.landmarks[other])
    slack = solution.slack_of(item, other)
    own = P[a, :, a] + P[b, :, b] - P[a, :, b] - P[b, :, a] + slack
    weights = -densities.new + classes.together(shown[item], shown[other])
    if views is not None:
        # two landmarks missed one sighting in every view without both; if they are one, a second sighting is clutter
        V = np.minimum(views[item], views[other])
        volume = log_volume(INDEPENDENT / 2 * slack)
        sighting = densities.seen - densities.clutter - 0.5 * (volume + d)
        weights = weights - np.maximum(V - both, 0) * densities.missed - both * np.maximum(sighting, 0)
    density, squares = log_density(nu, own)
    kept = (squares <= gate) & (density + weights > 0)
    item, other, a, b = item[kept], other[kept], a[kept], b[kept]
    nu, weights, alone = nu[kept], weights[kept], (density + weights)[kept]
    found: list[Merge] = []
    # landmarks that share no candidate are decided on their own
    label = pieces(len(chosen), [a], [b])[a]
    groups = (
        [np.arange(len(a))] if len(np.unique(item)) <= MOST_ITEMS else [np.flatnonzero(label == g) for g in set(label)]
    )
    for group in groups:
        likely = group[np.argsort(-alone[group], kind="stable")] if len(group) > MOST_PAIRS else group
        for begin in range(0, len(group), MOST_PAIRS):
            some = likely[begin : begin + MOST_PAIRS]
            decided = _decided(
                solution, item[some], other[some], a[some], b[some], nu[some], weights[some], P, probability
            )
            found += decided
            if decided:
                # less likely pairs are decided on in the next round, when these are merged
                break
    return found


def disjoint(found: list[Merge]) -> list[Merge]:
    """The merges of which no two have a landmark in common: of those that do, the one with the greatest margin."""
    taken: set[int] = set()
    kept = []
    for m in sorted(found, key=lambda m: -m.margin):
        if m.item not in taken and m.into not in taken:
            kept.append(m)
            taken |= {m.item, m.into}
    return kept


def _near(
    solution: MapSolution, items: np.ndarray, seen: list[np.ndarray], gate: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of an item and an older landmark within the gate of their marginal covariances, in at most ``most`` common scans.

    Returns:
        Item, older landmark, and the number of scans with both.
    """
    m, S, labels = solution.landmarks[:, :2], solution.covariances + solution.slack, solution.labels
    variances = np.diagonal(S, axis1=1, axis2=2)[:, :2]
    # the variance of the difference is at most the sum, as errors of landmarks are correlated positively
    close = (m[items, None] - m[None]) ** 2 <= gate * (variances[items, None] + variances[None])
    near = (labels[items, None] > labels[None]) & np.all(close, axis=2)
    pairs = [(items[k], j) for k, j in np.argwhere(near)]
    steps = {k: set(seen[k].tolist()) for k in {each for pair in pairs for each in pair}}
    both = [len(steps[k] & steps[j]) for k, j in pairs]
    found = np.array([(k, j, n) for (k, j), n in zip(pairs, both) if n <= most], dtype=np.int64).reshape(-1, 3)
    return found[:, 0], found[:, 1], found[:, 2]


def _decided(
    solution: MapSolution, item: np.ndarray, other: np.ndarray, a: np.ndarray, b: np.ndarray, nu: Array, weights: Array,
    P: Array, gate: float,
) -> list[Merge]:  # fmt: skip
    """The merges of one search."""
    if len(item) == 0:
        return []
    slack = solution.slack_of(item, other)
    S = difference_covariance(P, a, b, slack).reshape(nu.size, nu.size)
    # at least the noise that the sightings themselves leave, the other landmarks and poses known
    noise = solution.own_covariances[item] + slack
    candidates, order = Candidates.of(np.unique(item, return_inverse=True)[1], other, nu, S, weights, noise)
    item, other = item[order], other[order]
    chosen, evidence = candidates.best(gate, most=MAX_MERGE_HYPOTHESES)
    margins = candidates.margins(chosen, evidence, gate, most=MAX_MERGE_HYPOTHESES // 10)
    return [Merge(int(item[c]), int(other[c]), float(m), float(evidence)) for c, m in zip(chosen, margins) if c >= 0]
