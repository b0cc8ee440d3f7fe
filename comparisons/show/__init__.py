"""Everything that only shows: tables, figures, the interactive report and animations.

Results do not import this package. They ask `comparisons.display`, with which a renderer is registered here for each
class of results. The modules that need matplotlib are loaded when the first figure is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from os import PathLike
from typing import Any

from graphslam import SlamError

from .. import display
from .tables import as_html, as_text

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


def _figure(result: Any, **options: Any) -> Any:
    module, name = FIGURES[type(result).__name__].split(".")
    return getattr(import_module(f".{module}", __name__), name)(result, **options)


def _html(result: Any) -> str:
    text = as_html(result)
    if FIGURES[type(result).__name__]:
        # a table without its figure is better than neither
        with suppress(SlamError):
            text += "\n" + import_module(".canvas", __name__).png_as_html(_figure(result))
    return text


def _save(figure: Any, paths: Sequence[str | PathLike[str]]) -> None:
    import_module(".canvas", __name__).save_figure(figure, paths)


for _kind, _path in FIGURES.items():
    display.register(_kind, display.Renderer(as_text, _html, _figure if _path else None))
display.figure_writers.append(_save)
