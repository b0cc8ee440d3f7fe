"""The rows of a study for other programs: CSV and JSON lines."""

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


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        # repr keeps every digit
        return repr(value)
    if isinstance(value, str):
        text = printable(value)
        # spreadsheets take such texts for formulas, and execute them
        return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
    return json.dumps(value) if isinstance(value, dict) else value
