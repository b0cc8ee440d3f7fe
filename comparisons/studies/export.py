"""The rows of a study for other programs, CSV and JSON lines, and its summary as CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graphslam.errors import printable
from graphslam.files import write_whole

from ..saving import json_line
from .database import COLUMNS
from .summary import METRICS, Summary


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """One line per run, a head line with the columns' names; source and options as JSON, unknown figures empty.

    A text that a spreadsheet would take for a formula begins with an apostrophe.

    Raises:
        FormatError: the place cannot be written.
    """
    with write_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow([_cell(row[name]) for name in COLUMNS])


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
    with write_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([*counts, *(f"{metric}{part}" for metric in METRICS for part in parts)])
        for line in summary.methods:
            cells: list[Any] = [getattr(line, name) for name in counts]
            against = differences.get((line.log, line.method))
            for metric in METRICS:
                median, gap = line.figures[metric], None if against is None else against.figures[metric]
                cells += [None] * 4 if median is None else [median.median, median.low, median.high, median.count]
                cells += [None] * 3 if gap is None else [gap.median, gap.low, gap.high]
                cells += [None] * 2 if gap is None or against is None else [against.lower[metric], gap.count]
            writer.writerow(map(_cell, cells))


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        # repr keeps every digit
        return repr(value)
    if isinstance(value, str):
        text = printable(value)
        # spreadsheets take such texts for formulas, and execute them
        return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
    return json.dumps(value) if isinstance(value, dict) else value
