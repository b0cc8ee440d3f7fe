"""Weights as logarithms, compiled: normalise in one pass, where NumPy needs six.

Sums are kept per chunk of particles, so that they do not depend on the number of threads. Within a chunk they are kept
per lane, where lane k takes every 64th particle: the compiler may not change the order of a sum, but it can
vectorise over independent lanes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .blocks import CHUNK
from .fast_math import OPTIONS, exp
from .threads import Threads

#: partial sums per chunk
LANES = 64


def normalize(threads: Threads, log_weights: Array, highest: float) -> tuple[Array, float, float]:
    """Normalise log_weights (N,) in place so that their exponentials sum to 1.

    Returns:
        w = exp(log_weights before - highest) (N,), the sum of w and the sum of w².
    """
    weights, sums = np.empty_like(log_weights), np.empty((2, -(-len(log_weights) // CHUNK)))
    threads.run_light(_exponentials, log_weights, highest, weights, sums)
    total, squares = sums.sum(axis=1).tolist()
    log_weights -= highest + np.log(total)
    return weights, total, squares


@njit(**OPTIONS)
def _exponentials(lo: int, hi: int, log_weights: Array, highest: float, weights: Array, sums: Array) -> None:
    first, second = np.empty(LANES), np.empty(LANES)
    for chunk in range(lo, hi, CHUNK):
        first[:], second[:] = 0.0, 0.0
        end = min(chunk + CHUNK, hi)
        for start in range(chunk, end, LANES):
            n = min(LANES, end - start)
            for i in range(n):
                weights[start + i] = exp(log_weights[start + i] - highest)
            for i in range(n):
                first[i] += weights[start + i]
            for i in range(n):
                second[i] += weights[start + i] * weights[start + i]
        sums[0, chunk // CHUNK], sums[1, chunk // CHUNK] = first.sum(), second.sum()
