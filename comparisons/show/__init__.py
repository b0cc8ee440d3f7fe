"""Everything that only shows: tables, figures, the interactive report and animations.

Results do not import this package. They ask `comparisons.display`, with which a renderer is registered here for each
class of results. Modules are loaded when something is first shown: a table does not need matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from os import PathLike
from typing import Any

from graphslam import SlamError

from .. import display

#: class of results -> module and function of its figure; empty where it has none
FIGURES = {
    "Comparison": "figures.comparison_figure",
    "ParticleStudy": "study_figures.particles_figure",
    "ConsistencyStudy": "study_figures.consistency_figure",
    "BackendComparison": "study_figures.backends_figure",
    "Summary": "study_figures.study_figure",
    "ResultTable": "",
    "SolverComparison": "",
    "Survey": "",
}


def _renderer(figure: str) -> display.Renderer:
    def html(result: Any) -> str:
        text: str = _function("tables.as_html")(result)
        if figure:
            # a table without its figure is better than neither
            with suppress(SlamError):
                text += "\n" + _function("canvas.png_as_html")(draw(result))
        return text

    def draw(result: Any, **options: Any) -> Any:
        return _function(figure)(result, **options)

    return display.Renderer(lambda result: _function("tables.as_text")(result), html, draw if figure else None)


def _function(path: str) -> Callable[..., Any]:
    module, name = path.split(".")
    function: Callable[..., Any] = getattr(import_module(f".{module}", __name__), name)
    return function


def _save(figure: Any, paths: Sequence[str | PathLike[str]]) -> None:
    _function("canvas.save_figure")(figure, paths)


for _kind, _path in FIGURES.items():
    display.register(_kind, _renderer(_path))
display.figure_writers.append(_save)
