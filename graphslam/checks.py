"""Checks of options at the door, and the words of their messages."""

from __future__ import annotations

from numbers import Integral, Real

from .errors import OptionError


def check_choice(option: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise `OptionError` unless ``value`` is one of ``allowed``."""
    if value not in allowed:
        raise OptionError(f"{option} must be one of {', '.join(allowed)}, not {value!r}")


def check_positive(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a positive finite number."""
    for option, value in values.items():
        if not isinstance(value, Real) or not 0 < value < float("inf"):
            raise OptionError(f"{option} must be a positive number, not {value!r}")


def check_count(**values: int) -> None:
    """Raise `OptionError` unless every keyword's value is a whole number, 0 or above."""
    for option, value in values.items():
        if not isinstance(value, Integral) or isinstance(value, bool):
            raise OptionError(f"{option} must be a whole number, not {value!r}")
        if value < 0:
            raise OptionError(f"{option} must not be negative, but is {value}")


def listed(noun: str, numbers: list[int], most: int = 8) -> str:
    """'pose 3', 'poses 3 and 4', 'poses 1, 2, 3 and 40 more'."""
    if len(numbers) == 1:
        return f"{noun} {numbers[0]}"
    if len(numbers) > most:
        return f"{noun}s {', '.join(map(str, numbers[:most]))} and {len(numbers) - most} more"
    return f"{noun}s {', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"
