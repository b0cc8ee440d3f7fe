"""One sighting of one landmark beyond linearisation, compiled: moments by quadrature, and Q at the estimated range.

The Kalman update linearises h at the old mean, and a first sighting is taken for N(h^-1, R Q R'). With the book's noise this
costs up to 0.15 standard deviations after four sightings, most of it by the first: under a flat prior the range has the
density r N(r; l, q), whose mean is l + q / l. Here the landmark is the Gaussian that has the mean and covariance of the
posterior: in closed form after a first sighting, by 3 x 3 Gauss-Hermite points about the mode after later ones,
and the likelihood is the integral over the same points. A landmark's heading is linear given its position, and is
integrated exactly.

Q at the estimated range: the variance of the range is that at |m - x| in place of the measured range, as in the slides.

Source: Ito and Xiong, *Gaussian filters for nonlinear filtering problems*, IEEE Transactions on Automatic Control 2000.
"""

from __future__ import annotations

from math import exp as library_exp
from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .blocks import BLOCK, Nine, Three, copy_in, copy_out, gather, get_nine, get_three, padded, put_nine
from .fast_math import OPTIONS, atan2, exp, log, sincos, wrap_angle
from .kalman import LOG_2PI, update_landmark
from .moment_kernels import NOTHING, add, gaussian

#: three points of Gauss and Hermite, and their weights
POINTS, WEIGHTS = (-sqrt(3.0), 0.0, sqrt(3.0)), (1 / 6, 2 / 3, 1 / 6)

#: Gauss-Newton steps from the Kalman update to the mode, about which the points lie
STEPS = 3


