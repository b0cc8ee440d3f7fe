"""Ellipses of three standard deviations as polygons, which a film can move about."""

from __future__ import annotations

import numpy as np

from graphslam.se2 import Array, rotation

from .frame import Frame

#: the corners of the polygon that stands for an ellipse
CORNERS = 40


def ellipses(means: Array, covariances: Array, sigmas: float = 3.0) -> Array:
    """The curves m + sigmas S^1/2 (cos a, sin a), for means (L, 2) and covariances (L, 2, 2): (L, CORNERS, 2)."""
    a = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    circle = np.stack([np.cos(a), np.sin(a)])
    variances, directions = np.linalg.eigh(covariances)
    root = directions * np.sqrt(np.maximum(variances, 0))[:, None, :]
    return means[:, None, :] + sigmas * np.swapaxes(root @ circle, 1, 2)


def map_of(frame: Frame, placement: Array) -> tuple[Array, Array]:
    """The means (L, 2) of a frame's landmarks and the ellipses (L', CORNERS, 2) of those with covariances, placed.

    Args:
        frame: in the estimator's axes.
        placement: the pose (3,) of those axes in the picture.
    """
    turn = rotation(placement[2])
    means = np.array([m[:2] for m in frame.landmarks.values()]).reshape(-1, 2) @ turn.T + placement[:2]
    known = [k for k, j in enumerate(frame.landmarks) if j in frame.landmark_covariances]
    covariances = np.array([S[:2, :2] for j in frame.landmarks if (S := frame.landmark_covariances.get(j)) is not None])
    covariances = turn @ covariances.reshape(-1, 2, 2) @ turn.T
    return means, ellipses(means[known], covariances)
