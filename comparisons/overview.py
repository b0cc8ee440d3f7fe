"""A log before it is solved: times and rates, sightings of each landmark, histograms, and what is probably wrong."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Log, SensorModel
from graphslam.log_checks import Finding, check_log
from graphslam.log_checks.readings import comparable
from graphslam.se2 import Array

from .display import Displayed
from .documents import ShowDocument, describe, document
from .exchange import elapsed_of
from .options import ReadingOptions
from .reading import read_log

#: intervals of the histograms
BINS = 12


@dataclass(frozen=True)
class Rate:
    """The times of poses, controls or sightings, see `documents.RateDocument`."""

    name: str
    count: int
    rate: float | None
    longest_gap: float | None
    gap_at: float | None


@dataclass(frozen=True)
class Seen:
    """The sightings of one landmark: their number, first and last time since the first pose [s], median range [m]."""

    id: int
    count: int
    first: float
    last: float
    range: float


@dataclass(frozen=True)
class Histogram:
    """A histogram: edges (n+1,) and counts (n,) of its intervals."""

    edges: Array
    counts: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Overview(Displayed):
    """A log in numbers. Times are in seconds since the first pose; without controls they count steps."""

    log: Log
    source: Path | None = None

    @cached_property
    def times(self) -> Array:
        """The time of each pose since the first (T+1,) [s]."""
        return elapsed_of(self.log)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Probable mistakes in the log."""
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
        rates = [_rate("poses", self.times, log.num_poses)]
        if log.dt is not None:
            begins = np.concatenate([[0.0], np.cumsum(log.dt)])[:-1]
            rates.append(_rate("controls", begins, len(log.dt)))
        rates.append(_rate("sightings", np.unique(self.times[log.steps]), len(log.steps)))
        if log.dt is None:
            # steps have no rate
            rates = [Rate(each.name, each.count, None, None, None) for each in rates]
        return tuple(rates)

    @cached_property
    def landmarks(self) -> tuple[Seen, ...]:
        """The landmarks by number of sightings."""
        found = []
        times = self.times[self.log.steps]
        for id in self.log.landmark_ids.tolist():
            rows = self.log.landmarks == id
            ranges = self.log.sightings[rows, 0]
            found.append(Seen(id, len(ranges), float(times[rows][0]), float(times[rows][-1]), float(np.median(ranges))))
        return tuple(sorted(found, key=lambda each: (-each.count, each.id)))

    @cached_property
    def ranges(self) -> Histogram:
        """The histogram of the ranges [m]."""
        ranges = self.log.sightings[:, 0]
        return _histogram(ranges, 0.0, float(np.max(ranges, initial=1.0)))

    @cached_property
    def bearings(self) -> Histogram:
        """The histogram of the bearings [rad]."""
        return _histogram(self.log.sightings[:, 1], -np.pi, np.pi)

    def to_json(self) -> dict[str, Any]:
        """The overview as plain data."""
        return document(
            ShowDocument,
            self,
            log=describe(self.log, self.source),
            rates=[asdict(each) for each in self.rates],
            landmarks=[asdict(each) for each in self.landmarks],
            ranges=vars(self.ranges),
            bearings=vars(self.bearings),
            warnings=[asdict(each) for each in self.findings],
        )


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
