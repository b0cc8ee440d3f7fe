"""What users hand in, as the numbers that it should be, or an `OptionError` that says what was expected."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np

from graphslam.errors import OptionError
from graphslam.se2 import Array


def whole(name: str, value: Any, expected: str = "a whole number") -> int:
    """A Python or NumPy integer; True and False are none."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise OptionError(f"{name} must be {expected}, not {value!r}") from None


def real(name: str, value: Any, expected: str) -> float:
    """One number, perhaps not finite."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise OptionError(f"{name} must be {expected}, not {value!r}") from None


def reals(name: str, value: Any, expected: str) -> Array:
    """A new array of numbers, of any shape."""
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise OptionError(f"{name} must be {expected}, not {value!r}") from None


def instance(name: str, value: Any, kind: type) -> None:
    """Raise unless the value is None or of this class."""
    if value is not None and not isinstance(value, kind):
        raise OptionError(f"{name} must be a {kind.__name__}, not {value!r}")
