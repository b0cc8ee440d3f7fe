"""The exact range-bearing density against its linearisation, for a Metropolis correction."""

from __future__ import annotations

from math import atan2, sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from ..fast_math import OPTIONS, wrap_angle
from .maps import UNSEEN, absorb, drawn, inverse6, off, relative, six, squared, three


@njit(**OPTIONS)
def draw_map(
    rng: np.random.Generator, x: Array, first: np.ndarray, marks: np.ndarray, y: Array, C: Array, J: int, third: float
) -> Array:
    """Draw the landmarks (J, 3) given a trajectory."""
    rows, m = np.empty((J, 9)), np.empty((J, 3))
    rows[:, 3] = UNSEEN
    for t in range(len(x)):
        for k in range(first[t], first[t + 1]):
            absorb(rows[marks[k]], three(x[t]), three(y[k]), six(C[k], 0), third)
    for j in range(J):
        m[j] = drawn(rng, three(rows[j]), six(rows[j], 3))
    return m


@njit(**OPTIONS)
def log_ratio(
    x: Array, m: Array, first: np.ndarray, marks: np.ndarray, y: Array, C: Array, z: Array, q: Array, third: float
) -> float:
    """Return the sum of log N(z; h(x, m), diag(q)) - log N(y; relative place, C), without constants."""
    total = 0.0
    for t in range(len(x)):
        for k in range(first[t], first[t + 1]):
            place = relative(three(x[t]), three(m[marks[k]]))
            W, _ = inverse6(six(C[k], 0))
            r = off(three(y[k]), place)
            bearing = atan2(place[1], place[0])
            e0 = z[k, 0] - sqrt(place[0] * place[0] + place[1] * place[1])
            e1 = wrap_angle(z[k, 1] - bearing)
            exact = e0 * e0 / q[k, 0] + e1 * e1 / q[k, 1]
            if third > 0.0:
                e2 = wrap_angle(z[k, 2] - bearing + place[2])
                exact += e2 * e2 / q[k, 2]
            else:
                r = r[0], r[1], 0.0
            total -= 0.5 * (exact - squared(W, r))
    return total


@njit(**OPTIONS)
def accept(
    rng: np.random.Generator, trial: Array, m: Array, ratio: Array, first: np.ndarray, marks: np.ndarray, y: Array,
    C: Array, z: Array, q: Array, third: float,
) -> bool:  # fmt: skip
    """Accept or reject a trajectory, drawn by a kernel that is reversible for the linearised density, and a new map with it.

    The map is drawn from the linearised density given the trajectory, so (trajectory, map) together are the proposal of a
    kernel that is reversible, too, and the probability of acceptance is the ratio of w = exact / linearised density.

    Args:
        m, ratio: the present map (J, 3) and log w (1,); replaced where the trajectory is accepted.
    """
    candidate = draw_map(rng, trial, first, marks, y, C, len(m), third)
    value = log_ratio(trial, candidate, first, marks, y, C, z, q, third)
    if np.log(rng.random()) >= value - ratio[0]:
        return False
    m[:], ratio[0] = candidate, value
    return True
