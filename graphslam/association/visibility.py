"""Counts of how often each landmark was in the field of view, and was then seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine import engine
from ..log import Log
from ..se2 import Array
from .densities import INSIDE, Densities, Field
from .map_solution import Backbone, MapSolution


@dataclass(frozen=True, eq=False)
class Visibility:
    """Counts (L,) for each landmark: the scans in which it was well within the field of view, and in which it was seen.

    ``whole`` and ``anywhere`` count the same for the whole field, at whose border noise decides whether a landmark is in it.
    """

    views: np.ndarray
    within: np.ndarray
    whole: np.ndarray
    anywhere: np.ndarray

    @classmethod
    def of(cls, log: Log, backbone: Backbone, solved: MapSolution, field: Field) -> Visibility:
        """The counts for the landmarks of a solved graph."""
        scans = np.unique(log.steps)
        limits = np.array(
            [[field.nearest / s, field.farthest * s, np.cos(min(field.bearing * s, np.pi))] for s in (INSIDE, 1.0)]
        )
        origin = np.asarray(backbone.origin, dtype=float)
        everywhere = engine.count_views(solved.poses[scans], np.ascontiguousarray(solved.landmarks), origin, limits)
        inside = _inside(solved.poses[log.steps[solved.rows]], solved.landmarks[solved.which], origin, limits)
        seen = [np.bincount(solved.which, each, len(solved.landmarks)).astype(np.int64) for each in inside]
        return cls(everywhere[0], seen[0], everywhere[1], seen[1])

    def misses(self, densities: Densities) -> Array:
        """The logarithm (L,) of the probability of the views without a sighting; half of it at the border of the field."""
        well = self.views - self.within
        border = np.maximum(self.whole - self.anywhere - well, 0)
        return well * densities.missed + border * np.log1p(-np.exp(densities.seen) / 2)


def _inside(poses: Array, landmarks: Array, origin: Array, limits: Array) -> np.ndarray:
    """For each of the limits (S, 3) whether a landmark (n, d) is inside seen from a pose (n, 3), (S, n)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = (landmarks[:, :2] - poses[:, :2]).T
    x, y = c * dx + s * dy - origin[0], c * dy - s * dx - origin[1]
    square, ahead = x * x + y * y, x * np.abs(x)
    low, high, cosine = limits.T[:, :, None]
    return np.asarray((square >= low**2) & (square <= high**2) & (ahead >= cosine * np.abs(cosine) * square))
