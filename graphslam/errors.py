"""The exceptions of the framework, with one root, so that a caller can catch all mistakes of the user."""

from __future__ import annotations

from typing import Any


class SlamError(Exception):
    """Root of all errors that this project raises on purpose; the text is one sentence for the user."""


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