@njit(**OPTIONS)
def initialize_by_moments(lo: int, hi: int, poses: Array, z: Array, q: Array, target: Array) -> None:
    """First sighting: the moments of r (cos, sin)(theta + phi'), r of density r N(r; l, q_l), phi' ~ N(phi, q_phi)."""
    z0, z1, z2 = padded(z, 0.0)
    q0, q1, q2 = padded(q, 1.0)
    length, square = z0 + q0 / z0, z0 * z0 + 3 * q0
    shrink, twice = library_exp(-0.5 * q1), library_exp(-2 * q1)
    ahead = length * shrink
    along, across, bearing = 0.5 * square * (1 + twice) - ahead * ahead, 0.5 * square * (1 - twice), ahead * q1
    b = np.empty((12, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, poses, start, n)
        for i in range(n):
            s, c = sincos(b[2, i] + z1)
            mean = b[0, i] + ahead * c, b[1, i] + ahead * s, wrap_angle(b[2, i] + z1 - z2)
            xx, xy, yy = c * c * along + s * s * across, c * s * (along - across), s * s * along + c * c * across
            put_nine(b, 3, i, (mean[0], mean[1], mean[2], xx, xy, -s * bearing, yy, c * bearing, q1 + q2))
        copy_out(b, 3, target, start, n)


@njit(**OPTIONS)
def refined_update(
    lo: int, hi: int, poses: Array, slots: np.ndarray, source: Array, target: Array, z: Array, q: Array,
    rate: float, points: bool, log_likelihood: Array,
) -> None:  # fmt: skip
    """As `landmark_kernels.update`; by quadrature if ``points``; the range has the variance (rate r)² + q_l."""
    third, sighting, variances = 1.0 if len(z) == 3 else 0.0, padded(z, 0.0), padded(q, 1.0)
    b, values = np.zeros((22, BLOCK)), np.empty(9)
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        gather(b, 0, source, slots, start, n)
        copy_in(b, 9, poses, start, n)
        for i in range(n):
            landmark, pose = get_nine(b, 0, i), get_three(b, 9, i)
            dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
            at = variances[0] + rate * rate * (dx * dx + dy * dy), variances[1], variances[2]
            value, moved = update_landmark(landmark, pose, sighting, at, third)
            if points and value > -np.inf:
                integral, exact = integrate(landmark, moved, pose, sighting, variances, rate, third, values)
                # where the points miss the posterior, what they say of it is worse than the Kalman update
                if exact[3] > 0 and exact[3] * exact[6] > exact[4] * exact[4] and -np.inf < integral < np.inf:
                    value, moved = integral, exact
            put_nine(b, 13, i, moved)
            log_likelihood[start + i] += value
        copy_out(b, 13, target, start, n)


@njit(**OPTIONS)
def integrate(
    prior: Nine, about: Nine, pose: Three, z: Three, q: Three, rate: float, third: float, values: Array
) -> tuple[float, Nine]:
    """Return the log likelihood and the moments of prior times likelihood, by points about its mode.

    ``about``: where the search for the mode begins.
    """
    mx, my, mh, sxx, sxy, sxh, syy, syh, shh = prior
    determinant = sxx * syy - sxy * sxy
    ixx, ixy, iyy = syy / determinant, -sxy / determinant, sxx / determinant
    # the heading given the position: mean mh + B d, variance v; sighted with the gain k
    bx, by = third * (ixx * sxh + ixy * syh), third * (ixy * sxh + iyy * syh)
    v = shh - bx * sxh - by * syh if third > 0.0 else 1.0
    total = v + q[2]
    k = third * v / total
    cx, cy = about[0], about[1]
    for step in range(STEPS + 1):
        ex, ey, dx, dy = cx - mx, cy - my, cx - pose[0], cy - pose[1]
        r, direction = sqrt(dx * dx + dy * dy), atan2(dy, dx)
        ux, uy, vx, vy = dx / r, dy / r, -dy / (r * r), dx / (r * r)
        wx, wy = third * (vx - bx), third * (vy - by)
        w0, w1, w2 = 1 / (q[0] + rate * rate * r * r), 1 / q[1], third / total
        axx = ixx + w0 * ux * ux + w1 * vx * vx + w2 * wx * wx
        axy = ixy + w0 * ux * uy + w1 * vx * vy + w2 * wx * wy
        ayy = iyy + w0 * uy * uy + w1 * vy * vy + w2 * wy * wy
        area = axx * ayy - axy * axy
        if step < STEPS:
            g0, g1 = w0 * (z[0] - r), w1 * wrap_angle(z[1] - direction + pose[2])
            g2 = w2 * wrap_angle(z[2] - direction + mh + bx * ex + by * ey)
            gx = ux * g0 + vx * g1 + wx * g2 - ixx * ex - ixy * ey
            gy = uy * g0 + vy * g1 + wy * g2 - ixy * ex - iyy * ey
            cx, cy = cx + (ayy * gx - axy * gy) / area, cy + (axx * gy - axy * gx) / area
    l00 = sqrt(ayy / area)
    l10 = -axy / (area * l00)
    l11 = sqrt(axx / area - l10 * l10)
    for p in range(9):
        n0, n1 = POINTS[p // 3], POINTS[p % 3]
        x, y = cx + l00 * n0, cy + l10 * n0 + l11 * n1
        ex, ey, dx, dy = x - mx, y - my, x - pose[0], y - pose[1]
        r, direction = sqrt(dx * dx + dy * dy), atan2(dy, dx)
        variance = q[0] + rate * rate * r * r
        e0, e1 = z[0] - r, wrap_angle(z[1] - direction + pose[2])
        e2 = third * wrap_angle(z[2] - direction + mh + bx * ex + by * ey)
        squared = ixx * ex * ex + 2 * ixy * ex * ey + iyy * ey * ey + e0 * e0 / variance + e1 * e1 / q[1]
        squared += e2 * e2 / total - n0 * n0 - n1 * n1 + log(variance)
        values[p] = -0.5 * squared + log(WEIGHTS[p // 3] * WEIGHTS[p % 3])
    top = values.max()
    sums = NOTHING
    for p in range(9):
        n0, n1 = POINTS[p // 3], POINTS[p % 3]
        ex, ey = l00 * n0, l10 * n0 + l11 * n1
        dx, dy = cx + ex - pose[0], cy + ey - pose[1]
        # relative to the prior's mean, in which the sighting of the heading is linear
        h = bx * (cx + ex - mx) + by * (cy + ey - my)
        h -= k * wrap_angle(z[2] - atan2(dy, dx) + mh + h)
        w = exp(values[p] - top)
        sums = add(sums, w, ex, ey, h)
    value = log(sums[0]) + top + log(l00 * l11) - 0.5 * log(determinant * q[1] * total) - (1 + 0.5 * third) * LOG_2PI
    if third == 0.0:
        value += 0.5 * log(total)
    return value, gaussian(sums, cx, cy, mh, (1 - k) * v)
