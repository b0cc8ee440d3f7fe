"""Gaussian random numbers that are a function of a key and an index, so that threads need no common generator.

The filter's generator draws one key per motion. Each of the N particles then has five numbers of its own, which depend
only on the key and on the particle's index (`vmslam/numbers/random.hpp` in the engine).

Rejected: `Generator.standard_normal`, which takes 7 to 8 ns per number in a single thread (here: 2.3 ns), and one
generator per block of particles, which is repeatable but as slow.
"""

from __future__ import annotations

import numpy as np

from graphslam.engine import engine
from graphslam.se2 import Array


def draw_key(rng: np.random.Generator) -> int:
    """Draw a new key: one uniform number of the generator with its 53 bits moved to the top."""
    # rng.bytes and rng.integers take 3 to 8 us, as much as a hundred particles
    return int(rng.random() * 2.0**53) << 11


def standard_normals(rng: np.random.Generator, particles: int) -> Array:
    """Draw the five standard normal numbers of each particle for one motion, (N, 5), as the filters use them."""
    normals: Array = engine.standard_normals(draw_key(rng), particles)
    return normals
