"""`Format`, the description of a file format of logs, and what readers share: text files of numbers; errors name lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError, decimals
from ..errors.checks import first
from ..files import number, read_text
from ..log import Log
from ..log.cells import time_faults
from ..log.rows import Fault, ReadOptions, finite_fault, sound_rows
from ..log.streams import MOST_DISORDER, disorder
from ..se2 import Array

#: the message about a data set in which no landmark was seen
NO_SIGHTING = "no sighting of any landmark: nothing to estimate from"


@dataclass(frozen=True)
class Format:
    """A file format of logs.

    Attributes:
        name: as in the option ``format`` of `load`.
        recognises: tests a path and its first bytes; a folder has none.
        read: the reader.
        write: the writer, where logs can be written in this format.
        suffixes: usual suffixes of files to write.
        robots: the numbers of the robots of a data set, for formats that may have several.
        read_robots: the reader of all of them, {number: log}, whose sightings of each other have the class "robot N".
        separate_times: whether odometry and sightings have their own times, so that poses are chosen by the reader.
    """

    name: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, ReadOptions], Log]
    write: Callable[[Log, Path], None] | None = None
    suffixes: tuple[str, ...] = ()
    robots: Callable[[Path], list[int]] | None = None
    read_robots: Callable[[Path, ReadOptions], dict[int, Log]] | None = None
    separate_times: bool = False


def member(folder: Path, name: str, holds: str) -> Path:
    """The path of a file of a data set.

    Raises:
        FormatError: the file is missing; the message says what it would hold.
    """
    path = folder / name
    if not path.is_file():
        raise FormatError(path, None, f"this file of the data set is missing; it would hold {holds}")
    return path


def optional_member(folder: Path, name: str, holds: str, notes: list[str]) -> Path | None:
    """The path of a file of a data set, or None and a note where it is missing."""
    path = folder / name
    if path.is_file():
        return path
    notes.append(f"{name}, which would hold {holds}, is missing: read without")
    return None


@contextmanager
def errors_name(path: Path) -> Iterator[None]:
    """Errors of the log become errors of the file that it is read from."""
    try:
        yield
    except FormatError:
        raise
    except LogError as error:
        raise FormatError(path, None, str(error)) from None


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
        notes: where it is given, rows that cannot be are left out, and counted in it (`log.rows.sound_rows`).
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
        which = f"{decimals(rows[k, 0])} s comes after {decimals(np.max(rows[:k, 0]))} s"
        message = f"time runs backwards: {which}; sort the lines by time"
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
