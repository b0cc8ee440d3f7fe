"""Association and solving in turn: with the whole drive solved, every sighting is assigned again; alternatives are tried.

Each round merges landmarks that are one, assigns the sightings of every scan to the landmarks of the solved graph, makes
landmarks of sightings that no landmark explains but that agree with each other, and drops landmarks whose sightings are
better explained as clutter. A landmark with sightings z_k, assigned with squares nu_k' S_k^-1 nu_k, is kept where

    log(density) + 1/2 log det(2 pi C) + sum of [log P_D + log N(nu_k; 0, S_k) - log(density of clutter)]
    + (views without a sighting) log(1 - P_D) > log(factor),

Laplace's approximation of the evidence for it, C its covariance from its sightings alone.

The search climbs: alternatives are tried, refined, and kept where the total evidence is significantly higher.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import GraphError
from ..se2 import Array, difference
from .ambiguity import Alternative, all_alternatives
from .assignment import assign, disjoint, merges
from .evidence import Visibility, evidence, gates, log_density, log_volume
from .map_solution import MapSolution, Places, Problem
from .problem import Densities, held, id_of_each, may_be_one

#: chains of landmarks that are one are merged link by link, at most so often in a round
MERGING = 4


#: the association has settled where a round changes at most this share of the sightings
SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class Refined:
    """The label (M,) of each sighting, -1 for clutter; the solved graph; how many rounds it took; and what is doubtful.

    ``margins`` (M,): the logarithm of the evidence for the label over that for the best other one, infinite for none.
    """

    labels: np.ndarray
    solved: MapSolution
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
        solved = _merged(problem, MapSolution.of(backbone, labels, poses))
        world = backbone.places.seen_at(solved.poses[steps])
        labels, margins = _assigned(problem, world, solved)
        labels, margins = held(labels, known, steps), np.where(known < 0, margins, np.inf)
        labels = _born(problem, world, labels)
        labels, densities = _kept(problem, solved, labels)
        problem = replace(problem, densities=densities)
        poses, labels = solved.poses, _compact(held(labels, known, steps))
        settled = int(np.count_nonzero(labels != before)) <= SETTLED * len(labels)
    if not np.any(labels >= 0):
        return None
    return Refined(labels, MapSolution.of(backbone, labels, poses), rounds, settled, margins, problem.densities)


def unrefined(problem: Problem, labels: np.ndarray, poses: Array) -> Refined:
    """The graph of given labels (M,); a sighting that another landmark explains better has no margin."""
    backbone, steps = problem.backbone, problem.log.steps
    labels = _compact(held(labels, backbone.known, steps))
    solved = MapSolution.of(backbone, labels, poses)
    better, margins = _assigned(problem, backbone.places.seen_at(solved.poses[steps]), solved)
    margins = np.where(labels < 0, np.inf, np.where(better == labels, margins, 0.0))
    margins[backbone.known >= 0] = np.inf
    return Refined(labels, solved, 1, True, margins, problem.densities)


def _compact(labels: np.ndarray) -> np.ndarray:
    """The same labels numbered from 0 in the order of their first sightings."""
    names, first, which = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(names < 0, -1, first), kind="stable")
    number = np.empty(len(names), dtype=np.int64)
    number[order] = np.arange(len(names)) - np.sum(names < 0)
    number[names < 0] = -1
    return number[which]


def _merged(problem: Problem, solved: MapSolution) -> MapSolution:
    """The graph after all landmarks that are more likely one than two are merged."""
    for _ in range(MERGING):
        root = np.arange(len(solved.labels))
        found = merges(problem, solved, root, Visibility.of(problem, solved).views)
        ids = id_of_each(solved.which, problem.backbone.known[solved.rows], len(root))
        found = [m for m in found if may_be_one(ids[m.item], ids[m.into])]
        if not found:
            break
        for m in disjoint(found):
            root[m.item] = m.into
        labels = np.full(len(problem.log.steps), -1)
        labels[solved.rows] = root[solved.which]
        solved = MapSolution.of(problem.backbone, labels, solved.poses)
    return solved


def _assigned(problem: Problem, world: Places, solved: MapSolution) -> tuple[np.ndarray, Array]:
    """The label and the margin (M,) of each sighting: the best assignment of every scan."""
    densities, classes = problem.densities, problem.classes
    shown = classes.sums(solved.which, solved.rows, len(solved.labels))

    def weights(item: np.ndarray, landmark: np.ndarray) -> Array:
        return densities.seen - densities.clutter + classes.together(classes.of_sightings(item), shown[landmark])

    own = solved.own_covariances + solved.slack
    chosen, margins = assign(world, problem.log.steps, solved.landmarks, own, problem.options.gate, weights)
    return np.where(chosen < 0, -1, solved.labels[chosen]), margins


def _born(problem: Problem, world: Places, labels: np.ndarray) -> np.ndarray:
    """The labels with new ones for sightings that none has, but that agree with each other."""
    d, steps = world.means.shape[1], problem.log.steps
    gate = float(gates(problem.options.gate, d, 1)[1])
    labels, rows = labels.copy(), np.flatnonzero(labels < 0)
    if len(rows) < 2:
        return labels
    means, information, spread = np.zeros((len(rows), d)), np.zeros((len(rows), d, d)), np.zeros((len(rows), d, d))
    reach = np.sqrt(2 * gate * np.linalg.norm(world.covariances[rows][:, :2, :2], 2, axis=(1, 2)))
    reach += reach.max()
    last, number, count = np.full(len(rows), -1), np.full(len(rows), -1), 0
    for n, k in enumerate(rows):
        away = np.abs(world.means[k, :2] - means[:count, :2]).max(axis=1)
        near = np.flatnonzero((away <= reach[n]) & (last[:count] != steps[k]))
        best, square = count, np.inf
        if len(near):
            nu = difference(world.means[k], means[near])
            squares = log_density(nu, world.covariances[k] + spread[near])[1]
            best, square = int(near[np.argmin(squares)]), float(squares.min())
        if square > gate:
            best, count = count, count + 1
        own = np.linalg.inv(world.covariances[k])
        total = information[best] + own
        means[best] = difference(
            means[best] + np.linalg.solve(total, own @ difference(world.means[k], means[best])), np.zeros(d)
        )
        information[best], spread[best], last[best], number[n] = total, np.linalg.inv(total), steps[k], best
    born = np.bincount(number, minlength=count) >= 2
    labels[rows] = np.where(born[number], labels.max() + 1 + number, -1)
    return labels


def _kept(problem: Problem, solved: MapSolution, labels: np.ndarray) -> tuple[np.ndarray, Densities]:
    """The labels of landmarks with enough evidence, -1 for the others; and the densities counted again."""
    solved = MapSolution.of(problem.backbone, labels, solved.poses)
    seen = Visibility.of(problem, solved)
    share = float(np.mean(labels < 0))
    densities = problem.densities.counted(int(seen.within.sum()), int(seen.views.sum()), share)
    world = problem.backbone.places.seen_at(solved.poses[problem.log.steps])
    nu = difference(world.means[solved.rows], solved.landmarks[solved.which])
    each = densities.seen - densities.clutter + log_density(nu, world.covariances[solved.rows])[0]
    total = densities.new + 0.5 * log_volume(solved.own_covariances) + seen.misses(densities)
    total = total + np.bincount(solved.which, each)
    good = (total > np.log(problem.options.factor)) & (np.bincount(solved.which) > 1)
    labels = labels.copy()
    labels[solved.rows] = np.where(good[solved.which], labels[solved.rows], -1)
    return labels, densities


#: alternatives are tried whose linearised evidence is at most this much lower [nats]
PROMISING = 30.0
#: the rounds of association and solving of a trial
TRIAL_ROUNDS = 4
#: alternatives of each return that are tried
MAX_ALTERNATIVES = 3
#: so many poses are solved in all to examine the returns of a drive, and so many returns at least
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
    best = evidence(problem, refined.solved)
    tried: set[bytes] = set()
    solved: list[tuple[float, Array]] = []
    while True:
        found = all_alternatives(problem, refined.solved, most=MAX_ALTERNATIVES, events=events)
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
            ends = [(evidence(problem, t.solved), t) for t in trials if t is not None]
            solved += [(value, end.solved.poses) for value, end in ends]
            value, end = max(ends, key=lambda each: each[0], default=(-np.inf, refined))
            if value > best + np.log(options.factor):
                solved.append((best, refined.solved.poses))
                refined, best = end, value
                break
        else:
            left = len({alternative.labels.tobytes() for alternative in promising} - tried)
            for alternative in promising[: options.tries]:
                # refining may end at the association itself, though the alternative is nearly as likely
                other = MapSolution.of(problem.backbone, alternative.labels, alternative.poses)
                solved.append((evidence(problem, other), other.poses))
            rivals = [(best - value, poses) for value, poses in solved if np.isfinite(value)]
            return SearchResult(refined, found, len(tried), unsettled, left, rivals)
