"""The mean and covariance of a landmark from weighted points, compiled."""

from __future__ import annotations

from numba import njit

from .blocks import Nine
from .fast_math import INLINED, wrap_angle

#: sums over points of w, w x, w y, w h, w x², w x y, w y², w x h, w y h, w h², for a position (x, y) and a heading h
Sums = tuple[float, float, float, float, float, float, float, float, float, float]
NOTHING: Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit(**INLINED)
def add(sums: Sums, w: float, x: float, y: float, h: float) -> Sums:
    """Return the sums with one more point."""
    mass, x1, y1, h1, xx, xy, yy, xh, yh, hh = sums
    return (
        mass + w, x1 + w * x, y1 + w * y, h1 + w * h,
        xx + w * x * x, xy + w * x * y, yy + w * y * y, xh + w * x * h, yh + w * y * h, hh + w * h * h,
    )  # fmt: skip


@njit(**INLINED)
def gaussian(sums: Sums, x: float, y: float, h: float, rest: float) -> Nine:
    """Return the Gaussian of points relative to (x, y, h); each point has in its heading the variance ``rest`` beside."""
    mass, x1, y1, h1, xx, xy, yy, xh, yh, hh = sums
    x1, y1, h1 = x1 / mass, y1 / mass, h1 / mass
    return (
        x + x1, y + y1, wrap_angle(h + h1),
        xx / mass - x1 * x1, xy / mass - x1 * y1, xh / mass - x1 * h1,
        yy / mass - y1 * y1, yh / mass - y1 * h1, hh / mass - h1 * h1 + rest,
    )  # fmt: skip
