"""Logs of one place whose sightings have no ids, joined: each is associated alone, and their maps are matched.

1. Each log gets ids, a trajectory and a map of its own (`associate_from`).
2. The map of each log is a constellation that is looked for in the map of those before (`graph.constellation.match`), and the
   log is followed through that map (`graph.tracking`). Landmarks that agree get one id.
3. From both starts the graph of all logs so far is solved, and association and solving take turns
   (`association.refining`), which merges landmarks that the drift of a log had held apart. The end with more evidence counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..graph.constellation import Constellations, Merged, match
from ..graph.landmark_map import LandmarkMap
from ..graph.localization import SURE, odds_of
from ..graph.tracking import follow
from ..log import UNIDENTIFIED, Log
from ..log.join import end_to_end
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, compose, in_frame
from ..solvers.solve import solve
from .assignment import evidence
from .associate import associate_from
from .map_solution import Problem
from .problem import AssociationOptions
from .refining import refine

#: the fewest landmarks of two maps that have to agree
FEWEST = 5


def joined_without_ids(logs: Sequence[Log]) -> tuple[Log, list[int]]:
    """The log of all, with ids and without clutter, in the frame of the first, and the first step of each.

    Args:
        logs: with controls and the same noise models. Ids that a log has are used within this log.

    Raises:
        GraphError: a log has no landmarks that were seen twice, or its map surely is at no place in that of those before.
    """
    models: dict[str, Any] = {"motion": logs[0].motion or MotionModel(), "sensor": logs[0].sensor or SensorModel()}
    joined, starts = _associated(logs[0], models), [0]
    for each in logs[1:]:
        starts.append(joined.num_poses)
        ends = []
        for placed in _in_map_of(joined, _associated(each, models), models):
            both = end_to_end(joined, placed)
            ends.append(_refined(both.replace(initial_poses=solve(_graph(both, models)).poses), models))
        joined = max(ends, key=lambda end: end[1])[0]
    clutter = joined.landmarks == UNIDENTIFIED
    note = f"{len(joined.landmark_ids)} landmarks were found in all logs together, and {clutter.sum()} sightings are clutter"
    return joined.with_sightings(~clutter, notes=(*joined.notes, note)), starts


def _associated(log: Log, models: dict[str, Any]) -> Log:
    """The log with ids, `UNIDENTIFIED` for clutter, and its trajectory."""
    if log.identified:
        return log.replace(initial_poses=solve(_graph(log, models)).poses)
    found = associate_from(log, **models)
    return log.replace(landmarks=found.ids, initial_poses=found.poses, notes=(*log.notes, *found.notes))


def _graph(log: Log, models: dict[str, Any]) -> Graph:
    return Graph.from_log(log.with_sightings(log.landmarks != UNIDENTIFIED), edges="landmark+motion", **models)


def _in_map_of(before: Log, log: Log, models: dict[str, Any]) -> list[Log]:
    """The log with initial poses in the frame of those before and with their ids, by its map and by following it.

    Raises:
        GraphError: its map surely is at no place in that of those before, and neither are its sightings.
    """
    known, own = solve(_graph(before, models)).map, solve(_graph(log, models)).map
    reach = float(np.quantile(np.concatenate([before.sightings[:, 0], log.sightings[:, 0]]), 0.98))
    fresh = max(known, default=-1) + 1
    names = {j: fresh + k for k, j in enumerate(own)} | {UNIDENTIFIED: UNIDENTIFIED}
    ways = list[Log]()
    found = match(_merged(own, log), Constellations.of(known, reach))
    if found and odds_of([each for each, _ in found]) > SURE and np.sum(found[0][0].agree) >= FEWEST:
        best, where = found[0]
        ids = np.array(list(known))
        partners = {j: int(ids[where[k]]) for k, j in enumerate(own) if best.agree[k]}
        how = f"its map has {len(partners)} landmarks of those before"
        ids = np.array([partners.get(j, names[j]) for j in log.landmarks.tolist()])
        ways.append(_placed(log, ids, best.pose, how))
    try:
        along = follow(log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)), known, **models)
    except GraphError:
        if not ways:
            raise
        return ways
    seen = np.isin(along.landmarks, list(known))
    if along.lifted or len(np.unique(along.landmarks[seen])) < FEWEST:
        if not ways:
            raise GraphError(
                f"{log.name} and {_names(before)} have no {FEWEST} landmarks in common: are they logs of one place?"
            )
        return ways
    # what the map does not have keeps its own id, where most sightings of that are not in the map
    mostly = {j: 2 * np.sum(seen[log.landmarks == j]) > np.sum(log.landmarks == j) for j in own}
    others = [UNIDENTIFIED if mostly.get(j, True) else names[j] for j in log.landmarks.tolist()]
    fix = along.fixes[0]
    frame = compose(fix.pose, between(log.initial_poses[0], np.zeros(3)))
    how = f"it was followed through their map, where {fix.sentence}"
    return [*ways, _placed(log, np.where(seen, along.landmarks, others), frame, how)]


def _placed(log: Log, ids: np.ndarray, frame: Array, how: str) -> Log:
    """The log with ids, and initial poses in another frame."""
    return log.replace(
        landmarks=ids,
        initial_poses=in_frame(frame, log.initial_poses),
        notes=(*log.notes, f"joined without ids: {how}"),
    )


def _merged(own: LandmarkMap, log: Log) -> Merged:
    """The landmarks of a map as a constellation."""
    places, covariances = np.full((len(own), 3), np.nan), np.zeros((len(own), 3, 3))
    for k, (j, place) in enumerate(own.items()):
        d = len(place)
        places[k, :d], covariances[k, :d, :d] = place, own.covariances[j]
    counts = np.array([np.count_nonzero(log.landmarks == j) for j in own])
    return Merged(places, covariances, counts, np.zeros(0, dtype=int))


def _names(log: Log) -> str:
    return " and ".join(each.name for each in log.sessions) or log.name


def _refined(joined: Log, models: dict[str, Any]) -> tuple[Log, float]:
    """The joined log after association and solving in turn, and its evidence."""
    bare = joined.replace(landmarks=np.full(len(joined.steps), UNIDENTIFIED), relations=None, positions=None)
    _, labels = np.unique(joined.landmarks, return_inverse=True)
    # the smallest name is that of clutter
    labels = labels - int(np.any(joined.landmarks == UNIDENTIFIED))
    problem = Problem.of(bare, models["motion"], models["sensor"], AssociationOptions())
    found = refine(problem, labels, joined.initial_poses)
    if found is None:
        return joined, -np.inf
    ids = np.where(found.labels < 0, UNIDENTIFIED, found.labels)
    return joined.replace(landmarks=ids, initial_poses=found.solution.poses), evidence(problem, found.solution)
