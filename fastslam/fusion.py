"""One sighting folded into one landmark, or into one pose: the equations that the kernels are made of.

The updates factor V = L D L', L with a unit diagonal, and never form the gain. With the columns w_k of S H' L'^-1, the
residual y = L^-1 r and the entries d_k of D the step is m += sum of w_k y_k / d_k, S -= sum of w_k w_k' / d_k
(symmetric by construction), the Mahalanobis term is the sum of y_k² / d_k and det V the product of the d_k.

A sighting that cannot be weighed (the particle stands on the landmark, or a number overflows) gets the log likelihood
-inf and changes nothing.

Landmarks are nine numbers, m_x, m_y, m_h, S_xx, S_xy, S_xh, S_yy, S_yh, S_hh; beliefs of the pose are nine as well, x,
y, theta and the upper triangle of P. Without psi ``third`` is 0 instead of 1, the third variance is 1, the numbers of
the heading are 0, and the third row becomes a residual of zero that nothing depends on.
"""

from __future__ import annotations

from math import log as library_log
from math import pi, sqrt

import numpy as np
from numba import njit

from .branchless import INLINED, atan2, log, sincos, wrap_angle

Three = tuple[float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]

LOG_2PI = library_log(2 * pi)
#: nearer than this [m] a particle stands on the landmark: the bearing is rounding, and H = dh/dm has no value
ON_LANDMARK = 1e-9
#: the smallest normal number: below it det V has no digits left
SMALLEST = 2.3e-308


@njit(**INLINED)
def log_density(squared: float, determinant: float, constant: float, r: float) -> float:
    """-(squared + log determinant) / 2 - constant, or -inf where that means nothing."""
    value = -0.5 * (squared + log(determinant)) - constant
    possible = r >= ON_LANDMARK and SMALLEST <= determinant < np.inf and -np.inf < value < np.inf
    return value if possible else -np.inf


@njit(**INLINED)
def fold_into_landmark(landmark: Nine, pose: Three, z: Three, q: Three, third: float) -> tuple[float, Nine]:
    """log N(z; h(x, m), V = H S H' + Q) and the landmark after the Kalman update, the pose known.

    H's third row is its second with -1 under the heading.
    """
    mx, my, mh, sxx, sxy, sxh, syy, syh, shh = landmark
    dx, dy = mx - pose[0], my - pose[1]
    r = sqrt(dx * dx + dy * dy)
    inverse = 1.0 / r
    ux, uy = dx * inverse, dy * inverse
    direction = atan2(dy, dx)
    e0 = z[0] - r
    e1 = wrap_angle(z[1] - direction + pose[2])
    e2 = third * wrap_angle(z[2] - direction + mh)
    # the columns a, b, c of S H'
    ax, ay, ah = sxx * ux + sxy * uy, sxy * ux + syy * uy, sxh * ux + syh * uy
    bx, by, bh = (sxy * ux - sxx * uy) * inverse, (syy * ux - sxy * uy) * inverse, (syh * ux - sxh * uy) * inverse
    cx, cy, ch = third * (bx - sxh), third * (by - syh), third * (bh - shh)
    d0 = ux * ax + uy * ay + q[0]
    i0 = 1.0 / d0
    l10, l20 = (ux * bx + uy * by) * i0, (ux * cx + uy * cy) * i0
    bx, by, bh = bx - l10 * ax, by - l10 * ay, bh - l10 * ah
    cx, cy, ch = cx - l20 * ax, cy - l20 * ay, ch - l20 * ah
    d1 = (ux * by - uy * bx) * inverse + q[1]
    i1 = 1.0 / d1
    l21 = (ux * cy - uy * cx) * inverse * i1
    cx, cy, ch = cx - l21 * bx, cy - l21 * by, ch - l21 * bh
    d2 = third * ((ux * cy - uy * cx) * inverse - ch) + q[2]
    i2 = 1.0 / d2
    y1 = e1 - l10 * e0
    y2 = e2 - l20 * e0 - l21 * y1
    g0, g1, g2 = e0 * i0, y1 * i1, y2 * i2
    value = log_density(e0 * g0 + y1 * g1 + y2 * g2, d0 * d1 * d2, (1.0 + 0.5 * third) * LOG_2PI, r)
    seen = value > -np.inf
    return value, (
        mx + ax * g0 + bx * g1 + cx * g2 if seen else mx,
        my + ay * g0 + by * g1 + cy * g2 if seen else my,
        wrap_angle(mh + ah * g0 + bh * g1 + ch * g2) if seen else mh,
        sxx - ax * ax * i0 - bx * bx * i1 - cx * cx * i2 if seen else sxx,
        sxy - ax * ay * i0 - bx * by * i1 - cx * cy * i2 if seen else sxy,
        sxh - ax * ah * i0 - bx * bh * i1 - cx * ch * i2 if seen else sxh,
        syy - ay * ay * i0 - by * by * i1 - cy * cy * i2 if seen else syy,
        syh - ay * ah * i0 - by * bh * i1 - cy * ch * i2 if seen else syh,
        shh - ah * ah * i0 - bh * bh * i1 - ch * ch * i2 if seen else shh,
    )


