"""The arithmetic that the compiled loops of all edge families share. Every function is inlined into its caller.

In world axes, the Jacobians of an edge between two nodes are B_i = -[I, u; 0, 1] and B_j = [I, v; 0, 1]; u and v are
called levers. `add_pair` adds B' Omega B to Omega and -B' Omega e to xi.

A symmetric 3 x 3 matrix W is a tuple of six numbers, (w00, w01, w11, w02, w12, w22); a vector is a tuple of three.
Residuals without a heading row have w02 = w12 = w22 = 0.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit


@njit(inline="always", error_model="numpy")
def wrap(angle):
    """The same angle in [-pi, pi), as `se2.wrap`, but not exact to the last digit for angles already there."""
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(inline="always", error_model="numpy")
def row(matrices, k):
    """The symmetric matrix in row k of an array (M, 6)."""
    return matrices[k, 0], matrices[k, 1], matrices[k, 2], matrices[k, 3], matrices[k, 4], matrices[k, 5]


@njit(inline="always", error_model="numpy")
def plus(V, W):
    """V + W."""
    return V[0] + W[0], V[1] + W[1], V[2] + W[2], V[3] + W[3], V[4] + W[4], V[5] + W[5]


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
def inverse(W, oriented):
    """W^-1; without a heading row (not ``oriented``) the inverse of the leading 2 x 2 part, and zeros."""
    w00, w01, w11, w02, w12, w22 = W
    if oriented:
        m00, m01, m02 = w11 * w22 - w12 * w12, w02 * w12 - w01 * w22, w01 * w12 - w02 * w11
        f = 1 / (w00 * m00 + w01 * m01 + w02 * m02)
        rest = w00 * w22 - w02 * w02, m02, w01 * w02 - w00 * w12, w00 * w11 - w01 * w01
        return f * m00, f * m01, f * rest[0], f * rest[1], f * rest[2], f * rest[3]
    f = 1 / (w00 * w11 - w01 * w01)
    return f * w11, -f * w01, f * w00, 0.0, 0.0, 0.0


@njit(inline="always", error_model="numpy")
def add_corner(block, sign, W):
    """Add sign W to the part of a block that belongs to the positions, its leading 2 x 2."""
    block[0, 0] += sign * W[0]
    block[0, 1] += sign * W[1]
    block[1, 0] += sign * W[1]
    block[1, 1] += sign * W[2]


@njit(inline="always", error_model="numpy")
def add_block(block, W, lever):
    """Add B' Omega B to a diagonal block, with B = +-[I, lever; 0, 1]; returns the third column of Omega B."""
    a = product(W, (lever[0], lever[1], 1.0))
    add_corner(block, 1.0, W)
    block[0, 2] += a[0]
    block[1, 2] += a[1]
    block[2, 0] += a[0]
    block[2, 1] += a[1]
    block[2, 2] += lever[0] * a[0] + lever[1] * a[1] + a[2]
    return a


@njit(inline="always", error_model="numpy")
def add_gradient(row, sign, g, lever):
    """Add sign B' g to a row of xi, with B = [I, lever; 0, 1]."""
    row[0] += sign * g[0]
    row[1] += sign * g[1]
    row[2] += sign * (lever[0] * g[0] + lever[1] * g[1] + g[2])


@njit(inline="always", error_model="numpy")
def add_pair(values, xi, i, j, slots, W, g, u, v):
    """Add one edge between the nodes i and j to Omega and xi: B' Omega B and -B' Omega e.

    B_i = -[I, u; 0, 1] and B_j = [I, v; 0, 1]. All pair edges of the plane have this form in world axes.

    Args:
        values, xi: those of `BlockSystem`.
        i, j: the nodes.
        slots: those of their diagonal blocks and of the block that they share.
        W: Omega.
        g: Omega e.
        u, v: the levers, the derivatives of the residual's position with respect to the headings of the nodes.
    """
    add_gradient(xi[i], 1.0, g, u)
    add_gradient(xi[j], -1.0, g, v)
    a = add_block(values[slots[0]], W, u)
    b = add_block(values[slots[1]], W, v)
    corner = u[0] * b[0] + u[1] * b[1] + b[2]
    if i > j:
        # only the upper triangle is stored: the block in row j and column i is the transpose
        a, b = b, a
    block = values[slots[2]]
    add_corner(block, -1.0, W)
    block[0, 2] -= b[0]
    block[1, 2] -= b[1]
    block[2, 0] -= a[0]
    block[2, 1] -= a[1]
    block[2, 2] -= corner


@njit(inline="always", error_model="numpy")
def add_point(values, xi, i, j, slots, W, g, u):
    """As `add_pair` for two rows and a point at the second end: B_i = -[I, u] and B_j = [I, 0].

    `add_pair` gives the same numbers, but takes a fifth longer, since it also adds the zeros of the point's heading.
    """
    add_gradient(xi[i], 1.0, g, u)
    xi[j, 0] -= g[0]
    xi[j, 1] -= g[1]
    a = add_block(values[slots[0]], W, u)
    add_corner(values[slots[1]], 1.0, W)
    block = values[slots[2]]
    add_corner(block, -1.0, W)
    if i < j:
        block[2, 0] -= a[0]
        block[2, 1] -= a[1]
    else:
        block[0, 2] -= a[0]
        block[1, 2] -= a[1]
