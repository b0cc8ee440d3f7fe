"""One sighting of one landmark for all particles, compiled: weigh, initialise, update, correct the pose.

The Gaussians of a landmark are a column (5, N) or, with a heading, (9, N), in the order of `blocks`. ``slots[i]`` is the
place in ``source`` from which particle i inherits; the updated Gaussian is written to place i of ``target``. Where no
resampling happened since the last sighting, slots is 0, 1, 2, ... and both may be the same column.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .blocks import BLOCK, WITHOUT_HEADING, copy_in, copy_out, gather, get_nine, get_three, padded, put_nine
from .fast_math import OPTIONS, atan2, wrap_angle
from .kalman import LOG_2PI, initial_landmark, log_density, update_landmark, update_pose


@njit(**OPTIONS)
def weigh_known(lo: int, hi: int, poses: Array, landmark: Array, z: Array, q: Array, log_likelihood: Array) -> None:
    """Add log N(z; h(x, m), Q), Q = diag(q), of a landmark at a known place (n,) to log_likelihood (N,)."""
    third, constant = 1.0 if len(z) == 3 else 0.0, 0.5 * len(z) * LOG_2PI
    z0, z1, z2 = padded(z, 0.0)
    q0, q1, q2 = padded(q, 1.0)
    mx, my, mh = padded(landmark, 0.0)
    determinant = q0 * q1 * q2
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
            b[3, i] = log_density(e0 * e0 / q0 + e1 * e1 / q1 + third * e2 * e2 / q2, determinant, constant, r)
        for i in range(n):
            log_likelihood[start + i] += b[3, i]


@njit(**OPTIONS)
def initialize(lo: int, hi: int, poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    third, sighting, variances = 1.0 if len(z) == 3 else 0.0, padded(z, 0.0), padded(q, 1.0)
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            put_nine(b, 3, i, initial_landmark(get_three(b, 0, i), sighting, variances, third))
        for k in range(target.shape[0]):
            row = 3 + (k if third else WITHOUT_HEADING[k])
            for i in range(n):
                target[k, start + i] = b[row, i]


@njit(**OPTIONS)
def update_2d(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Add log N(z; h(m), V = H S H' + Q) to log_likelihood (N,), then update (m, S), of a landmark without heading.

    The equations are those of `kalman.update_landmark` without the third row: a third of the work.
    """
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
            possible = value > -np.inf
            b[8, i] = value
            b[9, i] = mx + ax * g0 + bx * g1 if possible else mx
            b[10, i] = my + ay * g0 + by * g1 if possible else my
            b[11, i] = sxx - ax * ax * i0 - bx * bx * i1 if possible else sxx
            b[12, i] = sxy - ax * ay * i0 - bx * by * i1 if possible else sxy
            b[13, i] = syy - ay * ay * i0 - by * by * i1 if possible else syy
        for i in range(n):
            log_likelihood[start + i] += b[8, i]
        copy_out(b, 9, target, start, n)


@njit(**OPTIONS)
def update_3d(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Add log N(z; h(m), V = H S H' + Q) to log_likelihood (N,), then update (m, S), of a landmark with a heading."""
    sighting, variances = padded(z, 0.0), padded(q, 1.0)
    b = np.empty((22, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        gather(b, 0, source, slots, start, n)
        copy_in(b, 9, poses, start, n)
        for i in range(n):
            b[12, i], moved = update_landmark(get_nine(b, 0, i), get_three(b, 9, i), sighting, variances, 1.0)
            put_nine(b, 13, i, moved)
        for i in range(n):
            log_likelihood[start + i] += b[12, i]
        copy_out(b, 13, target, start, n)


@njit(**OPTIONS)
def correct(
    lo: int, hi: int, belief: Array, slots: np.ndarray, source: Array, z: Array, q: Array, log_likelihood: Array
) -> None:
    """Correct the Gaussians of the poses (9, N) by one sighting of a known landmark, as FastSLAM 2.0 does.

    Adds log N(z; h(x, m), V = H_x P H_x' + H_m S H_m' + Q) to log_likelihood (N,), then updates the poses.
    """
    third, sighting, variances = 1.0 if len(z) == 3 else 0.0, padded(z, 0.0), padded(q, 1.0)
    b = np.zeros((28, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        for k in range(source.shape[0]):
            row = k if third else WITHOUT_HEADING[k]
            for i in range(n):
                b[row, i] = source[k, slots[start + i]]
        copy_in(b, 9, belief, start, n)
        for i in range(n):
            b[18, i], moved = update_pose(get_nine(b, 9, i), get_nine(b, 0, i), sighting, variances, third)
            put_nine(b, 19, i, moved)
        for i in range(n):
            log_likelihood[start + i] += b[18, i]
        copy_out(b, 19, belief, start, n)
