"""Logs of one place whose sightings have no ids, joined: each is associated alone, and their maps are matched.

1. Each log gets ids, a trajectory and a map of its own (`associate`).
2. The map of each log is a constellation that is looked for in the map of those before (`graph.constellation.match`). Where
   that is not sure, because one of the maps is bent, the log is followed through the other map instead (`graph.tracking`).
   Landmarks that agree get one id.
3. The graph of both is solved, and with all logs together association and solving take turns (`association.refining`), which
   merges landmarks that the drift of a log had held apart, and splits none that agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..graph.constellation import Constellations, Merged, match
from ..graph.landmark_map import LandmarkMap
from ..graph.localization import SURE
from ..graph.tracking import follow
from ..log import UNIDENTIFIED, Log
from ..log.end_to_end import end_to_end
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, compose
from ..solvers.solve import solve
from .associate import associate
from .map_solution import Problem
from .problem import AssociationOptions
from .refining import refine

#: so many landmarks of two maps have to agree
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
        joined = end_to_end(joined, _in_map_of(joined, _associated(each, models), models))
        poses = solve(_graph(joined, models)).poses
        joined = joined.replace(initial_poses=poses)
    return _again(joined, models), starts


def _associated(log: Log, models: dict[str, Any]) -> Log:
    """The log with ids, `UNIDENTIFIED` for clutter, and its trajectory."""
    if log.identified:
        return log.replace(initial_poses=solve(_graph(log, models)).poses)
    found = associate(log, **models)
    return log.replace(landmarks=found.ids, initial_poses=found.poses, notes=(*log.notes, *found.notes))


def _graph(log: Log, models: dict[str, Any]) -> Graph:
    return Graph.from_log(log.with_sightings(log.landmarks != UNIDENTIFIED), edges="landmark+motion", **models)


def _in_map_of(before: Log, log: Log, models: dict[str, Any]) -> Log:
    """The log with initial poses in the frame of those before, and their ids where its landmarks are theirs."""
    known, own = solve(_graph(before, models)).map, solve(_graph(log, models)).map
    reach = float(np.quantile(np.concatenate([before.sightings[:, 0], log.sightings[:, 0]]), 0.98))
    found = match(_merged(own, log), Constellations.of(known, reach))
    partners: dict[int, int] = {}
    if found and _odds([each.evidence for each, _ in found]) > SURE and np.sum(found[0][0].agree) >= FEWEST:
        best, where = found[0]
        ids = np.array(list(known))
        partners = {j: int(ids[where[k]]) for k, j in enumerate(own) if best.agree[k]}
        placed = _moved(log.initial_poses, best.pose)
        how = f"its map has {len(partners)} landmarks of those before"
    else:
        unknown = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
        along = follow(unknown, known, **models)
        if along.lifted:
            raise GraphError(f"{log.name} does not fit one place in the map of {_names(before)}")
        for j in own:
            there, count = np.unique(along.landmarks[log.landmarks == j], return_counts=True)
            best_id = int(there[np.argmax(count)])
            if best_id in known and 2 * count.max() > count.sum() and best_id not in partners.values():
                partners[j] = best_id
        if len(partners) < FEWEST:
            raise GraphError(
                f"{log.name} and {_names(before)} have no {FEWEST} landmarks in common: are they logs of one place?"
            )
        fix = along.fixes[0]
        placed = _moved(log.initial_poses, compose(fix.pose, between(log.initial_poses[0], np.zeros(3))))
        how = f"it was followed through their map, where {fix.sentence}"
    fresh = max([*known, *partners.values()], default=-1) + 1
    names = {j: partners.get(j, fresh + k) for k, j in enumerate(own)} | {UNIDENTIFIED: UNIDENTIFIED}
    return log.replace(
        landmarks=[names[j] for j in log.landmarks.tolist()],
        initial_poses=placed,
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


def _moved(poses: Array, frame: Array) -> Array:
    """Poses (n, 3) in another frame, without jumps of a full turn."""
    moved = compose(frame, poses)
    moved[:, 2] = poses[:, 2] + frame[2]
    return moved


def _odds(evidence: Sequence[float]) -> float:
    """The odds of the first place against the others and none."""
    others = float(np.logaddexp.reduce([0.0, *evidence[1:]]))
    return float(np.exp(np.clip(evidence[0] - others, -700.0, 700.0)))


def _names(log: Log) -> str:
    return " and ".join(each.name for each in log.sessions) or log.name


def _again(joined: Log, models: dict[str, Any]) -> Log:
    """The joined log after association and solving in turn, without clutter."""
    bare = joined.replace(landmarks=np.full(len(joined.steps), UNIDENTIFIED), relations=None, positions=None)
    _, labels = np.unique(joined.landmarks, return_inverse=True)
    # the smallest name is that of clutter
    labels = labels - int(np.any(joined.landmarks == UNIDENTIFIED))
    problem = Problem.of(bare, models["motion"], models["sensor"], AssociationOptions())
    found = refine(problem, labels, joined.initial_poses)
    if found is not None:
        joined = joined.replace(
            landmarks=np.where(found.labels < 0, UNIDENTIFIED, found.labels), initial_poses=found.solved.poses
        )
    clutter = joined.landmarks == UNIDENTIFIED
    note = f"{len(joined.landmark_ids)} landmarks were found in all logs together, and {clutter.sum()} sightings are clutter"
    return joined.with_sightings(~clutter, notes=(*joined.notes, note))
