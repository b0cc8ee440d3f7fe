"""The page: everything that is known of a comparison, put into the template and written as one file."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from os import PathLike
from pathlib import Path
from string import Template
from typing import Any

from graphslam import FormatError, SlamError
from graphslam.files import write_whole

from ..comparison import Comparison, with_models
from ..config import RunConfig, versions
from ..estimator import RunOptions
from ..plots import reference_of
from ..saving import check_can_write, jsonable
from ..tables import comparison_remarks
from .convergence import remarks, stories
from .costs import convergence_figure, costs_figure
from .errors import errors_figure
from .matrix import MOST_NODES, Picture, matrix_figure, pictures
from .plotly_bundle import check_plotly, plotly_script
from .style import Figure
from .table import table_html
from .toggles import estimator_toggles, layer_toggles
from .trajectories import COLUMNS, trajectories_figure
from .uncertainty import graph_of
from .view import View, view_of

SUFFIXES = (".html", ".htm")


def check_page(path: Path) -> None:
    """Say now, rather than after minutes of work, that no page can be written at ``path``.

    Raises:
        FormatError: the name does not end in .html, or the place cannot be written.
        OptionError: the extra ``report`` is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FormatError(
            path, None, f"a report page is a file {' or '.join(SUFFIXES)}, not {path.suffix or path.name!r}"
        )
    check_can_write(path)
    check_plotly()


def write_report(comparison: Comparison, path: str | PathLike[str], config: RunConfig | None = None) -> None:
    """Write the page of a comparison, whole or not at all.

    Args:
        comparison: what to show.
        path: the file, .html.
        config: what the run was told; default: the options of the comparison.

    Raises:
        FormatError: the name does not end in .html, or the place cannot be written.
        OptionError: the extra ``report`` is not installed.
    """
    path = Path(path)
    check_page(path)
    text = page_of(comparison, config)
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page_of(comparison: Comparison, config: RunConfig | None = None) -> str:
    """The HTML text of the page of a comparison.

    Raises:
        OptionError: the extra ``report`` is not installed.
    """
    config = config or RunConfig(log=comparison.source, options=comparison.options or RunOptions())
    config = replace(config, options=with_models(config.options, comparison.log))
    script, plotly = plotly_script()
    view = view_of(comparison, config.options)
    matrix, matrix_words = _matrix(comparison, config)
    convergence, convergence_words, endings = _convergence(comparison, config)
    figures = {
        "map": trajectories_figure(view),
        "errors": errors_figure(view),
        "costs": costs_figure(comparison),
        "convergence": convergence,
        "matrix": matrix,
    }
    log = comparison.log
    part = {
        "title": escape(log.name),
        "summary": escape(_summary(view)),
        "table": table_html(comparison),
        "remarks": _items(comparison_remarks(comparison)),
        "estimators": estimator_toggles(view),
        "layers": layer_toggles(view),
        "last": str(len(view.steps) - 1),
        "error_heading": escape(_error_heading(view)),
        "map_note": escape(_map_note(view)),
        "errors_note": escape(_errors_note(view)),
        "costs_hidden": _hidden(figures["costs"]),
        "convergence_hidden": _hidden(figures["convergence"]),
        "matrix_hidden": _hidden(figures["matrix"]),
        "errors_hidden": _hidden(figures["errors"]),
        "convergence_note": escape(convergence_words),
        "convergence_remarks": _items(endings),
        "matrix_note": escape(matrix_words),
        "configuration": escape(config.to_toml()),
        "versions": _items([*versions(), plotly, platform.platform()]),
        "figures": embedded({name: figure for name, figure in figures.items() if figure is not None}),
        "facts": embedded(_facts(view)),
        "style": _resource("page.css"),
        "behaviour": _resource("page.js"),
        "plotly": script,
    }
    return Template(_resource("page.html")).substitute(part)


