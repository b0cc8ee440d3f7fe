"""Kalman updates of one landmark or of one pose by one sighting: the equations of which the kernels are made.

The updates factor the innovation covariance as V = L D L', L with a unit diagonal, and never form the gain. With the
columns w_k of S H' L'^-1, the residual y = L^-1 r and the entries d_k of D, the update is m += sum of w_k y_k / d_k and
S -= sum of w_k w_k' / d_k, which is symmetric by construction. The squared Mahalanobis distance is the sum of y_k² / d_k
and det V is the product of the d_k.

A sighting that cannot be weighed, because the particle stands on the landmark or a number overflows, has the log
likelihood -inf and changes nothing.

Gaussians are nine numbers as in `blocks`. Without psi the numbers of a landmark's heading have no meaning, and the third
row is replaced by a residual of zero with variance 1, on which nothing depends.
"""

from __future__ import annotations

from math import log as library_log
from math import pi, sqrt

import numpy as np
from numba import njit

from .blocks import Nine, Three
from .fast_math import INLINED, atan2, log, sincos, wrap_angle

LOG_2PI = library_log(2 * pi)
#: a particle nearer than this [m] stands on the landmark: the bearing is rounding error, and H = dh/dm is undefined
ON_LANDMARK = 1e-9
#: the smallest normal number: a smaller det V has lost its digits
SMALLEST = 2.3e-308


@njit(**INLINED)
def log_density(squared: float, determinant: float, constant: float, r: float) -> float:
    """Return -(squared + log determinant) / 2 - constant, or -inf where this is undefined."""
    value = -0.5 * (squared + log(determinant)) - constant
    possible = r >= ON_LANDMARK and SMALLEST <= determinant < np.inf and -np.inf < value < np.inf
    return value if possible else -np.inf


@njit(**INLINED)
def weigh_and_update(
    belief: Nine, a: Three, b: Three, c: Three, e: Three, L: Three, D: Three, third: float, r: float, sign: float
) -> tuple[float, Nine]:
    """Return the log likelihood of a sighting and the updated Gaussian, from the factors of V.

    Args:
        belief: the Gaussian before the update.
        a, b, c: the columns w_k, multiplied by ``sign``.
        e: residual; ``L``: the entries L_10, L_20, L_21; ``D``: its diagonal.
        third: 1 with psi, 0 without; ``r``: distance between robot and landmark [m].
    """
    x, y, h, pxx, pxy, pxh, pyy, pyh, phh = belief
    i0, i1, i2 = 1.0 / D[0], 1.0 / D[1], 1.0 / D[2]
    y1 = e[1] - L[0] * e[0]
    y2 = e[2] - L[1] * e[0] - L[2] * y1
    g0, g1, g2 = e[0] * i0, y1 * i1, y2 * i2
    value = log_density(e[0] * g0 + y1 * g1 + y2 * g2, D[0] * D[1] * D[2], (1.0 + 0.5 * third) * LOG_2PI, r)
    possible = value > -np.inf
    g0, g1, g2 = sign * g0, sign * g1, sign * g2
    return value, (
        x + a[0] * g0 + b[0] * g1 + c[0] * g2 if possible else x,
        y + a[1] * g0 + b[1] * g1 + c[1] * g2 if possible else y,
        wrap_angle(h + a[2] * g0 + b[2] * g1 + c[2] * g2) if possible else h,
        pxx - a[0] * a[0] * i0 - b[0] * b[0] * i1 - c[0] * c[0] * i2 if possible else pxx,
        pxy - a[0] * a[1] * i0 - b[0] * b[1] * i1 - c[0] * c[1] * i2 if possible else pxy,
        pxh - a[0] * a[2] * i0 - b[0] * b[2] * i1 - c[0] * c[2] * i2 if possible else pxh,
        pyy - a[1] * a[1] * i0 - b[1] * b[1] * i1 - c[1] * c[1] * i2 if possible else pyy,
        pyh - a[1] * a[2] * i0 - b[1] * b[2] * i1 - c[1] * c[2] * i2 if possible else pyh,
        phh - a[2] * a[2] * i0 - b[2] * b[2] * i1 - c[2] * c[2] * i2 if possible else phh,
    )


