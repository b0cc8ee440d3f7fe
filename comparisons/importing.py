"""Import of your own tables and bags: their contents, the choice among them, and the log (`import_log`).

`inspect_log` describes a log before it is solved: times and rates, sightings of each landmark, histograms, and what is
probably wrong.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from graphslam import FormatError, Log, LogError, OptionError, SensorModel
from graphslam.files import check_file, check_path, check_unpacked, first_bytes
from graphslam.io.bag_drive import drive_of_bag, topics_of
from graphslam.io.bag_topics import is_bag
from graphslam.io.tables import RECIPE, Recipe, drive_of, merged, read_recipe, recipe_if_any
from graphslam.log.drive import Timed
from graphslam.log.join import Drive, read_drive
from graphslam.log.rows import TABLES, ReadOptions
from graphslam.log_checks import Finding, check_log
from graphslam.log_checks.readings import comparable
from graphslam.se2 import Array

from .options import ImportOptions, ReadingOptions
from .options.reading import read_log
from .results import Count, Displayed, LogDocument, Numbers, describe, one_of
from .results.files import elapsed_of

#: what a table or topic holds
Kind = Annotated[str, one_of("odometry", "sightings", "truth")]
Possible = Annotated[str, one_of("odometry", "sightings", "truth", "")]


@dataclass(frozen=True)
class FoundStream:
    """A table or topic that was read.

    Attributes:
        kind: what it holds.
        source: its file or topic.
        rows: their number.
        begin, end: the first and the last time of its clock [s].
        rate: different times per second.
        columns: which column was taken for what, with its unit.
    """

    kind: Kind
    source: str
    rows: Count
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
        could_be: what it could be; empty where it is of no use.
        chosen: for what it is read; empty where it is not.
    """

    name: str
    type: str
    count: Count
    could_be: Possible
    chosen: Possible


