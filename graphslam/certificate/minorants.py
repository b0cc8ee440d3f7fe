"""The convex quadratic function below J that touches it at a candidate: its matrix S, its gradient, rounding errors.

Pose i is a unit complex number z_i = exp(i theta_i) and a complex position t_i. With w = t_b + z_b d_b - t_a - z_a d_a
an edge of `ConstantEdges` has e_xy = conj(z_a) w and e_theta = theta_b - theta_a - turn. Its cost e' Omega e is at least

    J_e(v) + 2 Re(conj(p) (e_xy - v_xy)) + beta |e_xy - v_xy|² + 2 A (1 - cos f) + 2 g sin f,   f = e_theta - v_theta,

for all e, with equality at the residual v of the candidate, where p = (Omega v)_xy, g = (Omega v)_theta,
Omega - diag(beta, beta, kappa) is positive semidefinite, A = kappa u / tan u and u = g / kappa, if abs(u) < pi. For
abs(z_i) = 1 this is a Hermitian form of (z, t). See docs/certificate.md for the derivation.

``share`` chooses the split: beta = (1 - share) times the smallest eigenvalue of the position block of Omega, and kappa the
largest number that this beta allows. Where Omega does not correlate position and heading, share counts as 0.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ..incremental.kernels import wrap
from ..linear.hermitian import ROUNDOFF
from ..se2 import Array

#: the part of beta and of kappa that absorbs rounding errors
ABSORBED = 1e-9
#: how far abs(u) must stay below pi
HALF_TURN = np.pi - 1e-6
#: shares to try for one edge, where its own split leaves no curvature in the heading
MORE_SHARES = (0.5, 0.8, 0.95, 0.99)


class Forces(NamedTuple):
    """The edges at a candidate state.

    Attributes:
        p, g: (E,) complex and real, Omega v of the computed residual v.
        p_error: (E,) a bound on the rounding error of p.
        reached: (E,) complex, where the end lies in the axes of the first node.
        place_error, heading_error: (E,) how far v may be from the residual of the state.
        cost: (E,) the cost of each edge.
        slack: (E,) a bound on the rounding errors of the function that touches it, whatever its split.
        zero: (E,) whether the residual of the state may be zero, so far as its rounding tells.
    """

    p: Array
    p_error: Array
    g: Array
    reached: Array
    place_error: Array
    heading_error: Array
    cost: Array
    slack: Array
    zero: Array


class Curvature(NamedTuple):
    """The split of each edge.

    Attributes:
        beta, A: (E,); beta = -1 leaves the edge out.
        error: (E,) a bound on the rounding error of A, in units.
        slack: (E,) what the parts of beta and kappa leave of the rounding errors that they absorb.
    """

    beta: Array
    A: Array
    error: Array
    slack: Array


class Minorant(NamedTuple):
    """The function below J at a candidate state of N nodes, in the variables (z, t) of the nodes that are free.

    Attributes:
        values: (nnzb, 2, 2) complex, the blocks of S on the pattern of the graph.
        gradient: (N, 2) complex, half the gradient at the candidate; zero at a stationary point.
        scale: (N, 2) the sums of the absolute values that were added to each diagonal entry of S, or more.
        error: (N, 2) a bound on the rounding error of ``gradient``, in units.
        touched: the cost at the candidate, without the edges that were left out.
        slack: a bound on its rounding errors.
    """

    values: Array
    gradient: Array
    scale: Array
    error: Array
    touched: float
    slack: float


@njit(inline="always", error_model="numpy")
def _two_product(a, b):
    """a b as the sum of its rounded value and the error of that, exactly (Dekker 1971)."""
    p = a * b
    s, t = 134217729.0 * a, 134217729.0 * b
    a_high, b_high = s - (s - a), t - (t - b)
    a_low, b_low = a - a_high, b - b_high
    return p, a_low * b_low - (((p - a_high * b_high) - a_low * b_high) - a_high * b_low)


@njit(inline="always", error_model="numpy")
def _two_sum(a, b):
    """a + b as the sum of its rounded value and the error of that, exactly (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@njit(inline="always", error_model="numpy")
def _length(z):
    """abs(z), without the care for overflow that takes most of the time of `abs`; coordinates are at most 1e20."""
    return np.sqrt(z.real * z.real + z.imag * z.imag)


@njit(cache=True, error_model="numpy")
def _dot(a0, a1, a2, b0, b1, b2):
    """a' b as if computed with twice the digits: Omega may have entries 1e11 times its smallest eigenvalue (INTEL).

    The error is at most u |a' b| + (3 u)² |a|' |b| (Ogita, Rump and Oishi, *Accurate sum and dot product*, 2005).
    """
    p, e = _two_product(a0, b0)
    h, r = _two_product(a1, b1)
    p, q = _two_sum(p, h)
    e += r + q
    h, r = _two_product(a2, b2)
    p, q = _two_sum(p, h)
    return p + (e + (r + q))


@njit(cache=True, error_model="numpy")
def _split(o00, o01, o11, o02, o12, o22, share):
    """beta and kappa with Omega - diag(beta, beta, kappa) positive semidefinite, also after rounding; -1 for no beta."""
    mean, half = (o00 + o11) / 2, (o00 - o11) / 2
    largest = mean + np.sqrt(half * half + o01 * o01)
    # the determinant has an error of 3 units in o00 o11, and largest, of 4 units, is at least as large as both
    smallest = (o00 * o11 - o01 * o01) / largest - 16 * ROUNDOFF * min(o00, o11) if largest > 0 else 0.0
    if o02 == 0 and o12 == 0:
        return (smallest if smallest > 0 else -1.0), o22
    if not smallest > 0:
        return -1.0, 0.0
    beta = (1 - share) * smallest
    determinant = (smallest - beta) * (largest * (1 - 8 * ROUNDOFF) - beta)
    if not determinant > 0:
        return -1.0, 0.0
    m00, m11 = o00 - beta, o11 - beta
    first, second, third = o02 * o02 * m11, 2 * o02 * o12 * o01, o12 * o12 * m00
    size = (first + abs(second) + third) / determinant
    return beta, o22 - (first - second + third) / determinant - 16 * ROUNDOFF * (o22 + size)


@njit(cache=True, error_model="numpy")
def forces(state, first, second, start, end, turn, oriented, information):
    """The `Forces` at a state (N, 3) for edges (E,), with ``information`` (E, 6) as rows of upper triangles."""
    count = len(first)
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    p, p_error, g = np.empty(count, np.complex128), np.empty(count), np.empty(count)
    reached, place_error, heading_error = np.empty(count, np.complex128), np.empty(count), np.empty(count)
    cost, slack, zero = np.empty(count), np.empty(count), np.empty(count, np.bool_)
    for e in range(count):
        a, b, w = first[e], second[e], information[e]
        za, ta, heading = 1 + 0j, 0j, 0.0
        if a >= 0:
            za, ta, heading = complex(c[a], s[a]), complex(state[a, 0], state[a, 1]), state[a, 2]
        zb, tb = complex(c[b], s[b]), complex(state[b, 0], state[b, 1])
        d_a, d_b = complex(start[e, 0], start[e, 1]), complex(end[e, 0], end[e, 1])
        reached[e] = np.conj(za) * (tb + zb * d_b - ta)
        v, h = reached[e] - d_a, 0.0
        size = _length(ta) + _length(tb) + _length(d_a) + 2 * _length(d_b) + _length(reached[e]) + _length(v)
        place_error[e], heading_error[e] = 16 * ROUNDOFF * size, 0.0
        if oriented[e]:
            h = wrap(state[b, 2] - heading - turn[e])
            heading_error[e] = 16 * ROUNDOFF * (abs(heading) + abs(state[b, 2]) + abs(turn[e]) + np.pi)
        x, y = v.real, v.imag
        p[e] = complex(_dot(w[0], w[1], w[3], x, y, h), _dot(w[1], w[2], w[4], x, y, h))
        g[e] = _dot(w[3], w[4], w[5], x, y, h)
        cost[e] = p[e].real * x + p[e].imag * y + g[e] * h
        zero[e] = (p[e] == 0 or _length(v) <= place_error[e]) and (g[e] == 0 or abs(h) <= heading_error[e])
        # The function touches J_e at the computed residual. Its value at the state differs by the errors of v times p and g.
        # An error of g counts by the range of e_theta; those of p are absorbed by beta.
        rows = abs(w[0]) + 2 * abs(w[1]) + abs(w[2]) + abs(w[3]) + abs(w[4])
        p_size, v_size = _length(p[e]), _length(v)
        p_error[e] = 2 * ROUNDOFF * p_size + (4 * ROUNDOFF) ** 2 * rows * (v_size + abs(h))
        g_error = 2 * ROUNDOFF * abs(g[e]) + (4 * ROUNDOFF) ** 2 * ((abs(w[3]) + abs(w[4])) * v_size + abs(w[5] * h))
        slack[e] = 3 * p_size * place_error[e] + 3 * abs(g[e]) * heading_error[e] + p_error[e] * v_size + 16 * g_error
    return p, p_error, g, reached, place_error, heading_error, cost, slack, zero


@njit(cache=True, error_model="numpy")
def curvature(information, oriented, force, share):
    """The `Curvature` of edges (E,) at their `Forces` for one share."""
    _, p_error, g, _, place_error, heading_error, _, _, _ = force
    count = len(g)
    beta, A, error, slack = np.empty(count), np.zeros(count), np.zeros(count), np.zeros(count)
    for e in range(count):
        w, known = information[e], oriented[e]
        coupled = w[3] != 0 or w[4] != 0
        beta[e], kappa = _split(w[0], w[1], w[2], w[3], w[4], w[5], share)
        k = 0
        while known and coupled and beta[e] > 0 and not abs(g[e]) < HALF_TURN * kappa and k < len(MORE_SHARES):
            if MORE_SHARES[k] > share:
                beta[e], kappa = _split(w[0], w[1], w[2], w[3], w[4], w[5], MORE_SHARES[k])
            k += 1
        # an edge may measure the heading alone, or nothing about it
        if w[0] == 0 and w[1] == 0 and w[2] == 0 and not coupled:
            beta[e] = 0.0
        elif beta[e] > 0:
            # with w0 the rounding error of w, beta |w|² - 2 p_error |w| is at least (1 - ABSORBED) beta |w - w0|² - slack
            lost = p_error[e] + beta[e] * place_error[e]
            slack[e] = lost * lost / (ABSORBED * beta[e]) + beta[e] * place_error[e] ** 2
            beta[e] *= 1 - ABSORBED
        if not known or (g[e] == 0 and kappa == 0):
            continue
        absorbing = ABSORBED * kappa
        kappa -= absorbing
        if not abs(g[e]) < HALF_TURN * kappa:
            beta[e] = -1.0
            continue
        u = g[e] / kappa
        if abs(u) < 1e-4:
            # u / tan u >= 1 - u² for these u
            A[e], error[e] = kappa * (1 - u * u), kappa
        else:
            A[e] = kappa * u / np.tan(u)
            error[e] = kappa + abs(A[e]) + kappa * (u / np.sin(u)) ** 2
        # cos f changes with the rounding of f by less than a part of f²
        lost = abs(A[e]) * heading_error[e]
        slack[e] += lost * lost / absorbing + 2 * lost * heading_error[e]
    return beta, A, error, slack


@njit(cache=True, error_model="numpy")
def minorant(state, first, second, end, oriented, free, indptr, indices, force, curve):
    """The `Minorant` from `Forces` and `Curvature`. The cost is constant in nodes that are not ``free`` (N,)."""
    p_of, _, g_of, reached_of, place_error, _, cost, slack_of, _ = force
    beta_of, A_of, error_of, split_slack = curve
    n = len(state)
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    values = np.zeros((len(indices), 2, 2), np.complex128)
    gradient = np.zeros((n, 2), np.complex128)
    scale, error = np.zeros((n, 2)), np.zeros((n, 2))
    touched, rest, slack = 0.0, 0.0, 0.0
    for e in range(len(first)):
        a, b, beta, A, p, g = first[e], second[e], beta_of[e], A_of[e], p_of[e], g_of[e]
        if beta < 0:
            # J_e >= 0 is the bound that remains
            continue
        touched, lost = _two_sum(touched, cost[e])
        rest += lost
        slack += slack_of[e] + split_slack[e] + 8 * ROUNDOFF * abs(cost[e])
        if a == b:
            # a constant
            continue
        reached, d_b = reached_of[e], complex(end[e, 0], end[e, 1])
        za = complex(c[a], s[a]) if a >= 0 else 1 + 0j
        zb = complex(c[b], s[b])
        strength, reach = _length(p), _length(reached)
        pulled = strength * (reach + _length(d_b))
        # of p times the rounding error of the place, in units of 64
        far = strength * place_error[e] / (64 * ROUNDOFF)
        curved = 4 * error_of[e] + 4 * abs(g) + (strength**2 / beta if beta > 0 else 0.0)
        if a >= 0 and free[a]:
            slot = indptr[a + 1] - 1
            corner = beta * np.conj(reached) - np.conj(p)
            values[slot, 0, 0] += beta * reach**2 + A - (np.conj(p) * reached).real
            values[slot, 0, 1] += corner
            values[slot, 1, 0] += np.conj(corner)
            values[slot, 1, 1] += beta
            gradient[a, 0] += za * complex(0, -(p * np.conj(reached)).imag - g)
            gradient[a, 1] -= p * za
            scale[a, 0] += 4 * beta * reach**2 + curved + 2 * pulled
            scale[a, 1] += 8 * beta
            error[a, 0] += 2 * pulled + abs(g) + far
            error[a, 1] += 2 * strength
        if free[b]:
            slot = indptr[b + 1] - 1
            force_b = np.conj(zb) * za * p * np.conj(d_b)
            corner = beta * np.conj(d_b)
            values[slot, 0, 0] += beta * (d_b.real**2 + d_b.imag**2) + A - force_b.real
            values[slot, 0, 1] += corner
            values[slot, 1, 0] += np.conj(corner)
            values[slot, 1, 1] += beta
            gradient[b, 0] += zb * complex(0, force_b.imag + g)
            gradient[b, 1] += p * za
            # without a heading row and a lever, the node has no heading
            if oriented[e] or d_b != 0:
                scale[b, 0] += 4 * beta * (d_b.real**2 + d_b.imag**2) + curved + 2 * pulled
            scale[b, 1] += 8 * beta
            error[b, 0] += 2 * pulled + abs(g)
            error[b, 1] += 2 * strength
        if a >= 0 and free[a] and free[b]:
            to = np.conj(p) - beta * np.conj(reached)
            q00 = to * d_b + complex(-A, -g) * za * np.conj(zb)
            low, high = min(a, b), max(a, b)
            slot = indptr[high] + np.searchsorted(indices[indptr[high] : indptr[high + 1]], low)
            V = values[slot]
            if a < b:
                V[0, 0] += q00
                V[0, 1] += to
                V[1, 0] -= beta * d_b
                V[1, 1] -= beta
            else:
                V[0, 0] += np.conj(q00)
                V[1, 0] += np.conj(to)
                V[0, 1] -= np.conj(beta * d_b)
                V[1, 1] -= beta
    return values, gradient, scale, error, touched + rest, slack * (1 + 4 * len(first) * ROUNDOFF)


@njit(cache=True, error_model="numpy")
def strains(state, first, second, end, reached, x):
    """By how much a change x (N, 2) of (z, t) stretches and turns each edge: what multiplies beta and A in x^H S x."""
    count = len(first)
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    stretched, turned = np.empty(count), np.empty(count)
    for e in range(count):
        a, b, d_b = first[e], second[e], complex(end[e, 0], end[e, 1])
        za, xa, ta = 1 + 0j, 0j, 0j
        if a >= 0:
            za, xa, ta = complex(c[a], s[a]), x[a, 0], x[a, 1]
        zb = complex(c[b], s[b])
        stretched[e] = abs(x[b, 1] - ta + x[b, 0] * d_b - xa * reached[e]) ** 2
        turned[e] = abs(x[b, 0] * za * np.conj(zb) - xa) ** 2
    return stretched, turned
