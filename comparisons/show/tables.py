"""Results as tables and sentences: for the terminal, as plain text, as HTML and for LaTeX.

A `LeanTable` never cuts a number. `tables_of` chooses the function for a class of results. These functions import no results
at run time, so that showing one class does not load all the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from html import escape
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Column, Table
from rich.text import Text

from graphslam.errors import SlamError, printable
from graphslam.files import write_text
from graphslam.metrics import exchanged
from graphslam.metrics import headings as metric_headings

from ..options import DOUBTFUL
from ..results.documents import errors_of_sessions
from ..results.results import sightings_of
from .canvas import placement_of_result, png_as_html, save_figure  # noqa: F401

if TYPE_CHECKING:
    from graphslam import Certificate

    from ..comparison import Comparison, ResultTable
    from ..results.results import FoundIds

#: tables, and the sentences below them
Tables = tuple[list[Table], list[str]]
#: the width of text that is not written to a terminal
WIDTH = 140
#: class of results -> the functions that make its tables and its figure, empty where it has none
RESULTS = {
    "ResultTable": ("tables.result_tables", ""),
    "Comparison": ("tables.comparison_tables", "figures.comparison_figure"),
    "SolverComparison": ("studies.solver_tables", ""),
    "BackendComparison": ("studies.backend_tables", "studies.backends_figure"),
    "ParticleStudy": ("studies.particle_tables", "studies.particles_figure"),
    "ConsistencyStudy": ("studies.consistency_tables", "studies.consistency_figure"),
    "Summary": ("studies.summary_tables", "studies.study_figure"),
    "Evaluation": ("log_tables.evaluation_tables", "figures.evaluation_figure"),
    "Survey": ("log_tables.survey_tables", ""),
    "Calibration": ("log_tables.calibration_tables", ""),
    "Import": ("log_tables.import_tables", ""),
    "Overview": ("log_tables.overview_tables", "figures.overview_figure"),
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
    """Tables, sentences and, where there is one, the figure of a result, without scripts or styles; all text escaped."""
    tables, remarks = tables_of(result)
    parts = [*map(table_as_html, tables), *(f"<p>{escape(remark)}</p>" for remark in remarks)]
    # a table without its figure is better than neither
    with suppress(SlamError, NotImplementedError):
        parts.append(png_as_html(figure_of(result)))
    return "\n".join(parts)


def figure_of(result: object, **options: Any) -> Any:
    """The figure of a result.

    Raises:
        NotImplementedError: there is no figure of this class of results.
    """
    if not (draw := RESULTS[type(result).__name__][1]):
        raise NotImplementedError(f"there is no figure of {type(result).__name__}")
    return function(draw)(result, **options)


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


def write_latex(result: object, path: Path) -> None:
    """Write the tables of a result for LaTeX with the package booktabs, and the sentences below them as comments.

    Raises:
        FormatError: the place cannot be written.
    """
    tables, remarks = tables_of(result)
    comments = "".join(f"% {printable(remark)}\n" for remark in remarks)
    write_text(path, "\n\n".join([*map(table_as_latex, tables), comments]))


def table_as_latex(table: Table) -> str:
    """One table as LaTeX; sections are separated by rules."""
    sides = "".join("r" if column.justify == "right" else "l" for column in table.columns)
    head = " & ".join(_latex(column.header) for column in table.columns)
    lines = ["% \\usepackage{booktabs}", "\\begin{table}", "\\centering"]
    lines += [f"\\caption{{{_latex(table.title)}}}"] * bool(table.title)
    lines += [f"\\begin{{tabular}}{{{sides}}}", "\\toprule", f"{head} \\\\", "\\midrule"]
    cells = zip(*(list(column.cells) for column in table.columns))
    for row, entries in zip(table.rows, cells):
        lines.append(" & ".join(map(_latex, entries)) + " \\\\")
        lines += ["\\midrule"] * row.end_section
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", "\\end{table}"])


def _latex(cell: object) -> str:
    """A cell with the characters that LaTeX takes for commands escaped."""
    special: dict[str, str | int | None] = {
        "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--", "µ": r"\textmu{}",
    }  # fmt: skip
    return _text(cell).translate(str.maketrans(special | {letter: f"\\{letter}" for letter in "&%$#_{}"}))


def _plain(cell: object) -> str:
    return escape(_text(cell))


def _text(cell: object) -> str:
    return (cell.plain if isinstance(cell, Text) else str(cell)).replace("\n", " ").strip()


NOTHING = "–"
#: columns of names wrap in a narrow terminal, but each keeps this width where it needs it
NAMES = 18


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table: short, and a dash where it is not known."""
    if value is None or value != value:
        return NOTHING
    return f"{value:.{digits}f}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.{digits - 1}e}"


