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

from .blocks import BLOCK, copy_in, copy_out, gather, get_nine, get_three, padded, put_nine
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
    sighting, variances = padded(z, 0.0), padded(q, 1.0)
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            put_nine(b, 3, i, initial_landmark(get_three(b, 0, i), sighting, variances))
        copy_out(b, 3, target, start, n)


@njit(**OPTIONS)
def update(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Add log N(z; h(m), V = H S H' + Q) to log_likelihood (N,), then do the Kalman update of (m, S)."""
    sighting, variances = padded(z, 0.0), padded(q, 1.0)
    b = np.empty((22, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        gather(b, 0, source, slots, start, n)
        copy_in(b, 9, poses, start, n)
        # one loop each, so that the compiler leaves the third row out of the first: a third of the work
        if len(z) == 2:
            for i in range(n):
                landmark = (b[0, i], b[1, i], 0.0, b[3, i], b[4, i], 0.0, b[6, i], 0.0, 0.0)
                b[12, i], moved = update_landmark(landmark, get_three(b, 9, i), sighting, variances, 0.0)
                b[13, i], b[14, i], b[16, i], b[17, i], b[19, i] = moved[0], moved[1], moved[3], moved[4], moved[6]
        else:
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
        gather(b, 0, source, slots, start, n)
        copy_in(b, 9, belief, start, n)
        for i in range(n):
            b[18, i], moved = update_pose(get_nine(b, 9, i), get_nine(b, 0, i), sighting, variances, third)
            put_nine(b, 19, i, moved)
        for i in range(n):
            log_likelihood[start + i] += b[18, i]
        copy_out(b, 19, belief, start, n)
