"""Import of your own tables and bags: their contents, the choice among them, and the log."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import FormatError, Log, LogError, OptionError
from graphslam.bags.bag import is_bag
from graphslam.bags.read import drive_of_bag, topics_of
from graphslam.files import check_file, check_path, check_unpacked
from graphslam.formats.bag import recipe_beside
from graphslam.formats.tables import drive_of, recipe_of
from graphslam.log_checks import Finding, check_log
from graphslam.reading import ReadOptions
from graphslam.tables.drive import Timed
from graphslam.tables.join import Drive, read_drive
from graphslam.tables.options import TABLES
from graphslam.tables.recipe import Recipe, merged, read_recipe

from .display import Displayed
from .documents import ImportDocument, describe, document
from .options import ImportOptions


@dataclass(frozen=True)
class FoundStream:
    """A table or topic that was read.

    Attributes:
        kind: odometry, sightings or truth.
        source: its file or topic.
        rows: their number.
        begin, end: of its clock [s].
        rate: rows per second; of sightings, of different times.
        columns: which column was taken for what.
    """

    kind: str
    source: str
    rows: int
    begin: float
    end: float
    rate: float | None
    columns: tuple[str, ...]


@dataclass(frozen=True)
class FoundTopic:
    """A topic of a bag.

    Attributes:
        name, type: of the topic and its messages.
        count: the number of messages.
        could_be: odometry, sightings or truth; empty where it is of no use.
        chosen: for what it is read; empty where it is not.
    """

    name: str
    type: str
    count: int
    could_be: str
    chosen: str


@dataclass(frozen=True)
class Import(Displayed):
    """The result of `import_log`: the contents of tables or a bag, and the log.

    Attributes:
        source: the folder or bag; None where each table was named.
        topics: of a bag.
        streams: the tables or topics that were read.
        log: of these; None where they make none.
        landmarks: the number of landmarks of the true map; None where there is none.
        reason: why there is no log.
    """

    source: Path | None
    topics: tuple[FoundTopic, ...] = ()
    streams: tuple[FoundStream, ...] = ()
    log: Log | None = None
    landmarks: int | None = None
    reason: str = ""

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Probable mistakes in the log, see `graphslam.log_checks`."""
        return () if self.log is None else check_log(self.log)

    def to_json(self, file: Path | None = None) -> dict[str, Any]:
        """The import as plain data, and the file that was written."""
        return document(
            ImportDocument,
            source=self.source,
            topics=[asdict(topic) for topic in self.topics],
            streams=[asdict(stream) for stream in self.streams],
            log=None if self.log is None else describe(self.log, self.source),
            warnings=[finding.message for finding in self.findings],
            file=file,
            reason=self.reason,
        )


def import_log(source: str | PathLike[str] | None = None, **options: Any) -> Import:
    """Read your own tables or bag and say what was found.

    Args:
        source: the folder of tables, or the bag; None where the options name the file of each table.
        options: fields of `options.ImportOptions`: odometry, sightings, truth, map, recipe, angles, time, columns, ...

    Returns:
        What was found. Where a bag can be opened but makes no log, ``reason`` says why.

    Raises:
        LogError: a table breaks a rule, or a bag cannot be opened.
        OptionError: an option is impossible, or does not apply.
    """
    return imported(None if source is None else Path(source), ImportOptions.of(**options))


def imported(source: Path | None, options: ImportOptions) -> Import:
    """The same as `import_log`, with the options as one object."""
    named = {table: place for table in TABLES if (place := getattr(options, table)) is not None}
    changes = options.of_component("tables")
    recipe = None if options.recipe is None else read_recipe(options.recipe)
    reading = ReadOptions(keep_every=options.keep_every)
    if source is None:
        for table in ("odometry", "sightings"):
            if table not in named:
                raise OptionError(f"name the folder or bag, or the file of each table: --{table} FILE is missing")
        tables: dict[str, Any] = {table: Path(path) for table, path in named.items()}
        drive = read_drive(**tables, options=merged(recipe or Recipe(), changes).options)
        return _made(Import(None), drive, reading, Path(named["odometry"]).resolve().parent.name)
    check_path(source)
    if not source.is_dir():
        check_file(source)
    if is_bag(source, _head(source)):
        recipe = _with_places(merged(recipe or recipe_beside(source), changes), named)
        topics = tuple(
            FoundTopic(each.topic.name, each.topic.type, each.topic.count, each.could_be, each.chosen)
            for each in topics_of(source, recipe)
        )
        found = Import(source, topics)
        try:
            return _made(found, drive_of_bag(source, recipe), reading, source.resolve().stem)
        except LogError as error:
            return replace(found, reason=str(error))
    if not source.is_dir():
        check_unpacked(source, _head(source))
        raise FormatError(
            source, None, "this is no bag; give the folder of tables, or the file of each: --odometry .. --sightings .."
        )
    recipe = _with_places(merged(recipe or recipe_of(source), changes), named)
    return _made(Import(source), drive_of(source, recipe), reading, source.resolve().name)


def _made(found: Import, drive: Drive, reading: ReadOptions, name: str) -> Import:
    with warnings.catch_warnings():
        # they are also notes of the log, which are shown
        warnings.simplefilter("ignore", UserWarning)
        log = Log(**drive.parts(reading, name))
    streams = tuple(_stream(kind, stream) for kind, stream in drive.streams.items())
    return replace(found, streams=streams, log=log, landmarks=None if drive.landmarks is None else len(drive.landmarks))


def _head(path: Path) -> bytes:
    if path.is_dir():
        return b""
    with path.open("rb") as stream:
        return stream.read(64)


def _with_places(recipe: Recipe, named: dict[str, str]) -> Recipe:
    """The recipe with the files or topics that the options name."""
    places = {table: dict(place) for table, place in recipe.places.items()}
    for table, place in named.items():
        # of a table of a folder its file, of a bag its topic
        places.setdefault(table, {}).update({"file": place, "topic": place})
    return Recipe(recipe.options, places)


def _stream(kind: str, stream: Timed) -> FoundStream:
    begin, end = stream.times[0] / 1e9, stream.times[-1] / 1e9
    different = 1 + int(np.count_nonzero(np.diff(stream.times)))
    rate = (different - 1) / (end - begin) if end > begin else None
    return FoundStream(kind, stream.table.source, len(stream.times), begin, end, rate, stream.columns)
