"""Registration of landmarks without ids in a map: which place in it has a constellation like theirs.

Two measured landmarks at a distance d match the pairs of landmarks of the map at the same distance, and each match is a
hypothesis of the pose T. All are scored by how many measurements have a landmark of the map nearby; the best are refined and
compared by their evidence, as in `maps.registration`. There the id says which of the L landmarks a measurement is of.
Here it may be any of them: with the density rho = L / A of the landmarks of the map, a measurement adds

    log(RIGHT sum over j of p_kj / rho + 1 - RIGHT),

p_kj its density if it is of landmark j, of which the `NEAR` nearest count; 1 - RIGHT is for clutter and landmarks that the
map does not have. One that is too uncertain to say anything adds about 0.

Sightings of one landmark must count once: they are merged first, in the frame of the measurements.

Sources: Bailey, Nebot, Rosenblatt and Durrant-Whyte, *Data association for mobile robot navigation: a graph theoretic
approach*, ICRA 2000; MacKay, *Information Theory, Inference, and Learning Algorithms*, chapter 28.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..se2 import Array, difference, rotation, transform
from .landmark_map import LandmarkMap
from .registration import GATE, RIGHT, Match, Points, distinct, refined, those_that_differ, through, volume

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

#: the pairs of measurements that make hypotheses, how often each measurement is in one, and the most matches of a pair
PAIRS, USED, MATCHES = 16, 3, 5_000
#: the most measurements by which hypotheses are scored, and the hypotheses that are refined
SCORED, REFINED = 30, 24
#: how many standard deviations two distances may differ
WIDE = 2.5
#: the landmarks of the map that a measurement may be of
NEAR = 8
#: cells of the table of the nearest landmark
CELLS = 40_000
#: how often partners are chosen again, and how often for places that are alike, within a factor of e^CLOSE
REFINEMENTS, LAST_REFINEMENTS, CLOSE = 3, 6, 20.0


@dataclass(frozen=True, eq=False)
class Constellations:
    """A map whose pairs of landmarks are sorted by their distance.

    Attributes:
        ids: (L,) of the landmarks.
        places, covariances: (L, 3) and (L, 3, 3), headings NaN where they are not known.
        tree: of the places.
        pairs, distances: (N, 2) and (N,), by increasing distance.
        corner, cell, nearest: a table (X, Y) of the landmark nearest to each square cell, and where it begins.
        area: of the map [m²].
    """

    ids: np.ndarray
    places: Array
    covariances: Array
    tree: cKDTree
    pairs: np.ndarray
    distances: Array
    corner: Array
    cell: float
    nearest: np.ndarray
    area: float

    @classmethod
    def of(cls, landmarks: LandmarkMap, reach: float) -> Constellations:
        """A map, with the pairs that are not farther apart than twice the reach of the sensor [m]."""
        from scipy.spatial import cKDTree

        ids, (places, covariances) = np.array(list(landmarks)), landmarks.arrays(landmarks)
        tree = cKDTree(places[:, :2])
        pairs = tree.query_pairs(2 * reach, output_type="ndarray")
        distances = np.hypot(*(places[pairs[:, 1], :2] - places[pairs[:, 0], :2]).T)
        order = np.argsort(distances)
        corner = places[:, :2].min(axis=0) - reach / 4
        size = np.ptp(places[:, :2], axis=0) + reach / 2
        cell = float(np.sqrt(np.prod(size) / CELLS))
        shape = np.ceil(size / cell).astype(int)
        centres = np.moveaxis(np.indices(shape), 0, -1) * cell + corner + cell / 2
        nearest = tree.query(centres.reshape(-1, 2))[1].reshape(shape)
        area = float(np.prod(np.ptp(places[:, :2], axis=0) + reach))
        return cls(ids, places, covariances, tree, pairs[order], distances[order], corner, cell, nearest, area)

    def near(self, points: Array) -> np.ndarray:
        """About the nearest landmark of points (..., 2), from the table."""
        cells = ((points - self.corner) / self.cell).astype(int)
        cells = np.clip(cells, 0, np.array(self.nearest.shape) - 1)
        return np.asarray(self.nearest[cells[..., 0], cells[..., 1]])


@dataclass(frozen=True, eq=False)
class Merged:
    """Landmarks in the frame of the measurements, K of each: places (K, 3), covariances (K, 3, 3), numbers of sightings.

    ``which`` (M,) is the landmark of each sighting.
    """

    places: Array
    covariances: Array
    counts: np.ndarray
    which: np.ndarray


def merged(y: Array, sensed: Array, drift: Array, steps: np.ndarray, gate: float = GATE, compared: int = 2) -> Merged:
    """Sightings (M, 3), headings NaN where unknown, as landmarks: each belongs to the nearest one that it fits, or is new.

    Args:
        y: places.
        sensed, drift: (M, 3, 3) their covariances by the sensor, and by the odometry since the first pose.
        steps: (M,) at which they were seen; two sightings of one step are two landmarks.
        gate: the squared Mahalanobis distance up to which one fits.
        compared: of how many coordinates; the headings are known where it is 3.
    """
    d = 3 if np.isfinite(y[:, 2]).all() else 2
    # the trace is no less than the largest variance in any direction
    spread = np.trace((sensed + drift)[:, :2, :2], axis1=1, axis2=2)
    reach = np.sqrt(gate * (spread + np.trace(sensed[:, :2, :2], axis1=1, axis2=2).max(initial=0.0)))
    means, information, W = np.zeros((len(y), d)), np.zeros((len(y), d, d)), np.linalg.inv(sensed[:, :d, :d])
    # of each landmark its first sighting, and the step of its last one
    first, last, which, count = np.zeros(len(y), dtype=int), np.full(len(y), -1), np.zeros(len(y), dtype=int), 0
    for k in range(len(y)):
        off = difference(y[k, :compared], means[:count, :compared])
        near = np.flatnonzero((np.abs(off[:, :2]).max(axis=1) <= reach[k]) & (last[:count] != steps[k]))
        off, since = off[near], (drift[k] - drift[first[near]])[:, :compared, :compared]
        V = sensed[k, :compared, :compared] + np.linalg.inv(information[near])[:, :compared, :compared] + since
        squares = np.einsum("ci,ci->c", off, np.linalg.solve(V, off[:, :, None])[:, :, 0])
        if squares.min(initial=np.inf) < gate:
            c = int(near[np.argmin(squares)])
        else:
            c, count = count, count + 1
            first[c], means[c] = k, y[k, :d]
        information[c] += W[k]
        means[c] += np.linalg.solve(information[c], W[k] @ difference(y[k, :d], means[c]))
        last[c], which[k] = steps[k], c
    places, covariances = np.full((count, 3), np.nan), np.zeros((count, 3, 3))
    places[:, :d] = means[:count]
    covariances[:, :d, :d] = np.linalg.inv(information[:count]) + drift[first[:count], :d, :d]
    return Merged(places, covariances, np.bincount(which), which)


def match(landmarks: Merged, known: Constellations) -> list[tuple[Match, np.ndarray]]:
    """The poses T that differ, by decreasing evidence, each with the number (K,) in the map of each landmark's partner.

    It is -1 for a landmark that has none nearby. One that has a partner and does not agree is a second one at its place.
    """
    order = np.argsort(-landmarks.counts, kind="stable")[:SCORED]
    y, C = landmarks.places[order], landmarks.covariances[order]
    variance = np.trace(C[:, :2, :2], axis1=1, axis2=2) / 2
    variance = variance + float(np.mean(np.trace(known.covariances[:, :2, :2], axis1=1, axis2=2))) / 2
    poses = _hypotheses(y[:, :2], variance, known)
    if not len(poses):
        return []
    moved = transform(poses[:, None], y)
    near = known.near(moved)
    squares = np.sum((moved - known.places[near, :2]) ** 2, axis=2) / variance
    first = distinct(squares, np.where(squares <= GATE, near + 1, 0), REFINED)
    return _ranked(*_refined(landmarks, known, poses[first], REFINEMENTS))


def with_alike(
    landmarks: Merged, known: Constellations, found: list[tuple[Match, np.ndarray]]
) -> list[tuple[Match, np.ndarray]]:
    """The result of `match`, with the places where the map has the constellation of its best match again.

    A place that is exactly alike may have been refined with other partners, and have less evidence for no other reason.
    """
    best, partners = found[0]
    kept = best.agree
    exact = landmarks.places[kept].copy()
    exact[:, :2] = (known.places[partners[kept], :2] - best.pose[:2]) @ rotation(best.pose[2])
    once = replace(landmarks, places=exact, covariances=landmarks.covariances[kept], counts=landmarks.counts[kept])
    alike = match(once, known)
    poses = np.array([each.pose for each, _ in alike if each.evidence > alike[0][0].evidence - CLOSE])
    if len(poses) < 2:
        return found
    matches, again = _refined(landmarks, known, poses, LAST_REFINEMENTS)
    return _ranked([*matches, *(each for each, _ in found)], [*again, *(each for _, each in found)])


def _ranked(
    matches: Sequence[Match | None], partners: Sequence[np.ndarray] | np.ndarray
) -> list[tuple[Match, np.ndarray]]:
    """The matches that differ, with their partners."""
    return [(each, partners[k]) for k, each in those_that_differ(matches)]


def _hypotheses(y: Array, variance: Array, known: Constellations) -> Array:
    """T (H, 3) of pairs of measurements and pairs of landmarks at the same distance; the rarest distances first."""
    i, j = np.triu_indices(len(y), 1)
    apart = np.hypot(*(y[j] - y[i]).T)
    off = WIDE * np.sqrt(variance[i] + variance[j])
    low, high = (np.searchsorted(known.distances, apart + sign * off) for sign in (-1, 1))
    count = high - low
    used, chosen = np.zeros(len(y), dtype=int), list[Array]()
    for k in np.argsort(count, kind="stable").tolist():
        # two that are hardly apart do not say where they head
        if count[k] == 0 or apart[k] < 2 * off[k] / WIDE or max(used[i[k]], used[j[k]]) >= USED:
            continue
        if count[k] > MATCHES or len(chosen) == PAIRS:
            break
        used[[i[k], j[k]]] += 1
        pairs = known.pairs[low[k] : high[k]]
        a, b = (known.places[np.concatenate([pairs[:, n], pairs[:, 1 - n]]), :2] for n in (0, 1))
        way, here = b - a, y[j[k]] - y[i[k]]
        theta = np.arctan2(here[0] * way[:, 1] - here[1] * way[:, 0], way @ here)
        share = variance[j[k]] / (variance[i[k]] + variance[j[k]])
        middle = np.broadcast_to(share * y[i[k]] + (1 - share) * y[j[k]], a.shape)
        chosen.append(through(theta, middle, share * a + (1 - share) * b))
    return np.concatenate(chosen) if chosen else np.zeros((0, 3))


def _refined(
    landmarks: Merged, known: Constellations, poses: Array, rounds: int
) -> tuple[list[Match | None], np.ndarray]:
    """Hypotheses (H, 3) after Gauss-Newton with the nearest landmark for each measurement, and these partners (H, K)."""
    matches: list[Match | None] = []
    ids = np.arange(len(landmarks.places))
    for _ in range(rounds):
        moved = transform(poses[:, None], landmarks.places)
        distance, partner = known.tree.query(moved)
        # one landmark is seen once: the nearest measurement has it
        order = np.lexsort((distance, partner))
        in_order = np.take_along_axis(partner, order, axis=1)
        again = np.zeros(partner.shape, dtype=bool)
        np.put_along_axis(again, order[:, 1:], in_order[:, 1:] == in_order[:, :-1], axis=1)
        places = known.places[partner]
        places[again, :2] += 1e6
        points = Points(landmarks.places, landmarks.covariances, places, known.covariances[partner], ids, known.area)
        matches = refined(points, poses)
        poses = np.array([pose if match is None else match.pose for match, pose in zip(matches, poses)])
    moved = transform(poses[:, None], landmarks.places)
    partners = known.tree.query(moved, k=np.arange(1, min(NEAR, len(known.ids)) + 1))[1]
    turn = rotation(poses[:, 2])[:, None]
    V = turn @ landmarks.covariances[:, :2, :2] @ np.swapaxes(turn, 2, 3)
    V = V[:, :, None] + known.covariances[partners][..., :2, :2]
    e = moved[:, :, None] - known.places[partners][..., :2]
    squares = np.einsum("hkni,hknij,hknj->hkn", e, np.linalg.inv(V), e, optimize=True)
    densities = np.exp(-squares / 2) / (2 * np.pi * np.sqrt(np.linalg.det(V)))
    seen = np.log(RIGHT * densities.sum(axis=2) * known.area / len(known.ids) + 1 - RIGHT)
    # two that were not merged, but are at one landmark, are one sighting of it
    seen = np.where(again, np.minimum(seen, 0.0), seen).sum(axis=1)
    return [
        None if match is None else replace(match, evidence=float(s + volume(match.covariance, known.area)))
        for match, s in zip(matches, seen)
    ], np.where(squares.min(axis=2) > GATE, -1, partner)
