"""Gaussians of landmarks and of single poses, compiled: fuse, move to other axes, draw.

A landmark is nine numbers as in `fastslam.blocks`: its mean (x, y, heading) and the upper triangle of its covariance. A
negative S_xx marks a landmark that has not been seen: its prior is flat. Sightings are relative places

    q = (R(theta)' (m - p), m_h - theta),    y | x, m ~ N(q, C),

with C constant in the axes of the robot. Seen from a known pose, a sighting is y in world axes with a turned C: an
observation of the landmark itself. So fusing sightings and integrating landmarks out is exact linear algebra, and the
order of the sightings does not matter. Without psi the heading is a number of variance 1 that nothing depends on.
"""

from __future__ import annotations

from math import cos, log, sin, sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from ..blocks import Three
from ..fast_math import OPTIONS, wrap_angle

Six = tuple[float, float, float, float, float, float]

#: S_xx of a landmark that has not been seen
UNSEEN = -1.0


@njit(**OPTIONS)
def composed(pose: Three, d: Three) -> Three:
    """Return the pose that lies at d in the axes of a pose."""
    c, s = cos(pose[2]), sin(pose[2])
    return pose[0] + c * d[0] - s * d[1], pose[1] + s * d[0] + c * d[1], wrap_angle(pose[2] + d[2])


@njit(**OPTIONS)
def relative(pose: Three, other: Three) -> Three:
    """Return where another pose or a landmark lies in the axes of a pose, the heading wrapped."""
    c, s = cos(pose[2]), sin(pose[2])
    dx, dy = other[0] - pose[0], other[1] - pose[1]
    return c * dx + s * dy, c * dy - s * dx, wrap_angle(other[2] - pose[2])


@njit(**OPTIONS)
def turned(C: Six, angle: float) -> Six:
    """Return a covariance in axes turned by -angle: G C G', G = blkdiag(R(angle), 1)."""
    c, s = cos(angle), sin(angle)
    xx, xy, xh, yy, yh, hh = C
    return (
        c * c * xx - 2 * c * s * xy + s * s * yy,
        c * s * (xx - yy) + (c * c - s * s) * xy,
        c * xh - s * yh,
        s * s * xx + 2 * c * s * xy + c * c * yy,
        s * xh + c * yh,
        hh,
    )


@njit(**OPTIONS)
def turn(row: Array, angle: float) -> Three:
    """Return G v, G = blkdiag(R(angle), 1)."""
    c, s = cos(angle), sin(angle)
    return c * row[0] - s * row[1], s * row[0] + c * row[1], row[2]


@njit(**OPTIONS)
def inverse6(V: Six) -> tuple[Six, float]:
    """Return the inverse of a symmetric matrix and its determinant."""
    xx, xy, xh, yy, yh, hh = V
    a, b, c = yy * hh - yh * yh, xh * yh - xy * hh, xy * yh - xh * yy
    determinant = xx * a + xy * b + xh * c
    i = 1.0 / determinant
    return (a * i, b * i, c * i, (xx * hh - xh * xh) * i, (xy * xh - xx * yh) * i, (xx * yy - xy * xy) * i), determinant


@njit(**OPTIONS)
def times(S: Six, v: Three) -> Three:
    """Return a symmetric matrix times a vector."""
    return (
        S[0] * v[0] + S[1] * v[1] + S[2] * v[2],
        S[1] * v[0] + S[3] * v[1] + S[4] * v[2],
        S[2] * v[0] + S[4] * v[1] + S[5] * v[2],
    )


@njit(**OPTIONS)
def added(S: Six, C: Six) -> Six:
    """Return the sum of two symmetric matrices."""
    return S[0] + C[0], S[1] + C[1], S[2] + C[2], S[3] + C[3], S[4] + C[4], S[5] + C[5]


@njit(**OPTIONS)
def three(row: Array) -> Three:
    """Return the first three numbers of a row."""
    return row[0], row[1], row[2]


@njit(**OPTIONS)
def six(row: Array, first: int) -> Six:
    """Return six numbers of a row."""
    return row[first], row[first + 1], row[first + 2], row[first + 3], row[first + 4], row[first + 5]


@njit(**OPTIONS)
def put(row: Array, mean: Three, S: Six) -> None:
    """Write a Gaussian."""
    row[0], row[1], row[2] = mean
    row[3], row[4], row[5], row[6], row[7], row[8] = S


@njit(**OPTIONS)
def density(mean: Three, S: Six, y: Three, C: Six, third: float) -> float:
    """Return log N(y; mean, S + C) without the constant of 2 pi."""
    W, determinant = inverse6(added(S, C))
    r = y[0] - mean[0], y[1] - mean[1], third * wrap_angle(y[2] - mean[2])
    g = times(W, r)
    return -0.5 * (r[0] * g[0] + r[1] * g[1] + r[2] * g[2] + log(determinant))


@njit(**OPTIONS)
def fuse(row: Array, y: Three, C: Six, third: float) -> float:
    """Let a landmark absorb the observation y ~ N(m, C); return log N(y; mean, S + C), 0 for the first one."""
    if row[3] < 0:
        put(row, y, C)
        return 0.0
    S = six(row, 3)
    W, determinant = inverse6(added(S, C))
    r = y[0] - row[0], y[1] - row[1], third * wrap_angle(y[2] - row[2])
    g = times(W, r)
    d = times(S, g)
    # S (S + C)^-1 C, in which nothing cancels; row by row of the first product
    a = times(W, (S[0], S[1], S[2]))
    b = times(W, (S[1], S[3], S[4]))
    c = times(W, (S[2], S[4], S[5]))
    put(
        row,
        (row[0] + d[0], row[1] + d[1], wrap_angle(row[2] + d[2])),
        (
            a[0] * C[0] + a[1] * C[1] + a[2] * C[2],
            a[0] * C[1] + a[1] * C[3] + a[2] * C[4],
            a[0] * C[2] + a[1] * C[4] + a[2] * C[5],
            b[0] * C[1] + b[1] * C[3] + b[2] * C[4],
            b[0] * C[2] + b[1] * C[4] + b[2] * C[5],
            c[0] * C[2] + c[1] * C[4] + c[2] * C[5],
        ),
    )
    return -0.5 * (r[0] * g[0] + r[1] * g[1] + r[2] * g[2] + log(determinant))


