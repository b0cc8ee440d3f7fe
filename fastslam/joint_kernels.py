"""A landmark from all of its sightings at once, compiled: evidence and moments, given the poses of a particle.

Updates of a Gaussian, however good, add an error with every sighting, because the posterior of a landmark is no Gaussian.
Here nothing is carried over but the poses from which the landmark was seen. At its K-th sighting

    Z_K = integral of prod over k <= K of N(z_k; h(x_k, m), Q_k) dm

is computed anew, and the weight is multiplied by Z_K / Z_{K-1}. The product of all weights is the last Z, so errors do not
add up, and the mean and covariance of the landmark are those of the integrand. Z_1 is the range, in closed form.

The integral is taken by Gauss-Hermite points about the mode, found by Gauss-Newton, with the curvature there. The heading
of a landmark is linear given its position, and is integrated exactly. An update costs O(K), so that after `MOST` sightings,
when the posterior is nearly Gaussian, the following ones are integrated alone (`refined_kernels`).

Source: Naylor and Smith, *Applications of a method for the efficient computation of posterior distributions*, Applied
Statistics 1982, for the points about the mode.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .blocks import Nine
from .fast_math import OPTIONS, atan2, exp, log, wrap_angle
from .kalman import LOG_2PI, update_landmark
from .memory import JOINT
from .moment_kernels import NOTHING, add, gaussian

#: sightings of a landmark that are integrated together
MOST = JOINT
#: Gauss-Newton steps from the mean before the sighting to the mode
STEPS = 5
#: points in each direction, for the density of the standard normal distribution
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


@njit(**OPTIONS)
def joint_update(
    lo: int, hi: int, past: Array, poses: Array, slots: np.ndarray, source: Array, target: Array, before: Array,
    after: Array, z: Array, q: Array, rates: Array, third: float, log_likelihood: Array,
) -> None:  # fmt: skip
    """Add log Z_K - log Z_{K-1} to log_likelihood (N,), and write the Gaussians of the landmark and log Z_K.

    Args:
        past: (3 M, N) the poses of the first M sightings; those of the other K - M are ``poses`` (3, N).
        source, target: columns of Gaussians (5 or 9, N); ``before``, ``after``: log Z (N,); particle i reads at slots[i].
        z, q: (K, 3) all sightings and their variances; the variance of the k-th range is (rates[k] r)² + q[k, 0].
        third: 1 with psi, 0 without.
    """
    K, M, short = len(z), len(past) // 3, len(source) == 5
    x, values = np.empty((K, 3)), np.empty(len(NODES) ** 2)
    for i in range(lo, hi):
        for k in range(K):
            for c in range(3):
                x[k, c] = past[3 * k + c, i] if k < M else poses[c, i]
        s = slots[i]
        if short:
            old = (source[0, s], source[1, s], 0.0, source[2, s], source[3, s], 0.0, source[4, s], 0.0, 0.0)
        else:
            old = (
                source[0, s], source[1, s], source[2, s], source[3, s], source[4, s], source[5, s], source[6, s],
                source[7, s], source[8, s],
            )  # fmt: skip
        total, new = evidence(x, z, q, rates, old, third, values)
        if not (-np.inf < total < np.inf and new[3] > 0 and new[3] * new[6] > new[4] * new[4]):
            # where the points find nothing, the particle is far from its sightings
            at = x[K - 1, 0], x[K - 1, 1], x[K - 1, 2]
            dx, dy = old[0] - at[0], old[1] - at[1]
            spread = q[K - 1, 0] + rates[K - 1] ** 2 * (dx * dx + dy * dy)
            value, new = update_landmark(
                old, at, (z[K - 1, 0], z[K - 1, 1], z[K - 1, 2]), (spread, q[K - 1, 1], q[K - 1, 2]), third
            )
            log_likelihood[i] += value
            after[i] = before[s] + (value if value > -np.inf else 0.0)
        else:
            log_likelihood[i] += total - before[s]
            after[i] = total
        if short:
            target[0, i], target[1, i], target[2, i], target[3, i], target[4, i] = (
                new[0],
                new[1],
                new[3],
                new[4],
                new[6],
            )
        else:
            for c in range(9):
                target[c, i] = new[c]


@njit(**OPTIONS)
def evidence(
    x: Array, z: Array, q: Array, rates: Array, about: Nine, third: float, values: Array
) -> tuple[float, Nine]:
    """Return log Z and the Gaussian of a landmark that was sighted from poses x (K, 3); arguments as `joint_update`.

    ``about``: where the search for the mode begins, and the heading about which headings are averaged.
    """
    K, n = len(z), len(NODES)
    cx, cy, ch = about[0], about[1], about[2]
    for step in range(STEPS + 1):
        axx = axy = ayy = gx = gy = total = tx = ty = mean = 0.0
        for k in range(K):
            dx, dy = cx - x[k, 0], cy - x[k, 1]
            r2 = dx * dx + dy * dy
            r, direction = sqrt(r2), atan2(dy, dx)
            ux, uy, vx, vy = dx / r, dy / r, -dy / r2, dx / r2
            w0, w1 = 1 / (q[k, 0] + rates[k] * rates[k] * r2), 1 / q[k, 1]
            axx += w0 * ux * ux + w1 * vx * vx
            axy += w0 * ux * uy + w1 * vx * vy
            ayy += w0 * uy * uy + w1 * vy * vy
            g0, g1 = w0 * (z[k, 0] - r), w1 * wrap_angle(z[k, 1] - direction + x[k, 2])
            gx += ux * g0 + vx * g1
            gy += uy * g0 + vy * g1
            if third > 0.0:
                # the heading that this sighting gives, relative to ch
                w2, e = 1 / q[k, 2], wrap_angle(direction - z[k, 2] - ch)
                total += w2
                tx, ty, mean = tx + w2 * vx, ty + w2 * vy, mean + w2 * e
                axx += w2 * vx * vx
                axy += w2 * vx * vy
                ayy += w2 * vy * vy
                gx -= w2 * e * vx
                gy -= w2 * e * vy
        if third > 0.0:
            axx -= tx * tx / total
            axy -= tx * ty / total
            ayy -= ty * ty / total
            gx += mean * tx / total
            gy += mean * ty / total
        area = axx * ayy - axy * axy
        if step < STEPS:
            cx, cy = cx + (ayy * gx - axy * gy) / area, cy + (axx * gy - axy * gx) / area
    l00 = sqrt(ayy / area)
    l10 = -axy / (area * l00)
    l11 = sqrt(axx / area - l10 * l10)
    constant = 0.0
    for k in range(K):
        constant += (2.0 + third) * LOG_2PI + log(q[k, 1]) + third * log(q[k, 2])
        constant += log(q[k, 0]) if rates[k] == 0.0 else 0.0
    top = -np.inf
    for p in range(n * n):
        n0, n1 = NODES[p // n], NODES[p % n]
        px, py = cx + l00 * n0, cy + l10 * n0 + l11 * n1
        squared = mean = square = total = 0.0
        for k in range(K):
            dx, dy = px - x[k, 0], py - x[k, 1]
            r2 = dx * dx + dy * dy
            direction = atan2(dy, dx)
            variance = q[k, 0] + rates[k] * rates[k] * r2
            e0, e1 = z[k, 0] - sqrt(r2), wrap_angle(z[k, 1] - direction + x[k, 2])
            squared += e0 * e0 / variance + e1 * e1 / q[k, 1] + (log(variance) if rates[k] > 0.0 else 0.0)
            if third > 0.0:
                w2, e = 1 / q[k, 2], wrap_angle(direction - z[k, 2] - ch)
                total, mean, square = total + w2, mean + w2 * e, square + w2 * e * e
        if third > 0.0:
            squared += square - mean * mean / total + log(total) - LOG_2PI
        values[p] = -0.5 * (squared - n0 * n0 - n1 * n1 + constant) + log(WEIGHTS[p // n] * WEIGHTS[p % n])
        top = max(top, values[p])
    sums, rest = NOTHING, 0.0
    for p in range(n * n):
        n0, n1 = NODES[p // n], NODES[p % n]
        ex, ey, h = l00 * n0, l10 * n0 + l11 * n1, 0.0
        if third > 0.0:
            mean = total = 0.0
            for k in range(K):
                w2 = 1 / q[k, 2]
                direction = atan2(cy + ey - x[k, 1], cx + ex - x[k, 0])
                total, mean = total + w2, mean + w2 * wrap_angle(direction - z[k, 2] - ch)
            h, rest = mean / total, 1 / total
        w = exp(values[p] - top)
        sums = add(sums, w, ex, ey, h)
    # the points are those of the standard normal density, whose normaliser is that of the change of variables
    return log(sums[0]) + top + log(l00 * l11) + LOG_2PI, gaussian(sums, cx, cy, ch, rest)
