"""The proposal of FastSLAM 2.0 for all particles, compiled: predict, correct by each sighting, draw.

A belief of the pose is nine rows (9, N): x, y, theta and the upper triangle of its covariance P_xx, P_xy, P_xt, P_yy,
P_yt, P_tt. Blocks, slots and columns of landmarks are those of `landmark_kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .branchless import OPTIONS, sincos, wrap_angle
from .fusion import draw_pose, fold_into_pose
from .landmark_kernels import copy_in, copy_out, gather
from .motion_kernels import BLOCK
from .noise import normal_pair


@njit(**OPTIONS)
def predict(
    lo: int, hi: int, poses: Array, nu: float, omega: float, nu_var: float, omega_var: float, dt: float,
    epsilon: float, belief: Array,
) -> None:  # fmt: skip
    """The motion as a Gaussian: mean f(x_{t-1}, u_t), covariance A M A' + epsilon I."""
    a = omega * dt / 2
    sine, cosine = sincos(a)
    if a * a < 0.09:
        # d/da (sin(a) / a), exact to rounding where the difference below would cancel
        q = a * a
        slope = -1 / 3 + q * (1 / 30 + q * (-1 / 840 + q * (1 / 45360 + q * (-1 / 3991680 + q / 518918400))))
        slope *= a
    else:
        slope = (cosine - sine / a) / a
    sinc = sine / a if a != 0.0 else 1.0
    # A = df/du in the frame that looks along the chord: nu moves along it, omega along, across and round
    by_nu, chord = dt * sinc, nu * dt * sinc
    along, across = nu * dt * dt / 2 * slope, nu * dt * dt / 2 * sinc
    p_aa = by_nu * by_nu * nu_var + along * along * omega_var
    p_ac, p_cc = along * across * omega_var, across * across * omega_var
    p_at, p_ct, p_tt = along * dt * omega_var, across * dt * omega_var, dt * dt * omega_var
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i] + a)
            b[3, i] = b[0, i] + chord * c
            b[4, i] = b[1, i] + chord * s
            b[5, i] = wrap_angle(b[2, i] + 2 * a)
            b[6, i] = c * c * p_aa - 2 * c * s * p_ac + s * s * p_cc + epsilon
            b[7, i] = c * s * (p_aa - p_cc) + (c * c - s * s) * p_ac
            b[8, i] = c * p_at - s * p_ct
            b[9, i] = s * s * p_aa + 2 * c * s * p_ac + c * c * p_cc + epsilon
            b[10, i] = s * p_at + c * p_ct
            b[11, i] = p_tt + epsilon
        copy_out(b, 3, belief, start, n)


@njit(**OPTIONS)
def predict_leap(
    lo: int, hi: int, poses: Array, mean: tuple[float, ...], covariance: tuple[float, ...], belief: Array
) -> None:
    """The motion of `motion_kernels.leap` as a Gaussian; covariance: upper triangle, in the axes of x_{t-1}."""
    dx, dy, turn = mean
    p_aa, p_ac, p_at, p_cc, p_ct, p_tt = covariance
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i])
            b[3, i] = b[0, i] + c * dx - s * dy
            b[4, i] = b[1, i] + s * dx + c * dy
            b[5, i] = wrap_angle(b[2, i] + turn)
            b[6, i] = c * c * p_aa - 2 * c * s * p_ac + s * s * p_cc
            b[7, i] = c * s * (p_aa - p_cc) + (c * c - s * s) * p_ac
            b[8, i] = c * p_at - s * p_ct
            b[9, i] = s * s * p_aa + 2 * c * s * p_ac + c * c * p_cc
            b[10, i] = s * p_at + c * p_ct
            b[11, i] = p_tt
        copy_out(b, 3, belief, start, n)


@njit(**OPTIONS)
def correct(
    lo: int, hi: int, belief: Array, slots: np.ndarray, source: Array, z: Array, q: Array, log_likelihood: Array
) -> None:
    """Weigh with N(z; h(x, m), V = H_x P H_x' + H_m S H_m' + Q), then the Kalman update of the pose's belief."""
    oriented = source.shape[0] == 9
    third = 1.0 if oriented else 0.0
    sighting, variances = (z[0], z[1], z[2] if oriented else 0.0), (q[0], q[1], q[2] if oriented else 1.0)
    b = np.empty((28, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 9, belief, start, n)
        if oriented:
            gather(b, 0, source, slots, start, n)
        else:
            for i in range(n):
                j = slots[start + i]
                b[0, i], b[1, i], b[2, i] = source[0, j], source[1, j], 0.0
                b[3, i], b[4, i], b[5, i] = source[2, j], source[3, j], 0.0
                b[6, i], b[7, i], b[8, i] = source[4, j], 0.0, 0.0
        for i in range(n):
            m = (b[0, i], b[1, i], b[2, i], b[3, i], b[4, i], b[5, i], b[6, i], b[7, i], b[8, i])
            x = (b[9, i], b[10, i], b[11, i], b[12, i], b[13, i], b[14, i], b[15, i], b[16, i], b[17, i])
            value, moved = fold_into_pose(x, m, sighting, variances, third)
            b[18, i] = value
            b[19, i], b[20, i], b[21, i], b[22, i], b[23, i] = moved[0], moved[1], moved[2], moved[3], moved[4]
            b[24, i], b[25, i], b[26, i], b[27, i] = moved[5], moved[6], moved[7], moved[8]
        for i in range(n):
            log_likelihood[start + i] += b[18, i]
        copy_out(b, 19, belief, start, n)


@njit(**OPTIONS)
def draw(lo: int, hi: int, belief: Array, key: np.uint64, poses: Array) -> None:
    """x_t ~ N(mean, P), from the first three numbers n of the motion, as in `noise`."""
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, belief, start, n)
        for i in range(n):
            n0, n1 = normal_pair(key, start + i, 0)
            n2, _ = normal_pair(key, start + i, 1)
            x = (b[0, i], b[1, i], b[2, i], b[3, i], b[4, i], b[5, i], b[6, i], b[7, i], b[8, i])
            b[9, i], b[10, i], b[11, i] = draw_pose(x, n0, n1, n2)
        copy_out(b, 9, poses, start, n)
