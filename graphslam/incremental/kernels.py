"""The arithmetic of single edges in the compiled loops of the online solver. Every function is inlined into its caller.

A symmetric 3 x 3 matrix W is a tuple of six numbers, (w00, w01, w11, w02, w12, w22); a vector is a tuple of three.
Residuals without a heading row have w02 = w12 = w22 = 0.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from ..edges.robust import CAUCHY, GEMAN_MCCLURE, HUBER


@njit(inline="always", error_model="numpy")
def wrap(angle):
    """The same angle in [-pi, pi), as `se2.wrap`, but not exact to the last digit for angles already there."""
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(inline="always", error_model="numpy")
def row(matrices, k):
    """The symmetric matrix in row k of an array (M, 6)."""
    return matrices[k, 0], matrices[k, 1], matrices[k, 2], matrices[k, 3], matrices[k, 4], matrices[k, 5]


@njit(inline="always", error_model="numpy")
def product(W, e):
    """W e."""
    w00, w01, w11, w02, w12, w22 = W
    x, y, t = e
    return w00 * x + w01 * y + w02 * t, w01 * x + w11 * y + w12 * t, w02 * x + w12 * y + w22 * t


@njit(inline="always", error_model="numpy")
def dot(a, b):
    """a' b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(inline="always", error_model="numpy")
def scaled(f, W):
    """f W."""
    return f * W[0], f * W[1], f * W[2], f * W[3], f * W[4], f * W[5]


@njit(inline="always", error_model="numpy")
def turned(c, s, W):
    """T W T' with T = blkdiag(R, 1), R the rotation by the angle with cosine c and sine s."""
    w00, w01, w11, w02, w12, w22 = W
    return (
        c * c * w00 - 2 * c * s * w01 + s * s * w11,
        c * s * (w00 - w11) + (c * c - s * s) * w01,
        s * s * w00 + 2 * c * s * w01 + c * c * w11,
        c * w02 - s * w12,
        s * w02 + c * w12,
        w22,
    )


@njit(inline="always", error_model="numpy")
def loss(code, c, squares):
    """2 rho(r) of one edge, from r²; see `edges.robust`."""
    if code == HUBER and squares > c * c:
        return 2 * c * np.sqrt(squares) - c * c
    if code == CAUCHY:
        return c * c * np.log1p(squares / (c * c))
    if code == GEMAN_MCCLURE:
        return c * c * squares / (c * c + squares)
    return squares


@njit(inline="always", error_model="numpy")
def weight(code, c, squares):
    """w(r) of one edge, from r²."""
    if code == HUBER and squares > c * c:
        return c / np.sqrt(squares)
    if code == CAUCHY:
        return c * c / (c * c + squares)
    if code == GEMAN_MCCLURE:
        return (c * c / (c * c + squares)) ** 2
    return 1.0
