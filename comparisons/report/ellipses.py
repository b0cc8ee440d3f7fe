"""Ellipses of three standard deviations as polygons."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graphslam.se2 import Array

from .style import place

#: corners of a polygon that the eye takes for an ellipse
CORNERS = 24
SIGMAS = 3.0
_TURN = np.linspace(0, 2 * np.pi, CORNERS + 1)
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN)])


def outline(mean: Array, covariance: Array) -> Array:
    """The points m + 3 V sqrt(D) (cos, sin)' with S = V D V', closed, (CORNERS + 1, 2)."""
    variances, directions = np.linalg.eigh(covariance)
    half_axes = directions * (SIGMAS * np.sqrt(np.maximum(variances, 0)))
    return (mean[:, None] + half_axes @ _CIRCLE).T


def outlines(ellipses: Iterable[tuple[Array, Array]]) -> dict[str, list[float | None]]:
    """x and y of one trace that draws many ellipses (mean, covariance), with gaps between."""
    x: list[float | None] = []
    y: list[float | None] = []
    for mean, covariance in ellipses:
        points = outline(mean, covariance)
        x += [*map(place, points[:, 0]), None]
        y += [*map(place, points[:, 1]), None]
    return {"x": x, "y": y}
