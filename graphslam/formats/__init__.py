"""File formats of logs: one module each, and the registry that picks one by the content of a file.

A format is a module-level `Format` with a name, a test of the file's first bytes, a reader, and a writer where logs
can be written in it. Add a format by writing its module and naming it in `FORMATS`.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from ..checks import check_choice
from ..errors import FormatError, OptionError
from ..files import check_file
from ..log import Log
from . import huang, lnpr, lost_in_the_woods, mrclam, npz, victoria_park
from .base import Format
from .mat import is_mat

FORMATS: dict[str, Format] = {
    module.FORMAT.name: module.FORMAT for module in (npz, lnpr, mrclam, huang, lost_in_the_woods, victoria_park)
}


def load(
    path: str | PathLike[str], format: str | None = None, *, robot: int | None = None, keep_every: float | None = None
) -> Log:
    """Read a log; the format is guessed from the content of the file or folder unless named.

    Args:
        path: a file, or the folder of a data set.
        format: the name of the format.
        robot: which one, where a folder has several.
        keep_every: also keep a pose at least every so many seconds [s], where poses stand only where something was seen.

    Raises:
        FormatError: there is no such file, it is not of a known format, or breaks its format's rules; the message has
            file and line, what was expected and what to do.
        OptionError: ``format`` is not the name of a format, or an option is not for this format or impossible.
    """
    path = Path(path)
    if format is not None:
        check_choice("format", format, tuple(FORMATS))
    if not path.is_dir():
        check_file(path)
    chosen = FORMATS[format] if format is not None else _guessed(path)
    given = {name: value for name, value in (("robot", robot), ("keep_every", keep_every)) if value is not None}
    for name in given:
        if name not in chosen.options:
            raise OptionError(f"{name} is not for logs of the format {chosen.name!r} ({path})")
    return chosen.read(path, **given)


def _guessed(path: Path) -> Format:
    head = b""
    if not path.is_dir():
        with path.open("rb") as stream:
            head = stream.read(4096)
        if not head.strip():
            raise FormatError(path, None, "the file is empty; a log has at least one pose and its sightings")
    for candidate in FORMATS.values():
        if candidate.recognises(path, head):
            return candidate
    if path.is_dir():
        raise FormatError(
            path,
            None,
            "this is a folder, and not that of a known data set; slam-compare datasets tells how they must look",
        )
    raise FormatError(
        path,
        None if is_mat(head) else 1,
        f"not a log in any known format ({', '.join(FORMATS)}); name the format if it is one",
    )


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
