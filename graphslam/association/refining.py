"""Association and solving in turn: with the whole drive solved, every sighting is assigned again.

Each round merges landmarks that are one, assigns the sightings of every scan to the landmarks of the solved graph, makes
landmarks of sightings that no landmark explains but that agree with each other, and drops landmarks whose sightings are
better explained as clutter. A landmark with sightings z_k, assigned with squares nu_k' S_k^-1 nu_k, is kept where

    log(density) + 1/2 log det(2 pi C) + sum of [log P_D + log N(nu_k; 0, S_k) - log(density of clutter)]
    + (views without a sighting) log(1 - P_D) > log(factor),

Laplace's approximation of the evidence for it, C its covariance from its sightings alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GraphError
from ..log import Log
from ..se2 import Array
from .assignment import PlacedSightings, assign
from .classes import Classes
from .densities import Densities, Field
from .geometry import differences
from .given_ids import held, id_of_each, may_be_one
from .hypotheses import gates, log_density, log_volume
from .map_solution import Backbone, MapSolution
from .merging import merges
from .options import AssociationOptions
from .visibility import Visibility

#: chains of landmarks that are one are merged link by link, at most so often in a round
MERGING = 4


#: the association has settled where a round changes at most this share of the sightings
SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class Refined:
    """The label (M,) of each sighting, -1 for clutter; the solved graph; how many rounds it took; and what is doubtful.

    ``margins`` (M,): the logarithm of the evidence for the label over that for the best other one, infinite for none.
    ``close``: how many pairs of landmarks may as well be one, by the factor of the options.
    """

    labels: np.ndarray
    solved: MapSolution
    rounds: int
    settled: bool
    margins: Array
    densities: Densities


def refine(
    log: Log, backbone: Backbone, labels: np.ndarray, poses: Array, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> Refined | None:  # fmt: skip
    """Association and solving in turn, from labels (M,) and poses (T+1, 3).

    None where no landmark is left, or where the labels contradict the motions so much that solving diverges.
    """
    try:
        return _in_turn(log, backbone, labels, poses, field, densities, classes, options)
    except GraphError:
        return None


def _in_turn(
    log: Log, backbone: Backbone, labels: np.ndarray, poses: Array, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> Refined | None:  # fmt: skip
    known, steps = backbone.known, log.steps
    labels, settled = _compact(held(labels, known, steps)), False
    margins = np.full(len(labels), np.inf)
    rounds = 0
    while rounds < options.rounds and not settled:
        rounds, before = rounds + 1, labels
        if not np.any(labels >= 0):
            return None
        solved = _merged(log, MapSolution.of(backbone, labels, poses), backbone, field, densities, classes, options)
        world = PlacedSightings.of(backbone.places, solved.poses[log.steps])
        labels, margins = _assigned(world, log, solved, densities, classes, options)
        labels, margins = held(labels, known, steps), np.where(known < 0, margins, np.inf)
        labels = _born(world, log, labels, options)
        labels, densities = _kept(log, backbone, solved, field, labels, densities, options)
        poses, labels = solved.poses, _compact(held(labels, known, steps))
        settled = int(np.count_nonzero(labels != before)) <= SETTLED * len(labels)
    if not np.any(labels >= 0):
        return None
    return Refined(labels, MapSolution.of(backbone, labels, poses), rounds, settled, margins, densities)


def unrefined(
    log: Log, backbone: Backbone, labels: np.ndarray, poses: Array, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> Refined:  # fmt: skip
    """The graph of given labels (M,); a sighting that another landmark explains better has no margin."""
    labels = _compact(held(labels, backbone.known, log.steps))
    solved = MapSolution.of(backbone, labels, poses)
    world = PlacedSightings.of(backbone.places, solved.poses[log.steps])
    better, margins = _assigned(world, log, solved, densities, classes, options)
    margins = np.where(labels < 0, np.inf, np.where(better == labels, margins, 0.0))
    margins[backbone.known >= 0] = np.inf
    return Refined(labels, solved, 1, True, margins, densities)


def _compact(labels: np.ndarray) -> np.ndarray:
    """The same labels numbered from 0 in the order of their first sightings."""
    names, first, which = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(names < 0, -1, first), kind="stable")
    number = np.empty(len(names), dtype=np.int64)
    number[order] = np.arange(len(names)) - np.sum(names < 0)
    number[names < 0] = -1
    return number[which]


def _merged(
    log: Log, solved: MapSolution, backbone: Backbone, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> MapSolution:  # fmt: skip
    """The graph after all landmarks that are more likely one than two are merged."""
    for _ in range(MERGING):
        everyone = np.arange(len(solved.labels))
        shown = classes.sums(solved.which, solved.rows, len(everyone))
        views = Visibility.of(log, backbone, solved, field).views
        found = merges(solved, everyone, solved.seen(log.steps), shown, densities, classes, options, views)
        root = np.arange(len(solved.labels))
        ids = id_of_each(solved.which, backbone.known[solved.rows], len(root))
        found = [m for m in found if may_be_one(ids[m.item], ids[m.into])]
        taken: set[int] = set()
        for m in sorted(found, key=lambda m: -m.margin):
            if m.item not in taken and m.into not in taken:
                root[m.item] = m.into
                taken |= {m.item, m.into}
        if not taken:
            break
        labels = np.full(len(log.steps), -1)
        labels[solved.rows] = root[solved.which]
        solved = MapSolution.of(backbone, labels, solved.poses)
    return solved


def _assigned(
    world: PlacedSightings,
    log: Log,
    solved: MapSolution,
    densities: Densities,
    classes: Classes,
    options: AssociationOptions,
) -> tuple[np.ndarray, Array]:
    """The label and the margin (M,) of each sighting: the best assignment of every scan."""
    shown = classes.sums(solved.which, solved.rows, len(solved.labels))

    def weights(item: np.ndarray, landmark: np.ndarray) -> Array:
        return densities.seen - densities.clutter + classes.together(classes.of_sightings(item), shown[landmark])

    own = solved.own_covariances + solved.slack
    chosen, margins = assign(world, log.steps, solved.landmarks, own, options.gate, weights)
    return np.where(chosen < 0, -1, solved.labels[chosen]), margins


def _born(world: PlacedSightings, log: Log, labels: np.ndarray, options: AssociationOptions) -> np.ndarray:
    """The labels with new ones for sightings that none has, but that agree with each other."""
    d, gate = world.means.shape[1], float(gates(options.gate, world.means.shape[1], 1)[1])
    labels, rows = labels.copy(), np.flatnonzero(labels < 0)
    if len(rows) < 2:
        return labels
    means, information, spread = np.zeros((len(rows), d)), np.zeros((len(rows), d, d)), np.zeros((len(rows), d, d))
    reach = np.sqrt(2 * gate * np.linalg.norm(world.covariances[rows][:, :2, :2], 2, axis=(1, 2)))
    reach += reach.max()
    last, number, count = np.full(len(rows), -1), np.full(len(rows), -1), 0
    for n, k in enumerate(rows):
        away = np.abs(world.means[k, :2] - means[:count, :2]).max(axis=1)
        near = np.flatnonzero((away <= reach[n]) & (last[:count] != log.steps[k]))
        best, square = count, np.inf
        if len(near):
            nu = differences(world.means[k], means[near])
            squares = log_density(nu, world.covariances[k] + spread[near])[1]
            best, square = int(near[np.argmin(squares)]), float(squares.min())
        if square > gate:
            best, count = count, count + 1
        own = np.linalg.inv(world.covariances[k])
        total = information[best] + own
        means[best] = differences(
            means[best] + np.linalg.solve(total, own @ differences(world.means[k], means[best])), np.zeros(d)
        )
        information[best], spread[best], last[best], number[n] = total, np.linalg.inv(total), log.steps[k], best
    born = np.bincount(number, minlength=count) >= 2
    labels[rows] = np.where(born[number], labels.max() + 1 + number, -1)
    return labels


def _kept(
    log: Log, backbone: Backbone, solved: MapSolution, field: Field, labels: np.ndarray, densities: Densities,
    options: AssociationOptions,
) -> tuple[np.ndarray, Densities]:  # fmt: skip
    """The labels of landmarks with enough evidence, -1 for the others; and the densities counted again."""
    solved = MapSolution.of(backbone, labels, solved.poses)
    seen = Visibility.of(log, backbone, solved, field)
    densities = densities.counted(int(seen.within.sum()), int(seen.views.sum()), float(np.mean(labels < 0)))
    world = PlacedSightings.of(backbone.places, solved.poses[log.steps])
    nu = differences(world.means[solved.rows], solved.landmarks[solved.which])
    each = densities.seen - densities.clutter + log_density(nu, world.covariances[solved.rows])[0]
    total = densities.new + 0.5 * log_volume(solved.own_covariances) + seen.misses(densities)
    total = total + np.bincount(solved.which, each)
    good = (total > np.log(options.factor)) & (np.bincount(solved.which) > 1)
    labels = labels.copy()
    labels[solved.rows] = np.where(good[solved.which], labels[solved.rows], -1)
    return labels, densities