@dataclass(frozen=True)
class Import(Displayed):
    """The result of `import_log`: the contents of tables or a bag, and the log.

    Attributes:
        source: the folder or bag; null where each table was named.
        topics: the topics of a bag.
        streams: the tables or topics that were read.
        log: of these; None where they make none.
        landmarks: the number of landmarks of the true map; None where there is none.
        reason: why there is no log.
        file: the log that was written; null where none was.
    """

    source: Path | None
    topics: tuple[FoundTopic, ...] = ()
    streams: tuple[FoundStream, ...] = ()
    log: Log | None = field(default=None, repr=False)
    landmarks: int | None = field(default=None, repr=False)
    reason: str = ""
    file: Path | None = None
    shown: ClassVar = {"log": "described", "warnings": "warnings"}

    @property
    def described(self) -> LogDocument | None:
        """The log; null where the topics make none."""
        return None if self.log is None else describe(self.log, self.source)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Probable mistakes in the log, see `graphslam.log_checks`."""
        return () if self.log is None else check_log(self.log)

    @property
    def warnings(self) -> list[str]:
        """What is probably wrong with the log, with the likely cause."""
        return [finding.message for finding in self.findings]


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
    given = ImportOptions.of(**options)
    named = {table: place for table in TABLES if (place := getattr(given, table)) is not None}
    changes = given.of_component("tables")
    recipe = None if given.recipe is None else read_recipe(given.recipe)
    reading = ReadOptions(**given.of_component("reading"))
    if source is None:
        for table in ("odometry", "sightings"):
            if table not in named:
                raise OptionError(f"name the folder or bag, or the file of each table: --{table} FILE is missing")
        tables: dict[str, Any] = {table: Path(path) for table, path in named.items()}
        drive = read_drive(**tables, options=merged(recipe or Recipe(), changes).options)
        return _made(Import(None), drive, reading, Path(named["odometry"]).resolve().parent.name)
    source = Path(source)
    check_path(source)
    if not source.is_dir():
        check_file(source)
    if is_bag(source, first_bytes(source)):
        recipe = _with_places(merged(recipe or recipe_if_any(source.with_suffix(".toml")), changes), named)
        offered = ((each.topic, each.could_be, each.chosen) for each in topics_of(source, recipe))
        found = Import(source, tuple(FoundTopic(t.name, t.type, t.count, *uses) for t, *uses in offered))
        try:
            return _made(found, drive_of_bag(source, recipe), reading, source.resolve().stem)
        except LogError as error:
            return replace(found, reason=str(error))
    if not source.is_dir():
        check_unpacked(source, first_bytes(source))
        message = "this is no bag; give the folder of tables, or the file of each: --odometry .. --sightings .."
        raise FormatError(source, None, message)
    recipe = _with_places(merged(recipe or recipe_if_any(source / RECIPE), changes), named)
    return _made(Import(source), drive_of(source, recipe), reading, source.resolve().name)


def _made(found: Import, drive: Drive, reading: ReadOptions, name: str) -> Import:
    # the warnings are also notes of the log, which are shown
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        log = drive.log(reading, name)
    streams = tuple(_stream(kind, stream) for kind, stream in drive.streams.items())
    return replace(found, streams=streams, log=log, landmarks=None if drive.landmarks is None else len(drive.landmarks))


def _with_places(recipe: Recipe, named: dict[str, str]) -> Recipe:
    """The recipe with the files or topics that the options name."""
    places = {table: dict(place) for table, place in recipe.places.items()}
    for table, place in named.items():
        # of a table of a folder its file, of a bag its topic
        places.setdefault(table, {}).update({"file": place, "topic": place})
    return replace(recipe, places=places)


def _stream(kind: str, stream: Timed) -> FoundStream:
    begin, end = stream.times[0] / 1e9, stream.times[-1] / 1e9
    rate = np.count_nonzero(np.diff(stream.times)) / (end - begin) if end > begin else None
    return FoundStream(kind, stream.table.source, len(stream.times), begin, end, rate, stream.columns)


#: intervals of the histograms
BINS = 12


@dataclass(frozen=True)
class Rate:
    """The times of the poses, controls or sightings of a log, in seconds since its first pose.

    Attributes:
        name: what is counted.
        count: their number.
        rate: different times per second, the median.
        longest_gap: longest time between two [s].
        gap_at: when it begins [s].
    """

    name: Annotated[str, one_of("poses", "controls", "sightings")]
    count: Count
    rate: float | None
    longest_gap: float | None
    gap_at: float | None


@dataclass(frozen=True)
class Seen:
    """The sightings of one landmark.

    Attributes:
        id: of the landmark.
        count: number of sightings.
        first, last: the times of the first and the last one since the first pose [s].
        range: the median range [m].
    """

    id: int
    count: Count
    first: float
    last: float
    range: float


@dataclass(frozen=True)
class Histogram:
    """A histogram.

    Attributes:
        edges: (n+1,) limits of the intervals.
        counts: (n,) number of values in each interval.
    """

    edges: Numbers
    counts: Numbers


@dataclass(frozen=True, eq=False, repr=False)
class Overview(Displayed):
    """A log in numbers. Times are in seconds since the first pose; without controls they count steps."""

    log: Log = field(repr=False)
    source: Path | None = field(default=None, repr=False)
    shown: ClassVar = {
        name: name for name in ("seconds", "distance", "turned", "rates", "landmarks", "ranges", "bearings")
    } | {"log": "described", "warnings": "findings"}

    @property
    def described(self) -> LogDocument:
        """The log."""
        return describe(self.log, self.source)

    @cached_property
    def times(self) -> Array:
        """The time of each pose since the first (T+1,) [s]."""
        return elapsed_of(self.log)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What is probably wrong, with the likely cause."""
        return check_log(self.log)

    @cached_property
    def compared(self) -> bool:
        """Whether sightings could be compared with the odometry."""
        return comparable(self.log) is not None

    @cached_property
    def path(self) -> Array:
        """Dead reckoning (T+1, 3); the initial poses where there are no controls."""
        return self.log.initial_poses if self.log.controls is None else self.log.dead_reckoning()

    @cached_property
    def seen_at(self) -> Array:
        """The landmark of each sighting, seen from dead reckoning (M, 2)."""
        log = self.log
        return (log.sensor or SensorModel()).h_inverse(self.path[log.steps], log.sightings)[:, :2]

    @property
    def seconds(self) -> float | None:
        """The time from the first pose to the last [s]; None without controls."""
        return None if self.log.dt is None else float(np.sum(self.log.dt))

    @property
    def distance(self) -> float | None:
        """Distance driven according to the odometry [m]."""
        return self._sum(0)

    @property
    def turned(self) -> float | None:
        """Sum of all turns [rad]."""
        return self._sum(1)

    def _sum(self, column: int) -> float | None:
        if self.log.controls is None or self.log.dt is None:
            return None
        return float(np.sum(np.abs(self.log.controls[:, column]) * self.log.dt))

    @cached_property
    def rates(self) -> tuple[Rate, ...]:
        """The numbers of poses, controls and sightings."""
        log = self.log
        if log.dt is None:
            # steps have no rate
            return _rate("poses", np.empty(0), log.num_poses), _rate("sightings", np.empty(0), len(log.steps))
        controls = _rate("controls", log.control_times[:-1], len(log.dt))
        seen = _rate("sightings", np.unique(self.times[log.steps]), len(log.steps))
        return _rate("poses", self.times, log.num_poses), controls, seen

    @cached_property
    def landmarks(self) -> tuple[Seen, ...]:
        """The landmarks by number of sightings."""
        found = []
        for id in self.log.landmark_ids.tolist():
            rows = self.log.landmarks == id
            times, ranges = self.times[self.log.steps[rows]], self.log.sightings[rows, 0]
            found.append(Seen(id, len(ranges), float(times[0]), float(times[-1]), float(np.median(ranges))))
        return tuple(sorted(found, key=lambda each: (-each.count, each.id)))

    @cached_property
    def ranges(self) -> Histogram:
        """The histogram of the ranges [m]."""
        return _histogram(self.log.sightings[:, 0], 0.0, float(np.max(self.log.sightings[:, 0], initial=1.0)))

    @cached_property
    def bearings(self) -> Histogram:
        """The histogram of the bearings [rad]."""
        return _histogram(self.log.sightings[:, 1], -np.pi, np.pi)


def inspect_log(log: Log | str | PathLike[str] | None = None, **options: Any) -> Overview:
    """Look at a log before it is solved.

    Args:
        log: a log, the file or folder of one, or None for the sample log of the package.
        options: fields of `options.ReadingOptions`: robot, stride, max_range, ...

    Raises:
        FormatError: a file cannot be read.
        OptionError: an option is unknown or impossible.
    """
    return Overview(*read_log(log, ReadingOptions.of(**options)))


def _rate(name: str, times: Array, count: int) -> Rate:
    steps = np.diff(times)
    if len(steps) == 0:
        return Rate(name, count, None, None, None)
    k, middle = int(np.argmax(steps)), float(np.median(steps))
    return Rate(name, count, 1 / middle if middle > 0 else None, float(steps[k]), float(times[k]))


def _histogram(values: Array, low: float, high: float) -> Histogram:
    counts, edges = np.histogram(values, bins=BINS, range=(low, high))
    return Histogram(edges, counts)
