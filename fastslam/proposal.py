"""The proposal of FastSLAM 2.0: poses drawn from a corrected prediction, with the exact importance weight of the draw.

A motion is predicted as the Gaussian N(m, P), P = A A' + epsilon I, where A = df/du diag(std) belongs to the noise
c ~ N(0, I) of the control. The sightings correct it, with h linearised, to the proposal q(x) = N(x; m+, P+). A pose x*
drawn from q instead of from the motion multiplies the weight by

    p(x*) / q(x*) = N(x*; m, P) / N(x*; m+, P+),

and each sighting multiplies it by its likelihood at the drawn pose, as in FastSLAM 1.0. What the linearisation neglects
then makes the weights less equal, but not wrong.

The motion is not Gaussian: x = f(x_{t-1}, u + diag(std) c) + e with e ~ N(0, epsilon I). In the linear model the noise of a
motion that ends at x* is c | x* ~ N(A' P^-1 d, I - A' P^-1 A) and e = d - A c, with d = x* - m. This noise is drawn and
put into f. Proposal and motion have the same density of the noise given x*, so the factor above is exact for f as well.

The original FastSLAM 2.0 weighs by N(z; h(m), V) under the prediction, which is the same only where f and h are linear.

Sources: Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM 2.0*, IJCAI 2003; Liu, *Monte Carlo Strategies in Scientific
Computing*, 2001, section 2.5, for the weight.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .blocks import BLOCK, Nine, Three, copy_in, copy_out, get_nine, get_three
from .fast_math import INLINED, OPTIONS, log, sincos, wrap_angle
from .noise import normal_pair

Six = tuple[float, float, float, float, float, float]

#: the proposal takes epsilon as at least this share of the variance of the motion, so that P has an inverse
LEAST_SHARE = 1e-10
#: and as at least this variance [m², rad²], 10 nm, so that the rounding of poses does not count as noise
LEAST_EPSILON = 1e-16
#: the conditional variances of a draw are at least this share of the variances before the sightings; below is rounding
ROUNDING = 1e-14


class Motion(NamedTuple):
    """What the draw needs to know of a motion, in the axes of its chord, which lies at ``angle`` to the robot."""

    angle: float
    #: along the chord, across it, turn
    mean: Three
    #: L^-1 of P = L L', row by row, and log det L
    whitening: Six
    log_scale: float
    #: the largest conditional variances that count as rounding: position, heading
    least: tuple[float, float]
    #: B = A' L'^-1 (2 x 3), row by row, and the lower triangle of C, C C' = I - B B': c = B a + C w
    share: Six
    rest: Three
    #: the nonzero entries of A: along by nu; along, across and turn by omega
    sensitivity: tuple[float, float, float, float]
    #: nu, omega, their standard deviations, dt, and sqrt(epsilon / the epsilon of the proposal)
    control: Six
    #: whether the motion is drawn from a control, or is the Gaussian itself
    nonlinear: bool


_3, _4, _6 = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
#: the last fields of a motion that is a Gaussian itself
NO_CONTROL = _6, _3, _4, _6, False
#: in place of a motion where nothing is drawn
NO_MOTION = Motion(0.0, _3, _6, 0.0, (0.0, 0.0), *NO_CONTROL)


@njit(**OPTIONS)
def whiten(covariance: Six) -> tuple[Six, float, tuple[float, float]]:
    """Return L^-1 (row by row) and log det L of P = L L', given as its upper triangle, and the least variances."""
    pxx, pxy, pxt, pyy, pyt, ptt = covariance
    l00 = sqrt(pxx)
    l10, l20 = pxy / l00, pxt / l00
    l11 = sqrt(pyy - l10 * l10)
    l21 = (pyt - l20 * l10) / l11
    l22 = sqrt(ptt - l20 * l20 - l21 * l21)
    w10, w21 = -l10 / (l00 * l11), -l21 / (l11 * l22)
    inverse = 1 / l00, w10, 1 / l11, -(l20 / l00 + l21 * w10) / l22, w21, 1 / l22
    return inverse, log(l00 * l11 * l22), (ROUNDING * (pxx + pyy), ROUNDING * ptt)


@njit(**OPTIONS)
def widened(epsilon: float, variance: float) -> float:
    """Return the epsilon of the proposal, for a motion whose control gives the ``variance`` (the trace of A A')."""
    return max(epsilon, LEAST_SHARE * variance, LEAST_EPSILON)


