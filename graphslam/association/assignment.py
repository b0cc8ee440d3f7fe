"""Which landmark is a sighting of, and which landmarks are one, given a solved graph.

`assign` gives all sightings of a log to the landmarks of one map, scan by scan, each landmark once in a scan. `merges` tests
jointly, with their covariance from the solved graph, which landmarks are one.

Two landmarks with difference delta ~ N(0, S) if they are one are merged where the evidence for it, log N(delta; 0, S) -
log(density of landmarks), is positive. This is the Bayesian information criterion with its constants: the landmark that
goes away saves -2 log(density) - log det(2 pi S), and J rises by delta' S^-1 delta. Landmarks that were seen in one scan
are never one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..graph.build import pieces
from ..log import UNIDENTIFIED, Log
from ..models import SensorModel
from ..se2 import Array, difference
from .evidence import Candidates, gates, log_density, log_volume
from .map_solution import INDEPENDENT, MapSolution, Places, Problem, difference_covariance
from .problem import LEAST, AssociationOptions, Classes, Densities, Field


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
    spread = np.trace(world.covariances[:, :2, :2], axis1=1, axis2=2)
    radius = np.sqrt(limit * (spread + np.max(own[:, :2, :2], initial=0.0)))
    lists = cKDTree(landmarks[:, :2]).query_ball_point(world.means[:, :2], radius)
    item = np.repeat(np.arange(len(lists)), [len(each) for each in lists])
    landmark = np.fromiter((j for each in lists for j in each), dtype=np.int64, count=len(item))
    nu = difference(world.means[item], landmarks[landmark])
    density, squares = log_density(nu, world.covariances[item] + own[landmark])
    evidence = density + weights(item, landmark)
    kept = (squares <= limit) & (evidence > 0)
    item, landmark, evidence = item[kept], landmark[kept], evidence[kept]
    chosen, margins = np.full(len(steps), -1), np.full(len(steps), np.inf)
    for begin, end in _runs(steps[item]):
        k, j, e = item[begin:end], landmark[begin:end], evidence[begin:end]
        rows, row = np.unique(k, return_inverse=True)
        names, column = np.unique(j, return_inverse=True)
        if len(names) == len(k) == len(rows):
            chosen[k], margins[k] = j, e
            continue
        table = np.zeros((len(rows), len(names) + len(rows)))
        table[row, column] = e
        a, b = linear_sum_assignment(table, maximize=True)
        good = table[a, b] > 0
        a, b = a[good], b[good]
        chosen[rows[a]] = names[b]
        others = table[a].copy()
        others[np.arange(len(a)), b] = 0.0
        margins[rows[a]] = table[a, b] - others.max(axis=1)
    return chosen, margins


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """The beginnings and ends of runs of equal values."""
    cuts = np.flatnonzero(np.diff(values)) + 1
    return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(values)], strict=True)) if len(values) else []


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


#: two landmarks that share the sightings of one are farther apart than chance would have them: each has those on its side
SHARED = 1 - 1e-9
#: with more landmarks than this each connected piece of them is searched by itself, ...
MOST_ITEMS = 40
#: ... a piece by at most so many pairs at a time: their joint covariance has the square of that number of blocks
MOST_PAIRS = 1_000
#: and compares at most so many hypotheses
MAX_HYPOTHESES = 3_000


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


def merges(problem: Problem, solved: MapSolution, items: np.ndarray, views: np.ndarray | None = None) -> list[Merge]:
    """The best joint hypothesis on which of the landmarks ``items`` (places in `MapSolution.landmarks`) are older landmarks.

    Args:
        views: (L,) in how many scans each landmark was in the field of view, if poses are known well enough for that.
    """
    densities, classes = problem.densities, problem.classes
    seen = solved.seen(problem.log.steps)
    shown = classes.sums(solved.which, solved.rows, len(seen))
    d, probability = solved.landmarks.shape[1], problem.options.gate if views is None else SHARED
    gate = float(gates(probability, d, 1)[1])
    item, other, both = _near(solved, items, seen, gate, 0 if views is None else np.inf)
    if len(item) == 0:
        return []
    chosen = np.unique(np.concatenate([item, other]))
    P = solved.joint_covariance(chosen)
    a, b = np.searchsorted(chosen, item), np.searchsorted(chosen, other)
    nu = difference(solved.landmarks[item], solved.landmarks[other])
    slack = solved.slack_of(item, other)
    own = P[a, :, a] + P[b, :, b] - P[a, :, b] - P[b, :, a] + slack
    weights = -densities.new + classes.together(shown[item], shown[other])
    if views is not None:
        # two landmarks missed one sighting in every view without both; if they are one, a second sighting is clutter
        V = np.minimum(views[item], views[other])
        sighting = (
            densities.seen - densities.clutter - 0.5 * (log_volume(INDEPENDENT / 2 * solved.slack_of(item, other)) + d)
        )
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
            decided = _decided(solved, item[some], other[some], a[some], b[some], nu[some], weights[some],
                               P, probability)  # fmt: skip
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
    solved: MapSolution, items: np.ndarray, seen: list[np.ndarray], gate: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of an item and an older landmark within the gate of their marginal covariances, seen together at most so often.

    Returns:
        Item, older landmark, and the number of scans with both.
    """
    m, S, labels = solved.landmarks[:, :2], solved.covariances + solved.slack, solved.labels
    variances = np.diagonal(S, axis1=1, axis2=2)[:, :2]
    # the variance of the difference is at most the sum, as errors of landmarks are correlated positively
    near = (labels[items, None] > labels[None]) & np.all(
        (m[items, None] - m[None]) ** 2 <= gate * (variances[items, None] + variances[None]), axis=2
    )
    pairs = [(items[k], j) for k, j in np.argwhere(near)]
    steps = {k: set(seen[k].tolist()) for k in {each for pair in pairs for each in pair}}
    both = [len(steps[k] & steps[j]) for k, j in pairs]
    found = np.array([(k, j, n) for (k, j), n in zip(pairs, both) if n <= most], dtype=np.int64).reshape(-1, 3)
    return found[:, 0], found[:, 1], found[:, 2]


def _decided(
    solved: MapSolution, item: np.ndarray, other: np.ndarray, a: np.ndarray, b: np.ndarray, nu: Array, weights: Array,
    P: Array, gate: float,
) -> list[Merge]:  # fmt: skip
    """The merges of one search."""
    if len(item) == 0:
        return []
    S = difference_covariance(P, a, b, solved.slack_of(item, other)).reshape(nu.size, nu.size)
    # at least the noise that the sightings themselves leave, the other landmarks and poses known
    noise = solved.own_covariances[item] + solved.slack_of(item, other)
    candidates, order = Candidates.of(np.unique(item, return_inverse=True)[1], other, nu, S, weights, noise)
    item, other = item[order], other[order]
    chosen, evidence = candidates.best(gate, most=MAX_HYPOTHESES)
    margins = candidates.margins(chosen, evidence, gate, most=MAX_HYPOTHESES // 10)
    return [Merge(int(item[c]), int(other[c]), float(m), float(evidence)) for c, m in zip(chosen, margins) if c >= 0]
