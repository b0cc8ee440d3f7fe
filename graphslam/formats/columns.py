"""Text files of numbers in columns, read fast, and blamed line by line when they are wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..se2 import Array


def read_columns(path: Path, columns: tuple[str, ...], *, times: bool = False) -> Array:
    """The numbers of a file, one row a line, (N, len(columns)). ``#`` begins a comment; line ends may be Windows'.

    Args:
        path: the file.
        columns: what the columns hold, for messages.
        times: whether the first column is times that must not run backwards.

    Raises:
        FormatError: the file is not text, a line has other columns, or times run backwards; with the line.
    """
    rows: Array | None
    try:
        with path.open(encoding="utf-8-sig") as stream:
            # loadtxt warns of files without rows, which is for the caller to judge
            lines = [line for line in stream if line.split("#", 1)[0].strip()]
        rows = np.loadtxt(lines, comments="#", ndmin=2) if lines else np.empty((0, len(columns)))
    except UnicodeDecodeError:
        raise FormatError(path, None, "not a text file (it has bytes that are not UTF-8)") from None
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    except ValueError:
        rows = None
    if rows is None or rows.shape[1] != len(columns) or not np.all(np.isfinite(rows)):
        raise _blame(path, columns)
    if times and np.any(np.diff(rows[:, 0]) < 0):
        raise _backwards(path, rows[:, 0])
    return rows


def line_of(path: Path, row: int) -> int:
    """The line that a row of `read_columns` comes from, counted from 1."""
    return _numbered(path)[row][0]


def _numbered(path: Path) -> list[tuple[int, list[str]]]:
    lines = enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1)
    return [(number, words) for number, line in lines if (words := line.split("#", 1)[0].split())]


def _blame(path: Path, columns: tuple[str, ...]) -> FormatError:
    """The error of the first line that is wrong."""
    form = ", ".join(columns)
    for number, words in _numbered(path):
        if len(words) != len(columns):
            return FormatError(path, number, f"expected {len(columns)} columns ({form}), found {len(words)}")
        for column, word in zip(columns, words):
            try:
                finite = math.isfinite(float(word))
            except ValueError:
                return FormatError(path, number, f"{column} should be a number, not {word!r}")
            if not finite:
                return FormatError(path, number, f"{column} is {word}; only finite numbers make sense here")
    return FormatError(path, None, f"cannot be read as columns {form}")


def _backwards(path: Path, times: Array) -> FormatError:
    k = int(np.argmax(np.diff(times) < 0)) + 1
    told = f"time runs backwards: {times[k]:.3f} s comes after {times[k - 1]:.3f} s; sort the lines by time"
    return FormatError(path, line_of(path, k), told)