def embedded(value: Any) -> str:
    """JSON that may stand inside a script element: nothing in it can end the element or begin another."""
    text = json.dumps(jsonable(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _facts(view: View) -> dict[str, Any]:
    """What the slider tells: the steps, their times, and what was seen from them in the robot's frame."""
    return {
        "columns": COLUMNS,
        "steps": view.steps,
        "times": view.times,
        "last": view.log.num_poses - 1,
        "judged_by": view.judged_by,
        "estimators": [estimate.name for estimate in view.estimates],
        "sightings": [
            [[round(x, 4), round(y, 4), int(j)] for (x, y), j in zip(view.points[t].tolist(), view.seen[t])]
            if t in view.points
            else []
            for t in view.steps.tolist()
        ],
    }


def _summary(view: View) -> str:
    log = view.log
    landmarks = f"of {len(log.landmark_ids)} landmarks" if log.identified else "that do not tell their landmark"
    words = [f"{log.num_poses} poses", f"{len(log.steps)} sightings {landmarks}"]
    words.append("(range, bearing, orientation)" if log.has_orientation else "(range, bearing)")
    if view.times is not None:
        words.append(f"in {view.times[-1] - view.times[0]:.1f} s")
    return " ".join([f"{words[0]},", *words[1:]])


def _map_note(view: View) -> str:
    note = "Ellipses are those of three standard deviations. A click on a path moves the slider to that step."
    if view.log.true_poses is not None:
        note += (
            " Each estimate is laid onto the truth by the rigid motion that its errors are measured after; only dead "
            "reckoning leaves from the true start."
        )
    if len(view.steps) < view.log.num_poses:
        note += f" {len(view.steps)} of {view.log.num_poses} steps are shown; the table is of all."
    return note


def _errors_note(view: View) -> str:
    if view.judged_by == "truth":
        return "Distance from the true position after alignment; its root mean square over all steps is the ATE."
    if view.judged_by is None:
        return ""
    return f"The log has no true poses: this is the distance from {view.judged_by} after alignment, not an error."


def _error_heading(view: View) -> str:
    if view.judged_by in ("truth", None):
        return "error [m]"
    return f"from {view.judged_by} [m]"


def _convergence(comparison: Comparison, config: RunConfig) -> tuple[Figure | None, str, list[str]]:
    """The figure, what it shows, and how each iteration ended."""
    try:
        told = stories(comparison.log, config.options)
    except SlamError as error:
        return None, f"Left out: {error}.", []
    words = (
        "All four start at the log's own initial poses, with every pair of sightings as an edge. The lectures re-choose "
        "x̂₀ at every step: the cost settles, but the whole graph keeps drifting, and the norm stays where it is. With the "
        "anchor held the world frame converges, at a constant rate, since its information moves with the state; mixing "
        "the last iterates hastens that. In the body frame the information depends on the measurements alone, so that "
        "one true cost is minimised: a few steps lead to the end."
    )
    return convergence_figure(told), words, remarks(told)


def _matrix(comparison: Comparison, config: RunConfig) -> tuple[Figure | None, str]:
    reference = reference_of(comparison)
    graph = None if reference is None else graph_of(reference, comparison.log, config.options)
    if reference is None or graph is None:
        return None, "Left out: no estimator of this comparison solved a graph that is known."
    before, after = pictures(graph)
    return matrix_figure(before, after), _matrix_words(reference.name, before, after)


def _matrix_words(name: str, before: Picture, after: Picture) -> str:
    words = (
        f"Ω of {name}: {before.nodes} nodes and {before.blocks} blocks of 3 x 3 in its lower triangle. Its factor L has "
        f"{before.factor_blocks} as the nodes are numbered, and {after.factor_blocks} in the order of elimination "
        "(approximate minimum degree)."
    )
    if before.nodes > len(before.cells):
        words += f" {before.nodes / len(before.cells):.1f} nodes share a cell on each side."
    if before.nodes > MOST_NODES:
        words += " The fill-in is counted, but not drawn."
    return words


def _items(sentences: Sequence[str]) -> str:
    return "\n".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)


def _hidden(figure: Figure | None) -> str:
    return "hidden" if figure is None else ""


def _resource(name: str) -> str:
    return files("comparisons.report").joinpath(name).read_text(encoding="utf-8")
