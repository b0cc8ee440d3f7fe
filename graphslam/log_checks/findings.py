"""`Finding`: something in a log that is probably a mistake; and what all checks compare sightings by.

They compare positions of sightings by the odometry, and distances between landmarks that are seen shortly after one another
(`Distances`). Over a short way both hardly depend on the drift of the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..log.rows import UNIDENTIFIED
from ..models import SensorModel
from ..se2 import Array


@dataclass(frozen=True)
class Finding:
    """Something in a log that is probably a mistake.

    Attributes:
        check: a short name, "bearing sign" for example.
        message: one sentence with the likely cause.
    """

    check: str
    message: str


#: two landmarks are compared if they are seen within this way, [rad] turned plus [ranges] driven, and number of sightings
_WAY, _BACK = 3.0, 30
#: distances that are computed at most
_ENOUGH = 200_000


@dataclass(frozen=True, eq=False)
class Distances:
    """K distances between landmarks.

    Attributes:
        pair: (K, 2) the ids of the two landmarks, the smaller first.
        step: (K,) at which the second one is seen.
        distance: (K,) [m].
        range: (K,) the mean range of the two sightings [m].
    """

    pair: np.ndarray
    step: np.ndarray
    distance: Array
    range: Array


def distances_of(log: Log) -> Distances:
    """The distances of a log; without controls those of landmarks that are seen from one pose."""
    known = np.flatnonzero(log.landmarks != UNIDENTIFIED)
    steps, ids, sightings = log.steps[known], log.landmarks[known], log.sightings[known, :2]
    # without controls poses are too far apart
    way, poses = 2 * _WAY * np.arange(log.num_poses), np.zeros((log.num_poses, 3))
    if log.controls is not None and len(known):
        way, poses = ways(log, known), log.dead_reckoning()
    places = (log.sensor or SensorModel()).h_inverse(poses[steps], sightings)
    every = max(1, len(ids) * _BACK // _ENOUGH)
    parts: list[tuple[np.ndarray, ...]] = []
    for back in range(1, _BACK + 1):
        b = np.arange(back, len(ids), every)
        b = b[(way[steps[b]] - way[steps[b - back]] <= _WAY) & (ids[b] != ids[b - back])]
        a = b - back
        pair = np.sort(np.column_stack([ids[a], ids[b]]), axis=1)
        apart = np.linalg.norm(places[b] - places[a], axis=1)
        parts.append((pair, steps[b], apart, (sightings[a, 0] + sightings[b, 0]) / 2))
    return Distances(*map(np.concatenate, zip(*parts)))


def ways(log: Log, known: np.ndarray) -> Array:
    """The way (T+1,) to each pose, [rad] turned plus [ranges] driven; a range is the median of the sightings ``known``."""
    assert log.controls is not None and log.dt is not None
    driven = np.abs(log.controls) @ [1 / float(np.median(log.sightings[known, 0])), 1.0] * log.dt
    return np.asarray(np.concatenate([[0.0], np.cumsum(driven)])[log.control_starts])
