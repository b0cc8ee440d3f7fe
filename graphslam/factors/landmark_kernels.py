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
        _by_pose(x[i], lever[p], c[p], s[p], -1.0, A)
        _by_pose(x[j], lever[q], c[p], s[p], 1.0, B)
        if turning:
            # the axes of e turn with the first pose
            A[0, 2] += e[1]
            A[1, 2] -= e[0]
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
def _by_pose(pose, lever, c, s, sign, jacobian):  # type: ignore[no-untyped-def]
    """Two rows of +-dy/d(pose) in axes of cosine c and sine s, by a perturbation in the pose's own axes."""
    ct, st = np.cos(pose[2]), np.sin(pose[2])
    jacobian[0, 0] = jacobian[1, 1] = sign * (c * ct + s * st)
    jacobian[0, 1] = sign * (s * ct - c * st)
    jacobian[1, 0] = -jacobian[0, 1]
    jacobian[0, 2], jacobian[1, 2] = sign * (c * lever[0] + s * lever[1]), sign * (-s * lever[0] + c * lever[1])


@njit(cache=True, error_model="numpy", inline="always")
def _residual(p, q, y, c, s, e):  # type: ignore[no-untyped-def]
    dx, dy = y[q, 0] - y[p, 0], y[q, 1] - y[p, 1]
    e[0], e[1] = c[p] * dx + s[p] * dy, -s[p] * dx + c[p] * dy
    if y.shape[1] == 3:
        angle = y[q, 2] - y[p, 2]
        e[2] = angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))
