"""Blocks of particles: the small buffers in which the kernels compute.

Arrays of particles are stored with the particle as the last axis, poses as (3, N), so that one number of all particles
is contiguous. A kernel takes particles lo to hi in blocks: it copies the numbers of a block into a buffer, computes
there, and copies the results out. Only then can the compiler prove that input and output do not overlap, and vectorise
over four to eight particles.

A Gaussian of a landmark or of a pose is nine numbers: the mean (3) and the upper triangle of the covariance (6), row by
row. A landmark without heading is stored as five: m_x, m_y, S_xx, S_xy, S_yy.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .fast_math import INLINED

Three = tuple[float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]

#: particles per block
BLOCK = 128
#: threads take ranges of whole chunks, so that no sum and no block depends on the number of threads
CHUNK = 8 * BLOCK
#: which of the nine numbers are stored of a landmark without heading
WITHOUT_HEADING = (0, 1, 3, 4, 6)


@njit(**INLINED)
def copy_in(block: Array, first: int, source: Array, start: int, n: int) -> None:
    """Copy particles start to start + n of source into the rows first, first + 1, ... of a block."""
    for k in range(source.shape[0]):
        for i in range(n):
            block[first + k, i] = source[k, start + i]


@njit(**INLINED)
def copy_out(block: Array, first: int, target: Array, start: int, n: int) -> None:
    """Copy the rows first, first + 1, ... of a block to particles start to start + n of target.

    A target of five rows takes those of a landmark without heading out of nine.
    """
    for k in range(target.shape[0]):
        row = first + (WITHOUT_HEADING[k] if target.shape[0] == 5 else k)
        for i in range(n):
            target[k, start + i] = block[row, i]


@njit(**INLINED)
def gather(block: Array, first: int, source: Array, slots: np.ndarray, start: int, n: int) -> None:
    """Copy the columns of source at the slots of particles start to start + n into a block, five rows as `copy_out`."""
    for k in range(source.shape[0]):
        row = first + (WITHOUT_HEADING[k] if source.shape[0] == 5 else k)
        for i in range(n):
            block[row, i] = source[k, slots[start + i]]


@njit(**INLINED)
def get_three(rows: Array, first: int, i: int) -> Three:
    """Return the numbers of particle i in three rows."""
    return rows[first, i], rows[first + 1, i], rows[first + 2, i]


@njit(**INLINED)
def get_nine(rows: Array, first: int, i: int) -> Nine:
    """Return the numbers of particle i in nine rows."""
    return (*get_three(rows, first, i), *get_three(rows, first + 3, i), *get_three(rows, first + 6, i))


@njit(**INLINED)
def put_nine(rows: Array, first: int, i: int, values: Nine) -> None:
    """Write nine numbers of particle i."""
    rows[first, i], rows[first + 1, i], rows[first + 2, i] = values[0], values[1], values[2]
    rows[first + 3, i], rows[first + 4, i], rows[first + 5, i] = values[3], values[4], values[5]
    rows[first + 6, i], rows[first + 7, i], rows[first + 8, i] = values[6], values[7], values[8]


@njit(**INLINED)
def padded(values: Array, fill: float) -> Three:
    """Return an array of two or three numbers as three numbers."""
    return values[0], values[1], values[2] if len(values) == 3 else fill


def unpack(numbers: Array, coordinates: int) -> tuple[Array, Array]:
    """Return the means (k, n) and covariances (k, n, n) of k stored Gaussians, (5, k) or (9, k); n = 2 or 3."""
    stored = 2 if len(numbers) == 5 else 3
    rows, columns = np.triu_indices(stored)
    covariances = np.empty((numbers.shape[1], stored, stored))
    covariances[:, rows, columns] = covariances[:, columns, rows] = numbers[stored:].T
    return numbers[:coordinates].T.copy(), covariances[:, :coordinates, :coordinates].copy()
