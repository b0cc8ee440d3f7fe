"""Numbers and points given as text on the command line, and simulated faults, checked.

`graphslam.errors` is imported where something is wrong, so that importing this module stays cheap.
"""

from __future__ import annotations

import math
from typing import Any


def check_faults(faults: dict[str, float]) -> None:
    """Raise `OptionError` for a fault that cannot be: no probability, or below zero."""
    from graphslam import OptionError

    for name, value in faults.items():
        option = "--" + name.replace("_", "-")
        if name in ("phantom", "oversight", "occlusion"):
            if not 0 <= value <= 1:
                raise OptionError(f"{option} is a probability, between 0 and 1, not {value!r}")
        elif not value >= 0 or (math.isinf(value) and not name.endswith("_interval")):
            raise OptionError(f"{option} must be a number, zero or above, not {value!r}")


def check_finite(options: dict[str, Any]) -> None:
    """Raise `OptionError` for a number of the simulator that is not finite."""
    from graphslam import OptionError

    for name, value in options.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise OptionError(f"--{name.replace('_', '-')} must be a finite number, not {value!r}")


def numbers(option: str, text: str, count: int | None = None) -> tuple[float, ...]:
    """The numbers of 'a,b,c'.

    Raises:
        OptionError: they are not finite numbers, or not as many as there should be.
    """
    from graphslam import OptionError

    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        raise OptionError(f"{option} should be numbers with commas between, not {text!r}") from None
    if not all(math.isfinite(value) for value in values):
        raise OptionError(f"{option} should be finite numbers, not {text!r}")
    if count is not None and len(values) != count:
        raise OptionError(f"{option} takes {count} numbers with commas between, not {text!r}")
    return values


def figure_formats(text: str) -> tuple[str, ...]:
    """The formats of 'png,pdf'.

    Raises:
        OptionError: there is no such format.
    """
    from graphslam.checks import check_choice

    from ..comparison import FIGURE_FORMATS

    formats = tuple(dict.fromkeys(word.strip().lower() for word in text.split(",") if word.strip()))
    for kind in formats:
        check_choice("--figures", kind, FIGURE_FORMATS)
    return formats


def points(option: str, text: str) -> list[tuple[float, ...]]:
    """The points of 'x,y x,y ...'.

    Raises:
        OptionError: they are not points.
    """
    from graphslam import OptionError

    if not text.split():
        raise OptionError(f"{option} should be points 'x,y x,y ...', not {text!r}")
    return [numbers(option, word, count=2) for word in text.split()]


def places(option: str, text: str) -> int | list[tuple[float, ...]]:
    """A number of places, or the places 'x,y x,y ...' themselves.

    Raises:
        OptionError: it is neither.
    """
    from graphslam import OptionError

    if "," in text:
        return points(option, text)
    try:
        return int(text)
    except ValueError:
        raise OptionError(f"{option} should be a whole number or points 'x,y x,y ...', not {text!r}") from None
