"""Text files of numbers: words, and tables of columns; errors name the line."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..checks import first
from ..errors import FormatError, decimals, quoted, shortened
from ..files import read_text
from ..reading import Fault, finite_fault, sound_rows
from ..se2 import Array
from ..sources.streams import MOST_DISORDER, disorder
from ..tables.times import time_faults


def number(path: Path, line: int, what: str, word: str) -> float:
    """A word as a finite number.

    Raises:
        FormatError: it is none; the message begins with ``what`` it should be.
    """
    try:
        value = float(word)
        if "_" in word:
            raise ValueError  # Python reads 1_0 as 10, other programs do not
    except ValueError:
        raise FormatError(path, line, f"{what} should be a number, not {quoted(word)}") from None
    if not math.isfinite(value):
        raise FormatError(path, line, f"{what} is {shortened(word)}; only finite numbers are allowed")
    return value


def whole(path: Path, line: int, what: str, word: str) -> int:
    """A word as a whole number of at most 64 bits.

    Raises:
        FormatError: it is none; the message begins with ``what`` it should be.
    """
    try:
        value = int(word)
        if "_" in word:
            raise ValueError
    except ValueError:
        raise FormatError(path, line, f"{what} should be a whole number, not {quoted(word)}") from None
    if not -(2**63) <= value < 2**63:
        raise FormatError(path, line, f"{what} should be a whole number of at most 64 bits, not {quoted(word)}")
    return value


def read_columns(
    path: Path,
    columns: tuple[str, ...],
    *,
    times: bool = False,
    notes: list[str] | None = None,
    noun: str = "rows",
    faults: Callable[[Array], Sequence[Fault]] = lambda _: (),
    strict: bool = False,
) -> Array:
    """The numbers of a file, one row per line, (N, len(columns)). ``#`` begins a comment.

    Args:
        path: the file.
        columns: the names of the columns, for messages.
        times: whether the first column is times, which may be out of order by at most `streams.MOST_DISORDER`.
        notes: where it is given, rows that cannot be are left out, and counted in it (`reading.sound_rows`).
        noun, strict: what the rows are, and whether the first one that cannot be is refused.
        faults: what cannot be beside numbers that are not finite.

    Raises:
        FormatError: the file is not text, a line has other columns, or times run backwards by more; with the line.
    """
    # loadtxt warns about files without rows, which the caller checks
    lines = [line for line in read_text(path).splitlines() if line.split("#", 1)[0].strip()]
    try:
        rows = np.loadtxt(lines, comments="#", ndmin=2) if lines else np.empty((0, len(columns)))
    except ValueError:
        rows = np.empty((0, 0))
    if rows.shape[1] != len(columns) or (notes is None and not np.all(np.isfinite(rows))):
        _refuse(path, columns)
    numbers = np.arange(len(rows))
    if notes is not None:
        finite = [finite_fault(rows[:, k], name) for k, name in enumerate(columns) if k or not times]
        wrong = [*(time_faults(rows[:, 0], "the time", "s", MOST_DISORDER) if times else ()), *finite, *faults(rows)]
        kept, about = sound_rows(
            len(rows), noun, wrong, lambda k, text: FormatError(path, line_of(path, k), text), strict=strict,
            source=path.name,
        )  # fmt: skip
        notes += about
        rows, numbers = rows[kept], numbers[kept]
    if times and (k := first(disorder(rows[:, 0]) > MOST_DISORDER)) is not None:
        before = rows[:k, 0].max()
        message = (
            f"time runs backwards: {decimals(rows[k, 0])} s comes after {decimals(before)} s; sort the lines by time"
        )
        raise FormatError(path, line_of(path, int(numbers[k])), message)
    return rows


def line_of(path: Path, row: int) -> int:
    """The line, counted from 1, of a row of `read_columns`."""
    return _numbered(path)[row][0]


def _numbered(path: Path) -> list[tuple[int, list[str]]]:
    lines = enumerate(read_text(path).splitlines(), start=1)
    return [(number, words) for number, line in lines if (words := line.split("#", 1)[0].split())]


def _refuse(path: Path, columns: tuple[str, ...]) -> None:
    """Raise the error of the first line that is wrong."""
    form = ", ".join(columns)
    for line, words in _numbered(path):
        if len(words) != len(columns):
            raise FormatError(path, line, f"expected {len(columns)} columns ({form}), found {len(words)}")
        for column, word in zip(columns, words):
            number(path, line, column, word)
    raise FormatError(path, None, f"cannot be read as columns {form}")
