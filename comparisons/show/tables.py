"""Results as tables and sentences: for the terminal, as plain text, and as HTML.

`tables_of` knows every class of results. Its functions import nothing of the results at run time, so that showing one
class does not load all the others.
"""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .cells import NOTHING, LeanTable, number, seconds, yes_no

if TYPE_CHECKING:
    from ..backends import BackendComparison
    from ..comparison import Comparison, ResultTable
    from ..solvers import SolverComparison

#: tables, and the sentences below them
Tables = tuple[list[Table], list[str]]
#: the width of text that is not written to a terminal
WIDTH = 140
#: class of results -> the functions that make its tables and its figure, empty where it has none
RESULTS = {
    "ResultTable": ("tables.result_tables", ""),
    "Comparison": ("tables.comparison_tables", "figures.comparison_figure"),
    "SolverComparison": ("tables.solver_tables", ""),
    "BackendComparison": ("tables.backend_tables", "study_figures.backends_figure"),
    "ParticleStudy": ("study_tables.particle_tables", "study_figures.particles_figure"),
    "ConsistencyStudy": ("study_tables.consistency_tables", "study_figures.consistency_figure"),
    "Summary": ("study_tables.summary_tables", "study_figures.study_figure"),
    "Survey": ("study_tables.survey_tables", ""),
    "Calibration": ("study_tables.calibration_tables", ""),
    "Import": ("log_tables.import_tables", ""),
}


def function(path: str) -> Callable[..., Any]:
    """A function of this package by module and name; the module is loaded now, if it has not been loaded before."""
    module, name = path.split(".")
    found: Callable[..., Any] = getattr(import_module(f".{module}", __package__), name)
    return found


def tables_of(result: object, **options: Any) -> Tables:
    """The tables of a result and the sentences below them.

    Args:
        result: of a class of results of this project.
        options: of its tables; a `Calibration` takes the ``name`` of its log.

    Raises:
        KeyError: the object is no result of this project.
    """
    tables: Tables = function(RESULTS[type(result).__name__][0])(result, **options)
    return tables


def as_text(result: object, width: int = WIDTH) -> str:
    """Tables and sentences in plain characters, lines at most ``width`` wide."""
    tables, remarks = tables_of(result)
    stream = StringIO()
    console = Console(file=stream, width=width, highlight=False, color_system=None)
    for table in tables:
        console.print(table)
    for remark in remarks:
        console.print(remark, markup=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip().splitlines())


def as_html(result: object) -> str:
    """Tables and sentences as HTML without scripts or styles of the page's own; all text escaped."""
    tables, remarks = tables_of(result)
    return "\n".join([*map(table_as_html, tables), *(f"<p>{escape(remark)}</p>" for remark in remarks)])


def table_as_html(table: Table) -> str:
    """One table as HTML; the first cell of each row is its heading."""
    title = f"<caption>{_plain(table.title)}</caption>" if table.title else ""
    sides = [f' style="text-align:{column.justify}"' for column in table.columns]
    head = "".join(f'<th scope="col"{side}>{_plain(column.header)}</th>' for column, side in zip(table.columns, sides))
    body = "".join(
        f'<tr><th scope="row"{sides[0]}>{_plain(name)}</th>'
        + "".join(f"<td{side}>{_plain(cell)}</td>" for cell, side in zip(cells, sides[1:]))
        + "</tr>\n"
        for name, *cells in zip(*(list(column.cells) for column in table.columns))
    )
    return f"<table>{title}<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table>"


def _plain(cell: object) -> str:
    return escape((cell.plain if isinstance(cell, Text) else str(cell)).replace("\n", " ").strip())


def result_tables(results: ResultTable) -> Tables:
    """The rows of a comparison, one per estimator; the NEES only where the truth is known."""
    metrics = {"ate_m": "ATE\n[m]", "rpe_m": "RPE\n[m]", "rpe_rad": "RPE\n[rad]", "landmark_rmse_m": "map\n[m]"}
    if any(row.nees is not None for row in results):
        metrics["nees"] = "NEES"
    table = LeanTable(results.title, ["estimator"], ["converged,\niterations", "time", "cost J", *metrics.values()])
    for row in results:
        values = (number(getattr(row, metric)) for metric in metrics)
        converged = yes_no(row.converged, f", {row.iterations}")
        table.add_row(row.name, converged, seconds(row.seconds), number(row.cost), *values)
    return [table], []


