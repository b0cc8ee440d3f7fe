"""What came out of a study: medians with intervals, and differences between methods on the same logs and seeds.

A method is an estimator with its varied options; a log is a file, or a simulated world with its varied settings (of which
each seed makes another log). Pure functions on the rows of `database.StudyDatabase.rows`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from graphslam import OptionError

from ..display import Displayed
from ..toml_files import nearest
from .bootstrap import Median, median_of
from .outcome import DONE, TIMEOUT

#: the figures that are summarised, and how tables and axes call them
METRICS = {
    "ate_m": "ATE [m]",
    "rpe_m": "RPE [m]",
    "rpe_rad": "RPE [rad]",
    "landmark_rmse_m": "map RMSE [m]",
    "iterations": "iterations",
    "seconds": "time [s]",
}
#: the name of the group that holds the runs of all logs
ALL = "all logs"

Row = Mapping[str, Any]


@dataclass(frozen=True)
class MethodSummary:
    """One method on one log (or on all).

    Attributes:
        log, method: which.
        runs: how many rows there are; ``failed`` of them raised, ``timeouts`` took too long.
        converged: the share that converged of those that could, None where nothing is iterated.
        figures: the median of each of `METRICS`; None where it is not known.
    """

    log: str
    method: str
    runs: int
    failed: int
    timeouts: int
    converged: float | None
    figures: Mapping[str, Median | None]


@dataclass(frozen=True)
class PairedDifference:
    """A method against the baseline, on the same log with the same seed: method minus baseline.

    Attributes:
        log, method, baseline: which.
        figures: the median of the differences in each of `METRICS`.
        lower: how often the method's figure was the lower one.
    """

    log: str
    method: str
    baseline: str
    figures: Mapping[str, Median | None]
    lower: Mapping[str, int]


@dataclass(frozen=True)
class Summary(Displayed):
    """A study summarised.

    Attributes:
        planned: how many runs the study has; ``done`` of them have a row.
        methods, differences: log by log, and last for all logs where there are several.
        baseline: what methods are compared with.
        errors: the sentence of each error or timeout, and how many runs ended with it.
    """

    planned: int
    done: int
    baseline: str | None
    methods: tuple[MethodSummary, ...]
    differences: tuple[PairedDifference, ...]
    errors: Mapping[str, int]

    def to_json(self) -> dict[str, Any]:
        """The summary as plain data."""
        return asdict(self)


def summarise(rows: Sequence[Row], planned: int, baseline: str | None = None) -> Summary:
    """Summarise the rows of a study.

    Args:
        rows: from `database.StudyDatabase.rows`.
        planned: how many runs the study has.
        baseline: the method that others are compared with; default: the first whose estimator is ``graph``, or else the
            first.

    Raises:
        OptionError: no method is called ``baseline``.
    """
    names = list(dict.fromkeys(row["method"] for row in rows))
    if baseline is not None and baseline not in names:
        hint = f"; did you mean {nearest(baseline, names)!r}?" if names else ""
        raise OptionError(f"the study has no method {baseline!r}{hint}")
    if baseline is None and names:
        of_graph = [row["method"] for row in rows if row["estimator"] == "graph"]
        baseline = of_graph[0] if of_graph else names[0]
    logs = list(dict.fromkeys(row["log"] for row in rows))
    methods: list[MethodSummary] = []
    differences: list[PairedDifference] = []
    for log in [*logs, *([ALL] if len(logs) > 1 else [])]:
        group = [row for row in rows if log in (ALL, row["log"])]
        by_name: dict[str, list[Row]] = {}
        for row in group:
            by_name.setdefault(row["method"], []).append(row)
        methods += [_method(log, name, found) for name, found in by_name.items()]
        if baseline in by_name:
            base = by_name[baseline]
            differences += [
                _difference(log, name, baseline, found, base) for name, found in by_name.items() if name != baseline
            ]
    errors = Counter(row["error"] for row in rows if row["status"] != DONE)
    return Summary(planned, len(rows), baseline, tuple(methods), tuple(differences), dict(errors.most_common()))


def _method(log: str, name: str, rows: Sequence[Row]) -> MethodSummary:
    status = Counter(row["status"] for row in rows)
    converged = [row["converged"] for row in rows if row["converged"] is not None]
    figures = {}
    for metric in METRICS:
        found = [(row[metric], _unit(row, log)) for row in rows if row[metric] is not None]
        figures[metric] = median_of([value for value, _ in found], [unit for _, unit in found])
    return MethodSummary(
        log=log,
        method=name,
        runs=len(rows),
        failed=len(rows) - status[DONE] - status[TIMEOUT],
        timeouts=status[TIMEOUT],
        converged=sum(converged) / len(converged) if converged else None,
        figures=figures,
    )


def _difference(log: str, name: str, baseline: str, rows: Sequence[Row], base: Sequence[Row]) -> PairedDifference:
    partner = {(row["log"], row["seed"]): row for row in base}
    figures, lower = {}, {}
    for metric in METRICS:
        values, units = [], []
        for row in rows:
            other = partner.get((row["log"], row["seed"]))
            if other is not None and row[metric] is not None and other[metric] is not None:
                values.append(row[metric] - other[metric])
                units.append(_unit(row, log))
        figures[metric] = median_of(values, units)
        lower[metric] = sum(value < 0 for value in values)
    return PairedDifference(log, name, baseline, figures, lower)


def _unit(row: Row, log: str) -> Hashable:
    """What the bootstrap draws. Worlds of one seed share its noise and count as one; a file counts as one among many.

    Within one file only the seeds are left to draw.
    """
    return row["seed"] if "simulate" in row["source"] or log != ALL else row["log"]
