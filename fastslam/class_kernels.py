"""The classes of landmarks of the particles, compiled: how much the class that a sighting shows speaks for a landmark.

Rows 11 to 10 + n of a slice of the pool of landmarks are p(c), the probability in each particle that the landmark is of
class c; without classes there are none. The model is that of `graphslam.association.classes`, with P(shown k given c) in a
matrix (n, n + 1), whose last column, 1/n, is for sightings of unknown class.
"""

from __future__ import annotations

from math import log

import numpy as np
from numba import njit

from graphslam.association.classes import LEAST, Classes
from graphslam.se2 import Array

from .fast_math import INLINED

#: the first of these rows
FIRST = 11


def confusion_of(classes: Classes | None) -> Array:
    """P(shown k given c) (n, n + 1) of classes; (0, 1) where there are none."""
    if classes is None or classes.count == 1:
        return np.empty((0, 1))
    return np.exp(classes.log_confusion)


@njit(**INLINED)
def log_ratio(rows: Array, i: int, confusion: Array, k: int) -> float:
    """Return the log of n sum over c of p(c) P(k given c): by how much class k is likelier than for a new landmark."""
    total = 0.0
    for c in range(len(confusion)):
        total += rows[FIRST + c, i] * confusion[c, k]
    return log(len(confusion) * total)


@njit(**INLINED)
def show(rows: Array, i: int, confusion: Array, k: int, known: bool) -> None:
    """Multiply p(c), which is 1/n for a landmark that was not ``known``, by P(k given c)."""
    total = 0.0
    for c in range(len(confusion)):
        rows[FIRST + c, i] = (rows[FIRST + c, i] if known else 1.0) * confusion[c, k]
        total += rows[FIRST + c, i]
    for c in range(len(confusion)):
        rows[FIRST + c, i] /= total


@njit(**INLINED)
def log_same(rows: Array, other: Array, i: int) -> float:
    """Return the log of n sum over c of p(c) p'(c): by how much two landmarks of one class are likelier than any two."""
    n, total = len(rows) - FIRST, 0.0
    for c in range(FIRST, len(rows)):
        total += rows[c, i] * other[c, i]
    return log(max(n * total, LEAST))


@njit(**INLINED)
def join(rows: Array, other: Array, i: int) -> None:
    """Multiply the p'(c) of the other landmark by p(c), as both are one."""
    total = 0.0
    for c in range(FIRST, len(rows)):
        other[c, i] *= rows[c, i]
        total += other[c, i]
    for c in range(FIRST, len(rows)):
        other[c, i] /= total
