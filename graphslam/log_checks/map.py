"""A log against its true map: whether the map has the landmarks that are seen, where they are seen from each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Log
from ..models import SensorModel
from ..reading import UNIDENTIFIED
from .distances import Distances
from .finding import Finding

#: fewer distances or triangles are not significant
_FEWEST = 10
#: distances, sightings and triangles that are compared at most
_ENOUGH = 5000
#: distances of the map that are off by more [ranges, median] contradict the sightings; another unit is a larger factor
_WRONG, _FACTOR = 0.4, 5.0
#: triangles of landmarks with angles whose sine is larger have a side, which is the other one in this part if mirrored
_SINE, _MIRRORED = 0.3, 0.8


def against_map(log: Log, found: Distances, *, trusted: bool) -> Iterator[Finding]:
    """Ids, distances and sides of the true landmarks, and their places if the true poses are ``trusted``."""
    if not log.true_landmarks:
        return
    seen, known = set(log.landmark_ids.tolist()), set(log.true_landmarks)
    if seen and 2 * len(seen & known) < min(len(seen), len(known)):
        which = f"only {len(seen & known)}" if seen & known else "none"
        yield Finding(
            "map ids",
            f"{which} of the {len(seen)} landmarks that are seen ({_listed(seen)}) is among the {len(known)} of the true map "
            f"({_listed(known)}); the ids of one of them may be of another list or column",
        )
        return
    if len(seen) == 1:
        return
    inside = _some(np.flatnonzero(np.isin(found.pair, list(known)).all(axis=1)))
    places = {j: np.asarray(place[:2]) for j, place in log.true_landmarks.items()}
    ends = np.array([[places[a], places[b]] for a, b in found.pair[inside].tolist()]).reshape(-1, 2, 2)
    true = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    off = _median(np.abs(true - found.distance[inside]) / found.range[inside])
    if len(true) >= _FEWEST and off > _WRONG:
        ratio = _median(true / np.maximum(found.distance[inside], 1e-9))
        cause = "the ids of the map may belong to other landmarks"
        if not 1 / _FACTOR < ratio < _FACTOR:
            cause = f"they are about {ratio:.3g} times as large: it may be in another unit"
        yield Finding(
            "map",
            f"the distances between landmarks in the true map differ from those that are seen by {off:.0%} of the range "
            f"(median); {cause}",
        )
    elif _is_mirrored(log, places):
        yield Finding(
            "map mirrored",
            "the true map is the mirror image of what is seen: x and y may be swapped, or one have the wrong sign",
        )
    elif trusted and (off := _seen_from_truth(log)) > _WRONG:
        yield Finding(
            "map",
            f"seen from the true poses the landmarks are {off:.0%} of the range (median) away from their places in the true "
            "map; its ids may belong to other landmarks, or its axes, units or origin be other ones than those of the poses",
        )


def _seen_from_truth(log: Log) -> float:
    """The median distance [ranges] between the map and the landmarks of the sightings from true poses; 0 if unknown."""
    assert log.true_landmarks is not None
    if log.robot_truth is None:
        return 0.0
    poses = log.robot_truth[log.steps]
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1) & np.isin(log.landmarks, list(log.true_landmarks)))
    if len(rows) < _FEWEST:
        return 0.0
    rows = _some(rows)
    seen = (log.sensor or SensorModel()).h_inverse(poses[rows], log.sightings[rows])[:, :2]
    true = np.array([log.true_landmarks[j][:2] for j in log.landmarks[rows].tolist()])
    return float(np.median(np.linalg.norm(seen - true, axis=1) / log.sightings[rows, 0]))


def _is_mirrored(log: Log, places: dict[int, np.ndarray]) -> bool:
    """Whether landmarks that are seen at one step, three by three, lie the other way round in the map."""
    rows = np.flatnonzero((log.landmarks != UNIDENTIFIED) & np.isin(log.landmarks, list(places)))
    triples = np.column_stack([rows[:-2], rows[1:-1], rows[2:]]) if len(rows) > 2 else np.zeros((0, 3), dtype=int)
    triples = _some(triples[np.ptp(log.steps[triples], axis=1) == 0])
    if len(triples) < _FEWEST:
        return False
    seen = (log.sensor or SensorModel()).h_inverse(np.zeros((len(triples), 3, 3)), log.sightings[triples])[..., :2]
    true = np.array([[places[j] for j in row] for row in log.landmarks[triples].tolist()])
    ours, theirs = (_side(corners) for corners in (seen, true))
    clear = (np.abs(ours) > _SINE) & (np.abs(theirs) > _SINE)
    return bool(np.sum(clear) >= _FEWEST and np.mean(ours[clear] * theirs[clear] < 0) > _MIRRORED)


def _side(corners: np.ndarray) -> np.ndarray:
    """The sine of the first angle of triangles (K, 3, 2), positive if counterclockwise; 0 for two equal corners."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    side: np.ndarray = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / np.where(size > 0, size, 1.0)
    return side


def _some(rows: np.ndarray) -> np.ndarray:
    """Rows spread over all of them, not many more than `_ENOUGH`."""
    return rows[:: max(1, len(rows) // _ENOUGH)]


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _listed(ids: set[int]) -> str:
    first = ", ".join(map(str, sorted(ids)[:3]))
    return f"{first}, ..." if len(ids) > 3 else first
