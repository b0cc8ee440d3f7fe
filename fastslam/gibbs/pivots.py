"""Renew one motion after the other, while everything after it moves along as one rigid body.

The state is the trajectory in relative coordinates, d_t = x_t seen from x_{t-1}. The motions are independent a priori, so
the conditional of d_t given all others is its prior times the likelihood of the sightings, in which only landmarks seen
both before and from t on play a part:

    N(d_t; motion, Sigma) prod over landmarks of N(mean_after; q(x_t, mean_before), S_after + S_before),

with what was seen from t on, fused in the axes of x_t, as one sighting. All of it is exact once the landmarks are
integrated out, and costs O(landmarks) for a candidate. N candidates, of which one is the present d_t, are drawn from a
Gaussian fitted to this product and weighed exactly: a conditional SMC of one step. This mixes what moves the later
trajectory and map as a whole, which `paths` moves slowly.

Source: Lindsten, Jordan and Schön, *Particle Gibbs with ancestor sampling*, JMLR 2014, section 6, for models whose
future depends on the whole past.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from ..fast_math import OPTIONS
from .exact import accept
from .maps import (
    UNSEEN,
    absorb,
    choose,
    coloured,
    composed,
    density,
    drawn,
    fuse,
    inform,
    inverse6,
    lower_root,
    off,
    put,
    relative,
    six,
    squared,
    three,
    times,
    turned,
    upper,
    whitened,
)  # fmt: skip

#: Gauss-Newton steps to the Gaussian of the candidates
FITS = 3


@njit(**OPTIONS)
def futures(x: Array, first: np.ndarray, marks: np.ndarray, y: Array, C: Array, J: int, third: float) -> Array:
    """Return what the sightings from each step on say of the landmarks, in the axes of that pose: (T + 2, J, 9)."""
    T = len(x) - 1
    after = np.empty((T + 2, J, 9))
    after[:, :, 3] = UNSEEN
    for t in range(T, 0, -1):
        if t < T:
            d = relative(three(x[t]), three(x[t + 1]))
            for j in range(J):
                if after[t + 1, j, 3] >= 0:
                    row = after[t + 1, j]
                    put(after[t, j], composed(d, three(row)), turned(six(row, 3), d[2]))
        for k in range(first[t], first[t + 1]):
            fuse(after[t, marks[k]], three(y[k]), six(C[k], 0), third)
    return after


@njit(**OPTIONS)
def sweep(
    rng: np.random.Generator, x: Array, guess: Array, motions: Array, W: Array, first: np.ndarray, marks: np.ndarray,
    y: Array, C: Array, J: int, N: int, third: float, z: Array, q: Array, m: Array, ratio: Array,
) -> None:  # fmt: skip
    """Renew all motions of the trajectory x (T + 1, 3) in place, from the first to the last.

    Args:
        guess: motions (T, 3) at which the fits begin; ``motions``, ``W``: their means and inverse covariances (T, 6).
        first, marks, y, C: the sightings of step t are first[t] to first[t + 1], of the landmarks ``marks``.
        z, q, m, ratio: for the correction by `exact.accept`; empty without it.
    """
    T = len(x) - 1
    after = futures(x, first, marks, y, C, J, third)
    before = np.empty((J, 9))
    before[:, 3] = UNSEEN
    for k in range(first[0], first[1]):
        absorb(before[marks[k]], three(x[0]), three(y[k]), six(C[k], 0), third)
    ds = np.empty((T, 3))
    for t in range(T):
        ds[t] = relative(three(x[t]), three(x[t + 1]))
    shared = np.empty(J, np.int64)
    L, eta, lw, candidates = np.empty((3, 3)), np.empty(3), np.empty(N), np.empty((N, 3))
    for t in range(1, T + 1):
        start, motion, w = three(x[t - 1]), three(motions[t - 1]), six(W[t - 1], 0)
        count = 0
        for j in range(J):
            if before[j, 3] >= 0 and after[t, j, 3] >= 0:
                shared[count] = j
                count += 1
        if count == 0:
            # nothing but the prior
            d = drawn(rng, motion, inverse6(w)[0])
        else:
            middle = three(guess[t - 1])
            for fit in range(FITS):
                prior(L, eta, middle, motion, w)
                pose = composed(start, middle)
                for i in range(count):
                    b, a = before[shared[i]], after[t, shared[i]]
                    inform(L, eta, pose, three(b), six(b, 3), three(a), six(a, 3), third)
                P, _ = inverse6(upper(L))
                step = times(P, (eta[0], eta[1], eta[2]))
                if fit < FITS - 1:
                    middle = composed(middle, step)
            root = lower_root(P)
            for n in range(N):
                if n == 0:
                    d = three(ds[t - 1])
                    e = whitened(root, off(step, relative(middle, d)))
                else:
                    e = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
                    v = coloured(root, e)
                    d = composed(middle, (step[0] + v[0], step[1] + v[1], step[2] + v[2]))
                candidates[n] = d
                pose = composed(start, d)
                value = 0.5 * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] - squared(w, off(motion, d)))
                for i in range(count):
                    b, a = before[shared[i]], after[t, shared[i]]
                    value += density(three(b), six(b, 3), composed(pose, three(a)), turned(six(a, 3), pose[2]), third)
                lw[n] = value
            d = three(candidates[choose(rng, lw)])
        if len(z) > 0:
            trial = x.copy()
            trial[t] = composed(start, d)
            for later in range(t, T):
                trial[later + 1] = composed(three(trial[later]), three(ds[later]))
            if accept(rng, trial, m, ratio, first, marks, y, C, z, q, third):
                x[:] = trial
        else:
            x[t] = composed(start, d)
        for k in range(first[t], first[t + 1]):
            absorb(before[marks[k]], three(x[t]), three(y[k]), six(C[k], 0), third)


@njit(**OPTIONS)
def prior(L: Array, eta: Array, middle: tuple, motion: tuple, w: tuple) -> None:
    """Set the information on a displacement of the end of a motion, in the axes there, to that of the motion's prior."""
    g = turned(w, -middle[2])
    r = relative((0.0, 0.0, middle[2]), (motion[0] - middle[0], motion[1] - middle[1], motion[2]))
    L[0, 0], L[0, 1], L[0, 2] = g[0], g[1], g[2]
    L[1, 0], L[1, 1], L[1, 2] = g[1], g[3], g[4]
    L[2, 0], L[2, 1], L[2, 2] = g[2], g[4], g[5]
    eta[0] = g[0] * r[0] + g[1] * r[1] + g[2] * r[2]
    eta[1] = g[1] * r[0] + g[3] * r[1] + g[4] * r[2]
    eta[2] = g[2] * r[0] + g[4] * r[1] + g[5] * r[2]