@njit(**OPTIONS)
def control_motion(
    nu: float, omega: float, nu_std: float, omega_std: float, dt: float, epsilon: float,
    angle: float, mean: Three, chord: tuple[float, float, float, float],
) -> tuple:  # fmt: skip
    """Return the fields of `Motion` for a control; ``chord``: the nonzero entries of df/du in the axes of the chord."""
    along_nu, along, across, turn = chord[0] * nu_std, chord[1] * omega_std, chord[2] * omega_std, chord[3] * omega_std
    least = widened(epsilon, along_nu * along_nu + along * along + across * across + turn * turn)
    covariance = (
        along_nu * along_nu + along * along + least, along * across, along * turn,
        across * across + least, across * turn, turn * turn + least,
    )  # fmt: skip
    inverse, log_scale, rounding = whiten(covariance)
    w00, w10, w11, w20, w21, w22 = inverse
    b00, b01, b02 = along_nu * w00, along_nu * w10, along_nu * w20
    b10, b11, b12 = along * w00, along * w10 + across * w11, along * w20 + across * w21 + turn * w22
    c00 = sqrt(max(1 - b00 * b00 - b01 * b01 - b02 * b02, 0.0))
    c10 = -(b00 * b10 + b01 * b11 + b02 * b12) / c00 if c00 > 0.0 else 0.0
    c11 = sqrt(max(1 - b10 * b10 - b11 * b11 - b12 * b12 - c10 * c10, 0.0))
    return (
        angle, mean, inverse, log_scale, rounding, (b00, b01, b02, b10, b11, b12), (c00, c10, c11),
        (along_nu, along, across, turn), (nu, omega, nu_std, omega_std, dt, sqrt(epsilon / least)), True,
    )  # fmt: skip


@njit(**INLINED)
def draw_weighted(
    start: Three, belief: Nine, normals: tuple[float, float, float, float, float], motion: Motion
) -> tuple[Three, float]:
    """Draw a pose from its corrected Gaussian; return it and log p(x*) - log q(x*).

    Args:
        start: the pose before the motion; ``belief``: the Gaussian N(m+, P+) after it and its sightings.
        normals: three standard normal numbers for x*, two for the noise of the control.
    """
    x, y, t, pxx, pxy, pxt, pyy, pyt, ptt = belief
    n0, n1, n2, n3, n4 = normals
    l00 = sqrt(max(pxx, motion.least[0]))
    l10, l20 = pxy / l00, pxt / l00
    l11 = sqrt(max(pyy - l10 * l10, motion.least[0]))
    l21 = (pyt - l20 * l10) / l11
    l22 = sqrt(max(ptt - l20 * l20 - l21 * l21, motion.least[1]))
    x, y, t = x + l00 * n0, y + l10 * n0 + l11 * n1, t + l20 * n0 + l21 * n1 + l22 * n2
    # the deviation d from the prediction in the axes of the chord, and a = L^-1 d
    s, c = sincos(start[2] + motion.angle)
    dx, dy = x - start[0], y - start[1]
    along, across = c * dx + s * dy - motion.mean[0], c * dy - s * dx - motion.mean[1]
    turn = wrap_angle(t - start[2] - motion.mean[2])
    w = motion.whitening
    a0, a1, a2 = w[0] * along, w[1] * along + w[2] * across, w[3] * along + w[4] * across + w[5] * turn
    ratio = 0.5 * (n0 * n0 + n1 * n1 + n2 * n2 - a0 * a0 - a1 * a1 - a2 * a2)
    ratio += log(l00 * l11 * l22) - motion.log_scale
    if motion.nonlinear:
        # the noise of the control that led here, and what f does with it beyond its linearisation
        b, r, A = motion.share, motion.rest, motion.sensitivity
        c0 = b[0] * a0 + b[1] * a1 + b[2] * a2 + r[0] * n3
        c1 = b[3] * a0 + b[4] * a1 + b[5] * a2 + r[1] * n3 + r[2] * n4
        nu, omega, nu_std, omega_std, dt, scale = motion.control
        e0, e1 = scale * (along - A[0] * c0 - A[1] * c1), scale * (across - A[2] * c1)
        e2 = scale * (turn - A[3] * c1)
        half = (omega + omega_std * c1) * dt / 2
        sine, _ = sincos(half)
        way = (nu + nu_std * c0) * dt * (sine / half if half != 0.0 else 1.0)
        sn, cn = sincos(start[2] + half)
        x, y = start[0] + way * cn + c * e0 - s * e1, start[1] + way * sn + s * e0 + c * e1
        t = start[2] + 2 * half + e2
    return (x, y, wrap_angle(t)), ratio


@njit(**INLINED)
def five_normals(key: np.uint64, particle: int) -> tuple[float, float, float, float, float]:
    """Return the five standard normal numbers of a particle."""
    n0, n1 = normal_pair(key, particle, 0)
    n2, n3 = normal_pair(key, particle, 1)
    n4, _ = normal_pair(key, particle, 2)
    return n0, n1, n2, n3, n4


@njit(**OPTIONS)
def draw_all(
    lo: int, hi: int, starts: Array, belief: Array, key: np.uint64, motion: Motion, poses: Array, log_likelihood: Array
) -> None:
    """Draw the poses (3, N) and add log p(x*) - log q(x*) to log_likelihood (N,)."""
    b = np.empty((16, BLOCK))
    for start in range(lo, hi, BLOCK):
        n = min(BLOCK, hi - start)
        copy_in(b, 0, belief, start, n)
        copy_in(b, 9, starts, start, n)
        for i in range(n):
            pose, b[15, i] = draw_weighted(get_three(b, 9, i), get_nine(b, 0, i), five_normals(key, start + i), motion)
            b[12, i], b[13, i], b[14, i] = pose
        for i in range(n):
            log_likelihood[start + i] += b[15, i]
        copy_out(b, 12, poses, start, n)
