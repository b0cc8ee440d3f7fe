"""File formats of logs: one module each, and the registry that chooses one by the content of a file.

A format is a module-level `Format`: a name, a test of the first bytes of a file, a reader, and a writer where logs can be
written in it. Add a format by writing its module and listing it in `FORMATS`.
"""

from __future__ import annotations

from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import FormatError, OptionError, checks, quoted
from ..files import check_file, check_path, check_unpacked, first_bytes, path_of
from ..graph import Graph
from ..graph.pose_graph import DIALECTS, IN_THE_PLANE, SPATIAL, is_pose_graph
from ..log import Log, check_is_log
from ..log.continuous_time import with_poses_every
from ..log.rows import ReadOptions
from . import bag_drive as bag
from . import huang, lnpr, lost_in_the_woods, mrclam, npz, pyfg, tables, victoria_park
from .base import Format
from .mat import is_mat

FORMATS: dict[str, Format] = {
    module.FORMAT.name: module.FORMAT
    for module in (npz, pyfg, lnpr, mrclam, huang, lost_in_the_woods, victoria_park, bag, tables)
}


def load(path: str | PathLike[str], *, format: str | None = None, **options: Any) -> Log:
    """Read a log; the format is recognised by the content of the file or folder unless it is named.

    Args:
        path: a file, or the folder of a data set.
        format: the name of the format.
        options: the fields of `ReadOptions`: ``robot``, the number of the robot where a data set has several;
            ``keep_every`` [s], keep a pose at least this often, also where nothing was seen.

    Raises:
        FormatError: there is no such file, it is not of a known format, or breaks its format's rules; the message has
            file and line, what was expected and what to do.
        OptionError: ``path`` is no path, ``format`` not the name of a format, or an option does not apply to this format or
            is impossible.
    """
    path = path_of(path)
    chosen = _format_of(path, format)
    known = [f.name for f in fields(ReadOptions)]
    checks.check_known("load", options, known, f"; its options are format, {', '.join(known)}")
    if options.get("robot") is not None and chosen.robots is None:
        raise OptionError(f"robot does not apply to logs of the format {quoted(chosen.name)} ({path}); leave it out")
    reading = ReadOptions(**options)
    log, seconds = chosen.read(path, reading), reading.keep_every
    return log if seconds is None or chosen.separate_times else with_poses_every(log, seconds)


def read(path: str | PathLike[str], *, format: str | None = None, **options: Any) -> Log | Graph:
    """The log of a file or folder, as `load` reads it, or the graph of a pose-graph file (`Graph.from_g2o`), by its content.

    Args:
        path, format, options: as `load`; ``format`` is also "g2o", "toro" or "isam". Pose graphs have no options.

    Raises:
        FormatError, OptionError: as `load`. GraphError: the graph falls into several pieces.
    """
    path = path_of(path)
    head = first_bytes(path) if format is None and path.is_file() else b""
    is_graph = is_pose_graph(head) and not any(form.recognises(path, head) for form in FORMATS.values())
    if format in DIALECTS or is_graph:
        if options:
            raise OptionError(f"{next(iter(options))} does not apply to pose graphs ({path}); leave it out")
        return Graph.from_g2o(path, format=format)
    return load(path, format=format, **options)


def robots_in(path: str | PathLike[str], *, format: str | None = None) -> list[int]:
    """The numbers of the robots of a data set; empty for a log of one robot, and for what has no numbers of robots.

    Raises:
        FormatError, OptionError: as `load`.
    """
    path = path_of(path)
    chosen = _format_of(path, format)
    return [] if chosen.robots is None or not path.is_dir() else chosen.robots(path)


def load_robots(path: str | PathLike[str], *, format: str | None = None, **options: Any) -> dict[int, Log]:
    """The logs of all robots of a data set by their numbers, for `graphslam.sessions.join_robots`.

    Their sightings of each other have the class "robot N" and no id.

    Args:
        path: the folder of a data set.
        format: the name of the format.
        options: the fields of `ReadOptions`, except for ``robot``.

    Raises:
        FormatError, OptionError: as `load`; the format has logs of one robot only.
    """
    path = path_of(path)
    chosen = _format_of(path, format)
    if chosen.read_robots is None:
        raise OptionError(f"logs of the format {quoted(chosen.name)} are of one robot ({path}); load reads them")
    known = [field.name for field in fields(ReadOptions) if field.name != "robot"]
    checks.check_known("load_robots", options, known, f"; it takes {', '.join(known)}")
    return chosen.read_robots(path, ReadOptions(**options))


def _format_of(path: Path, format: str | None) -> Format:
    """The format that is named, or that of the file or folder."""
    if format is not None:
        checks.check_choice("format", format, FORMATS)
    check_path(path)
    if not path.is_dir():
        check_file(path)
    return FORMATS[format] if format is not None else _recognised(path)


def _recognised(path: Path) -> Format:
    head = first_bytes(path)
    if not path.is_dir() and not head.strip():
        raise FormatError(path, None, "the file is empty; a log has at least one pose and its sightings")
    for candidate in FORMATS.values():
        if candidate.recognises(path, head):
            return candidate
    if path.is_dir():
        message = "this is a folder, and not that of a known data set; slam-compare datasets lists their files"
        raise FormatError(path, None, message)
    check_unpacked(path, head)
    if head.lstrip().startswith(tuple(tag.encode() for tag in SPATIAL)):
        raise FormatError(path, 1, f"this is a pose graph in space; {IN_THE_PLANE}")
    if head.lstrip().startswith((b"VERTEX", b"EDGE")):
        message = "this is a pose graph and no log; slam-compare backends FILE solves it, and Graph.from_g2o reads it"
        raise FormatError(path, 1, message)
    raise FormatError(
        path,
        None if is_mat(head) else 1,
        f"not a log in any known format ({', '.join(FORMATS)}); name the format if it is one. Tables of your own are a "
        "folder with odometry.csv and sightings.csv; slam-compare import --odometry FILE --sightings FILE joins others",
    )


def save(log: Log, path: str | PathLike[str], *, format: str | None = None) -> None:
    """Write a log, completely or not at all; the format follows from the suffix (.npz, .txt) unless it is named.

    Raises:
        FormatError: the format cannot hold what the log holds (``.npz`` holds everything), or the file cannot be written.
        OptionError: ``log`` is no `Log`, ``path`` is no path, or ``format`` is not the name of a format that can be written.
    """
    check_is_log(log)
    path = path_of(path)
    check_path(path)
    writers = {f.name: f.write for f in FORMATS.values() if f.write is not None}
    if format is None:
        by_suffix = {suffix: name for name in writers for suffix in FORMATS[name].suffixes}
        if path.suffix.lower() not in by_suffix:
            message = f"cannot tell the format from the suffix {quoted(path.suffix)}; use one of {', '.join(by_suffix)}"
            raise FormatError(path, None, message)
        format = by_suffix[path.suffix.lower()]
    checks.check_choice("format", format, writers)
    writers[format](log, path)


__all__ = ["FORMATS", "Format", "ReadOptions", "load", "load_robots", "read", "robots_in", "save"]
