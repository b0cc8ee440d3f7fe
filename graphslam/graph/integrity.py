"""Integrity: the probability that a pose in a map is off by more than a bound.

    risk = 1 - P(there) P(|N(0, s² Sigma)| within the bounds),    s² = max(1, squared residuals over their expectation).

The robot is not there where the first fix was wrong or it was lifted since: `graph.tracker` has the odds of that from every
sighting, after a drive smoothed by those that came later (the forward-backward recursion of a hidden Markov model with two
states). Where it is there, its error has the covariance Sigma of the estimate, made larger where residuals are larger than
the noise models say. An error is within the bounds if the position is within a circle and the heading within an interval.

Sources: Rabiner, *A tutorial on hidden Markov models*, Proceedings of the IEEE 1989; for the term, RTCA DO-229, *Minimum
operational performance standards for GPS/WAAS airborne equipment*.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import OptionError, quoted
from ..models import SensorModel
from ..se2 import Array
from .landmark_map import LandmarkMap
from .stretch import Stretch
from .tracker import LIFTED, NOTHING, Tracker, area_of

#: nodes of the quadrature over heading and position, and how many standard deviations it covers
_HEADING, _POSITION = np.polynomial.legendre.leggauss(24), np.polynomial.legendre.leggauss(24)
COVERED = 6.5
#: how many squares that are as expected count before the first one
PRIOR = 10


def beyond(covariances: Array, metres: float, radians: float = np.inf) -> Array:
    """The probability (...) that errors with covariances (..., 3, 3) are beyond the bounds.

    The heading is integrated by Gauss-Legendre quadrature; given it, the position is Gaussian, whose principal axes make
    the integral over the circle one of differences of error functions.

    Raises:
        OptionError: a bound is not positive.
    """
    from scipy.special import ndtr

    for name, bound in (("metres", metres), ("radians", radians)):
        if not bound > 0:
            raise OptionError(f"{name} must be a bound above 0, not {quoted(bound)}")
    P = np.asarray(covariances, dtype=float)
    variance = np.maximum(P[..., 2, 2], 1e-18)
    slope = P[..., :2, 2] / variance[..., None]
    values, axes = np.linalg.eigh(
        P[..., :2, :2] - slope[..., :, None] * slope[..., None, :] * variance[..., None, None]
    )
    small, large = np.moveaxis(np.sqrt(np.maximum(values, 1e-18)), -1, 0)
    slope = (np.swapaxes(axes, -1, -2) @ slope[..., None])[..., 0]
    std = np.sqrt(variance)
    half = np.minimum(radians, COVERED * std)
    theta = half[..., None] * _HEADING[0]
    weight = half[..., None] * _HEADING[1] * np.exp(-((theta / std[..., None]) ** 2) / 2) / np.sqrt(2 * np.pi)
    weight = weight / std[..., None]
    across, along = (slope[..., n, None, None] * theta[..., None] for n in (0, 1))
    small, large = small[..., None, None], large[..., None, None]
    low, high = np.maximum(-metres, along - COVERED * large), np.minimum(metres, along + COVERED * large)
    half = np.maximum(high - low, 0) / 2
    u = (low + high) / 2 + half * _POSITION[0]
    w = np.sqrt(np.maximum(metres**2 - u**2, 0)) if np.isfinite(metres) else np.inf
    inner = ndtr((w - across) / small) - ndtr((-w - across) / small)
    density = np.exp(-(((u - along) / large) ** 2) / 2) / (np.sqrt(2 * np.pi) * large)
    inside = (weight * (density * inner * half * _POSITION[1]).sum(axis=-1)).sum(axis=-1)
    return np.asarray(np.clip(1 - inside, 0.0, 1.0))


def inflation(squares: Sequence[float] | Array, rows: int = 2) -> float:
    """s² from the squared Mahalanobis distances of sightings with so many numbers each; their median, as some are wrong."""
    count = len(squares)
    if not count:
        return 1.0
    from scipy.special import chdtri

    return max(1.0, (PRIOR + count * float(np.median(squares)) / float(chdtri(rows, 0.5))) / (PRIOR + count))


def unlocated(landmarks: LandmarkMap, sensor: SensorModel, pose: Array) -> Tracker:
    """A tracker of a robot that may be anywhere in the map, linearised at a pose."""
    area = area_of(np.array([place[:2] for place in landmarks.values()]))
    return Tracker(landmarks, sensor, pose, np.diag([area, area, np.pi**2 / 3]))


def presence(drive: Stretch, poses: Array, landmarks: LandmarkMap) -> Array:
    """The probability (T+1,) that a robot was where its poses (T+1, 3) are, from all sightings of a drive.

    Where it was lifted, the motion says nothing. That may have been at any moment since the last sighting before.
    """
    from scipy.special import expit

    tracker, rows_at = unlocated(landmarks, drive.sensor, poses[0]), drive.rows_at
    before, gains, still, last = np.zeros(len(poses)), np.zeros(len(poses)), np.ones(len(poses)), 0
    for step, pose in enumerate(poses):
        if step:
            noise = drive.noise[step - 1]
            tracker.move(drive.motions[step - 1], noise)
            if noise[0, 0] + noise[1, 1] > NOTHING:
                still[last + 1 : step] = np.arange(step - last - 1, 0, -1) / (step - last)
        tracker.pose, rows = np.array(pose), rows_at[step]
        before[step] = tracker.log_odds
        if len(rows):
            gains[step], last = tracker.see(step, rows, drive.landmarks[rows], drive.sightings[rows]).gain, step
    after = np.zeros(len(poses))
    for step in range(len(poses) - 1, 0, -1):
        later = after[step] + gains[step]
        stay, change = np.log1p(-LIFTED), np.log(LIFTED)
        after[step - 1] = np.logaddexp(stay + later, change) - np.logaddexp(change + later, stay)
    return np.asarray(still * expit(before + gains + after))