def written(value: Any, form: str = "") -> str:
    """A value as the format says, and a dash where it is not known."""
    return NOTHING if value is None else format(value, form)


def ended(sentence: str) -> str:
    """A sentence with its full stop; a question has its own mark."""
    return sentence if sentence.endswith("?") else f"{sentence}."


def seconds(value: float | None) -> str:
    """A time with the unit that suits it."""
    if value is None or value != value:
        return NOTHING
    if value < 1e-3:
        return f"{value * 1e6:.0f} µs"
    return f"{value * 1e3:.1f} ms" if value < 1 else f"{value:.2f} s"


def word(value: int | str | None) -> Text:
    """A name from the data, which may hold any characters; a dash where there is none."""
    return Text(NOTHING if value is None else printable(str(value)))


def yes_no(value: bool | None, more: str = "") -> Text:
    """Yes, no, or a dash where the question makes no sense; ``more`` follows in the same cell."""
    if value is None:
        return Text(NOTHING)
    answer = Text("yes", style="green") if value else Text("no", style="bold red")
    return answer.append(more, style="not bold default")


def optimum(certificate: Certificate | None) -> Text:
    """Whether a solver's end is proven to be the global minimum, with the relative gap; a dash where no proof applies.

    What the proof holds is named: the weights of a robust kernel, the parameters that were estimated.
    """
    if certificate is None or not certificate.applicable:
        return Text(NOTHING)
    if not certificate.proven:
        return Text("not proven")
    held = certificate.status.removeprefix("global")
    return Text(f"proven{held}", style="green").append(f", {certificate.relative_gap:.0e}", style="default")


