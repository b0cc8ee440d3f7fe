"""Covariance ellipses of three standard deviations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from graphslam.se2 import Array

SIGMAS = 3.0
#: straight pieces that stand for an ellipse
CORNERS = 40
_ANGLES = np.linspace(0, 2 * np.pi, CORNERS + 1)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def ellipses(means: Mapping[int, Array], covariances: Mapping[int, Array]) -> Array:
    """The closed curves m + 3 V sqrt(D) (cos a, sin a)' with S = V D V', where the covariance S is known.

    Args:
        means: {id: (2,)} or longer; the first two numbers count.
        covariances: {id: (2, 2)} or larger; the upper left block counts.

    Returns:
        (L, CORNERS + 1, 2), in the order of ``covariances``.
    """
    m = np.array([means[j][:2] for j in covariances]).reshape(-1, 1, 2)
    variances, directions = np.linalg.eigh(np.array([S[:2, :2] for S in covariances.values()]).reshape(-1, 2, 2))
    half_axes = directions * (SIGMAS * np.sqrt(np.maximum(variances, 0)))[:, None, :]
    return np.asarray(m + np.swapaxes(half_axes @ _CIRCLE, 1, 2))
