"""A part of a map that lies wrong as a whole: surveyed at another time, taken from another drawing, or moved together.

A rigid motion of a part changes no distance within it, but those from its landmarks to the others. For two landmarks i and j
that are seen at about the same time, let r be the median of their measured distances, less that in the map. With u the
direction from i to j, and j in a part that lies where it is after a motion (t, phi) about the point c,

    r = - u . (t + phi perpendicular(m_j - c)) + s d + b u . (v_j - v_i) + noise,

where s and b are errors of the scale and of the ranges, d is the distance, and v the directions in which the robot sees them.
The noise is how much the measured distances scatter. The part is the landmarks on one side of a line, that line for which the
sum of min(z², `CAP`) is least, z the residuals over their noise. Where most distances within the parts fit badly, too, all
squares are divided by their median over that of chi-square.

A part has moved where this sum falls much, by more than the errors of a few landmarks can make it, and where most of the
landmarks on both sides say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors.checks import listed
from ..se2 import Array, chained, perpendicular
from .landmark_map import LandmarkMap
from .registration import evenly
from .stretch import Stretch

#: pairs are a sighting and each of so many that follow, up to so many moments later, with at most this variance [m²]
LAGS, MOMENTS, VAGUE = 24, 8, 0.25
#: the smallest distance of a pair [m], the fewest measurements of it, and the fewest pairs
NEAR, OFTEN, PAIRS = 1.0, 5, 30
#: a part of the standard deviation of distances by the noise models, and one [m], below which their scatter is not believed
LEAST, SHARED = 0.5, 0.003
#: the largest square that counts, and the squares at which a pair loses half of its weight
CAP, DOUBTED = 16.0, 9.0
#: directions of the lines, and the most lines of each
DIRECTIONS, LINES = 12, 24
#: the sum falls by so much, by so much for each distance between the parts, and there to so much of it
GAIN, EACH, LEFT = 60.0, 4.0, 0.13
#: with so much larger squares within the parts, places are wrong one by one
ROUGH = 15.0
#: the fewest landmarks of a part, the fewest that agree of each one, and how many times as many as contradict
SIDE, FEW, AGREE = 3, 2, 3
#: the median of chi-square with one degree of freedom
MEDIAN = 0.455


@dataclass(frozen=True)
class Part:
    """Landmarks that lie wrong together, and by how much [m] (root mean square)."""

    ids: tuple[int, ...]
    metres: float

    @property
    def sentence(self) -> str:
        """What is said of it."""
        return (
            f"{listed('landmark', list(self.ids))} lie {self.metres:.2f} m from where the others have them, all by one rigid "
            "motion: this part of the map was surveyed apart, or moved since the map was made; the map is used without it"
        )


@dataclass(frozen=True, eq=False)
class _Distances:
    """Of P pairs of L landmarks the measured distances less those in the map, their noise, and the columns for s and b.

    ``first`` and ``second`` are rows of ``places`` (L, 2).
    """

    places: Array
    first: np.ndarray
    second: np.ndarray
    off: Array
    noise: Array
    of_sensor: Array
    larger: float = 1.0

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Coefficients by robust least squares, and the squares (P,) that count."""
        weights = self.noise**-2
        for _ in range(4):
            mixed = columns.T * weights
            found = np.linalg.lstsq(mixed @ columns, mixed @ self.off, rcond=None)[0]
            squares = ((self.off - columns @ found) / self.noise) ** 2 / self.larger
            weights = self.noise**-2 / (1 + squares / DOUBTED)
        return found, np.minimum(squares, CAP)

    def moved(self, part: np.ndarray) -> tuple[Array, Array, np.ndarray]:
        """The motion (3,) of a part (L,) about the centre, the squares that count, and the pairs across its border."""
        a, b, across = self.places[self.first], self.places[self.second], part[self.first] != part[self.second]
        u = np.where(part[self.second], -1.0, 1.0)[:, None] * (b - a) / np.hypot(*(b - a).T)[:, None]
        arm = np.where(part[self.second][:, None], b, a) - self.places.mean(axis=0)
        moving = np.column_stack([u, np.einsum("ni,ni->n", u, perpendicular(arm))])
        found, squares = self.fitted(np.column_stack([self.of_sensor, across[:, None] * moving]))
        return found[2:], squares, across

    def scaled(self, squares: Array) -> _Distances:
        """The same with the noise that squares (P,) of a fit show."""
        return replace(self, larger=max(1.0, float(np.median(squares)) * self.larger / MEDIAN))


