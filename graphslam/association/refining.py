"""Association and solving in turn: with the whole drive solved, every sighting is assigned again; alternatives are tried.

Each round merges landmarks that are one, assigns the sightings of every scan to the landmarks of the solved graph, makes
landmarks of sightings that no landmark explains but that agree with each other, and drops landmarks whose sightings are
better explained as clutter. A landmark with sightings z_k, assigned with squares nu_k' S_k^-1 nu_k, is kept where

    log(density) + 1/2 log det(2 pi C) + sum of [log P_D + log N(nu_k; 0, S_k) - log(density of clutter)]
    + (views without a sighting) log(1 - P_D) > log(factor),

Laplace's approximation of the evidence for it, C its covariance from its sightings alone.

`search` climbs: alternatives are tried, refined, and kept where the total evidence is significantly higher.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import GraphError
from ..maps.constellation import merged
from ..se2 import Array, difference
from .ambiguity import Alternative, all_alternatives
from .assignment import Visibility, assign, disjoint, evidence, gates, log_density, log_volume, merges
from .map_solution import MapSolution, Places, Problem
from .problem import Densities, held, id_of_each, may_be_one

#: chains of landmarks that are one are merged link by link; the most links in a round
MERGING = 4


#: the association has settled where a round changes the labels of at most this share of the sightings
SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class Refined:
    """The label (M,) of each sighting, -1 for clutter; the solved graph; how many rounds it took; and what is doubtful.

    ``margins`` (M,): the logarithm of the evidence for the label over that for the best other one, infinite for none.
    """

    labels: np.ndarray
    solution: MapSolution
    rounds: int
    settled: bool
    margins: Array
    densities: Densities


def refine(problem: Problem, labels: np.ndarray, poses: Array) -> Refined | None:
    """Association and solving in turn, from labels (M,) and poses (T+1, 3).

    None where no landmark is left, or where the labels contradict the motions so much that solving diverges.
    """
    try:
        return _in_turn(problem, labels, poses)
    except GraphError:
        return None


def _in_turn(problem: Problem, labels: np.ndarray, poses: Array) -> Refined | None:
    backbone, steps, known = problem.backbone, problem.log.steps, problem.backbone.known
    labels, settled = _compact(held(labels, known, steps)), False
    margins = np.full(len(labels), np.inf)
    rounds = 0
    while rounds < problem.options.rounds and not settled:
        rounds, before = rounds + 1, labels
        if not np.any(labels >= 0):
            return None
        solution = _merged(problem, MapSolution.of(backbone, labels, poses))
        world = backbone.places.seen_at(solution.poses[steps])
        labels, margins = assigned(problem, world, solution)
        labels, margins = held(labels, known, steps), np.where(known < 0, margins, np.inf)
        labels = _born(problem, world, labels)
        labels, densities = _kept(problem, solution, labels)
        problem = replace(problem, densities=densities)
        poses, labels = solution.poses, _compact(held(labels, known, steps))
        settled = int(np.count_nonzero(labels != before)) <= SETTLED * len(labels)
    if not np.any(labels >= 0):
        return None
    return Refined(labels, MapSolution.of(backbone, labels, poses), rounds, settled, margins, problem.densities)


def unrefined(problem: Problem, labels: np.ndarray, poses: Array) -> Refined:
    """The graph of given labels (M,); a sighting that another landmark explains better has no margin."""
    backbone, steps = problem.backbone, problem.log.steps
    labels = _compact(held(labels, backbone.known, steps))
    solution = MapSolution.of(backbone, labels, poses)
    better, margins = assigned(problem, backbone.places.seen_at(solution.poses[steps]), solution)
    margins = np.where(labels < 0, np.inf, np.where(better == labels, margins, 0.0))
    margins[backbone.known >= 0] = np.inf
    return Refined(labels, solution, 1, True, margins, problem.densities)


def _compact(labels: np.ndarray) -> np.ndarray:
    """The same labels numbered from 0 in the order of their first sightings."""
    names, first, which = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(names < 0, -1, first), kind="stable")
    number = np.empty(len(names), dtype=np.int64)
    number[order] = np.arange(len(names)) - np.sum(names < 0)
    number[names < 0] = -1
    return number[which]


def _merged(problem: Problem, solution: MapSolution) -> MapSolution:
    """The graph after all landmarks that are more likely one than two are merged."""
    for _ in range(MERGING):
        root = np.arange(len(solution.labels))
        found = merges(problem, solution, root, Visibility.of(problem, solution).views)
        ids = id_of_each(solution.which, problem.backbone.known[solution.rows], len(root))
        found = [m for m in found if may_be_one(ids[m.item], ids[m.into])]
        if not found:
            break
        for m in disjoint(found):
            root[m.item] = m.into
        labels = np.full(len(problem.log.steps), -1)
        labels[solution.rows] = root[solution.which]
        solution = MapSolution.of(problem.backbone, labels, solution.poses)
    return solution


def assigned(problem: Problem, world: Places, solution: MapSolution) -> tuple[np.ndarray, Array]:
    """The label and the margin (M,) of each sighting: the best assignment of every scan."""
    densities, classes = problem.densities, problem.classes
    shown = classes.sums(solution.which, solution.rows, len(solution.labels))

    def weights(item: np.ndarray, landmark: np.ndarray) -> Array:
        return densities.seen - densities.clutter + classes.together(classes.of_sightings(item), shown[landmark])

    own = solution.own_covariances + solution.slack
    chosen, margins = assign(world, problem.log.steps, solution.landmarks, own, problem.options.gate, weights)
    return np.where(chosen < 0, -1, solution.labels[chosen]), margins


def _born(problem: Problem, world: Places, labels: np.ndarray) -> np.ndarray:
    """The labels with new ones for sightings that none has, but that agree with each other."""
    labels, rows, d = labels.copy(), np.flatnonzero(labels < 0), world.means.shape[1]
    y, C = np.full((len(rows), 3), np.nan), np.zeros((len(rows), 3, 3))
    y[:, :d], C[:, :d, :d] = world.means[rows], world.covariances[rows]
    gate = float(gates(problem.options.gate, d, 1)[1])
    found = merged(y, C, np.zeros_like(C), problem.log.steps[rows], gate, compared=d)
    labels[rows] = np.where(found.counts[found.which] > 1, labels.max() + 1 + found.which, -1)
    return labels


def _kept(problem: Problem, solution: MapSolution, labels: np.ndarray) -> tuple[np.ndarray, Densities]:
    """The labels of landmarks with enough evidence, -1 for the others; and the densities counted again."""
    solution = MapSolution.of(problem.backbone, labels, solution.poses)
    seen = Visibility.of(problem, solution)
    share = float(np.mean(labels < 0))
    densities = problem.densities.counted(int(seen.within.sum()), int(seen.views.sum()), share)
    world = problem.backbone.places.seen_at(solution.poses[problem.log.steps])
    nu = difference(world.means[solution.rows], solution.landmarks[solution.which])
    each = densities.seen - densities.clutter + log_density(nu, world.covariances[solution.rows])[0]
    total = densities.new + 0.5 * log_volume(solution.own_covariances) + seen.misses(densities)
    total = total + np.bincount(solution.which, each)
    good = (total > np.log(problem.options.factor)) & (np.bincount(solution.which) > 1)
    labels = labels.copy()
    labels[solution.rows] = np.where(good[solution.which], labels[solution.rows], -1)
    return labels, densities


#: alternatives are tried where their linearised evidence is lower by less than this [nats]
PROMISING = 30.0
#: the rounds of association and solving of a trial
TRIAL_ROUNDS = 4
#: alternatives of each return that are tried
MAX_ALTERNATIVES = 3
#: the returns that are examined: as many as need this number of poses to be solved in all, but at least the second number
WORK, LEAST_EVENTS = 75_000, 10


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best association that trials of alternatives lead to, and how the search went.

    Attributes:
        refined: the association.
        alternatives: the alternatives of the result.
        tried, unsettled: how many alternatives were tried, and how many of them had not settled after `TRIAL_ROUNDS` rounds.
        left: how many alternatives of the result are promising and were not tried, because no tries were left.
        rivals: what else was solved on the way, the promising alternatives of the result as they are among it: the evidence
            for the association over that for the rival [nats], and its poses (T+1, 3).
    """

    refined: Refined
    alternatives: list[Alternative]
    tried: int
    unsettled: int
    left: int
    rivals: list[tuple[float, Array]]


