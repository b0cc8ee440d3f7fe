"""The exceptions of the framework, with one root, so that a caller can catch all mistakes of the user."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def printable(text: str) -> str:
    """A text that can be shown: line breaks become spaces, and what no terminal shows becomes an escape such as \\x1b.

    Names are data: the name of a file or a log may hold line breaks, the escape sequences of terminals, or bytes that are
    not UTF-8 (which Python keeps as surrogates, and no encoder takes).
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in text)


#: the most characters of one input that a message repeats
QUOTED = 80


def shortened(text: str, most: int = QUOTED) -> str:
    """A text of at most ``most`` characters: a longer one keeps its begin and ends in "..."."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def reason_of(error: Exception) -> str:
    """The message of an error. Messages of other packages may repeat a whole input, and are shortened."""
    return str(error) if isinstance(error, SlamError) else shortened(" ".join(str(error).split()))


def decimals(value: float, digits: int = 3) -> str:
    """A number with so many decimals, or with an exponent where it would have more than 15 digits before them."""
    return f"{value:.{digits}f}" if abs(value) < 1e15 else f"{value:g}"


def quoted(value: object, most: int = QUOTED) -> str:
    """An input as messages quote it: its ``repr``, of at most ``most`` characters.

    A cell of a table may have 200,000 letters, and whole numbers of more than 4,300 digits have no ``repr`` at all.
    """
    if isinstance(value, str):
        # only its begin: the whole may be a file
        text = repr(value[: most + 1])
        return text if len(text) <= most else f"{text[: most - 4]}...{text[0]}"
    try:
        return shortened(repr(value), most)
    except Exception:  # the object is the user's own
        return f"a value of type {type(value).__name__}"


def named(names: Iterable[object], most: int = QUOTED) -> str:
    """Names with commas between, as many as ``most`` characters hold, and how many are left out."""
    texts = [shortened(str(name), most) for name in names]
    shown = len(texts)
    while shown > 1 and len(", ".join(texts[:shown])) > most:
        shown -= 1
    more = f" and {len(texts) - shown} more" if shown < len(texts) else ""
    return ", ".join(texts[:shown]) + more


class SlamError(Exception):
    """Root of all errors that this project raises on purpose; the text is one sentence for the user."""

    def __str__(self) -> str:
        return printable(" ".join(super().__str__().split()))


class LogError(SlamError):
    """A log, or a file that should hold one, breaks a rule."""


class FormatError(LogError):
    """A file does not follow its format. The text starts with ``file:line:`` where one line is the cause."""

    def __init__(self, path: object, line: int | None, message: str) -> None:
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line
        #: the text without file and line
        self.problem = message


class OptionError(SlamError, ValueError):
    """An option or a model parameter has an impossible value."""


class GraphError(SlamError):
    """A graph cannot be built, or cannot be solved because its edges do not determine its nodes."""


class FactorError(SlamError):
    """A GTSAM factor cannot be evaluated; the text names the factor and its keys, ``description`` describes it."""

    def __init__(self, message: str, description: Any = None) -> None:
        super().__init__(f"{description}: {message}" if description is not None else message)
        self.description = description
