"""The sums over all pairs of a landmark's sightings that `LandmarkFactor` needs at every evaluation."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def placed(x, node, z, offset, ahead, turning):  # type: ignore[no-untyped-def]
    """y = h^-1(x, z) (K, d), its heading not wrapped; what turning the pose does to it (K, 2); cos and sin of its axes.

    The axes of a pair stand at theta + ahead of its first sighting, or are the world's.
    """
    y, lever = np.empty(z.shape), np.empty((len(z), 2))
    c, s = np.ones(len(z)), np.zeros(len(z))
    for k in range(len(z)):
        pose, direction = x[node[k]], x[node[k], 2] + z[k, 1]
        ct, st = np.cos(pose[2]), np.sin(pose[2])
        vx = z[k, 0] * np.cos(direction) + ct * offset[0] - st * offset[1]
        vy = z[k, 0] * np.sin(direction) + st * offset[0] + ct * offset[1]
        y[k, 0], y[k, 1] = pose[0] + vx, pose[1] + vy
        lever[k, 0], lever[k, 1] = -vy, vx
        if z.shape[1] == 3:
            y[k, 2] = direction - z[k, 2]
        if turning:
            c[k], s[k] = np.cos(pose[2] + ahead[k]), np.sin(pose[2] + ahead[k])
    return y, lever, c, s


@njit(cache=True, error_model="numpy")
def pair_cost(a, b, y, c, s, information):  # type: ignore[no-untyped-def]
    """b'b: the sum of e' Omega e over pairs (a, b), e = y_b - y_a in axes turned by the angle of cosine c, sine s."""
    total = 0.0
    e = np.zeros(3)
    for k in range(len(a)):
        _residual(a[k], b[k], y, c, s, e)
        W = information[k]
        for i in range(3):
            total += W[i, i] * e[i] * e[i]
            for j in range(i):
                total += 2 * W[i, j] * e[i] * e[j]
    return total


@njit(cache=True, error_model="numpy")
def pair_sums(a, b, node, x, y, lever, c, s, information, turning):  # type: ignore[no-untyped-def]
    """A'A (3P, 3P) and A'b (3P,) by perturbations of the P poses in their own axes, and b'b."""
    size = 3 * len(x)
    omega, slope, total = np.zeros((size, size)), np.zeros(size), 0.0
    e, g = np.zeros(3), np.zeros(3)
    # de/d(pose) by its own axes: columns along, across and turning; WA and WB are Omega times them
    A, B, WA, WB = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    A[2, 2], B[2, 2] = -1.0, 1.0
    for k in range(len(a)):
        p, q = a[k], b[k]
        i, j = node[p], node[q]
        _residual(p, q, y, c, s, e)
        # what turning the first pose does: it moves y_a by the lever, and turns the axes of e
        cp, sp = c[p], s[p]
        A[0, 2] = -(cp * lever[p, 0] + sp * lever[p, 1])
        A[1, 2] = -(-sp * lever[p, 0] + cp * lever[p, 1])
        if turning:
            A[0, 2] += e[1]
            A[1, 2] -= e[0]
        B[0, 2], B[1, 2] = cp * lever[q, 0] + sp * lever[q, 1], -sp * lever[q, 0] + cp * lever[q, 1]
        # the pose's own axes, seen from those of e
        ci, si = np.cos(x[i, 2]), np.sin(x[i, 2])
        A[0, 0], A[0, 1], A[1, 0], A[1, 1] = (
            -(cp * ci + sp * si),
            cp * si - sp * ci,
            sp * ci - cp * si,
            -(sp * si + cp * ci),
        )
        cj, sj = np.cos(x[j, 2]), np.sin(x[j, 2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = cp * cj + sp * sj, sp * cj - cp * sj, cp * sj - sp * cj, sp * sj + cp * cj
        W = information[k]
        for r in range(3):
            g[r] = W[r, 0] * e[0] + W[r, 1] * e[1] + W[r, 2] * e[2]
            total += g[r] * e[r]
            for v in range(3):
                WA[r, v] = W[r, 0] * A[0, v] + W[r, 1] * A[1, v] + W[r, 2] * A[2, v]
                WB[r, v] = W[r, 0] * B[0, v] + W[r, 1] * B[1, v] + W[r, 2] * B[2, v]
        for u in range(3):
            slope[3 * i + u] += A[0, u] * g[0] + A[1, u] * g[1] + A[2, u] * g[2]
            slope[3 * j + u] += B[0, u] * g[0] + B[1, u] * g[1] + B[2, u] * g[2]
            for v in range(3):
                omega[3 * i + u, 3 * i + v] += A[0, u] * WA[0, v] + A[1, u] * WA[1, v] + A[2, u] * WA[2, v]
                omega[3 * j + u, 3 * j + v] += B[0, u] * WB[0, v] + B[1, u] * WB[1, v] + B[2, u] * WB[2, v]
                ab = A[0, u] * WB[0, v] + A[1, u] * WB[1, v] + A[2, u] * WB[2, v]
                omega[3 * i + u, 3 * j + v] += ab
                omega[3 * j + v, 3 * i + u] += ab
    return omega, slope, total


@njit(cache=True, error_model="numpy", inline="always")
def _residual(p, q, y, c, s, e):  # type: ignore[no-untyped-def]
    dx, dy = y[q, 0] - y[p, 0], y[q, 1] - y[p, 1]
    e[0], e[1] = c[p] * dx + s[p] * dy, -s[p] * dx + c[p] * dy
    if y.shape[1] == 3:
        angle = y[q, 2] - y[p, 2]
        e[2] = angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(cache=True, error_model="numpy")
def compressed(omega, slope, squares):  # type: ignore[no-untyped-def]
    """(d, rest) and R (n+1, n) with R'R = omega = A'A, R'(d, rest) = slope = A'b and d'd + rest² = squares = b'b.

    A Cholesky factorisation with diagonal pivoting: omega is singular, since nothing holds the whole piece. Directions
    with less than 1e-13 of the largest pivot are rounding errors. ``omega`` is overwritten.
    """
    n = len(omega)
    by_column = np.zeros((n, n + 1))  # R', so that R has columns without gaps
    e = np.zeros(n + 1)
    least = 0.0
    for i in range(n):
        least = max(least, 1e-13 * omega[i, i])
    left = squares
    free = np.ones(n, dtype=np.bool_)
    for row in range(n):
        best = -1
        for i in range(n):
            if free[i] and (best < 0 or omega[i, i] > omega[best, best]):
                best = i
        if omega[best, best] <= least:
            break
        pivot = np.sqrt(omega[best, best])
        free[best] = False
        by_column[best, row] = pivot
        e[row] = slope[best] / pivot
        left -= e[row] * e[row]
        for i in range(n):
            if free[i]:
                by_column[i, row] = omega[best, i] / pivot
                slope[i] -= by_column[i, row] * e[row]
        for i in range(n):
            if free[i]:
                f = by_column[i, row]
                for j in range(n):
                    omega[i, j] -= f * by_column[j, row]
    e[n] = np.sqrt(max(left, 0.0))
    return e, by_column.T
