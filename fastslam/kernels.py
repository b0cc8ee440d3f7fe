"""The loops over particles, compiled. One call is one motion or one sighting of one landmark, for all particles.

A landmark's Gaussians are rows of (N, 5) numbers (m_x, m_y, S_xx, S_xy, S_yy) or, with a heading h, of (N, 9) numbers
(m_x, m_y, m_h, S_xx, S_xy, S_xh, S_yy, S_yh, S_hh): one particle's row is one cache line. ``slots[i]`` is the row of
``source`` that particle i inherited; the moved Gaussian goes to row i of ``target``. Where nobody resampled since the
landmark was last seen, slots counts up and both may be the same array.

A sighting that cannot be weighed (the particle stands on the landmark, or a number overflows) gets the log likelihood
-inf and leaves the landmark where it was.
"""

from __future__ import annotations

from math import atan2, cos, floor, log, pi, sin, sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

LOG_2PI = log(2 * pi)
#: nearer than this [m] a particle stands on the landmark: the bearing is rounding, and H = dh/dm has no value
ON_LANDMARK = 1e-9


@njit(cache=True, error_model="numpy")
def wrap_angle(angle: float) -> float:
    """The same angle in [-pi, pi), bit for bit where it is there already."""
    if -pi <= angle < pi:
        return angle
    wrapped = angle - 2 * pi * floor((angle + pi) / (2 * pi))
    return wrapped if -pi <= wrapped < pi else -pi


@njit(cache=True, error_model="numpy")
def move(
    poses: Array, normals: Array, nu: float, omega: float, nu_std: float, omega_std: float, dt: float, pose_std: float,
    moved: Array,
) -> None:  # fmt: skip
    """x_t = f(x_{t-1}, u + std n_01) + pose_std n_234, the heading wrapped; poses (N, 3), normals (N, 5)."""
    for i in range(poses.shape[0]):
        forward = (nu + nu_std * normals[i, 0]) * dt
        a = (omega + omega_std * normals[i, 1]) * dt / 2
        chord = forward * (sin(a) / a) if a != 0.0 else forward
        heading = poses[i, 2] + a
        moved[i, 0] = poses[i, 0] + chord * cos(heading) + pose_std * normals[i, 2]
        moved[i, 1] = poses[i, 1] + chord * sin(heading) + pose_std * normals[i, 3]
        moved[i, 2] = wrap_angle(poses[i, 2] + 2 * a + pose_std * normals[i, 4])


@njit(cache=True, error_model="numpy")
def weigh_known(poses: Array, landmark: Array, z: Array, q: Array, log_likelihood: Array) -> None:
    """Add log N(z; h(x, m), Q), Q = diag(q), of a landmark at a known place (n,) to log_likelihood (N,)."""
    n = len(z)
    constant = 0.5 * n * LOG_2PI
    for k in range(n):
        constant += 0.5 * log(q[k])
    for i in range(poses.shape[0]):
        dx, dy = landmark[0] - poses[i, 0], landmark[1] - poses[i, 1]
        direction = atan2(dy, dx)
        r = sqrt(dx * dx + dy * dy)
        e0 = z[0] - r
        e1 = wrap_angle(z[1] - direction + poses[i, 2])
        squared = e0 * e0 / q[0] + e1 * e1 / q[1]
        if n == 3:
            e2 = wrap_angle(z[2] - direction + landmark[2])
            squared += e2 * e2 / q[2]
        value = -0.5 * squared - constant
        if r < ON_LANDMARK or not -np.inf < value < np.inf:
            value = -np.inf
        log_likelihood[i] += value


