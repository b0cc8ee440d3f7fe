"""The exceptions of the framework: one root, so that a caller can catch everything that is a user's mistake."""

from __future__ import annotations

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
