"""The motion of all particles, compiled.

Here and in the other kernels arrays are turned so that each number of all particles is contiguous, poses (3, N), and
particles lo to hi are done in blocks: gathered into a small buffer, computed there, written out. Only then can the
compiler tell that nothing overlaps and do four to eight particles at once.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .branchless import OPTIONS, sincos, wrap_angle
from .noise import normal_pair

#: particles per block
BLOCK = 128
#: threads take ranges made of so many particles, so that no sum and no block depends on how many threads there are
CHUNK = 8 * BLOCK


@njit(**OPTIONS)
def move(
    lo: int, hi: int, poses: Array, key: np.uint64, nu: float, omega: float, nu_std: float, omega_std: float, dt: float,
    pose_std: float, moved: Array,
) -> None:  # fmt: skip
    """x_t = f(x_{t-1}, u + std n_01) + pose_std n_234, the heading wrapped; poses (3, N), n as in `noise`."""
    b = np.empty((6, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        for k in range(3):
            for i in range(n):
                b[k, i] = poses[k, start + i]
        for i in range(n):
            n0, n1 = normal_pair(key, start + i, 0)
            n2, n3 = normal_pair(key, start + i, 1)
            n4, _ = normal_pair(key, start + i, 2)
            a = (omega + omega_std * n1) * dt / 2
            sine, _ = sincos(a)
            chord = (nu + nu_std * n0) * dt * (sine / a if a != 0.0 else 1.0)
            s, c = sincos(b[2, i] + a)
            b[3, i] = b[0, i] + chord * c + pose_std * n2
            b[4, i] = b[1, i] + chord * s + pose_std * n3
            b[5, i] = wrap_angle(b[2, i] + 2 * a + pose_std * n4)
        for k in range(3):
            for i in range(n):
                moved[k, start + i] = b[3 + k, i]


@njit(**OPTIONS)
def leap(
    lo: int, hi: int, poses: Array, key: np.uint64, mean: tuple[float, ...], root: tuple[float, ...], moved: Array
) -> None:
    """x_t = x_{t-1} moved by N(mean, L L') in its own axes, L's lower triangle row by row; n_012 as in `noise`."""
    dx, dy, turn = mean
    l00, l10, l11, l20, l21, l22 = root
    b = np.empty((6, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        for k in range(3):
            for i in range(n):
                b[k, i] = poses[k, start + i]
        for i in range(n):
            n0, n1 = normal_pair(key, start + i, 0)
            n2, _ = normal_pair(key, start + i, 1)
            ahead, left = dx + l00 * n0, dy + l10 * n0 + l11 * n1
            s, c = sincos(b[2, i])
            b[3, i] = b[0, i] + c * ahead - s * left
            b[4, i] = b[1, i] + s * ahead + c * left
            b[5, i] = wrap_angle(b[2, i] + turn + l20 * n0 + l21 * n1 + l22 * n2)
        for k in range(3):
            for i in range(n):
                moved[k, start + i] = b[3 + k, i]


@njit(**OPTIONS)
def pick(lo: int, hi: int, poses: Array, ancestors: np.ndarray, survivors: Array) -> None:
    """The poses (3, N) of the ancestors."""
    for k in range(3):
        for i in range(lo, hi):
            survivors[k, i] = poses[k, ancestors[i]]