@njit(cache=True, error_model="numpy")
def initialize_2d(poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting without psi: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    for i in range(poses.shape[0]):
        c, s = cos(poses[i, 2] + z[1]), sin(poses[i, 2] + z[1])
        across = z[0] * z[0] * q[1]
        target[i, 0] = poses[i, 0] + z[0] * c
        target[i, 1] = poses[i, 1] + z[0] * s
        target[i, 2] = c * c * q[0] + s * s * across
        target[i, 3] = c * s * (q[0] - across)
        target[i, 4] = s * s * q[0] + c * c * across


@njit(cache=True, error_model="numpy")
def initialize_3d(poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting with psi: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    for i in range(poses.shape[0]):
        c, s = cos(poses[i, 2] + z[1]), sin(poses[i, 2] + z[1])
        across = z[0] * z[0] * q[1]
        target[i, 0] = poses[i, 0] + z[0] * c
        target[i, 1] = poses[i, 1] + z[0] * s
        target[i, 2] = wrap_angle(poses[i, 2] + z[1] - z[2])
        target[i, 3] = c * c * q[0] + s * s * across
        target[i, 4] = c * s * (q[0] - across)
        target[i, 5] = -z[0] * s * q[1]
        target[i, 6] = s * s * q[0] + c * c * across
        target[i, 7] = z[0] * c * q[1]
        target[i, 8] = q[1] + q[2]


# The updates factor V = L L' and never form the gain: with W = S H' L'^-1 and y = L^-1 r the step is m += W y,
# S -= W W' (symmetric by construction), the Mahalanobis term is y'y, and det V is the squared product of L's diagonal.


@njit(cache=True, error_model="numpy")
def update_2d(
    poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array, log_likelihood: Array
) -> None:
    """Weigh with N(z; h(m), V = H S H' + Q), then the Kalman update of (m, S), of a landmark without heading."""
    for i in range(poses.shape[0]):
        j = slots[i]
        mx, my = source[j, 0], source[j, 1]
        sxx, sxy, syy = source[j, 2], source[j, 3], source[j, 4]
        dx, dy = mx - poses[i, 0], my - poses[i, 1]
        r = sqrt(dx * dx + dy * dy)
        ux, uy = dx / r, dy / r
        e0 = z[0] - r
        e1 = wrap_angle(z[1] - atan2(dy, dx) + poses[i, 2])
        # the columns of S H', one per row of H = [[ux, uy], [-uy/r, ux/r]]
        ax, ay = sxx * ux + sxy * uy, sxy * ux + syy * uy
        bx, by = (sxy * ux - sxx * uy) / r, (syy * ux - sxy * uy) / r
        l00 = sqrt(ux * ax + uy * ay + q[0])
        l10 = (ux * bx + uy * by) / l00
        l11 = sqrt((ux * by - uy * bx) / r + q[1] - l10 * l10)
        y0 = e0 / l00
        y1 = (e1 - l10 * y0) / l11
        value = -0.5 * (y0 * y0 + y1 * y1) - log(l00 * l11) - LOG_2PI
        if r < ON_LANDMARK or not -np.inf < value < np.inf:
            log_likelihood[i] = -np.inf
            target[i, 0], target[i, 1] = mx, my
            target[i, 2], target[i, 3], target[i, 4] = sxx, sxy, syy
            continue
        log_likelihood[i] += value
        ax, ay = ax / l00, ay / l00
        bx, by = (bx - l10 * ax) / l11, (by - l10 * ay) / l11
        target[i, 0] = mx + ax * y0 + bx * y1
        target[i, 1] = my + ay * y0 + by * y1
        target[i, 2] = sxx - ax * ax - bx * bx
        target[i, 3] = sxy - ax * ay - bx * by
        target[i, 4] = syy - ay * ay - by * by


@njit(cache=True, error_model="numpy")
def update_3d(
    poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array, log_likelihood: Array
) -> None:
    """The same of a landmark with a heading: H's third row is its second with -1 under the heading."""
    for i in range(poses.shape[0]):
        j = slots[i]
        mx, my, mh = source[j, 0], source[j, 1], source[j, 2]
        sxx, sxy, sxh = source[j, 3], source[j, 4], source[j, 5]
        syy, syh, shh = source[j, 6], source[j, 7], source[j, 8]
        dx, dy = mx - poses[i, 0], my - poses[i, 1]
        r = sqrt(dx * dx + dy * dy)
        ux, uy = dx / r, dy / r
        direction = atan2(dy, dx)
        e0 = z[0] - r
        e1 = wrap_angle(z[1] - direction + poses[i, 2])
        e2 = wrap_angle(z[2] - direction + mh)
        # the columns a, b, c of S H'
        ax, ay, ah = sxx * ux + sxy * uy, sxy * ux + syy * uy, sxh * ux + syh * uy
        bx, by, bh = (sxy * ux - sxx * uy) / r, (syy * ux - sxy * uy) / r, (syh * ux - sxh * uy) / r
        cx, cy, ch = bx - sxh, by - syh, bh - shh
        l00 = sqrt(ux * ax + uy * ay + q[0])
        l10 = (ux * bx + uy * by) / l00
        l20 = (ux * cx + uy * cy) / l00
        l11 = sqrt((ux * by - uy * bx) / r + q[1] - l10 * l10)
        l21 = ((ux * cy - uy * cx) / r - l10 * l20) / l11
        l22 = sqrt((ux * cy - uy * cx) / r - ch + q[2] - l20 * l20 - l21 * l21)
        y0 = e0 / l00
        y1 = (e1 - l10 * y0) / l11
        y2 = (e2 - l20 * y0 - l21 * y1) / l22
        value = -0.5 * (y0 * y0 + y1 * y1 + y2 * y2) - log(l00 * l11 * l22) - 1.5 * LOG_2PI
        if r < ON_LANDMARK or not -np.inf < value < np.inf:
            log_likelihood[i] = -np.inf
            for k in range(9):
                target[i, k] = source[j, k]
            continue
        log_likelihood[i] += value
        ax, ay, ah = ax / l00, ay / l00, ah / l00
        bx, by, bh = (bx - l10 * ax) / l11, (by - l10 * ay) / l11, (bh - l10 * ah) / l11
        cx = (cx - l20 * ax - l21 * bx) / l22
        cy = (cy - l20 * ay - l21 * by) / l22
        ch = (ch - l20 * ah - l21 * bh) / l22
        target[i, 0] = mx + ax * y0 + bx * y1 + cx * y2
        target[i, 1] = my + ay * y0 + by * y1 + cy * y2
        target[i, 2] = wrap_angle(mh + ah * y0 + bh * y1 + ch * y2)
        target[i, 3] = sxx - ax * ax - bx * bx - cx * cx
        target[i, 4] = sxy - ax * ay - bx * by - cx * cy
        target[i, 5] = sxh - ax * ah - bx * bh - cx * ch
        target[i, 6] = syy - ay * ay - by * by - cy * cy
        target[i, 7] = syh - ay * ah - by * bh - cy * ch
        target[i, 8] = shh - ah * ah - bh * bh - ch * ch