@njit(**OPTIONS)
def absorb(row: Array, pose: Three, y: Three, C: Six, third: float) -> float:
    """Let a landmark absorb a sighting from a known pose, as `fuse`."""
    return fuse(row, composed(pose, y), turned(C, pose[2]), third)


@njit(**OPTIONS)
def drawn(rng: np.random.Generator, mean: Three, S: Six) -> Three:
    """Draw from a Gaussian."""
    a = sqrt(S[0])
    b, c = S[1] / a, S[2] / a
    d = sqrt(S[3] - b * b)
    e = (S[4] - b * c) / d
    f = sqrt(S[5] - c * c - e * e)
    n0, n1, n2 = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
    return mean[0] + a * n0, mean[1] + b * n0 + d * n1, wrap_angle(mean[2] + c * n0 + e * n1 + f * n2)


@njit(**OPTIONS)
def inform(L: Array, eta: Array, pose: Three, mean: Three, S: Six, y: Three, C: Six, third: float) -> None:
    """Add to the information (L, eta) on a small displacement of a pose, in its own axes, that of a sighting.

    The displacement d moves the relative place q to q - A d, A = [[1, 0, -q_y], [0, 1, q_x], [0, 0, 1]]. With V = S + C
    (S turned into the axes of the pose) this adds A' V^-1 A and A' V^-1 (q - y).
    """
    q = relative(pose, mean)
    W, _ = inverse6(added(turned(S, -pose[2]), C))
    r = q[0] - y[0], q[1] - y[1], wrap_angle(q[2] - y[2])
    if third == 0.0:
        W, r = (W[0], W[1], 0.0, W[3], 0.0, 0.0), (r[0], r[1], 0.0)
    lever_in(L, eta, W, times(W, r), q)


@njit(**OPTIONS)
def lever_in(L: Array, eta: Array, W: Six, g: Three, q: Three) -> None:
    """Add A' W A to L and A' g to eta, A as in `inform`."""
    lever = -q[1], q[0], 1.0
    w = times(W, lever)
    eta[0] += g[0]
    eta[1] += g[1]
    eta[2] += g[0] * lever[0] + g[1] * lever[1] + g[2]
    L[0, 0] += W[0]
    L[0, 1] += W[1]
    L[1, 0] += W[1]
    L[1, 1] += W[3]
    L[0, 2] += w[0]
    L[2, 0] += w[0]
    L[1, 2] += w[1]
    L[2, 1] += w[1]
    L[2, 2] += w[0] * lever[0] + w[1] * lever[1] + w[2]


@njit(**OPTIONS)
def upper(M: Array) -> Six:
    """Return the upper triangle of a symmetric matrix (3, 3)."""
    return M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]


@njit(**OPTIONS)
def passed(W: Six, M: Six) -> Six:
    """Return W - W (W + M)^-1 W = (W^-1 + M^-1)^-1: the information M after noise of the information W."""
    P, _ = inverse6(added(W, M))
    a, b, c = times(P, (W[0], W[1], W[2])), times(P, (W[1], W[3], W[4])), times(P, (W[2], W[4], W[5]))
    d, e, f = times(W, a), times(W, b), times(W, c)
    return W[0] - d[0], W[1] - d[1], W[2] - d[2], W[3] - e[1], W[4] - e[2], W[5] - f[2]


@njit(**OPTIONS)
def lower_root(S: Six) -> Six:
    """Return the lower triangle of L, L L' = S, row by row."""
    a = sqrt(S[0])
    b, c = S[1] / a, S[2] / a
    d = sqrt(S[3] - b * b)
    e = (S[4] - b * c) / d
    return a, b, d, c, e, sqrt(S[5] - c * c - e * e)


@njit(**OPTIONS)
def whitened(root: Six, d: Three) -> Three:
    """Return L^-1 d."""
    a = d[0] / root[0]
    b = (d[1] - root[1] * a) / root[2]
    return a, b, (d[2] - root[3] * a - root[4] * b) / root[5]


@njit(**OPTIONS)
def coloured(root: Six, n: Three) -> Three:
    """Return L n."""
    return root[0] * n[0], root[1] * n[0] + root[2] * n[1], root[3] * n[0] + root[4] * n[1] + root[5] * n[2]


@njit(**OPTIONS)
def squared(W: Six, r: Three) -> float:
    """Return r' W r."""
    g = times(W, r)
    return r[0] * g[0] + r[1] * g[1] + r[2] * g[2]


@njit(**OPTIONS)
def off(motion: Three, d: Three) -> Three:
    """Return the deviation d - motion, the heading wrapped."""
    return d[0] - motion[0], d[1] - motion[1], wrap_angle(d[2] - motion[2])


@njit(**OPTIONS)
def choose(rng: np.random.Generator, log_weights: Array) -> int:
    """Draw an index in proportion to the exponentials of log weights."""
    return pick(rng, np.exp(log_weights - log_weights.max()))


@njit(**OPTIONS)
def pick(rng: np.random.Generator, weights: Array) -> int:
    """Draw an index in proportion to weights."""
    level, total = rng.random() * weights.sum(), 0.0
    for i in range(len(weights)):
        total += weights[i]
        if level < total:
            return i
    return len(weights) - 1
