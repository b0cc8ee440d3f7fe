"""The summary of a study: medians with intervals, and differences between methods on the same logs and seeds; its files.

A method is an estimator with its varied options. A log is a file, or a simulated world with its varied settings, of which
each seed makes another log.

Files have the rows of a study as CSV or JSON lines, and its summary as CSV.

The bootstrap interval of a median says how far it would move if other logs had been drawn.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from os import PathLike
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from graphslam.errors import OptionError, checks, printable, quoted
from graphslam.files import write_whole

from ..options import METRICS
from ..results import Band, Count, Displayed, json_line
from .execute import COLUMNS, DONE, TIMEOUT, StudyDatabase

#: the share of resamples that the interval holds
LEVEL = 0.95
RESAMPLES = 2000
#: numbers drawn at once, so that memory stays small whatever the study's size
_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class Median:
    """A median and its interval.

    Attributes:
        median: of the values.
        low, high: the interval; None where there is only one unit to draw from.
        count: the number of values.
        quartiles: the first and the third one, between which half of the values lie.
    """

    median: float
    low: float | None
    high: float | None
    count: Count
    quartiles: Band


def median_of(values: Sequence[float | None], units: Sequence[Hashable]) -> Median | None:
    """The median of values and its percentile-bootstrap interval (Efron and Tibshirani, 1993, chapter 13).

    Units are drawn with replacement, each with all its values: values of one log share its noise, and are not
    independent. With fewer than about ten units the interval is too short.

    Args:
        values: the numbers; those that are None do not count.
        units: of each value; equal for values that belong together.

    Returns:
        None where there are no values.
    """
    members: dict[Hashable, list[float]] = {}
    for value, unit in zip(values, units, strict=True):
        if value is not None:
            members.setdefault(unit, []).append(value)
    if not members:
        return None
    known = np.concatenate(list(members.values()))
    first, median, third = map(float, np.percentile(known, (25, 50, 75)))
    found, count = Median(median, None, None, len(known), (first, third)), len(members)
    if count < 2:
        return found
    # a row for each unit, NaN after its last value
    groups = np.array(list(zip_longest(*members.values(), fillvalue=np.nan)), dtype=float).T
    # the same values give the same interval
    rng = np.random.default_rng(0)
    step = max(1, _AT_ONCE // groups.size)
    draws = (rng.integers(count, size=(min(step, RESAMPLES - k), count)) for k in range(0, RESAMPLES, step))
    medians = np.concatenate([np.nanmedian(groups[draw].reshape(len(draw), -1), axis=1) for draw in draws])
    low, high = np.percentile(medians, (50 * (1 - LEVEL), 50 * (1 + LEVEL)))
    return replace(found, low=float(low), high=float(high))


#: the name of the group that holds the runs of all logs
ALL = "all logs"

Row = Mapping[str, Any]


@dataclass(frozen=True)
class MethodSummary:
    """One method on one log, or on all.

    Attributes:
        log, method: which.
        runs: the number of rows.
        failed: the number of runs that failed.
        timeouts: the number of runs that exceeded the time limit.
        converged: the share of runs that converged; None where nothing is iterated.
        proven: the share of runs proven to end at the global minimum of J; None where no proof applies.
        figures: the median of each of `METRICS`; None where it is not known.
    """

    log: str
    method: str
    runs: Count
    failed: Count
    timeouts: Count
    converged: float | None
    figures: Mapping[str, Median | None]
    proven: float | None = None


@dataclass(frozen=True)
class PairedDifference:
    """A method against the baseline, on the same log with the same seed: method minus baseline.

    On a file a deterministic method gives the same result for every seed: there it is one measurement, not one per seed.

    Attributes:
        log, method, baseline: which.
        figures: the median of the differences in each of `METRICS`.
        lower: in how many pairs the method's figure was the lower one.
    """

    log: str
    method: str
    baseline: str
    figures: Mapping[str, Median | None]
    lower: Mapping[str, Count]


@dataclass(frozen=True)
class Summary(Displayed):
    """A study summarised.

    Attributes:
        planned: the number of runs of the study.
        done: the number of runs that have a row.
        database: the SQLite file.
        study: the study file.
        baseline: the method that others are compared with.
        methods, differences: log by log, and last for all logs where there are several.
        errors: the sentence of each error or timeout, and how many runs ended with it.
    """

    planned: Count
    done: Count
    baseline: str | None
    methods: tuple[MethodSummary, ...]
    differences: tuple[PairedDifference, ...]
    errors: Mapping[str, Count]
    database: Path | None = None
    study: str | None = None


def summarise(study: str | PathLike[str] | StudyDatabase | Sequence[Row], *, baseline: str | None = None) -> Summary:
    """Summarise a study.

    Args:
        study: its database, as a file or open, or the rows of one.
        baseline: the method that others are compared with; default: the first whose estimator is ``graph``, or else the
            first.

    Raises:
        FormatError: the file is no database of a study.
        OptionError: there is no such method.
    """
    if isinstance(study, (str, PathLike)):
        with StudyDatabase.reading(Path(study)) as database:
            return summarise(database, baseline=baseline)
    of: dict[str, Any] = {}
    if isinstance(study, StudyDatabase):
        rows, (planned, _) = study.rows(), study.counts()
        of = {"database": study.path, "study": study.about().get("study")}
    else:
        rows, planned = list(map(dict, study)), len(study)
    names = list(dict.fromkeys(row["method"] for row in rows))
    if baseline is not None and baseline not in names:
        raise OptionError(f"the study has no method {quoted(baseline)}{checks.suggestion(baseline, names)}")
    if baseline is None:
        baseline = next((row["method"] for row in rows if row["estimator"] == "graph"), next(iter(names), None))
    logs = list(dict.fromkeys(row["log"] for row in rows))
    methods: list[MethodSummary] = []
    differences: list[PairedDifference] = []
    for log in [*logs, *([ALL] if len(logs) > 1 else [])]:
        by_name: dict[str, list[Row]] = {}
        for row in rows:
            if log in (ALL, row["log"]):
                by_name.setdefault(row["method"], []).append(row)
        for name, group in by_name.items():
            methods.append(_method(log, name, group))
            if baseline in by_name and name != baseline:
                differences.append(_difference(log, name, baseline, group, by_name[baseline]))
    errors = Counter(row["error"] for row in rows if row["status"] != DONE)
    return Summary(planned, len(rows), baseline, tuple(methods), tuple(differences), dict(errors.most_common()), **of)


def _method(log: str, name: str, rows: Sequence[Row]) -> MethodSummary:
    status, measured = Counter(row["status"] for row in rows), _measured(rows)
    units = [_unit(row, log) for row in measured]
    converged = [row["converged"] for row in rows if row["converged"] is not None]
    proven = [row["proven"] for row in rows if row.get("proven") is not None]
    return MethodSummary(
        log=log, method=name, runs=len(rows), failed=len(rows) - status[DONE] - status[TIMEOUT], timeouts=status[TIMEOUT],
        converged=sum(converged) / len(converged) if converged else None,
        proven=sum(proven) / len(proven) if proven else None,
        figures={metric: median_of([row[metric] for row in measured], units) for metric in METRICS},
    )  # fmt: skip


def _difference(log: str, name: str, baseline: str, rows: Sequence[Row], base: Sequence[Row]) -> PairedDifference:
    partners: dict[str, list[Row]] = {}
    for row in _measured(base):
        partners.setdefault(row["log"], []).append(row)
    pairs = [
        (row, other)
        for row in _measured(rows)
        for other in partners.get(row["log"], [])
        if row["seed"] == other["seed"] or None in (row["seed"], other["seed"])
    ]
    units = [_unit(other if row["seed"] is None else row, log) for row, other in pairs]
    figures, lower = {}, {}
    for metric in METRICS:
        gaps = [None if None in (a[metric], b[metric]) else a[metric] - b[metric] for a, b in pairs]
        figures[metric] = median_of(gaps, units)
        lower[metric] = sum(gap is not None and gap < 0 for gap in gaps)
    return PairedDifference(log, name, baseline, figures, lower)


def _measured(rows: Sequence[Row]) -> list[Row]:
    """The rows of a method, with repeats as one: a deterministic estimator has equal poses for all seeds on a file.

    Such a row has the median of the times, and no seed: it belongs to every seed.
    """
    groups: dict[Hashable, list[Row]] = {}
    for row in rows:
        repeatable = "file" in row["source"] and row["status"] == DONE and row["poses_sha256"] is not None
        groups.setdefault((row["log"], row["poses_sha256"] if repeatable else row["key"]), []).append(row)
    measured = []
    for first, *repeats in groups.values():
        times = [row["seconds"] for row in (first, *repeats) if row["seconds"] is not None]
        once = {"seed": None, "seconds": median(times) if times else None}
        measured.append({**first, **once} if repeats else first)
    return measured


def _unit(row: Row, log: str) -> Hashable:
    """The units of the bootstrap: worlds of one seed share its noise and are one unit; each file is one unit.

    Within one file only the seeds are left to draw.
    """
    return row["seed"] if "simulate" in row["source"] or log != ALL else row["log"]


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """One line per run, a head line with the columns' names; source and options as JSON, unknown figures empty.

    A text that a spreadsheet would take for a formula begins with an apostrophe.

    Raises:
        FormatError: the place cannot be written.
    """
    _write_table(path, COLUMNS, ([row[name] for name in COLUMNS] for row in rows))


def write_json_lines(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """One JSON object per run and line, with the columns as keys; unknown figures are null.

    Raises:
        FormatError: the place cannot be written.
    """
    with write_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
        for row in rows:
            stream.write(json_line(row) + "\n")


def write_summary_csv(summary: Summary, path: Path) -> None:
    """One line for each log and method: counts, then for each metric the median, its interval and the number of values.

    ``ate_m_difference`` and the two columns after it are the median difference from the baseline and its interval, on equal
    logs and seeds; ``ate_m_lower`` is the number of pairs in which the method is lower, ``ate_m_pairs`` that of all pairs.
    Unknown figures are empty.

    Raises:
        FormatError: the place cannot be written.
    """
    differences = {(line.log, line.method): line for line in summary.differences}
    counts = ("log", "method", "runs", "failed", "timeouts", "converged", "proven")
    parts = ("", "_low", "_high", "_count", "_difference", "_difference_low", "_difference_high", "_lower", "_pairs")
    head = (*counts, *(f"{metric}{part}" for metric in METRICS for part in parts))
    rows = []
    for line in summary.methods:
        cells, against = [getattr(line, name) for name in counts], differences.get((line.log, line.method))
        for metric in METRICS:
            *gap, pairs = _cells(None if against is None else against.figures[metric])
            lower = None if against is None or pairs is None else against.lower[metric]
            cells += [*_cells(line.figures[metric]), *gap, lower, pairs]
        rows.append(cells)
    _write_table(path, head, rows)


def _cells(median: Median | None) -> tuple[float | None, ...]:
    return (None,) * 4 if median is None else (median.median, median.low, median.high, median.count)


def _write_table(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with write_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(map(_cell, row) for row in rows)


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        text = printable(value)
        # spreadsheets take such texts for formulas, and execute them
        return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
    # csv writes all digits of numbers
    return json.dumps(value) if isinstance(value, dict) else value
