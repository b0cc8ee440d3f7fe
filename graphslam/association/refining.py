"""Association and solving in turn: with the whole drive solved, every sighting is assigned anew.

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
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from ..log import Log
from ..se2 import Array, transform, turn_matrix, wrap
from .classes import Classes
from .densities import INSIDE, Densities, Field
from .geometry import differences
from .hypotheses import gates, log_density, log_volume
from .merging import merges
from .options import AssociationOptions
from .solved import Backbone, Solved

#: chains of landmarks that are one are merged link by link, at most so often in a round
MERGING = 4


@dataclass(frozen=True, eq=False)
class Refined:
    """The label (M,) of each sighting, -1 for clutter; the solved graph; how many rounds it took; and what is doubtful.

    ``margins`` (M,): the logarithm of the evidence for the label over that for the best other one, infinite for none.
    ``close``: how many pairs of landmarks may as well be one, by the factor of the options.
    """

    labels: np.ndarray
    solved: Solved
    rounds: int
    settled: bool
    margins: Array
    densities: Densities


def refine(
    log: Log, backbone: Backbone, labels: np.ndarray, poses: Array, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> Refined | None:  # fmt: skip
    """Association and solving in turn, from labels (M,) and poses (T+1, 3); None where no landmark is left."""
    labels, settled = _compact(labels), False
    margins = np.full(len(labels), np.inf)
    rounds = 0
    while rounds < options.rounds and not settled:
        rounds, before = rounds + 1, labels
        if not np.any(labels >= 0):
            return None
        solved = _merged(log, Solved.of(backbone, labels, poses), backbone, field, densities, classes, options)
        world = _World.of(backbone, solved.poses)
        labels, margins = _assigned(world, log, solved, densities, classes, options)
        labels = _born(world, log, labels, options)
        labels, densities = _kept(log, backbone, solved, field, labels, densities, options)
        poses, labels = solved.poses, _compact(labels)
        settled = np.array_equal(labels, before)
    if not np.any(labels >= 0):
        return None
    return Refined(labels, Solved.of(backbone, labels, poses), rounds, settled, margins, densities)


def _compact(labels: np.ndarray) -> np.ndarray:
    """The same labels numbered from 0 in the order of their first sightings."""
    names, first, which = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.where(names < 0, -1, first), kind="stable")
    number = np.empty(len(names), dtype=np.int64)
    number[order] = np.arange(len(names)) - np.sum(names < 0)
    number[names < 0] = -1
    return number[which]


def _merged(
    log: Log, solved: Solved, backbone: Backbone, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> Solved:  # fmt: skip
    """The graph after all landmarks that are more likely one than two are merged."""
    for _ in range(MERGING):
        everyone = np.arange(len(solved.labels))
        shown = classes.sums(solved.which, solved.rows, len(everyone))
        views, _ = _views(log, backbone, solved, field)
        found = merges(solved, everyone, solved.seen(log.steps), shown, densities, classes, options, views)
        root = np.arange(len(solved.labels))
        taken: set[int] = set()
        for m in sorted(found, key=lambda m: -m.margin):
            if m.item not in taken and m.into not in taken:
                root[m.item] = m.into
                taken |= {m.item, m.into}
        if not taken:
            break
        labels = np.full(len(log.steps), -1)
        labels[solved.rows] = root[solved.which]
        solved = Solved.of(backbone, labels, solved.poses)
    return solved


@dataclass(frozen=True, eq=False)
class _World:
    """Where every sighting puts its landmark in the world, (M, d), and with what covariance (M, d, d), poses known."""

    means: Array
    covariances: Array

    @classmethod
    def of(cls, backbone: Backbone, poses: Array) -> _World:
        y, at = backbone.places.means, poses[backbone.log.steps]
        d = y.shape[1]
        means = transform(at, y[:, :2])
        if d == 3:
            means = np.column_stack([means, wrap(at[:, 2] + y[:, 2])])
        turn = turn_matrix(at[:, 2])[:, :d, :d]
        return cls(means, turn @ backbone.places.covariances @ np.swapaxes(turn, 1, 2))


def _assigned(
    world: _World, log: Log, solved: Solved, densities: Densities, classes: Classes, options: AssociationOptions
) -> tuple[np.ndarray, Array]:
    """The label and the margin (M,) of each sighting: the best assignment of every scan."""
    gate = float(gates(options.gate, world.means.shape[1], 1)[1])
    own = solved.own_covariances + solved.slack
    radius = np.sqrt(gate * (np.linalg.norm(world.covariances[:, :2, :2], 2, axis=(1, 2)) + np.max(own[:, :2, :2])))
    tree = cKDTree(solved.landmarks[:, :2])
    lists = tree.query_ball_point(world.means[:, :2], radius)
    item = np.repeat(np.arange(len(lists)), [len(each) for each in lists])
    landmark = np.fromiter((j for each in lists for j in each), dtype=np.int64, count=len(item))
    nu = differences(world.means[item], solved.landmarks[landmark])
    density, squares = log_density(nu, world.covariances[item] + own[landmark])
    shown = classes.sums(solved.which, solved.rows, len(solved.labels))
    each = classes.log_confusion[:, classes.shown].T
    evidence = densities.seen - densities.clutter + density + classes.together(each[item], shown[landmark])
    kept = (squares <= gate) & (evidence > 0)
    item, landmark, evidence = item[kept], landmark[kept], evidence[kept]
    labels, margins = np.full(len(log.steps), -1), np.full(len(log.steps), np.inf)
    step = log.steps[item]
    for begin, end in _runs(step):
        k, j, e = item[begin:end], landmark[begin:end], evidence[begin:end]
        rows, row = np.unique(k, return_inverse=True)
        names, column = np.unique(j, return_inverse=True)
        if len(names) == len(k) == len(rows):
            labels[k], margins[k] = solved.labels[j], e
            continue
        table = np.zeros((len(rows), len(names) + len(rows)))
        table[row, column] = e
        a, b = linear_sum_assignment(table, maximize=True)
        good = table[a, b] > 0
        a, b = a[good], b[good]
        labels[rows[a]] = solved.labels[names[b]]
        others = table[a].copy()
        others[np.arange(len(a)), b] = 0.0
        margins[rows[a]] = table[a, b] - others.max(axis=1)
    return labels, margins


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """The beginnings and ends of runs of equal values."""
    cuts = np.flatnonzero(np.diff(values)) + 1
    return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(values)], strict=True)) if len(values) else []


def _born(world: _World, log: Log, labels: np.ndarray, options: AssociationOptions) -> np.ndarray:
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
    log: Log, backbone: Backbone, solved: Solved, field: Field, labels: np.ndarray, densities: Densities,
    options: AssociationOptions,
) -> tuple[np.ndarray, Densities]:  # fmt: skip
    """The labels of landmarks with enough evidence, -1 for the others; and the densities counted anew."""
    solved = Solved.of(backbone, labels, solved.poses)
    views, within = _views(log, backbone, solved, field)
    border, at_border = (a - b for a, b in zip(_views(log, backbone, solved, field, 1.0), (views, within)))
    densities = densities.counted(int(within.sum()), int(views.sum()), float(np.mean(labels < 0)))
    world = _World.of(backbone, solved.poses)
    nu = differences(world.means[solved.rows], solved.landmarks[solved.which])
    each = densities.seen - densities.clutter + log_density(nu, world.covariances[solved.rows])[0]
    total = np.bincount(solved.which, each) + (views - within) * densities.missed
    # at the border of the field noise decides whether a landmark is in it
    total += np.maximum(border - at_border, 0) * np.log1p(-np.exp(densities.seen) / 2)
    total += densities.new + 0.5 * log_volume(solved.own_covariances)
    good = (total > np.log(options.factor)) & (np.bincount(solved.which) > 1)
    labels = labels.copy()
    labels[solved.rows] = np.where(good[solved.which], labels[solved.rows], -1)
    return labels, densities


def _views(
    log: Log, backbone: Backbone, solved: Solved, field: Field, inside: float = INSIDE
) -> tuple[np.ndarray, np.ndarray]:
    """In how many scans each landmark (L,) was within a share of the field of view, and in how many of these it was seen."""
    scans, origin = np.unique(log.steps), backbone.origin
    poses = solved.poses[scans]
    within = cKDTree(poses[:, :2]).query_ball_point(solved.landmarks[:, :2], field.farthest + np.hypot(*origin))
    at, landmark = (
        np.concatenate([np.zeros(0, int), *within]).astype(int),
        np.repeat(np.arange(len(within)), list(map(len, within))),
    )
    seen = field.holds(_in_axes(poses[at], solved.landmarks[landmark]), origin, inside)
    views = np.bincount(landmark, seen, len(within)).astype(np.int64)
    h = _in_axes(solved.poses[log.steps[solved.rows]], solved.landmarks[solved.which])
    return views, np.bincount(solved.which, field.holds(h, origin, inside), len(views)).astype(np.int64)


def _in_axes(poses: Array, places: Array) -> Array:
    """Places (n, 2 or 3) in the axes of poses (n, 3): the positions (n, 2)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = places[:, 0] - poses[:, 0], places[:, 1] - poses[:, 1]
    return np.column_stack([c * x + s * y, c * y - s * x])
