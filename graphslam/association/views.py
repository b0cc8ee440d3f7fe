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
        limits = np.array([[field.nearest / s, field.farthest * s, field.bearing * s] for s in (INSIDE, 1.0)])
        origin = np.asarray(backbone.origin, dtype=float)
        everywhere = _counts(solved.poses[scans], solved.landmarks, origin, limits)
        seen = _counts_of_pairs(
            solved.poses[log.steps[solved.rows]], solved.landmarks[solved.which], solved.which, origin, limits,
            len(solved.landmarks),
        )  # fmt: skip
        return cls(everywhere[0], seen[0], everywhere[1], seen[1])

    def misses(self, densities: Densities) -> Array:
        """The logarithm (L,) of the probability of the views without a sighting; half of it at the border of the field."""
        well = self.views - self.within
        border = np.maximum(self.whole - self.anywhere - well, 0)
        return well * densities.missed + border * np.log1p(-np.exp(densities.seen) / 2)


@njit(cache=True, error_model="numpy")
def _inside(pose, c, s, landmark, origin, limits):  # type: ignore[no-untyped-def]
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    x, y = c * dx + s * dy - origin[0], c * dy - s * dx - origin[1]
    square, n = x * x + y * y, len(limits)
    for k in range(n):
        low, high, bearing = limits[n - 1 - k]
        # the limits are nested, the widest last
        if square < low * low or square > high * high or abs(np.arctan2(y, x)) > bearing:
            return k
    return n


@njit(cache=True, error_model="numpy")
def _counts(poses, landmarks, origin, limits):  # type: ignore[no-untyped-def]
    """For each of the nested limits (S, 3) in how many of the poses (n, 3) each landmark (L, d) is inside, (S, L)."""
    n = len(limits)
    counts = np.zeros((n, len(landmarks)), np.int64)
    for t in range(len(poses)):
        c, s = np.cos(poses[t, 2]), np.sin(poses[t, 2])
        for j in range(len(landmarks)):
            for k in range(_inside(poses[t], c, s, landmarks[j], origin, limits)):
                counts[n - 1 - k, j] += 1
    return counts


@njit(cache=True, error_model="numpy")
def _counts_of_pairs(poses, landmarks, which, origin, limits, count):  # type: ignore[no-untyped-def]
    """The same for pairs of a pose (n, 3) and a landmark (n, d), added up by landmark ``which`` (n,)."""
    n = len(limits)
    counts = np.zeros((n, count), np.int64)
    for t in range(len(poses)):
        c, s = np.cos(poses[t, 2]), np.sin(poses[t, 2])
        for k in range(_inside(poses[t], c, s, landmarks[t], origin, limits)):
            counts[n - 1 - k, which[t]] += 1
    return counts