class LeanTable(Table):
    """A table without frame. Names wrap, numbers never do: it becomes several tables where the terminal is too narrow.

    Args:
        title: above the table.
        names: the headings of the columns of names, which come first.
        numbers: the headings of the other columns, aligned to the right.
    """

    def __init__(self, title: str, names: Sequence[str], numbers: Sequence[str]) -> None:
        super().__init__(
            title=Text(printable(title), style="bold"), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1),
            pad_edge=False, show_edge=False,
        )  # fmt: skip
        # as Text: rich would take [m] for markup
        for heading in names:
            self.add_column(Text(heading), overflow="fold")
        for heading in numbers:
            self.add_column(Text(heading), justify="right", no_wrap=True)

    def add_row(self, *cells: RenderableType | None, **settings: Any) -> None:
        """Add a row; texts are shown as they are, without markup and without what controls a terminal."""
        plain = [printable(cell) if isinstance(cell, str) else cell for cell in cells]
        # rich could take a bracket for markup
        super().add_row(*(Text(cell) if isinstance(cell, str) and "[" in cell else cell for cell in plain), **settings)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table, with narrow gaps where that lets it fit, else as few tables with the same rows as possible."""
        widths = [_width(column) for column in self.columns]
        names = [column for column in self.columns if not column.no_wrap]
        numbers = list(zip(self.columns, widths))[len(names) :]

        def split(gap: int, limit: int = options.max_width) -> list[list[Column]]:
            used = sum(min(NAMES, width) + gap for width in widths[: len(names)]) - gap
            return _split(numbers, limit - used, gap)

        gap = 1 if len(split(2)) > 1 == len(split(1)) else 2
        # as even as possible
        fewest, limits = len(split(gap)), range(1, options.max_width + 1)
        parts = next(even for limit in limits if len(even := split(gap, limit)) == fewest)
        for k, part in enumerate(parts):
            table = LeanTable("", (), ())
            table.title = None if k else self.title
            table.padding = (0, 0, 0, gap - 1)
            table.columns = [replace(column, _index=i) for i, column in enumerate((*names, *part))]
            table.rows = self.rows
            if k:
                yield ""
            yield from Table.__rich_console__(table, console, options)


def _split(columns: Sequence[tuple[Column, int]], limit: int, gap: int) -> list[list[Column]]:
    """The columns, given with their widths, in runs no wider than the limit, or a single column where one is wider."""
    parts: list[list[Column]] = [[]]
    used = 0
    for column, width in columns:
        used += width + gap
        if parts[-1] and used > limit:
            parts.append([])
            used = width + gap
        parts[-1].append(column)
    return parts


def _width(column: Column) -> int:
    """The longest line of a column."""
    texts = (cell.plain if isinstance(cell, Text) else str(cell) for cell in (column.header, *column.cells))
    return max(cell_len(line) for text in texts for line in text.split("\n"))


def result_tables(results: ResultTable) -> Tables:
    """The rows of a comparison, one per estimator that ran; columns of errors, NEES and proofs only where one is known."""
    ran = [row for row in results if row.skipped is None]
    metrics = {n: title for n, title in metric_headings().items() if any(getattr(r, n) is not None for r in ran)}
    known = any(row.nees is not None for row in results)
    proofs = any(row.certificate is not None and row.certificate.applicable for row in results)
    headings = ["converged,\niterations", "time", "cost J", "J per\ndof", *["optimum"] * proofs]
    scored = any(row.association is not None and row.association.found is not None for row in results)
    in_map = any(row.integrity_risk is not None for row in results)
    last = [*["NEES"] * known, *["P(off)\nmean, most"] * in_map, *["precision,\nrecall", "landmarks"] * scored]
    table = LeanTable(results.title, ["estimator"], [*headings, *metrics.values(), *last])
    for row in ran:
        values = (number(getattr(row, metric)) for metric in metrics)
        cells: list[Text | str] = [yes_no(row.converged, f", {row.iterations}"), seconds(row.seconds)]
        cells += [number(row.cost, 2), number(row.cost_per_dof, 2), *[optimum(row.certificate)] * proofs]
        off = [_risk(row.integrity_risk)] * in_map
        of_ids = _scores(row.association) * scored
        name = f"{row.name} ({row.knows})" if row.knows else row.name
        table.add_row(name, *cells, *values, *[number(row.nees, 2)] * known, *off, *of_ids)
    return [table], [ended(f"{row.name} has no result: {row.skipped}") for row in results if row.skipped is not None]


def _risk(risk: np.ndarray | None) -> str:
    """The mean and the largest of probabilities."""
    return NOTHING if risk is None else f"{np.nanmean(risk):.2g}, {np.nanmax(risk):.2g}"


def _scores(association: FoundIds | None) -> list[str]:
    """Precision and recall, and the numbers of landmarks that were found, missed, doubled and invented."""
    if association is None or association.found is None:
        return [NOTHING, NOTHING]
    counts = f"{association.found} {association.missed} {association.doubled} {association.invented}"
    return [f"{written(association.precision, '.3f')}, {written(association.recall, '.3f')}", counts]


#: of several logs, so many notes about single ones are shown in brief
BRIEF = 10


def comparison_tables(comparison: Comparison, *, brief: bool = False) -> Tables:
    """The table of the results, with agreement, skipped estimators, and notes of the log and the estimators.

    Args:
        comparison: what to show.
        brief: of several logs, only say where the notes about single ones are, if there are many.
    """
    log, remarks = comparison.log, _noise_remarks(comparison)
    warnings = [finding.message for finding in comparison.findings]
    remarks += [ended(f"WARNING: {message}") for message in warnings]
    if any(value is not None for value in comparison.nees.values()):
        remarks.append("NEES: 1 means consistent covariances, above 1 overconfident ones.")
    if any(result.integrity_risk is not None for result in comparison.results):
        metres, degrees = comparison.options.bound
        remarks.append(
            f"P(off): the probability that a pose is off by more than {metres:g} m or {degrees:g} degrees in the map; of "
            "online when the robot is there, of others after the drive."
        )
    if any(comparison.associations.values()):
        clutter = "" if log.identified else " Sightings without a true id count as clutter."
        remarks.append(
            "Precision and recall: of the ids that an estimator gave the sightings itself, against the true ones. Landmarks: "
            f"found, missed, doubled, invented.{clutter}"
        )
    if (difference := comparison.difference("graph", "gtsam")) is not None:
        remarks.append(f"graph and gtsam differ by at most {difference:.1e} in any x, y [m] or heading [rad].")
    if log.true_poses is None:
        if any(metrics.aligned_by for metrics in comparison.metrics.values()):
            how = "The log has no true poses: the maps are aligned to the true landmarks, and only maps have an error."
            remarks.append(how)
        else:
            remarks.append("The log has no true poses, so no error can be measured.")
    elif (covered := int(log.covered.sum())) < log.num_poses:
        remarks.append(f"The errors are those of the {covered} of {log.num_poses} poses that the ground truth covers.")
    if log.true_poses is not None and (where := log.truth_place):
        remarks.append(f"Errors are measured at the point that the ground truth is of, {where} of the robot's pose.")
    remarks += _exchanged(comparison)
    remarks += [ended(f"{entry.name} {entry.outcome}: {entry.reason}") for entry in comparison.skipped]
    remarks += [ended(f"{r.name} did not converge: {r.reason}") for r in comparison.results if r.converged is False]
    notes: dict[str, list[str]] = {note: [log.name] for note in log.notes if not log.sessions}
    # those of several logs begin with the name of theirs
    of_single = tuple(f"{session.name}: " for session in log.sessions)
    single = [note for note in log.notes if note.startswith(of_single)]
    hidden = brief and len(single) > BRIEF
    of_all = [f"{note[0].upper()}{note[1:]}" for note in log.notes if log.sessions and note not in single]
    remarks += [ended(note) for note in (*(() if hidden else single), *of_all)]
    if hidden:
        remarks.append(
            f"{len(single)} notes about reading, noise and ids of single logs are in the JSON (log.notes) and in the report."
        )
    for result in comparison.results:
        for note in comparison.notes_of(result):
            # solutions repeat what is wrong with their log, for those who have nothing else
            if note not in warnings:
                notes.setdefault(note, []).append(result.name)
    remarks += [ended(f"{', '.join(names)}: {note}") for note, names in notes.items()]
    tables, _ = result_tables(comparison.table)
    return [*tables, *session_table(comparison), *state_table(comparison)], remarks


def session_table(comparison: Comparison) -> list[Table]:
    """The errors in each of several logs that were solved together, and of each log by itself; empty where none is known."""
    errors = list(errors_of_sessions(comparison))
    metrics = {n: title for n, title in metric_headings().items() if any(getattr(e, n) is not None for e in errors)}
    if not metrics and all(each.together_m is None for each in errors):
        return []
    of_all = ["ATE in the\ncommon\nframe [m]", "ATE of\nthis log\nalone [m]"][: 1 + bool(comparison.alone)]
    table = LeanTable("Errors in each log", ["log", "estimator"], [*metrics.values(), *of_all])
    for before, each in zip([None, *errors], errors):
        numbers = [*(getattr(each, metric) for metric in metrics), each.together_m, each.alone_m]
        name = "" if before is not None and each.session is before.session else each.session.name
        table.add_row(name, each.estimator, *map(number, numbers[: len(metrics) + len(of_all)]))
    return [table]


def state_table(comparison: Comparison) -> list[Table]:
    """The landmarks of the map that were in view and do not surely agree, and new ones; empty where there are none."""
    every = comparison.options.landmark_states or ()
    states = [e for e in every if e.state != "not in view" and (e.state != "agrees" or e.probability < 0.95)]
    if not states:
        return []
    headings = ["state", "probability", "moved by\n[m]", "sightings", "views"]
    table = LeanTable("Landmarks of the map that do not surely agree, and new ones", ["landmark"], headings)
    for each in states:
        shift = None if each.shift is None else float(np.hypot(*each.shift))
        seen = str(each.seen), written(each.views)
        table.add_row(str(each.id), each.state, number(each.probability), number(shift, 2), *seen)
    return [table]


def landmark_table(comparison: Comparison) -> Table | None:
    """The error of each landmark in the map of each estimator, largest first; None where no error is known."""
    errors = {name: m.landmark_errors_m for name, m in comparison.metrics.items() if m.landmark_errors_m}
    if not errors:
        return None
    first, log = errors.get("graph") or next(iter(errors.values())), comparison.log
    title = "Error of each landmark after the alignment [m], largest first"
    classed, seen = log.classes is not None, {each.landmark: each for each in sightings_of(log, log.landmarks)}
    table = LeanTable(title, ["landmark"], [*["class"] * classed, "sightings", *errors])
    for j in sorted(set().union(*errors.values()), key=lambda j: (-first.get(j, -1.0), j)):
        shown = [word(seen[j].of_class if j in seen else None)] * classed
        count = str(len(seen[j].rows)) if j in seen else NOTHING
        table.add_row(str(j), *shown, count, *(number(of.get(j)) for of in errors.values()))
    return table


def _exchanged(comparison: Comparison) -> list[str]:
    """A sentence for each two landmarks of the first map that may have each other's id."""
    log = comparison.log
    for result in comparison.results:
        if log.true_landmarks and result.named and result.landmarks and result.name != "dead-reckoning":
            placement = placement_of_result(log, result)
            return [
                f"{result.name}: landmarks {a} and {b} lie where the ground truth has the other one; have their ids been "
                "exchanged?"
                for a, b in exchanged(log.true_landmarks, result.landmarks, placement)
            ]
    return []


