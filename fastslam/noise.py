"""Gaussian random numbers that are a function of a key and an index, so that threads need no common generator.

The filter's generator draws one key per motion. Each of the N particles then has five numbers of its own, which depend
only on the key and on the particle's index. Threads therefore share nothing, and a second kernel can compute the same
numbers again instead of storing them. The bits are those of SplitMix64 (Steele, Lea and Flood, *Fast splittable
pseudorandom number generators*, OOPSLA 2014) started at the key; Box and Muller (1958) make them Gaussian.

Rejected: `Generator.standard_normal`, which takes 7 to 8 ns per number in a single thread (here: 2.3 ns), and one
generator per block of particles, which is repeatable but as slow.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .fast_math import INLINED, OPTIONS, log, sincos

#: pairs of numbers per particle and motion; the last of the six numbers is not used
PAIRS = 3

_GOLDEN, _FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_27, _30, _31, _11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)


def draw_key(rng: np.random.Generator) -> np.uint64:
    """Draw a new key: one uniform number of the generator with its 53 bits moved to the top."""
    # rng.bytes and rng.integers take 3 to 8 us, as much as a hundred particles
    return np.uint64(int(rng.random() * 2.0**53) << 11)


def standard_normals(rng: np.random.Generator, particles: int) -> Array:
    """Draw the five standard normal numbers of each particle for one motion, (N, 5), as the compiled motions use them."""
    normals = np.empty((particles, 2 * PAIRS))
    _fill(draw_key(rng), normals)
    return normals[:, :5]


@njit(**INLINED)
def normal_pair(key: np.uint64, particle: int, pair: int) -> tuple[float, float]:
    """Return two independent standard normal numbers: pair 0, 1 or 2 of a particle."""
    index = np.uint64(2 * (PAIRS * particle + pair))
    # u lies in (0, 1], as the logarithm needs; the other uniform number lies in [0, 1)
    u = 1.0 - uniform(key, index)
    sine, cosine = sincos(2 * pi * uniform(key, index + np.uint64(1)) - pi)
    radius = sqrt(-2.0 * log(u))
    return radius * cosine, radius * sine


@njit(**INLINED)
def three_normals(key: np.uint64, particle: int) -> tuple[float, float, float]:
    """Return the first three standard normal numbers of a particle."""
    n0, n1 = normal_pair(key, particle, 0)
    n2, _ = normal_pair(key, particle, 1)
    return n0, n1, n2


@njit(**INLINED)
def uniform(key: np.uint64, index: np.uint64) -> float:
    """Return the uniform number of an index, in [0, 1)."""
    bits = key + (index + np.uint64(1)) * _GOLDEN
    bits = (bits ^ (bits >> _30)) * _FIRST
    bits = (bits ^ (bits >> _27)) * _SECOND
    bits = bits ^ (bits >> _31)
    return float(np.int64(bits >> _11)) * 2.0**-53


@njit(**OPTIONS)
def _fill(key: np.uint64, normals: Array) -> None:
    for i in range(normals.shape[0]):
        for pair in range(PAIRS):
            normals[i, 2 * pair], normals[i, 2 * pair + 1] = normal_pair(key, i, pair)
