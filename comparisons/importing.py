"""Import of your own tables and bags: what was found, which choice was made, and the log that it makes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Log, OptionError
from graphslam.files import check_file
from graphslam.formats.tables import drive_of, recipe_of
from graphslam.reading import ReadOptions
from graphslam.tables.join import Drive, read_drive
from graphslam.tables.options import TABLES
from graphslam.tables.recipe import Recipe, merged, read_recipe

from .display import Displayed
from .documents import ImportDocument, document
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
class Import(Displayed):
    """What `import_log` found in tables or a bag, and the log that it makes.

    Attributes:
        source: the folder or bag; None where each table was named.
        streams: the tables or topics that were read.
        log: of these.
        landmarks: the number of landmarks of the true map; None where there is none.
    """

    source: Path | None
    streams: tuple[FoundStream, ...]
    log: Log
    landmarks: int | None

    def to_json(self, file: Path | None = None) -> dict[str, Any]:
        """The import as plain data, and the file that was written."""
        from .comparison import describe

        return document(
            ImportDocument,
            source=self.source,
            streams=[asdict(stream) for stream in self.streams],
            log=describe(self.log, self.source),
            file=file,
        )


def import_log(source: str | PathLike[str] | None = None, **options: Any) -> Import:
    """Read your own tables or bag and say what was found.

    Args:
        source: the folder of tables, or the bag; None where the options name the file of each table.
        options: fields of `options.ImportOptions`: odometry, sightings, truth, map, recipe, angles, time, columns, ...

    Raises:
        LogError: a table or message breaks a rule.
        OptionError: an option is impossible, or does not apply.
    """
    return imported(None if source is None else Path(source), ImportOptions.of(**options))


def imported(source: Path | None, options: ImportOptions) -> Import:
    """The same as `import_log`, with the options as one object."""
    named = {table: place for table in TABLES if (place := getattr(options, table)) is not None}
    drive, name = _drive(source, options, named)
    reading = ReadOptions(keep_every=options.keep_every)
    log = Log(**drive.parts(reading, name))
    streams = tuple(_found(kind, stream) for kind, stream in drive.streams.items())
    return Import(source, streams, log, None if drive.landmarks is None else len(drive.landmarks))


def _drive(source: Path | None, options: ImportOptions, named: dict[str, str]) -> tuple[Drive, str]:
    """The streams, and the name of the log."""
    changes = options.of_component("tables")
    own = None if options.recipe is None else read_recipe(options.recipe)
    if source is None:
        recipe = merged(own or Recipe(), changes)
        for table in ("odometry", "sightings"):
            if table not in named:
                raise OptionError(f"name the folder or bag, or the file of each table: --{table} FILE is missing")
        tables: dict[str, Any] = {table: Path(path) for table, path in named.items()}
        return read_drive(**tables, options=recipe.options), Path(named["odometry"]).resolve().parent.name
    if not source.is_dir():
        check_file(source)
    recipe = merged(own or (recipe_of(source) if source.is_dir() else Recipe()), changes)
    recipe = _with_places(recipe, named, "file")
    return drive_of(source, recipe), source.resolve().name


def _with_places(recipe: Recipe, named: dict[str, str], what: str) -> Recipe:
    """The recipe with the files or topics that the options name."""
    places = {table: dict(place) for table, place in recipe.places.items()}
    for table, place in named.items():
        places.setdefault(table, {})[what] = place
    return Recipe(recipe.options, places)


def _found(kind: str, stream: Any) -> FoundStream:
    begin, end = stream.times[0] / 1e9, stream.times[-1] / 1e9
    different = len(np.unique(stream.times))
    rate = (different - 1) / (end - begin) if end > begin else None
    return FoundStream(kind, stream.table.source, len(stream.times), begin, end, rate, stream.columns)
