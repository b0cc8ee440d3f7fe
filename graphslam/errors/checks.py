"""Options: their declaration as fields of a dataclass, the checks of their values, and the messages of these checks."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Collection
from dataclasses import field
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import OptionError, quoted, shortened


def option(default: Any, help: str, unit: str = "", **more: Any) -> Any:
    """A field of an option dataclass: default, one sentence of help, and unit.

    The command line, configuration files and tables read help and unit from the ``metadata`` of
    `dataclasses.fields`, so that an option is declared once.

    Args:
        default: the default value.
        help: one sentence that says what the option does.
        unit: the unit of its value, for example "m/s"; empty where it has none.
        more: further entries of the metadata.
    """
    return field(default=default, metadata={"help": help, "unit": unit, **more})


def check_type(kind: type, **values: object) -> None:
    """Raise `OptionError` unless every keyword's value is None or of this type."""
    for name, value in values.items():
        if value is not None and not isinstance(value, kind):
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            raise OptionError(f"{name} must be {article} {kind.__name__}, not {quoted(value)}")


def check_choice(name: str, value: str, allowed: Collection[str]) -> None:
    """Raise `OptionError` unless ``value`` is one of ``allowed``."""
    if not isinstance(value, str) or value not in allowed:
        raise OptionError(f"{name} must be one of {', '.join(allowed)}, not {quoted(value)}")


def _is_real(value: object) -> bool:
    """Whether a value is a real number; NumPy's time spans count themselves among the whole numbers."""
    return isinstance(value, Real) and not isinstance(value, np.timedelta64)


def check_positive(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a positive finite number."""
    for name, value in values.items():
        if not _is_real(value) or not 0 < value <= sys.float_info.max:
            raise OptionError(f"{name} must be a positive number, not {quoted(value)}")


def check_real(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a number, which may be infinite or NaN."""
    for name, value in values.items():
        try:
            known = _is_real(value) and isinstance(float(value), float)
        except OverflowError:  # a whole number beyond 1e308
            known = False
        if not known:
            raise OptionError(f"{name} must be a number, not {quoted(value)}")


def check_number(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a finite number."""
    for name, value in values.items():
        if not _is_real(value) or isinstance(value, bool) or not abs(value) <= sys.float_info.max:
            raise OptionError(f"{name} must be a finite number, not {quoted(value)}")


def check_not_negative(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is zero or above; infinity is allowed."""
    for name, value in values.items():
        check_real(**{name: value})
        if not value >= 0:
            raise OptionError(f"{name} must not be negative, but is {quoted(value)}")


def check_count(**values: int) -> None:
    """Raise `OptionError` unless every keyword's value is a whole number, 0 or above."""
    for name, value in values.items():
        if not isinstance(value, Integral) or not _is_real(value) or isinstance(value, bool):
            raise OptionError(f"{name} must be a whole number, not {quoted(value)}")
        if value < 0:
            raise OptionError(f"{name} must not be negative, but is {quoted(value)}")


def checked_deviations(name: str, value: Any) -> dict[str, float]:
    """Standard deviations by name, {"wheel_scale": 0.03}.

    Raises:
        OptionError: it is no mapping from names to positive finite numbers.
    """
    try:
        found = {str(key): float(real_array(each)) for key, each in dict(value).items()}
        if all(0 < each < np.inf for each in found.values()):
            return found
    except (TypeError, ValueError, OverflowError):
        pass
    raise OptionError(f"{name} must be positive numbers by name, such as {{'wheel_scale': 0.03}}, not {quoted(value)}")


def checked_offset(name: str, value: Any) -> tuple[float, float]:
    """A place on the robot, (ahead, left) [m]; a single number is the distance ahead.

    Raises:
        OptionError: it is neither, or not finite.
    """
    try:
        offset = real_array(value)
    except (TypeError, ValueError, OverflowError):
        offset = np.empty(0)
    if offset.size == 1:
        offset = np.array([offset.item(), 0.0])
    if offset.shape != (2,) or not np.all(np.isfinite(offset)):
        raise OptionError(f"{name} must be (ahead, to the left) in m, or one number ahead, not {quoted(value)}")
    return float(offset[0]), float(offset[1])


def real_array(value: Any) -> np.ndarray:
    """A value as an array of floating-point numbers; NumPy alone would also turn complex numbers and times into such.

    Raises:
        TypeError, ValueError, OverflowError: it is none.
    """
    array = np.asarray(value)
    if array.dtype.kind in "cmM":
        raise TypeError(f"numbers of the type {array.dtype} are not real")
    return np.asarray(value, dtype=float)


def array_of(name: str, value: Any) -> np.ndarray:
    """A value as an array of floating-point numbers of any shape.

    Raises:
        OptionError: it is none.
    """
    try:
        return real_array(value)
    except (TypeError, ValueError, OverflowError):
        raise OptionError(f"{name} must be an array of numbers, not {quoted(value)}") from None


def first(wrong: ArrayLike) -> int | None:
    """The first index at which a condition (N,) holds, or None where it never does."""
    wrong = np.asarray(wrong, dtype=bool)
    return int(np.argmax(wrong)) if wrong.any() else None


def singular(text: str) -> str:
    """A text with '1 landmark' where it counts '1 landmarks'."""
    return re.sub(r"(?<![\w.,-])1 ([a-z]+[^\Wis])s\b", r"1 \1", text)


def listed(noun: str, numbers: list[int], most: int = 8) -> str:
    """'pose 3', 'poses 3 and 4', 'poses 1, 2, 3 and 40 more'."""
    if len(numbers) == 1:
        return f"{noun} {numbers[0]}"
    if len(numbers) > most:
        return f"{noun}s {', '.join(map(str, numbers[:most]))} and {len(numbers) - most} more"
    return f"{noun}s {', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"


def suggestion(word: object, known: Collection[str]) -> str:
    """The end of a message about an unknown word: the known word that is spelled like it, if there is one."""
    matches = difflib.get_close_matches(shortened(str(word)), list(known), n=1)
    return f"; did you mean {quoted(matches[0])}?" if matches else ""


def check_known(who: str, given: Collection[str], known: Collection[str], more: str = "") -> None:
    """Raise `OptionError` for the first of the given options that ``who`` does not have; the message ends with ``more``."""
    for name in given:
        if name not in known:
            raise OptionError(f"{who} has no option {quoted(name)}{suggestion(name, known)}{more}")


def make_read_only(owner: object, *names: str) -> None:
    """Replace arrays that are attributes of a frozen dataclass by views that cannot be written to."""
    for name in names:
        if isinstance(array := getattr(owner, name), np.ndarray):
            view = array.view()
            view.flags.writeable = False
            object.__setattr__(owner, name, view)
