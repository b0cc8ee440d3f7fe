"""The exceptions of the framework: one root, so that a caller can catch everything that is a user's mistake."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any


class SlamError(Exception):
    """Root of all errors that this project raises on purpose; its text is one sentence meant for the user."""


class LogError(SlamError):
    """A log, or the file that should hold one, is not what it has to be."""


class FormatError(LogError):
    """A file does not follow its format. The text starts with ``file:line:`` where a line is to blame."""

    def __init__(self, path: object, line: int | None, message: str) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line


class OptionError(SlamError, ValueError):
    """An option or a model parameter has a value that it cannot have."""


class GraphError(SlamError):
    """A graph cannot be built, or cannot be solved because its edges do not determine its nodes."""


class FactorError(SlamError):
    """A GTSAM factor cannot be evaluated; the text names the factor and its keys, ``description`` is what it is."""

    def __init__(self, message: str, description: Any = None) -> None:
        super().__init__(f"{description}: {message}" if description is not None else message)
        self.description = description


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
