"""Renew a stretch of poses between two fixed ends: conditional SMC with ancestor sampling, landmarks integrated out.

The poses x_s to x_e are renewed; those before and after stay where they are in the world, with what their sightings say of
the landmarks. N particles start at x_{s-1}; each has its own Gaussians of the landmarks that the stretch sees. Particle 0
is the present stretch. Each pose is drawn from the Gaussian of motion times `guide`, and weighed exactly:

    p(x_t | x_{t-1}) p(z_t | x_t, map) psi_t(x_t) / (psi_{t-1}(x_{t-1}) q(x_t)),

where psi_t, a Gaussian, looks ahead: roughly the likelihood of the sightings after t and of the fixed end x_{e+1}. At e it is
replaced by p(x_{e+1} | x_e) itself, so what is left of psi is nothing but better particles. Particles are resampled where
the effective sample size falls below half; particle 0 then draws its ancestor with the weights

    w_i p(x'_{t+1} | x_t^i) / psi_t(x_t^i) * prod p(z | x^i, m) / p(z | x^i)

over the sightings of the stretch so far, where m is a draw of the map given the present trajectory. m is a last, unweighted
step of the SMC, which is what makes these weights those of the whole future without a look at it.

Sources: Andrieu, Doucet and Holenstein, *Particle Markov chain Monte Carlo methods*, JRSS B 2010; Lindsten, Jordan and
Schön, *Particle Gibbs with ancestor sampling*, JMLR 2014; Kok, Solin and Schön, *Rao-Blackwellized particle smoothing
for simultaneous localization and mapping*, Data-Centric Engineering 2024; Guarniero, Johansen and Lee, *The iterated
auxiliary particle filter*, JASA 2017, for psi.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from ..fast_math import OPTIONS
from .maps import (
    UNSEEN,
    absorb,
    added,
    choose,
    coloured,
    composed,
    density,
    drawn,
    inform,
    inverse6,
    lever_in,
    lower_root,
    off,
    passed,
    pick,
    relative,
    six,
    squared,
    three,
    times,
    turn,
    turned,
    upper,
    whitened,
)  # fmt: skip

#: Gauss-Newton steps to the path about which the guide is linearised
FITS = 2
#: resample below this share of N
LEAST_SHARE = 0.5


@njit(**OPTIONS)
def guide(
    middle: Array, begin: int, T: int, end: Array, motions: Array, W: Array, before: Array, local: np.ndarray,
    first: np.ndarray, y: Array, C: Array, third: float, ahead: Array, ahead_eta: Array, full: Array, full_eta: Array,
) -> None:  # fmt: skip
    """Write the information on displacements of the poses ``middle`` (n, 3) from what comes after, without and with t.

    A landmark counts with what the rest of the log says of it; those that only this stretch sees are left out.
    """
    n = len(middle)
    zero = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n - 1, -1, -1):
        t = begin + i
        ahead[i], ahead_eta[i] = 0.0, 0.0
        if i == n - 1:
            if t < T:
                covariance, _ = inverse6(six(W[t], 0))
                inform(ahead[i], ahead_eta[i], three(middle[i]), three(end), zero, three(motions[t]), covariance, 1.0)
        else:
            # the next pose, of information (full, full_eta), as a landmark whose sighting is the motion
            d = relative(three(middle[i]), three(middle[i + 1]))
            w, information = six(W[t], 0), turned(upper(full[i + 1]), d[2])
            P, _ = inverse6(added(w, information))
            g = times(w, times(P, turn(full_eta[i + 1], d[2])))
            reduced = passed(w, information)
            h = times(reduced, off(three(motions[t]), d))
            lever_in(ahead[i], ahead_eta[i], reduced, (g[0] + h[0], g[1] + h[1], g[2] + h[2]), d)
        full[i], full_eta[i] = ahead[i], ahead_eta[i]
        for k in range(first[t], first[t + 1]):
            row = before[local[k]]
            if row[3] >= 0:
                inform(
                    full[i], full_eta[i], three(middle[i]), three(row), six(row, 3), three(y[k]), six(C[k], 0), third
                )


@njit(**OPTIONS)
def proposal(start: tuple, middle: tuple, motion: tuple, w: tuple, L: Array, eta: Array) -> tuple:
    """Return the mean displacement from ``middle`` and its covariance, of motion times guide."""
    predicted = relative(middle, composed(start, motion))
    # the prior's axes are those of the start
    prior = turned(w, start[2] - middle[2])
    P, _ = inverse6(added(prior, upper(L)))
    g = times(prior, predicted)
    return times(P, (g[0] + eta[0], g[1] + eta[1], g[2] + eta[2])), P


@njit(**OPTIONS)
def quadratic(L: Array, eta: Array, d: tuple) -> float:
    """Return eta' d - d' L d / 2."""
    return eta[0] * d[0] + eta[1] * d[1] + eta[2] * d[2] - 0.5 * squared(upper(L), d)


@njit(**OPTIONS)
def renew(
    rng: np.random.Generator, x: Array, s: int, e: int, guess: Array, motions: Array, W: Array, first: np.ndarray,
    marks: np.ndarray, y: Array, C: Array, J: int, N: int, third: float, ancestors: bool,
) -> float:  # fmt: skip
    """Renew the poses s to e of the trajectory x (T + 1, 3) in place; arguments as those of `pivots.sweep`.

    Returns:
        The effective sample size at the end, as a share of N.
    """
    T, n = len(x) - 1, e - s + 1
    lo, hi = first[s], first[e + 1]
    # the landmarks of this stretch, by numbers of its own, and what the rest of the log says of them
    number, local = np.full(J, -1), np.empty(len(marks), np.int64)
    count = 0
    for k in range(lo, hi):
        if number[marks[k]] < 0:
            number[marks[k]] = count
            count += 1
        local[k] = number[marks[k]]
    before = np.empty((count, 9))
    before[:, 3] = UNSEEN
    t = 0
    for k in range(len(marks)):
        while first[t + 1] <= k:
            t += 1
        if (k < lo or k >= hi) and number[marks[k]] >= 0:
            absorb(before[number[marks[k]]], three(x[t]), three(y[k]), six(C[k], 0), third)
    # a map for the ancestors, drawn given the present trajectory
    m = before.copy()
    if ancestors:
        for t in range(s, e + 1):
            for k in range(first[t], first[t + 1]):
                absorb(m[local[k]], three(x[t]), three(y[k]), six(C[k], 0), third)
        for j in range(count):
            m[j, :3] = drawn(rng, three(m[j]), six(m[j], 3))
    end = x[min(e + 1, T)]
    middle = np.empty((n, 3))
    ahead, ahead_eta, full, full_eta = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    start = three(x[s - 1])
    for i in range(n):
        start = composed(start, three(guess[s - 1 + i]))
        middle[i] = start
    for fit in range(FITS):
        guide(middle, s, T, end, motions, W, before, local, first, y, C, third, ahead, ahead_eta, full, full_eta)
        if fit < FITS - 1:
            start = three(x[s - 1])
            for i in range(n):
                step, _ = proposal(
                    start, three(middle[i]), three(motions[s - 1 + i]), six(W[s - 1 + i], 0), full[i], full_eta[i]
                )
                start = composed(three(middle[i]), step)
                middle[i] = start

    poses, parents = np.empty((n, N, 3)), np.empty((n, N), np.int64)
    maps, spare = np.empty((N, count, 9)), np.empty((N, count, 9))
    maps[:] = before
    lw, surplus, back = np.zeros(N), np.zeros(N), np.zeros(N)
    ancestor, rho, kept = np.arange(N), np.empty(N), np.empty(N)
    for i in range(n):
        t, last = s + i, i == n - 1
        motion, w, mid = three(motions[t - 1]), six(W[t - 1], 0), three(middle[i])
        for p in range(N):
            start = three(x[s - 1]) if i == 0 else three(poses[i - 1, ancestor[p]])
            step, P = proposal(start, mid, motion, w, full[i], full_eta[i])
            root = lower_root(P)
            if p == 0:
                pose = three(x[t])
                d = relative(mid, pose)
                a = whitened(root, off(step, d))
            else:
                a = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
                v = coloured(root, a)
                d = off((0.0, 0.0, 0.0), (step[0] + v[0], step[1] + v[1], step[2] + v[2]))
                pose = composed(mid, d)
            poses[i, p], parents[i, p] = pose, ancestor[p]
            value = 0.5 * (a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
            value += np.log(root[0] * root[2] * root[5])
            value -= 0.5 * squared(w, off(motion, relative(start, pose)))
            for k in range(first[t], first[t + 1]):
                j, place, spread = local[k], composed(pose, three(y[k])), turned(six(C[k], 0), pose[2])
                increment = absorb(maps[p, j], pose, three(y[k]), six(C[k], 0), third)
                value += increment
                if ancestors:
                    surplus[p] += density(three(m[j]), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), place, spread, third) - increment
            value -= back[p]
            if not last:
                back[p] = quadratic(ahead[i], ahead_eta[i], d)
                value += back[p]
            elif e < T:
                value -= 0.5 * squared(six(W[e], 0), off(three(motions[e]), relative(pose, three(end))))
            lw[p] += value
        if last:
            break
        weights = np.exp(lw - lw.max())
        if weights.sum() ** 2 >= LEAST_SHARE * N * (weights * weights).sum():
            for p in range(N):
                ancestor[p] = p
            continue
        if ancestors:
            nxt, ahead_w = three(x[t + 1]), six(W[t], 0)
            for p in range(N):
                deviation = off(three(motions[t]), relative(three(poses[i, p]), nxt))
                rho[p] = lw[p] - back[p] - 0.5 * squared(ahead_w, deviation) + surplus[p]
            ancestor[0] = choose(rng, rho)
        else:
            ancestor[0] = 0
        for p in range(1, N):
            ancestor[p] = pick(rng, weights)
        kept[:] = surplus
        rho[:] = back
        for p in range(N):
            spare[p], surplus[p], back[p] = maps[ancestor[p]], kept[ancestor[p]], rho[ancestor[p]]
        maps, spare = spare, maps
        lw[:] = 0.0
    chosen = choose(rng, lw)
    for i in range(n - 1, -1, -1):
        x[s + i] = poses[i, chosen]
        chosen = parents[i, chosen]
    weights = np.exp(lw - lw.max())
    return weights.sum() ** 2 / (weights * weights).sum() / N
