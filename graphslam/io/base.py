"""`Format`, the description of a file format of logs; and the files of a data set, by which errors are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import FormatError, LogError
from ..log import Log
from ..log.rows import ReadOptions

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
    if (path := folder / name).is_file():
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
