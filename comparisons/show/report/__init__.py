"""The interactive report: one HTML file that shows a comparison offline, with everything in it that it needs.

`view` aligns the estimates and thins them, the modules of the figures turn that into plain Plotly dictionaries, and the page
puts them into its template. Plotly (the extra ``report``) is imported only to copy its script into the page.
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from graphslam import Log, OptionError, SlamError
from graphslam.files import path_of, write_text
from graphslam.log import UNIDENTIFIED

from ...comparison import Comparison, run
from ...estimators.config import versions
from ...results import EstimatorResult, jsonable, sentence
from ...results.files import check_can_write
from ...results.results import sightings_of
from ..canvas import MATRIX, colour_of, reference_of
from ..language import catalogue, language_of, translated, translated_table
from ..tables import NOTHING, LeanTable, landmark_table, number, table_as_html, tables_of, word
from . import charts
from .view import Figure, View, line_of, view_of

if TYPE_CHECKING:
    from rich.console import RenderableType


def check_page(path: Path) -> None:
    """Raise now rather than after minutes of work if no report can be written at ``path``.

    Raises:
        FormatError: the place cannot be written.
        OptionError: the name does not end in .html, or the extra ``report`` is not installed.
    """
    check_can_write(path, endings=(".html", ".htm"))
    check_plotly()


def check_plotly() -> None:
    """Raise `OptionError` with what to install where the optional package is missing."""
    if find_spec("plotly") is None:
        raise OptionError("the interactive report needs the package plotly: pip install -e '.[report]' in the clone")


def write_report(
    comparison: Comparison | Log | str | PathLike[str] | None, path: str | PathLike[str], *, language: str = "en",
    **options: Any,
) -> None:  # fmt: skip
    """Write the interactive report of a comparison, one HTML file that works offline, whole or not at all.

    Args:
        comparison: what `comparisons.run` has returned; or a log, its file, or None for the sample log, which is run first.
        path: the HTML file.
        language: of the page, "en" or "ja".
        options: of `comparisons.run`, where a log is run.

    Raises:
        FormatError, OptionError: see `check_page`.
        SlamError: see `comparisons.run`.
    """
    check_page(path_of(path))
    language = language_of(language)
    if not isinstance(comparison, Comparison):
        comparison = run(comparison, **options)
    elif options:
        message = f"the comparison has been run: it takes no options ({', '.join(options)}); give the log instead"
        raise OptionError(message)
    write_text(path, page_of(comparison, language))


def page_of(comparison: Comparison, language: str = "en") -> str:
    """The HTML text of the report of a comparison; needs the extra ``report``."""
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    def say(text: str) -> str:
        return escape(translated(text, language))

    def items(texts: Sequence[str]) -> str:
        return "\n".join(f"<li>{say(text)}</li>" for text in texts)

    view = view_of(comparison)
    matrix, matrix_note = _unless_failed(lambda: _matrix(comparison))
    variants, convergence_note = _unless_failed(lambda: (charts.iterations(comparison.log, comparison.options), ""))
    error_heading, errors_note = _error_texts(view)
    figures = {
        "map": charts.paths_figure(view), "errors": charts.errors_figure(view), "costs": charts.costs_figure(comparison),
        "convergence": charts.convergence_figure(variants) if variants else None, "matrix": matrix,
    }  # fmt: skip
    tables, sentences = tables_of(comparison)
    tables[0].title = None
    poses_known = any(estimate.covariances is not None for estimate in view.estimates)
    part = {
        "title": escape(comparison.log.name), "language": language, "summary": say(_summary(view)),
        "table": "\n".join(table_as_html(translated_table(table, language)) for table in tables),
        "remarks": items(sentences), "landmarks": _landmarks(comparison, language),
        "estimators": "\n".join(_box(e.name) for e in view.estimates),
        "pose_ellipses_hidden": "" if poses_known else "hidden",
        "last": str(len(view.steps) - 1),
        **{f"{name}_hidden": "hidden" if figure is None else "" for name, figure in figures.items()},
        "map_note": say(_map_note(view)), "error_heading": say(error_heading), "errors_note": say(errors_note),
        "convergence_note": say(convergence_note), "convergence_remarks": items(charts.remarks(variants or [])),
        "matrix_note": say(matrix_note), "entry": MATRIX[charts.ENTRY], "fill": MATRIX[charts.FILL],
        "configuration": escape(comparison.config),
        "versions": items([*versions(), f"plotly.js {get_plotlyjs_version()}", platform.platform()]),
        "figures": embedded({n: _translated_figure(figure, language) for n, figure in figures.items() if figure}),
        "facts": embedded(_facts(view) | {"matches": matches_of(comparison), "words": _words(language)}),
        "style": _resource("page.css"), "behaviour": _resource("page.js"), "plotly": get_plotlyjs(),
    }  # fmt: skip
    # the texts of the template, but not its style
    page = _TEXTS.sub(lambda text: translated(text[0], language), _resource("page.html"))
    return Template(page).substitute(part)


def _box(name: str) -> str:
    """A box that shows or hides an estimator, with a sample of its line."""
    text = escape(name)
    return f'<label><input type="checkbox" checked data-estimator="{text}">{_sample(name)}{text}</label>'


#: texts between the marks of a page, and those of its labels
_TEXTS = re.compile(r'(?<=>)[^<>]*[a-z][^<>]*(?=<)|(?<=aria-label=")[^"]*(?=")')
#: keys of a figure that hold texts
_TITLES = ("text", "name", "hovertemplate")
_TAG = re.compile("(<[^>]*>)")


def _translated_figure(figure: Any, language: str) -> Any:
    """A figure with its titles, names and hover texts, which have tags between their parts, in a language."""
    if isinstance(figure, dict):
        return {
            key: "".join(part if part[:1] == "<" else translated(part, language) for part in _TAG.split(value))
            if key in _TITLES and isinstance(value, str)
            else _translated_figure(value, language)
            for key, value in figure.items()
        }
    return [_translated_figure(each, language) for each in figure] if isinstance(figure, list) else figure


def _words(language: str) -> dict[str, str]:
    """The translations of the templates that the script of the page has."""
    script = _resource("page.js")
    return {} if language == "en" else {k: v for k, v in catalogue(language).items() if f'say("{k}"' in script}


def embedded(value: Any) -> str:
    """JSON that may stand inside a script element: nothing in it can end the element or begin another."""
    text = json.dumps(jsonable(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _facts(view: View) -> dict[str, Any]:
    """The data of the slider: the steps, their times, and what is seen from them in the axes of the robot."""
    return {
        "columns": charts.COLUMNS, "steps": view.steps, "times": view.times, "last": view.log.num_poses - 1,
        "measured_from": view.measured_from, "estimators": [estimate.name for estimate in view.estimates],
        "sightings": [[[round(x, 4), round(y, 4), int(j)] for x, y, j in seen.tolist()] for seen in view.sightings],
    }  # fmt: skip


def _summary(view: View) -> str:
    log = view.log
    kind = "range, bearing, orientation" if log.has_orientation else "range, bearing"
    time = "" if view.times is None else f" in {view.times[-1] - view.times[0]:.1f} s"
    return f"{log.sizes} ({kind}){time}"


def _map_note(view: View) -> str:
    note = ""
    if reference := view.aligned_to:
        note += f" Each estimate is aligned to {reference} by the rigid motion that its errors are measured after."
    if view.truth is not None and (where := view.log.truth_place):
        note += f" Paths are those of the point that the ground truth is of, {where} of the robot's pose."
    if view.log.composite:
        note += " Between its poses a path follows the recorded controls."
    if len(view.steps) < view.log.num_poses:
        note += f" {len(view.steps)} of {view.log.num_poses} steps are shown; the table counts all of them."
    return note


def _landmarks(comparison: Comparison, language: str) -> str:
    """The errors of the landmarks, and what was matched to them, to be unfolded; empty where nothing is known."""
    parts = []
    for table in (landmark_table(comparison), *(association_table(comparison, each) for each in comparison.results)):
        if table is not None:
            table = translated_table(table, language)
            title, table.title = escape(str(table.title)), None
            parts.append(f'<details><summary>{title}</summary><div class="wide">{table_as_html(table)}</div></details>')
    return "\n".join(parts)


#: in longer logs a click shows nothing: the page has to stay small
MOST_SIGHTINGS = 100_000


def matches_of(comparison: Comparison) -> dict[str, Any]:
    """``of``: the number of the association that each estimator has; ``associations``: {landmark: what is known of it} each.

    Of a landmark are known the ``steps`` of its sightings, those of them that are ``doubtful``, the ``true`` landmark and
    the ``share`` of its sightings that are of it, and its ``class``. Estimators with the same ids share an association.
    """
    log, of = comparison.log, dict[str, int]()
    found: dict[tuple[bytes, bytes], dict[str, Any]] = {}
    for result in comparison.results if len(log.steps) <= MOST_SIGHTINGS else ():
        ids = log.landmarks if result.association is None else result.association
        key = ids.tobytes(), b"" if result.unconfirmed is None else result.unconfirmed.tobytes()
        if key not in found:
            found[key] = _matches(comparison, result, ids)
        of[result.name] = list(found).index(key)
    return {"of": of, "associations": list(found.values())}


def _matches(comparison: Comparison, result: EstimatorResult, ids: np.ndarray) -> dict[str, Any]:
    log, scores = comparison.log, comparison.associations[result.name]
    found = {}
    for each in sightings_of(log, ids):
        steps = log.steps[each.rows]
        doubtful = steps[:0] if result.unconfirmed is None else steps[result.unconfirmed[each.rows]]
        entry: dict[str, Any] = {"steps": steps.tolist(), "doubtful": doubtful.tolist(), "class": each.of_class}
        if scores is not None:
            true = scores.matches.get(each.landmark, UNIDENTIFIED)
            entry["true"] = None if true == UNIDENTIFIED else true
            entry["share"] = round(float(np.mean(log.landmarks[each.rows] == true)), 3)
        found[str(each.landmark)] = entry
    return found


def association_table(comparison: Comparison, result: EstimatorResult) -> Table | None:
    """The landmarks of a result with ids of its own, with the true ones that they are matched with; None where it has none.

    The share is that of the sightings that truly are of the matched landmark.
    """
    if result.association is None:
        return None
    log, scores = comparison.log, comparison.associations[result.name]
    headings = ["sightings", "unconfirmed", "steps", *["class", "share of\nthe class"] * (log.classes is not None)]
    headings += ["true\nlandmark", "correct\nshare"] * (scores is not None)
    table = LeanTable(f"Landmarks of {result.name}, and what was matched to them", ["landmark"], headings)
    known = _matches(comparison, result, result.association)
    for each in sightings_of(log, result.association):
        of, steps = known[str(each.landmark)], log.steps[each.rows]
        cells: list[RenderableType] = [str(len(steps)), str(len(of["doubtful"])), f"{steps.min()}-{steps.max()}"]
        if log.classes is not None:
            cells += [word(each.of_class), number(each.share, 2)]
        if scores is not None:
            cells += [NOTHING, NOTHING] if of["true"] is None else [str(of["true"]), f"{of['share']:.2f}"]
        table.add_row(str(each.landmark), *cells)
    return table


def _error_texts(view: View) -> tuple[str, str]:
    """The heading of errors in a table, and what their figure shows."""
    if view.measured_from in ("truth", None):
        return "error [m]", "Distance from the true position after alignment; its root mean square is the ATE."
    note = f"The log has no true poses: this is the distance from {view.measured_from} after alignment, not an error."
    return f"from {view.measured_from} [m]", note


def _unless_failed(make: Callable[[], tuple[Any, str]]) -> tuple[Any, str]:
    """A part of the page and a sentence on it; None and the reason where it cannot be made."""
    try:
        return make()
    except Exception as error:
        return None, f"Left out: {sentence(error)}."


def _matrix(comparison: Comparison) -> tuple[Figure, str]:
    reference = reference_of(comparison)
    if reference is None or reference.graph is None:
        raise SlamError("no estimator of this comparison solved a graph")
    before, after = charts.pictures(reference.graph)
    return charts.matrix_figure(before, after), charts.description(reference.name, before, after)


def _sample(name: str) -> str:
    """A short piece of an estimator's line, as a picture beside its name."""
    look, colour = line_of(name), colour_of(name)
    line = look["line"]
    dash = "" if line.get("dash", "solid") == "solid" else f' stroke-dasharray="{line["dash"].replace("px", "")}"'
    mark = ""
    if "marker" in look:
        cross = look["marker"]["symbol"].startswith("x")
        shape = '<path d="M13 4l8 8m0-8l-8 8"' if cross else '<circle cx="17" cy="8" r="4"'
        mark = f'{shape} fill="none" stroke="{colour}" stroke-width="1.6"/>'
    return (
        f'<svg width="34" height="16" aria-hidden="true"><line x1="0" y1="8" x2="34" y2="8" stroke="{colour}" '
        f'stroke-width="{line["width"]:.1f}"{dash}/>{mark}</svg>'
    )


def _resource(name: str) -> str:
    return files("comparisons.show.report").joinpath(name).read_text(encoding="utf-8")
