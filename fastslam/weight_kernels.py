"""Weights as logarithms, compiled: multiply, normalise. One pass each, where NumPy makes eight.

Maxima and sums are kept per chunk of particles, whatever thread does it, and within a chunk per lane, one for each
place in a short row: the compiler may not change the order of a sum, but lanes are independent of each other.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .branchless import OPTIONS, exp
from .crew import Crew
from .motion_kernels import CHUNK

LANES = 64


def multiply(crew: Crew, log_weights: Array, log_likelihood: Array) -> float:
    """log_likelihood += log_weights, (N,); the largest result. NaN does not come here."""
    maxima = np.empty(-(-len(log_weights) // CHUNK))
    crew.run_light(_multiply, log_weights, log_likelihood, maxima)
    return float(maxima.max())


def normalize(crew: Crew, log_weights: Array, highest: float) -> tuple[Array, float, float]:
    """Make exp(log_weights) sum to 1; w = exp(log_weights before - highest) (N,), sum w and sum w²."""
    weights, sums = np.empty_like(log_weights), np.empty((2, -(-len(log_weights) // CHUNK)))
    crew.run_light(_exponentials, log_weights, highest, weights, sums)
    total, squares = sums.sum(axis=1).tolist()
    log_weights -= highest + np.log(total)
    return weights, total, squares


@njit(**OPTIONS)
def _multiply(lo: int, hi: int, log_weights: Array, log_likelihood: Array, maxima: Array) -> None:
    lanes = np.empty(LANES)
    for chunk in range(lo, hi, CHUNK):
        lanes[:] = -np.inf
        end = min(chunk + CHUNK, hi)
        for start in range(chunk, end, LANES):
            for i in range(min(LANES, end - start)):
                value = log_likelihood[start + i] + log_weights[start + i]
                log_likelihood[start + i] = value
                lanes[i] = value if value > lanes[i] else lanes[i]
        maxima[chunk // CHUNK] = lanes.max()


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