def displaced_part(drive: Stretch, landmarks: LandmarkMap) -> Part | None:
    """The smaller part of a map where the distances that a drive measures show that two parts do not fit; else None."""
    from scipy.spatial import cKDTree

    seen = np.array([j for j in np.unique(drive.landmarks).tolist() if j in landmarks])
    found = _distances(drive, landmarks, seen) if len(seen) >= 2 * SIDE else None
    if found is None:
        return None
    distances = found.scaled(found.fitted(found.of_sensor)[1])
    places, paired = distances.places, np.union1d(distances.first, distances.second)

    def misfit(part: np.ndarray) -> float:
        few = min(np.sum(part[paired]), np.sum(~part[paired])) < SIDE
        return np.inf if few else float(np.sum(distances.moved(part)[1]))

    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = places @ np.stack([np.cos(angles), np.sin(angles)])
    lines = np.sort(along[paired], axis=0)[evenly(len(paired), LINES)]
    part = min((along[:, k] >= at for k in range(DIRECTIONS) for at in lines[:, k]), key=misfit)
    # two parts that fit within themselves show the noise
    fitting = distances.scaled(distances.moved(part)[1])
    motion, squares, across = fitting.moved(part)
    without = fitting.fitted(fitting.of_sensor)[1]
    gains = without - squares
    if fitting.larger > ROUGH or gains.sum() < max(GAIN, EACH * across.sum()):
        return None
    if 2 * across.sum() > len(across) or squares[across].sum() > LEFT * without[across].sum():
        return None
    votes = np.bincount(fitting.first[across], gains[across], len(places))
    votes += np.bincount(fitting.second[across], gains[across], len(places))
    agree, contradict = (np.array([np.sum(which & part), np.sum(which & ~part)]) for which in (votes > 1, votes < -1))
    if agree.min() < FEW or agree.sum() < 2 * SIDE or np.any(agree < AGREE * contradict):
        return None
    # a landmark without distances is of the part of the nearest one that has some
    part = part[paired[cKDTree(places[paired]).query(places)[1]]]
    smaller = part if 2 * part.sum() <= len(part) else ~part
    way = motion[:2] + motion[2] * perpendicular(places[smaller] - places.mean(axis=0))
    return Part(tuple(seen[smaller].tolist()), float(np.sqrt(np.mean(np.sum(way**2, axis=1)))))


def _distances(drive: Stretch, landmarks: LandmarkMap, seen: np.ndarray) -> _Distances | None:
    """The distances between landmarks of a map that a drive measures; None where they are few."""
    order = np.argsort(drive.steps, kind="stable")
    order = order[np.isin(drive.landmarks[order], seen)]
    which, steps = np.searchsorted(seen, drive.landmarks[order]), drive.steps[order]
    moments = np.unique(steps, return_inverse=True)[1]
    poses, places = chained(np.zeros(3), drive.motions)[steps], landmarks.arrays(seen.tolist())[0][:, :2]
    y, C = drive.sensor.places(drive.sightings[order, :2], poses)
    way = y - poses[:, :2]
    v = way / np.maximum(np.hypot(*way.T), NEAR / 2)[:, None]
    drift = np.concatenate([np.zeros((1, 2)), np.cumsum(np.diagonal(drive.noise, 0, 1, 2)[:, 1:], axis=0)])[steps]
    found = []
    for lag in range(1, LAGS + 1):
        a, b = np.arange(len(order) - lag), np.arange(lag, len(order))
        near = moments[b] - moments[a] <= MOMENTS
        since, first = drift[b] - drift[a], np.where(which[a] < which[b], a, b)
        a, b = first, a + b - first
        u, in_map = y[b] - y[a], np.hypot(*(places[which[b]] - places[which[a]]).T)
        distance = np.hypot(*u.T)
        u = u / np.maximum(distance, NEAR / 2)[:, None]
        both = C[a] + C[b]
        along = np.einsum("ni,nij,nj->n", u, both, u)
        sideways = np.trace(both, axis1=1, axis2=2) - along
        variance = along + 2 * since[:, 0] + since[:, 1] * np.sum(way[a] ** 2, axis=1)
        used = near & (which[a] != which[b]) & (np.minimum(distance, in_map) > NEAR) & (variance < VAGUE)
        # errors across the line make it longer
        off = distance - in_map - sideways / (2 * np.maximum(distance, NEAR))
        of_ranges = np.einsum("ni,ni->n", u, v[b] - v[a])
        found.append(np.column_stack([which[a], which[b], a, b, off, variance, of_ranges, in_map])[used])
    rows = np.concatenate(found)
    rows = rows[np.lexsort(rows[:, 1::-1].T)]
    groups = np.split(rows, np.flatnonzero(np.any(np.diff(rows[:, :2], axis=0) != 0, axis=1)) + 1)
    counts = np.array([min(len(np.unique(group[:, 2])), len(np.unique(group[:, 3]))) for group in groups])
    groups = [group for group, count in zip(groups, counts) if count >= OFTEN]
    if len(groups) < PAIRS:
        return None
    i, j, _, _, off, variance, of_ranges, in_map = np.array([np.median(group, axis=0) for group in groups]).T
    scatter = np.array([1.4826 * np.median(np.abs(group[:, 4] - r)) for group, r in zip(groups, off)])
    squares = np.maximum(scatter, LEAST * np.sqrt(variance)) ** 2 * np.pi / 2 / counts[counts >= OFTEN] + SHARED**2
    i, j = i.astype(int), j.astype(int)
    if landmarks.covariances:
        S, u = landmarks.between(seen.tolist())[:, :, :2, :2], (places[j] - places[i]) / in_map[:, None]
        squares += np.einsum("ni,nij,nj->n", u, S[i, i] + S[j, j] - S[i, j] - S[j, i], u)
    return _Distances(places, i, j, off, np.sqrt(squares), np.column_stack([in_map, of_ranges]))
