"""Conversion of arguments to numbers, with an `OptionError` that says what was expected."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam.checks import real_array
from graphslam.errors import OptionError, quoted
from graphslam.se2 import Array, wrap


def whole(name: str, value: Any, expected: str = "a whole number") -> int:
    """Return a Python or NumPy integer as an int; True and False are refused."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise OptionError(f"{name} must be {expected}, not {quoted(value)}") from None


def finite(name: str, value: Any, expected: str, shapes: Sequence[tuple[int, ...]]) -> Array:
    """Return a new array of finite numbers with one of the shapes."""
    try:
        array = real_array(value).copy()
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape not in shapes or not np.all(np.isfinite(array)):
        raise OptionError(f"{name} must be {expected}, not {quoted(value)}")
    return array


def index(name: str, value: Any, count: int) -> int:
    """Return a whole number between 0 and count - 1."""
    number = whole(name, value)
    if not 0 <= number < count:
        raise OptionError(f"there is no {name} {number}: they are numbered 0 to {count - 1}")
    return number


def measurements(ids: Any, sightings: ArrayLike) -> tuple[np.ndarray, Array]:
    """Return ids (k,) and sightings (k, 2 or 3) as arrays, angles wrapped; ids None stands for k unknown ids."""
    try:
        z = real_array(sightings).copy()
        numbers = np.zeros(len(z), dtype=np.int64) if ids is None else np.asarray(ids)
        if numbers.size == 0 and z.size == 0:
            return numbers, np.empty((0, 2))
        if z.ndim != 2 or z.shape[1] not in (2, 3) or numbers.shape != (len(z),):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        expected = "whole numbers (k,) and sightings (k, 2) or (k, 3)"
        raise OptionError(f"observe takes {expected}, not {quoted(ids)} and {quoted(sightings)}") from None
    if numbers.dtype.kind not in "iu":
        raise OptionError(f"the ids of landmarks must be whole numbers, not {quoted(numbers.tolist())}")
    if numbers.dtype.kind == "u" and np.any(numbers > np.iinfo(np.int64).max):
        raise OptionError(f"the ids of landmarks must be below 2^63, not {quoted(int(numbers.max()))}")
    numbers = numbers.astype(np.int64)
    if not np.all(np.isfinite(z)) or np.any(z[:, 0] <= 0):
        raise OptionError("sightings must be finite and their ranges above zero")
    z[:, 1:] = wrap(z[:, 1:])
    return numbers, z
