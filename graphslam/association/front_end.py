"""Association along the drive: tracks from a local filter, joined to landmarks by graphs of the drive so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, compose
from ..solvers.solve import solve
from .classes import Classes
from .densities import Densities
from .given_ids import id_of_each, may_be_one
from .local_map import LocalMap
from .map_solution import Backbone, MapSolution
from .merging import merges
from .options import AssociationOptions

#: the most solutions of the graph along a drive
MOST_WINDOWS = 150
#: so many windows long a landmark that was just found may turn out to be an older one
OPEN = 4


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """The label (M,) of each sighting after the drive, -1 where it was left out, and the poses (T+1, 3)."""

    labels: np.ndarray
    poses: Array
    deferred: int


def run_front_end(
    log: Log, motion: MotionModel, sensor: SensorModel, backbone: Backbone, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> FrontEndResult:  # fmt: skip
    """Drive along the log once.

    Where some sightings have ids, the robot moves as the graph of these alone says: after a long way, where it is decides
    which landmarks the others are of.
    """
    motions, noises = log.motions(motion)
    if np.any(kept := backbone.known >= 0):
        graph = Graph.from_log(
            log.with_sightings(kept), motion=motion, sensor=sensor, edges="landmark+motion", kernel="none"
        )
        guide = solve(graph).poses
        motions = between(guide[:-1], guide[1:])
    window = max(options.window, -(-log.num_poses // MOST_WINDOWS))
    local = LocalMap(log.initial_poses[0], backbone.places, densities, classes, window, options)
    first = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
    filtered = np.empty((log.num_poses, 3))
    tracks, fresh = np.full(len(log.steps), -1), 0
    root = np.arange(len(log.steps))
    poses, done, deferred = filtered[:0], 0, 0
    for t in range(log.num_poses):
        if t:
            local.move(motions[t - 1], noises[t - 1])
        if first[t + 1] > first[t]:
            rows = np.arange(first[t], first[t + 1])
            tracks[rows] = local.scan(rows, t, fresh)
            fresh = max(fresh, int(tracks[rows].max()) + 1)
        filtered[t] = local.pose
        if ((t + 1) % window and t + 1 < log.num_poses) or first[t + 1] == 0:
            continue
        # the graph of the drive so far
        if done:
            ahead = compose(poses[-1], between(filtered[done - 1], filtered[done : t + 1]))
            poses = np.concatenate([poses, ahead])
        else:
            poses = filtered[: t + 1].copy()
        done = t + 1
        _join_by_ids(root, tracks, backbone.known)
        for _ in range(3):
            labels = np.where(tracks >= 0, root[tracks], -1)[: first[t + 1]]
            labels[_alone(labels, log.steps[: first[t + 1]], t - OPEN * window)] = -1
            if not np.any(labels >= 0):
                break
            try:
                solved = MapSolution.of(backbone, labels, poses)
            except GraphError:
                # the labels contradict the motions so much that solving diverges; `refine` finds it, too
                break
            poses = solved.poses
            joined, deferred = _join(log, solved, t - OPEN * window, backbone.known, densities, classes, options)
            if not joined:
                break
            for new, old in joined.items():
                root[root == new] = old
            active = root[local.tracks]
            doubled = [k for k in range(len(active)) if active[k] in active[k + 1 :]]
            local.remove(local.tracks[doubled])
    labels = np.where(tracks >= 0, root[tracks], -1) if len(tracks) else tracks
    return FrontEndResult(labels, poses if done == log.num_poses else filtered, deferred)


def _alone(labels: np.ndarray, steps: np.ndarray, since: int) -> np.ndarray:
    """Which sightings are the only one of their landmark, and old."""
    _, which, counts = np.unique(labels, return_inverse=True, return_counts=True)
    return (counts[which] == 1) & (steps < since)


def _join_by_ids(root: np.ndarray, tracks: np.ndarray, known: np.ndarray) -> None:
    """Give tracks of which most sightings have one id the ``root`` of the oldest of them."""
    ids = id_of_each(tracks, known, len(root))
    for j in np.unique(ids[ids >= 0]):
        roots = np.unique(root[ids == j])
        root[np.isin(root, roots[1:])] = roots[0]


def _join(
    log: Log, solved: MapSolution, since: int, known: np.ndarray, densities: Densities, classes: Classes,
    options: AssociationOptions,
) -> tuple[dict[int, int], int]:  # fmt: skip
    """{new: old} labels of landmarks that are one, and how many decisions are left for later because they are ambiguous."""
    seen = solved.seen(log.steps)
    items = np.flatnonzero([steps[0] >= since for steps in seen])
    shown = classes.sums(solved.which, solved.rows, len(seen))
    found = merges(solved, items, seen, shown, densities, classes, options)
    # one landmark may be near an old one by chance; a place that is seen again has several
    least = np.log(options.factor)
    ids = id_of_each(solved.which, known[solved.rows], len(seen))
    sure = [m for m in found if m.margin >= least and m.evidence >= 2 * least and may_be_one(ids[m.item], ids[m.into])]
    # chains, of which each member was seen with another one, are joined in several rounds
    taken: set[int] = set()
    joined = {}
    for m in sorted(sure, key=lambda m: -m.margin):
        if m.item not in taken and m.into not in taken:
            joined[int(solved.labels[m.item])] = int(solved.labels[m.into])
            taken |= {m.item, m.into}
    return joined, len(found) - len(sure)
