"""The exceptions of the framework, with one root, so that a caller can catch all mistakes of the user."""

from __future__ import annotations

from typing import Any


def printable(text: str) -> str:
    """A text that can be shown: line breaks become spaces, and what no terminal shows becomes an escape such as \\x1b.

    Names are data: the name of a file or a log may hold line breaks, the escape sequences of terminals, or bytes that are
    not UTF-8 (which Python keeps as surrogates, and no encoder takes).
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in text)


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


class OptionError(SlamError, ValueError):
    """An option or a model parameter has an impossible value."""


class GraphError(SlamError):
    """A graph cannot be built, or cannot be solved because its edges do not determine its nodes."""


class FactorError(SlamError):
    """A GTSAM factor cannot be evaluated; the text names the factor and its keys, ``description`` describes it."""

    def __init__(self, message: str, description: Any = None) -> None:
        super().__init__(f"{description}: {message}" if description is not None else message)
        self.description = description
