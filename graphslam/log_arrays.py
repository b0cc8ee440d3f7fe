"""The arguments of a `Log` as arrays: shapes, types and impossible values are refused in one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import array_of, first, real_array
from .errors import LogError, OptionError, quoted, shortened
from .se2 import Array


def length_of(value: Any) -> int | None:
    """The number of rows of an array or a list; None of what has none."""
    try:
        return len(value)
    except TypeError:
        return None


def checked_starts(value: np.ndarray, controls: int) -> np.ndarray:
    """The first control of each motion, and the number of controls, (T+1,)."""
    try:
        starts = np.array(value)
    except ValueError:  # rows of different lengths
        starts = np.empty(0)
    whole = starts.ndim == 1 and len(starts) > 0 and starts.dtype.kind in "iu"
    if not whole or starts[0] != 0 or starts[-1] != controls or np.any(np.diff(starts) <= 0):
        raise LogError(
            f"control_starts must be whole numbers, one per pose, that increase from 0 to the number of controls, {controls}"
        )
    return starts.astype(np.int64)


def checked_truth(value: ArrayLike, shape: tuple[int, ...], name: str = "true_poses") -> Array:
    """True poses; each row is complete, a position with an unknown heading, or unknown."""
    array = array_of(name, value)
    unknown = np.isnan(array)
    known = finite_floats(name, np.where(unknown, 0.0, array) if array.shape == shape else array, shape)
    k = first((unknown[:, 0] != unknown[:, 1]) | (unknown[:, 0] & ~unknown[:, 2]))
    if k is not None:
        raise LogError(f"{name}[{k}] is {array[k]}; a row must be complete, (x, y, NaN) or all NaN")
    known[unknown] = np.nan
    return known


def checked_classes(value: ArrayLike, length: int) -> np.ndarray:
    """Classes as words, or as whole numbers."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise LogError(f"classes must be words, or whole numbers, one per sighting, not {quoted(value)}") from None
    if array.dtype.kind == "O" and all(isinstance(each, str) for each in array.flat):
        array = array.astype(str)
    if array.dtype.kind != "U":
        return whole_numbers("classes", array, length, "words, or whole numbers")
    if array.shape != (length,):
        raise LogError(f"classes must have one entry per sighting, shape ({length},), not {array.shape}")
    return np.char.strip(array)


def checked_landmarks(value: Any) -> dict[int, Array]:
    """The true map, {id: (x, y) or (x, y, heading)}."""
    if not isinstance(value, Mapping):
        raise OptionError(f"true_landmarks must be a mapping {{id: (x, y) or (x, y, heading)}}, not {quoted(value)}")
    for j in value:
        if not isinstance(j, (int, float, np.integer)) or j % 1 != 0 or not -(2**63) <= j < 2**63:
            raise OptionError(f"the ids of true_landmarks must be whole numbers of at most 64 bits, not {quoted(j)}")
    return {int(j): _landmark(int(j), m) for j, m in value.items()}


def _landmark(id: int, value: ArrayLike) -> Array:
    landmark = finite_floats(f"true_landmarks[{id}]", value, (None,))
    if len(landmark) not in (2, 3):
        raise LogError(f"true_landmarks[{id}] must be (x, y) or (x, y, heading), not of shape {landmark.shape}")
    return landmark


def finite_floats(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """A copy of an array of finite numbers of a shape, in which None stands for any length."""
    try:
        array = real_array(value).copy()
    except (TypeError, ValueError, OverflowError) as error:
        raise LogError(f"{name} must be an array of numbers: {shortened(str(error))}") from None
    if array.ndim != len(shape) or any(want is not None and want != have for want, have in zip(shape, array.shape)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise LogError(f"{name} must have shape ({wanted}), not {array.shape}")
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise LogError(f"{name}{where} is {array[tuple(where)]}; all numbers must be finite")
    return array


def whole_numbers(
    name: str, value: ArrayLike, length: int, wanted: str = "whole numbers", noun: str = "sighting"
) -> np.ndarray:
    """A copy of an array (length,) of whole numbers of 64 bits, one for each ``noun``."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise LogError(f"{name} must be {wanted}, one per {noun}, not {quoted(value)}") from None
    if array.size == 0:
        array = array.astype(np.int64).reshape(-1)
    if array.shape != (length,):
        raise LogError(f"{name} must have one entry per {noun}, shape ({length},), not {array.shape}")
    try:
        with np.errstate(invalid="ignore"):
            if array.dtype.kind in "cmM":
                raise TypeError
            whole = array.astype(np.int64)
    except (TypeError, ValueError, OverflowError):  # of a word, or None
        raise LogError(f"{name} must be {wanted}, not such as {quoted(array[0])}") from None
    if not np.array_equal(whole, array):
        raise LogError(f"{name} must be {wanted}")
    return whole.copy()


@dataclass(frozen=True)
class Session:
    """One of the drives, or robots, that a log was joined from: its name, its first step, and the time of that [s]."""

    name: str
    start: int
    start_time: float


def check_sessions(sessions: Sequence[Session], poses: int) -> None:
    """Raise `LogError` unless the first steps of sessions, if there are any, increase from 0 and are below ``poses``."""
    starts = [each.start for each in sessions]
    if starts and (starts[0] != 0 or np.any(np.diff([*starts, poses]) <= 0)):
        raise LogError(f"sessions start at the steps {starts}; these must increase from 0 and be below {poses}")
