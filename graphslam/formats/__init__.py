"""File formats of logs: one module each, and the registry that picks one by the content of a file.

A format is a module-level `Format` with a name, a test of the file's first bytes, a reader, and a writer where logs
can be written in it. Add a format by writing its module and naming it in `FORMATS`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ..errors import FormatError, check_choice
from ..files import check_file
from ..log import Log
from . import lnpr, npz
from .base import Format

FORMATS: dict[str, Format] = {f.name: f for f in (npz.FORMAT, lnpr.FORMAT)}


def load(path: str | PathLike[str], format: str | None = None) -> Log:
    """Read a log; the format is guessed from the file's content unless named.

    Raises:
        FormatError: the file does not exist, is not of a known format, or breaks its format's rules; the message has
            file and line, what was expected and what to do.
        OptionError: ``format`` is not the name of a format.
    """
    path = Path(path)
    if format is not None:
        check_choice("format", format, tuple(FORMATS))
    check_file(path)
    if format is not None:
        return FORMATS[format].read(path)
    with path.open("rb") as stream:
        head = stream.read(4096)
    if not head.strip():
        raise FormatError(path, None, "the file is empty; a log has at least one pose and its sightings")
    for candidate in FORMATS.values():
        if candidate.recognises(head):
            return candidate.read(path)
    raise FormatError(path, 1, f"not a log in any known format ({', '.join(FORMATS)}); name the format if it is one")


def save(log: Log, path: str | PathLike[str], format: str | None = None) -> None:
    """Write a log, whole or not at all; the format follows from the suffix (.npz, .txt) unless named.

    Raises:
        FormatError: the format cannot hold what the log holds (``.npz`` holds everything), or the place cannot be
            written.
        OptionError: ``format`` is not the name of a format that can be written.
    """
    path = Path(path)
    writable = {f.name: f for f in FORMATS.values() if f.write is not None}
    if format is None:
        by_suffix = {suffix: f.name for f in writable.values() for suffix in f.suffixes}
        if path.suffix not in by_suffix:
            known = ", ".join(by_suffix)
            raise FormatError(path, None, f"cannot tell the format from the suffix {path.suffix!r}; use one of {known}")
        format = by_suffix[path.suffix]
    check_choice("format", format, tuple(writable))
    write = writable[format].write
    assert write is not None
    write(log, path)


__all__ = ["FORMATS", "Format", "load", "save"]