def _noise_remarks(comparison: Comparison) -> list[str]:
    """Which noise models were used, and what J per degree of freedom says about them."""
    names = {
        "book": "the book's", "log": "those of the log or its reader", "file": "those of the noise file", "given": "as given",
        "estimated": "estimated from each log, one for all" if comparison.log.sessions else "estimated from this log",
    }  # fmt: skip
    sources = {name: names[source] for name, source in comparison.noise_source.items()}
    same = len(set(sources.values())) == 1
    which = sources["motion"] if same else ", ".join(f"{name} {source}" for name, source in sources.items())
    remarks = [f"Noise models: {which}."]
    if (solved := comparison.noise_ratio) is not None:
        first, ratio = solved
        verdict = ""
        if ratio > DOUBTFUL:
            why = "the noise models assume less noise than there is, or sightings are wrong."
            verdict = f" {first} has {number(ratio, 1)}: {why}"
        elif ratio < 1 / DOUBTFUL:
            why = "the noise models assume more noise than there is."
            if "estimated" in comparison.noise_source.values():
                why = "correlated errors count as fewer sightings with more noise."
            verdict = f" {first} has {number(ratio, 2)}: {why}"
        robust = any(r.name == first and r.graph is not None and r.graph.reweighted for r in comparison.results)
        but = ", except for the sightings that the robust kernel weighs down" if robust else ""
        remarks.append(f"J per dof (degree of freedom): about 1 means that the noise models fit{but}.{verdict}")
    expected = [f"{r.name} {number(r.expected_ate_m, 3)} m" for r in comparison.results if r.expected_ate_m is not None]
    if expected:
        remarks.append(f"Expected ATE, from the covariances, if the noise models are right: {', '.join(expected)}.")
    return remarks
