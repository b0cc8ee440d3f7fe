"""A log against its ground truth (scale, signs and axes of the true poses) and against its true map (ids and places).

`against_map` checks whether the map has the landmarks that are seen, at the distances from each other at which they are seen.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import decimals
from ..log import Log
from ..log.rows import UNIDENTIFIED
from ..models import SensorModel
from ..se2 import Array, between, wrap
from .ids import Distances, Finding

#: motions that are needed
_FEWEST = 20
#: the number of straight lines that the path is divided into; turns between neighbours count above the second number [rad]
_LINES, _TURN = 60, 0.15
#: mirrored turns fit if their median error is below the first number [rad], and below this share of that of the given turns
_FITS, _PART = 0.3, 0.4
#: mean cosine of the angle between two directions that are the same
_ALONG = 0.7


def against_truth(log: Log) -> Iterator[Finding]:
    """Odometry against the true poses: the length of the way, the sign of its turns, and where the robot looks."""
    if log.true_poses is None or log.controls is None:
        return
    # a truth with few rows, as of GPS, is known at single poses only
    placed = np.flatnonzero(log.covered)
    if len(placed) <= _FEWEST:
        return
    begin, end = placed[:-1], placed[1:]
    path, truth = log.at_truth(log.dead_reckoning()), log.true_poses
    # over long pieces as well, because noise of true poses that are close to each other makes their path longer
    lines = placed[:: max(1, len(begin) // _LINES)]
    lengths = [
        [float(np.sum(np.hypot(*(poses[to, :2] - poses[at, :2]).T))) for poses in (path, truth)]
        for at, to in ((lines[:-1], lines[1:]), (begin, end))
    ]
    ours, theirs = lengths[1]
    if all(max(each) > 1 and not 0.5 < each[0] / max(each[1], 1e-9) < 2 for each in lengths):
        ways = f"the odometry drives {decimals(ours, 1)} m where the truth moves {decimals(theirs, 1)} m"
        cause = "one may be in another unit"
        yield Finding("truth scale", f"{ways}; {cause}")
    mirrored = _truth_is_mirrored(path, truth, placed)
    headed = np.isfinite(truth[begin, 2]) & np.isfinite(truth[end, 2])
    begin, end = begin[headed], end[headed]
    if len(begin) < _FEWEST:
        if mirrored:
            what = "the true path turns the other way than the odometry"
            cause = "x and y of the truth may be swapped, or one of them or of the turn rates have the wrong sign"
            yield Finding("truth mirrored", f"{what}: {cause}")
        return
    turns, real = path[end, 2] - path[begin, 2], wrap(truth[end, 2] - truth[begin, 2])
    small = np.abs(turns) < np.pi / 2
    product, size = float(np.sum((turns * real)[small])), float(np.sum((turns**2)[small]))
    if np.sum(np.abs(turns[small])) > 1 and product < -0.5 * size:
        also = "; or x and y of the truth are swapped, with the headings" if mirrored else ""
        message = f"the odometry turns the other way than the truth; one of them has the wrong sign{also}"
        yield Finding("truth sign", message)
        return
    if theirs > 1:
        driven = between(path[begin], path[end])
        yield from _headings(between(truth[begin], truth[end]), truth[begin], driven, mirrored=mirrored)


def _headings(motions: Array, truth: Array, driven: Array, *, mirrored: bool) -> Iterator[Finding]:
    """Whether the robot looks where it drives; if not, whether it does with x and y read another way.

    Args:
        motions: (K, 3) true ones, seen from the poses where they begin.
        truth: (K, 3) where they begin.
        driven: (K, 3) the motions of dead reckoning.
        mirrored: whether the true path turns the other way than the odometry.
    """
    far = np.hypot(*motions[:, :2].T) > np.median(np.hypot(*motions[:, :2].T))
    if not far.any():
        return
    ahead, heading = np.arctan2(driven[far, 1], driven[far, 0]), truth[far, 2]
    seen = np.arctan2(motions[far, 1], motions[far, 0])
    aside = np.mean(np.exp(1j * (seen - ahead)))
    # cos of the angle between where the robot looks and where it drives
    others = {
        "x and y of the truth are swapped": np.pi / 2 - (seen + heading),
        "x of the truth has the wrong sign": np.pi - (seen + heading),
        "y of the truth has the wrong sign": -(seen + heading),
    }
    fits = {name: float(np.mean(np.cos(direction - heading - ahead))) for name, direction in others.items()}
    best = max(fits, key=lambda name: fits[name])
    if mirrored and fits[best] > _ALONG > aside.real:
        yield Finding("truth mirrored", f"{best}: read like this, the robot looks where it drives")
    elif abs(aside) > _ALONG and abs(direction := np.angle(aside)) > np.deg2rad(45):
        away = f"the true headings point {np.rad2deg(abs(direction)):.0f} degrees away from the direction of driving"
        cause = "they may be in another unit, or count from another axis"
        yield Finding("truth heading", f"{away}; {cause}")
    elif abs(aside) < 1 - _ALONG:
        what = "the true headings have nothing to do with the direction of driving"
        cause = "they may be in another unit or column"
        yield Finding("truth heading", f"{what}; {cause}")


def _truth_is_mirrored(path: Array, truth: Array, known: np.ndarray) -> bool:
    """Whether the true path has the turns of the odometry with the other sign."""
    lengths = np.hypot(*np.diff(path[known, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    if way[-1] == 0:
        return False
    ends = known[np.unique(np.searchsorted(way, np.linspace(0, way[-1], _LINES + 1)).clip(max=len(known) - 1))]
    lines = [np.diff(poses[ends, 0] + 1j * poses[ends, 1]) for poses in (path, truth)]
    ours, theirs = (np.angle(line[1:] * np.conj(line[:-1])) for line in lines)
    turning = (np.abs(ours) > _TURN) & (np.abs(ours) < np.pi / 2)
    if np.sum(turning) < _FEWEST // 2:
        return False
    given, other = (float(np.median(np.abs(wrap(theirs + sign * ours)[turning]))) for sign in (-1, 1))
    return other < _FITS and other < _PART * given


#: fewer distances or triangles are not significant
_FEWEST_DISTANCES = 10
#: distances, sightings and triangles that are compared at most
_ENOUGH = 5000
#: distances of the map that are off by more [ranges, median] contradict the sightings; another unit is a larger factor
_WRONG, _FACTOR = 0.4, 5.0
#: triangles of landmarks count where the sine of their angle is larger than the first number; a map is mirrored where more
#: than the second share of them has the other orientation
_SINE, _MIRRORED = 0.3, 0.8


def against_map(log: Log, found: Distances, *, trusted: bool) -> Iterator[Finding]:
    """Ids, distances and sides of the true landmarks, and their places if the true poses are ``trusted``."""
    if not log.true_landmarks:
        return
    seen, known = set(log.landmark_ids.tolist()), set(log.true_landmarks)
    if seen and 2 * len(seen & known) < min(len(seen), len(known)):
        which = f"only {len(seen & known)}" if seen & known else "none"
        which = f"{which} of the {len(seen)} landmarks that are seen ({_listed(seen)})"
        among = f"is among the {len(known)} of the true map ({_listed(known)})"
        cause = "the ids of one of them may be of another list or column"
        yield Finding("map ids", f"{which} {among}; {cause}")
        return
    if len(seen) == 1:
        return
    inside = _some(np.flatnonzero(np.isin(found.pair, list(known)).all(axis=1)))
    places = {j: np.asarray(place[:2]) for j, place in log.true_landmarks.items()}
    ends = np.array([[places[a], places[b]] for a, b in found.pair[inside].tolist()]).reshape(-1, 2, 2)
    true = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    off = _median(np.abs(true - found.distance[inside]) / found.range[inside])
    if len(true) >= _FEWEST_DISTANCES and off > _WRONG:
        ratio = _median(true / np.maximum(found.distance[inside], 1e-9))
        cause = "the ids of the map may belong to other landmarks"
        if not 1 / _FACTOR < ratio < _FACTOR:
            cause = f"they are about {ratio:.3g} times as large: it may be in another unit"
        what = "the distances between landmarks in the true map differ from"
        others = f"those that are seen by {off:.0%} of the range (median)"
        yield Finding("map", f"{what} {others}; {cause}")
    elif _map_is_mirrored(log, places):
        message = "the true map is the mirror image of what is seen: x and y may be swapped, or one have the wrong sign"
        yield Finding("map mirrored", message)
    elif trusted and (off := _seen_from_truth(log)) > _WRONG:
        away = f"seen from the true poses the landmarks are {off:.0%} of the range (median) away"
        reason = "from their places in the true map; its ids may belong to other landmarks"
        cause = "or its axes, units or origin be other ones than those of the poses"
        yield Finding("map", f"{away} {reason}, {cause}")


def _seen_from_truth(log: Log) -> float:
    """The median distance [ranges] between the map and the landmarks of the sightings from true poses; 0 if unknown."""
    assert log.true_landmarks is not None
    if log.robot_truth is None:
        return 0.0
    poses = log.robot_truth[log.steps]
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1) & np.isin(log.landmarks, list(log.true_landmarks)))
    if len(rows) < _FEWEST_DISTANCES:
        return 0.0
    rows = _some(rows)
    seen = (log.sensor or SensorModel()).h_inverse(poses[rows], log.sightings[rows])[:, :2]
    true = np.array([log.true_landmarks[j][:2] for j in log.landmarks[rows].tolist()])
    return float(np.median(np.linalg.norm(seen - true, axis=1) / log.sightings[rows, 0]))


def _map_is_mirrored(log: Log, places: dict[int, np.ndarray]) -> bool:
    """Whether landmarks that are seen at one step, three by three, lie the other way round in the map."""
    rows = np.flatnonzero((log.landmarks != UNIDENTIFIED) & np.isin(log.landmarks, list(places)))
    triples = np.column_stack([rows[:-2], rows[1:-1], rows[2:]]) if len(rows) > 2 else np.zeros((0, 3), dtype=int)
    triples = _some(triples[np.ptp(log.steps[triples], axis=1) == 0])
    if len(triples) < _FEWEST_DISTANCES:
        return False
    seen = (log.sensor or SensorModel()).h_inverse(np.zeros((len(triples), 3, 3)), log.sightings[triples])[..., :2]
    true = np.array([[places[j] for j in row] for row in log.landmarks[triples].tolist()])
    ours, theirs = (_side(corners) for corners in (seen, true))
    clear = (np.abs(ours) > _SINE) & (np.abs(theirs) > _SINE)
    return bool(np.sum(clear) >= _FEWEST_DISTANCES and np.mean(ours[clear] * theirs[clear] < 0) > _MIRRORED)


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
