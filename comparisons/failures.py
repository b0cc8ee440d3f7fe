"""Errors of single parts of a result, as sentences; the other parts are still made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from graphslam import FormatError, SlamError
from graphslam.errors import printable


def sentence(error: BaseException) -> str:
    """An exception in one line: those meant for the user as they are, all others with their type."""
    text = printable(" ".join(str(error).split()))
    return text if isinstance(error, SlamError) else f"{type(error).__name__}: {text}" if text else type(error).__name__


@contextmanager
def noted(notes: list[str], failed: str) -> Iterator[None]:
    """Catch an error of the block, and add "FAILED: the error in one sentence" to the notes.

    A file or folder that cannot be written is no failure of a part: it ends the work.

    Raises:
        FormatError, OSError: the place of the results cannot be written.
    """
    try:
        yield
    except (FormatError, OSError):
        raise
    except Exception as error:
        notes.append(f"{failed}: {sentence(error)}")
