"""The table of results in HTML: the rows and words of the table in the terminal."""

from __future__ import annotations

from html import escape

from ..comparison import Comparison, Row
from ..tables import NOTHING, number, seconds, yes_no

HEADINGS = ("converged", "iterations", "time", "cost J", "ATE [m]", "RPE [m]", "RPE [rad]", "map [m]")


def table_html(comparison: Comparison) -> str:
    """A table element, a row per estimator, skipped ones with their reason."""
    head = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in ("estimator", *HEADINGS))
    rows = "\n".join(_row(row) for row in comparison.table)
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>"


def _row(row: Row) -> str:
    name = f'<th scope="row">{escape(row.name)}</th>'
    if row.skipped is not None:
        return f'<tr class="skipped">{name}<td colspan="{len(HEADINGS)}">left out: {escape(row.skipped)}</td></tr>'
    cells = [
        str(yes_no(row.converged)),
        # a filter goes over the log once: 0 iterations would read as if it had not started
        NOTHING if row.converged is None else str(row.iterations),
        seconds(row.seconds),
        *map(number, (row.cost, row.ate_m, row.rpe_m, row.rpe_rad, row.landmark_rmse_m)),
    ]
    return f"<tr>{name}{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