def search(problem: Problem, refined: Refined) -> SearchResult:
    """Try alternatives while the evidence rises, with the densities of the association that it begins with."""
    problem, options = replace(problem, densities=refined.densities), problem.options
    events, unsettled = max(LEAST_EVENTS, WORK // problem.log.num_poses), 0
    brief = replace(problem, options=replace(options, rounds=min(options.rounds, TRIAL_ROUNDS)))
    best = evidence(problem, refined.solution)
    tried: set[bytes] = set()
    solutions: list[tuple[float, Array]] = []
    while True:
        found = all_alternatives(problem, refined.solution, most=MAX_ALTERNATIVES, events=events)
        promising = sorted((a for a in found if a.log_factor < PROMISING), key=lambda a: a.log_factor)
        for alternative in promising:
            if len(tried) == options.tries or (key := alternative.labels.tobytes()) in tried:
                continue
            tried.add(key)
            trials = [refine(brief, alternative.labels, alternative.poses)]
            if alternative.log_factor < 0:
                # refining merges pairs, which may undo what all landmarks of a place together say
                trials.append(unrefined(brief, alternative.labels, alternative.poses))
            unsettled += any(not trial.settled for trial in trials if trial is not None)
            ends = [(evidence(problem, t.solution), t) for t in trials if t is not None]
            solutions += [(value, end.solution.poses) for value, end in ends]
            value, end = max(ends, key=lambda each: each[0], default=(-np.inf, refined))
            if value > best + np.log(options.factor):
                solutions.append((best, refined.solution.poses))
                refined, best = end, value
                break
        else:
            left = len({alternative.labels.tobytes() for alternative in promising} - tried)
            for alternative in promising[: options.tries]:
                # refining may end at the association itself, though the alternative is nearly as likely
                other = MapSolution.of(problem.backbone, alternative.labels, alternative.poses)
                solutions.append((evidence(problem, other), other.poses))
            rivals = [(best - value, poses) for value, poses in solutions if np.isfinite(value)]
            return SearchResult(refined, found, len(tried), unsettled, left, rivals)