@njit(**INLINED)
def update_landmark(landmark: Nine, pose: Three, z: Three, q: Three, third: float) -> tuple[float, Nine]:
    """Return log N(z; h(x, m), V = H S H' + Q) and the landmark after the Kalman update, with the pose known.

    H is [[u_x, u_y, 0], [-u_y/r, u_x/r, 0], [-u_y/r, u_x/r, -1]], where u is the direction to the landmark.
    """
    mx, my, mh, sxx, sxy, sxh, syy, syh, shh = landmark
    dx, dy = mx - pose[0], my - pose[1]
    r = sqrt(dx * dx + dy * dy)
    inverse = 1.0 / r
    ux, uy = dx * inverse, dy * inverse
    direction = atan2(dy, dx)
    e = z[0] - r, wrap_angle(z[1] - direction + pose[2]), third * wrap_angle(z[2] - direction + mh)
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
    l21 = (ux * cy - uy * cx) * inverse * (1.0 / d1)
    c = cx - l21 * bx, cy - l21 * by, ch - l21 * bh
    d2 = third * ((ux * c[1] - uy * c[0]) * inverse - c[2]) + q[2]
    a, b = (ax, ay, ah), (bx, by, bh)
    if third > 0.0:
        return weigh_and_update(landmark, a, b, c, e, (l10, l20, l21), (d0, d1, d2), third, r, 1.0)
    # constants, so that the compiler leaves the third row out where it knows that there is none
    c, e = (0.0, 0.0, 0.0), (e[0], e[1], 0.0)
    return weigh_and_update(landmark, a, b, c, e, (l10, 0.0, 0.0), (d0, d1, 1.0), 0.0, r, 1.0)


@njit(**INLINED)
def update_pose(belief: Nine, landmark: Nine, z: Three, q: Three, third: float) -> tuple[float, Nine]:
    """Return log N(z; h(x, m), V = H_x P H_x' + H_m S H_m' + Q) and the pose's Gaussian after the Kalman update.

    h depends on pose and landmark through m - x, theta and the landmark's heading h, so V is made of their covariances.
    """
    x, y, t, pxx, pxy, pxt, pyy, pyt, ptt = belief
    mx, my, mh, sxx, sxy, sxh, syy, syh, shh = landmark
    dx, dy = mx - x, my - y
    r = sqrt(dx * dx + dy * dy)
    inverse = 1.0 / r
    ux, uy = dx * inverse, dy * inverse
    vx, vy = -uy * inverse, ux * inverse
    direction = atan2(dy, dx)
    e = z[0] - r, wrap_angle(z[1] - direction + t), third * wrap_angle(z[2] - direction + mh)
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
    l21 = (v21 - l20 * v10) * (1.0 / d1)
    d2 = v22 - l20 * v20 - l21 * l21 * d1
    bx, by, bt = bx - l10 * ax, by - l10 * ay, bt - l10 * at
    cx, cy, ct = cx - l20 * ax - l21 * bx, cy - l20 * ay - l21 * by, ct - l20 * at - l21 * bt
    return weigh_and_update(
        belief, (ax, ay, at), (bx, by, bt), (cx, cy, ct), e, (l10, l20, l21), (v00, d1, d2), third, r, -1.0
    )


@njit(**INLINED)
def initial_landmark(pose: Three, z: Three, q: Three) -> Nine:
    """Return the Gaussian of a landmark after its first sighting: mean h^-1(x, z), covariance (H' Q^-1 H)^-1 = R Q R'."""
    s, c = sincos(pose[2] + z[1])
    across = z[0] * z[0] * q[1]
    bearing = z[0] * q[1]
    return (
        pose[0] + z[0] * c,
        pose[1] + z[0] * s,
        wrap_angle(pose[2] + z[1] - z[2]),
        c * c * q[0] + s * s * across,
        c * s * (q[0] - across),
        -s * bearing,
        s * s * q[0] + c * c * across,
        c * bearing,
        q[1] + q[2],
    )


@njit(**INLINED)
def draw_pose(belief: Nine, n0: float, n1: float, n2: float) -> Three:
    """Return mean + L n with L L' = P, from three standard normal numbers n, the heading wrapped.

    Where P is degenerate (no noise in some direction) the corresponding column of L is zero.
    """
    x, y, t, pxx, pxy, pxt, pyy, pyt, ptt = belief
    l00 = sqrt(max(pxx, 0.0))
    i00 = 1.0 / l00 if l00 > 0.0 else 0.0
    l10, l20 = pxy * i00, pxt * i00
    l11 = sqrt(max(pyy - l10 * l10, 0.0))
    l21 = (pyt - l20 * l10) * (1.0 / l11 if l11 > 0.0 else 0.0)
    l22 = sqrt(max(ptt - l20 * l20 - l21 * l21, 0.0))
    return x + l00 * n0, y + l10 * n0 + l11 * n1, wrap_angle(t + l20 * n0 + l21 * n1 + l22 * n2)
