"""The comparison of backends as a table and as a figure of cost over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from .backends import BackendComparison, BackendRow
from .plots import paper_figure
from .tables import NOTHING, lean_table, number, seconds, yes_no

_STYLES: dict[str, dict[str, Any]] = {
    "graphslam": {"color": "#56B4E9", "linestyle": "-", "marker": "o", "linewidth": 2.0},
    "gtsam-lm": {"color": "#0072B2", "linestyle": "--", "marker": "s"},
    "gtsam-gn": {"color": "#009E73", "linestyle": "-.", "marker": "^"},
    "g2o-gn": {"color": "#D55E00", "linestyle": ":", "marker": "x"},
    "g2o-lm": {"color": "black", "linestyle": (0, (5, 1.5)), "marker": "+"},
}


def backends_table(outcome: BackendComparison) -> Table:
    """One row per file and backend; the last column is our time over theirs where both reached the best chi2."""
    table = lean_table("pose graphs: chi2 by one evaluator, time from initial values to the stop rule")
    table.add_column("file", no_wrap=True)
    table.add_column("backend", no_wrap=True)
    for heading in ("chi2", "best", "iter-\nations", "time", "ours/\ntheirs"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    previous = None
    for row in outcome.rows:
        ratio = outcome.ratio(row)
        table.add_row(
            Path(row.file).name if row.file != previous else "",
            row.backend,
            number(row.chi2 if row.chi2 == row.chi2 else None, 6),
            yes_no(outcome.reached(row)),
            str(row.iterations),
            seconds(row.seconds if row.seconds == row.seconds else None),
            NOTHING if ratio is None or row.backend == "graphslam" else f"1/{1 / ratio:.1f}",
        )
        previous = row.file
    return table


def backends_remarks(outcome: BackendComparison) -> list[str]:
    """The geometric means, and a sentence for each run that did not end at the best chi2."""
    remarks = []
    for name in dict.fromkeys(row.backend for row in outcome.rows if row.backend != "graphslam"):
        mean = outcome.geometric_mean(name)
        if mean is not None:
            remarks.append(f"graphslam takes 1/{1 / mean:.1f} of the time of {name} (geometric mean).")
    for row in outcome.rows:
        if not outcome.reached(row):
            remarks.append(f"{Path(row.file).name}: {row.backend} did not reach the best chi2: {row.reason}.")
    return remarks


def backends_figure(outcome: BackendComparison) -> Figure:
    """chi2 above the best of its file over time, both on logarithmic axes, one panel per file."""
    files = list(dict.fromkeys(row.file for row in outcome.rows))
    columns = min(len(files), 3)
    rows = -(-len(files) // columns)
    with paper_figure(figsize=(7.16 * columns / 3 if columns < 3 else 7.16, 2.4 * rows)) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        handles: dict[str, Any] = {}
        for panel, file in zip(panels, files):
            best = outcome.best(file)
            for row in (row for row in outcome.rows if row.file == file and len(row.trace) > 1):
                (handles[row.backend],) = panel.plot(*_curve(row, best), label=row.backend, **_STYLES[row.backend])
            panel.set(xscale="log", yscale="log", title=Path(file).name, xlabel="time [s]")
        for panel in panels[len(files) :]:
            panel.set_visible(False)
        for panel in panels[::columns]:
            panel.set_ylabel("chi2 above the best, relative")
        if handles:
            figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles))
    return figure


def _curve(row: BackendRow, best: float) -> tuple[list[float], list[float]]:
    # the first point, at time zero, has no place on a logarithmic axis; below 1e-10 all is rounding
    return [t for t, _ in row.trace[1:]], [max((cost - best) / max(best, 1e-300), 1e-10) for _, cost in row.trace[1:]]