def comparison_tables(comparison: Comparison) -> Tables:
    """The table of the results, with agreement, skipped estimators, and notes of the log and the estimators."""
    log, remarks = comparison.log, []
    if any(value is not None for value in comparison.nees.values()):
        remarks.append("NEES: 1 means consistent covariances, above 1 overconfident ones.")
    if (difference := comparison.difference("graph", "gtsam")) is not None:
        remarks.append(f"graph and gtsam differ by at most {difference:.1e} in any x, y [m] or heading [rad].")
    if log.true_poses is None:
        remarks.append("The log has no true poses, so no error can be measured.")
    elif (covered := int(log.covered.sum())) < log.num_poses:
        remarks.append(f"The errors are those of the {covered} of {log.num_poses} poses that the ground truth covers.")
    remarks += [f"{entry.name} {entry.outcome}: {entry.reason}." for entry in comparison.skipped]
    remarks += [f"{r.name} did not converge: {r.reason}." for r in comparison.results if r.converged is False]
    notes: dict[str, list[str]] = {note: [log.name] for note in log.notes}
    for result in comparison.results:
        for note in comparison.notes_of(result):
            notes.setdefault(note, []).append(result.name)
    remarks += [f"{', '.join(names)}: {note}." for note, names in notes.items()]
    return result_tables(comparison.table)[0], remarks


def solver_tables(comparison: SolverComparison) -> Tables:
    """A row per variant; below, what disagrees and what was left out, reason by reason."""
    headings = ("poses\ndiffer by", "costs\ndiffer by", "iterations\n/ gtsam", "time", "time of\ngtsam", "agree")
    table = LeanTable("hand-written solver against GTSAM", ["variant"], headings)
    for variant in comparison.variants:
        table.add_row(
            variant.name,
            f"{variant.pose_difference:.1e}",
            f"{variant.cost_difference:.1e}",
            f"{variant.iterations} / {variant.gtsam_iterations}",
            seconds(variant.seconds),
            seconds(variant.gtsam_seconds),
            yes_no(variant.problem is None),
        )
    reasons: dict[str, list[str]] = {}
    for entry in comparison.skipped:
        reasons.setdefault(entry.reason, []).append(entry.name)
    remarks = [f"DIFFERENT: {problem}." for problem in comparison.problems]
    for reason, names in reasons.items():
        which = names[0] if len(names) == 1 else f"{len(names)} variants ({names[0]}, ...)"
        remarks.append(f"{which} left out: {reason}.")
    return [table], remarks


def backend_tables(comparison: BackendComparison) -> Tables:
    """A row per file and solver; below, the mean ratios of the times and the runs that did not reach the best chi2."""
    table = LeanTable(
        "pose graphs: chi2 by one evaluator, time from the initial values until the stop rule holds",
        ["file", "solver"], ["chi2", "best", "iterations", "time", "ours /\ntheirs"],
    )  # fmt: skip
    ours, previous, remarks = "graphslam", None, []
    for row in comparison.rows:
        ratio = comparison.ratio(row)
        table.add_row(
            Path(row.file).name if row.file != previous else "",
            row.backend,
            number(row.chi2, 6),
            yes_no(comparison.reached(row)),
            str(row.iterations),
            seconds(row.seconds),
            NOTHING if ratio is None or row.backend == ours else f"1/{1 / ratio:.1f}",
        )
        previous = row.file
    for name in dict.fromkeys(row.backend for row in comparison.rows if row.backend != ours):
        if (mean := comparison.geometric_mean(name)) is not None:
            remarks.append(f"graphslam takes 1/{1 / mean:.1f} of the time of {name} (geometric mean).")
    for row in comparison.rows:
        if not comparison.reached(row):
            remarks.append(f"{Path(row.file).name}: {row.backend} did not reach the best chi2: {row.reason}.")
    return [table], remarks
