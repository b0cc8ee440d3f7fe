"""One sighting of one landmark for all particles, compiled: weigh, start, update.

A landmark's Gaussians are a column (5, N) of numbers m_x, m_y, S_xx, S_xy, S_yy or, with a heading h, (9, N) of
m_x, m_y, m_h, S_xx, S_xy, S_xh, S_yy, S_yh, S_hh. ``slots[i]`` is the place in ``source`` that particle i inherited;
the moved Gaussian goes to place i of ``target``. Where nobody resampled since the landmark was last seen, slots counts
up and both may be the same column. For blocks and the order of the axes see `motion_kernels`.

The equations with a heading are in `fusion`; those without are here once more, because a third of their work is enough.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .branchless import INLINED, OPTIONS, atan2, sincos, wrap_angle
from .fusion import LOG_2PI, fold_into_landmark, log_density
from .motion_kernels import BLOCK


@njit(**INLINED)
def gather(block: Array, first: int, source: Array, slots: np.ndarray, start: int, n: int) -> None:
    """Bring the rows of source at the slots of particles start to start + n into rows first, first + 1, ..."""
    for k in range(source.shape[0]):
        for i in range(n):
            block[first + k, i] = source[k, slots[start + i]]


@njit(**INLINED)
def copy_in(block: Array, first: int, source: Array, start: int, n: int) -> None:
    """The same without slots."""
    for k in range(source.shape[0]):
        for i in range(n):
            block[first + k, i] = source[k, start + i]


@njit(**INLINED)
def copy_out(block: Array, first: int, target: Array, start: int, n: int) -> None:
    """Write rows first, first + 1, ... of a block to particles start to start + n of target."""
    for k in range(target.shape[0]):
        for i in range(n):
            target[k, start + i] = block[first + k, i]


@njit(**OPTIONS)
def weigh_known(
    lo: int, hi: int, poses: Array, landmark: Array, z: Array, q: Array, log_likelihood: Array
) -> None:  # fmt: skip
    """Add log N(z; h(x, m), Q), Q = diag(q), of a landmark at a known place (n,) to log_likelihood (N,)."""
    oriented = len(z) == 3
    z0, z1, z2 = z[0], z[1], z[2] if oriented else 0.0
    q0, q1, q2 = q[0], q[1], q[2] if oriented else 1.0
    mx, my, mh = landmark[0], landmark[1], landmark[2] if oriented else 0.0
    weight, constant, determinant = 1.0 if oriented else 0.0, 0.5 * len(z) * LOG_2PI, q0 * q1 * q2
    b = np.empty((4, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            dx, dy = mx - b[0, i], my - b[1, i]
            direction = atan2(dy, dx)
            r = sqrt(dx * dx + dy * dy)
            e0 = z0 - r
            e1 = wrap_angle(z1 - direction + b[2, i])
            e2 = wrap_angle(z2 - direction + mh)
            b[3, i] = log_density(e0 * e0 / q0 + e1 * e1 / q1 + weight * e2 * e2 / q2, determinant, constant, r)
        for i in range(n):
            log_likelihood[start + i] += b[3, i]


@njit(**OPTIONS)
def initialize_2d(lo: int, hi: int, poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting without psi: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    z0, z1, along, across = z[0], z[1], q[0], z[0] * z[0] * q[1]
    b = np.empty((8, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i] + z1)
            b[3, i] = b[0, i] + z0 * c
            b[4, i] = b[1, i] + z0 * s
            b[5, i] = c * c * along + s * s * across
            b[6, i] = c * s * (along - across)
            b[7, i] = s * s * along + c * c * across
        copy_out(b, 3, target, start, n)


@njit(**OPTIONS)
def initialize_3d(lo: int, hi: int, poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting with psi: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    z0, z1, z2, along, across = z[0], z[1], z[2], q[0], z[0] * z[0] * q[1]
    bearing, heading = z[0] * q[1], q[1] + q[2]
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i] + z1)
            b[3, i] = b[0, i] + z0 * c
            b[4, i] = b[1, i] + z0 * s
            b[5, i] = wrap_angle(b[2, i] + z1 - z2)
            b[6, i] = c * c * along + s * s * across
            b[7, i] = c * s * (along - across)
            b[8, i] = -s * bearing
            b[9, i] = s * s * along + c * c * across
            b[10, i] = c * bearing
            b[11, i] = heading
        copy_out(b, 3, target, start, n)


@njit(**OPTIONS)
def update_2d(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Weigh with N(z; h(m), V = H S H' + Q), then the Kalman update of (m, S), of a landmark without heading."""
    z0, z1, q0, q1 = z[0], z[1], q[0], q[1]
    b = np.empty((14, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        gather(b, 0, source, slots, start, n)
        copy_in(b, 5, poses, start, n)
        for i in range(n):
            mx, my, sxx, sxy, syy = b[0, i], b[1, i], b[2, i], b[3, i], b[4, i]
            dx, dy = mx - b[5, i], my - b[6, i]
            r = sqrt(dx * dx + dy * dy)
            inverse = 1.0 / r
            ux, uy = dx * inverse, dy * inverse
            e0 = z0 - r
            e1 = wrap_angle(z1 - atan2(dy, dx) + b[7, i])
            # the columns of S H', one per row of H = [[ux, uy], [-uy/r, ux/r]]
            ax, ay = sxx * ux + sxy * uy, sxy * ux + syy * uy
            bx, by = (sxy * ux - sxx * uy) * inverse, (syy * ux - sxy * uy) * inverse
            d0 = ux * ax + uy * ay + q0
            i0 = 1.0 / d0
            l10 = (ux * bx + uy * by) * i0
            bx, by = bx - l10 * ax, by - l10 * ay
            d1 = (ux * by - uy * bx) * inverse + q1
            i1 = 1.0 / d1
            y1 = e1 - l10 * e0
            g0, g1 = e0 * i0, y1 * i1
            value = log_density(e0 * g0 + y1 * g1, d0 * d1, LOG_2PI, r)
            seen = value > -np.inf
            b[8, i] = value
            b[9, i] = mx + ax * g0 + bx * g1 if seen else mx
            b[10, i] = my + ay * g0 + by * g1 if seen else my
            b[11, i] = sxx - ax * ax * i0 - bx * bx * i1 if seen else sxx
            b[12, i] = sxy - ax * ay * i0 - bx * by * i1 if seen else sxy
            b[13, i] = syy - ay * ay * i0 - by * by * i1 if seen else syy
        for i in range(n):
            log_likelihood[start + i] += b[8, i]
        copy_out(b, 9, target, start, n)


@njit(**OPTIONS)
def update_3d(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """The same of a landmark with a heading."""
    sighting, variances = (z[0], z[1], z[2]), (q[0], q[1], q[2])
    b = np.empty((22, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        gather(b, 0, source, slots, start, n)
        copy_in(b, 9, poses, start, n)
        for i in range(n):
            m = (b[0, i], b[1, i], b[2, i], b[3, i], b[4, i], b[5, i], b[6, i], b[7, i], b[8, i])
            value, moved = fold_into_landmark(m, (b[9, i], b[10, i], b[11, i]), sighting, variances, 1.0)
            b[12, i] = value
            b[13, i], b[14, i], b[15, i], b[16, i], b[17, i] = moved[0], moved[1], moved[2], moved[3], moved[4]
            b[18, i], b[19, i], b[20, i], b[21, i] = moved[5], moved[6], moved[7], moved[8]
        for i in range(n):
            log_likelihood[start + i] += b[12, i]
        copy_out(b, 13, target, start, n)
