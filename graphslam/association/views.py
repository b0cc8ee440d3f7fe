"""How often each landmark was in the field of view, and how often it was then seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..log import Log
from ..se2 import Array
from .densities import INSIDE, Densities, Field
from .solved import Backbone, Solved


@dataclass(frozen=True, eq=False)
class Views:
    """Of each landmark (L,): in how many scans it was well within the field of view, and in how many of these it was seen.

    ``whole`` and ``anywhere`` count the same for the whole field, at whose border noise decides whether a landmark is in it.
    """

    views: np.ndarray
    within: np.ndarray
    whole: np.ndarray
    anywhere: np.ndarray

    @classmethod
    def of(cls, log: Log, backbone: Backbone, solved: Solved, field: Field) -> Views:
        """Those of the landmarks of a solved graph."""
        scans = np.unique(log.steps)
        limits = np.array(
            [[field.nearest / s, field.farthest * s, np.cos(min(field.bearing * s, np.pi))] for s in (INSIDE, 1.0)]
        )
        origin = np.asarray(backbone.origin, dtype=float)
        everywhere = _counts(solved.poses[scans], solved.landmarks, origin, limits)
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


@njit(cache=True, error_model="numpy")
def _counts(poses, landmarks, origin, limits):  # type: ignore[no-untyped-def]
    """For each of the nested limits (S, 3), the widest last, in how many of the poses (n, 3) each landmark is inside, (S, L).

    A limit is the least and the most range, and the cosine of the most bearing: a bearing is within it where x / r is at
    least that.
    """
    n = len(limits)
    counts = np.zeros((n, len(landmarks)), np.int64)
    ax, ay, farthest = origin[0], origin[1], limits[n - 1, 1] ** 2
    for t in range(len(poses)):
        c, s = np.cos(poses[t, 2]), np.sin(poses[t, 2])
        # the sensor in the world
        px, py = poses[t, 0] + c * ax - s * ay, poses[t, 1] + s * ax + c * ay
        for j in range(len(landmarks)):
            dx, dy = landmarks[j, 0] - px, landmarks[j, 1] - py
            square = dx * dx + dy * dy
            if square > farthest:
                continue
            x = c * dx + s * dy
            ahead = x * abs(x)
            for k in range(n - 1, -1, -1):
                low, high, cosine = limits[k, 0], limits[k, 1], limits[k, 2]
                if square < low * low or square > high * high or ahead < cosine * abs(cosine) * square:
                    break
                counts[k, j] += 1
    return counts