@njit(**INLINED)
def fold_into_pose(belief: Nine, landmark: Nine, z: Three, q: Three, third: float) -> tuple[float, Nine]:
    """log N(z; h(x, m), V = H_x P H_x' + H_m S H_m' + Q) and the pose's belief after the Kalman update.

    h sees pose and landmark through m - x, theta and the landmark's heading, so V is made of the covariance of those.
    """
    x, y, t, pxx, pxy, pxt, pyy, pyt, ptt = belief
    mx, my, mh, sxx, sxy, sxh, syy, syh, shh = landmark
    dx, dy = mx - x, my - y
    r = sqrt(dx * dx + dy * dy)
    inverse = 1.0 / r
    ux, uy = dx * inverse, dy * inverse
    vx, vy = -uy * inverse, ux * inverse
    direction = atan2(dy, dx)
    e0 = z[0] - r
    e1 = wrap_angle(z[1] - direction + t)
    e2 = third * wrap_angle(z[2] - direction + mh)
    # C = Cov(m - x), and the columns of -P H_x'
    cxx, cxy, cyy = pxx + sxx, pxy + sxy, pyy + syy
    ax, ay, at = pxx * ux + pxy * uy, pxy * ux + pyy * uy, pxt * ux + pyt * uy
    cx, cy, ct = third * (pxx * vx + pxy * vy), third * (pxy * vx + pyy * vy), third * (pxt * vx + pyt * vy)
    bx, by, bt = pxx * vx + pxy * vy + pxt, pxy * vx + pyy * vy + pyt, pxt * vx + pyt * vy + ptt
    # V, with Cov(m - x, theta) = -P_xt and Cov(m - x, h) = S_xh
    fx, fy = cxx * vx + cxy * vy, cxy * vx + cyy * vy
    bearing = vx * fx + vy * fy
    turned = vx * pxt + vy * pyt
    headed = vx * sxh + vy * syh
    v00 = ux * (cxx * ux + cxy * uy) + uy * (cxy * ux + cyy * uy) + q[0]
    v10 = ux * fx + uy * fy + ux * pxt + uy * pyt
    v11 = bearing + 2 * turned + ptt + q[1]
    v20 = third * (ux * fx + uy * fy - ux * sxh - uy * syh)
    v21 = third * (bearing + turned - headed)
    v22 = third * (bearing - 2 * headed + shh) + q[2]
    i0 = 1.0 / v00
    l10, l20 = v10 * i0, v20 * i0
    d1 = v11 - l10 * v10
    i1 = 1.0 / d1
    l21 = (v21 - l20 * v10) * i1
    d2 = v22 - l20 * v20 - l21 * l21 * d1
    i2 = 1.0 / d2
    bx, by, bt = bx - l10 * ax, by - l10 * ay, bt - l10 * at
    cx, cy, ct = cx - l20 * ax - l21 * bx, cy - l20 * ay - l21 * by, ct - l20 * at - l21 * bt
    y1 = e1 - l10 * e0
    y2 = e2 - l20 * e0 - l21 * y1
    g0, g1, g2 = e0 * i0, y1 * i1, y2 * i2
    value = log_density(e0 * g0 + y1 * g1 + y2 * g2, v00 * d1 * d2, (1.0 + 0.5 * third) * LOG_2PI, r)
    seen = value > -np.inf
    return value, (
        x - ax * g0 - bx * g1 - cx * g2 if seen else x,
        y - ay * g0 - by * g1 - cy * g2 if seen else y,
        wrap_angle(t - at * g0 - bt * g1 - ct * g2) if seen else t,
        pxx - ax * ax * i0 - bx * bx * i1 - cx * cx * i2 if seen else pxx,
        pxy - ax * ay * i0 - bx * by * i1 - cx * cy * i2 if seen else pxy,
        pxt - ax * at * i0 - bx * bt * i1 - cx * ct * i2 if seen else pxt,
        pyy - ay * ay * i0 - by * by * i1 - cy * cy * i2 if seen else pyy,
        pyt - ay * at * i0 - by * bt * i1 - cy * ct * i2 if seen else pyt,
        ptt - at * at * i0 - bt * bt * i1 - ct * ct * i2 if seen else ptt,
    )


@njit(**INLINED)
def first_sighting(pose: Three, z: Three, q: Three, third: float) -> Nine:
    """The landmark that a sighting starts: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    s, c = sincos(pose[2] + z[1])
    across = z[0] * z[0] * q[1]
    return (
        pose[0] + z[0] * c,
        pose[1] + z[0] * s,
        third * wrap_angle(pose[2] + z[1] - z[2]),
        c * c * q[0] + s * s * across,
        c * s * (q[0] - across),
        -third * z[0] * s * q[1],
        s * s * q[0] + c * c * across,
        third * z[0] * c * q[1],
        third * (q[1] + q[2]),
    )


@njit(**INLINED)
def draw_pose(belief: Nine, n0: float, n1: float, n2: float) -> Three:
    """mean + L n, L L' = P, from three standard normal numbers, the heading wrapped.

    Where P is degenerate (no noise in some direction) the column of L that has nothing to say is zero.
    """
    x, y, t, pxx, pxy, pxt, pyy, pyt, ptt = belief
    l00 = sqrt(max(pxx, 0.0))
    i00 = 1.0 / l00 if l00 > 0.0 else 0.0
    l10, l20 = pxy * i00, pxt * i00
    l11 = sqrt(max(pyy - l10 * l10, 0.0))
    l21 = (pyt - l20 * l10) * (1.0 / l11 if l11 > 0.0 else 0.0)
    l22 = sqrt(max(ptt - l20 * l20 - l21 * l21, 0.0))
    return x + l00 * n0, y + l10 * n0 + l11 * n1, wrap_angle(t + l20 * n0 + l21 * n1 + l22 * n2)
