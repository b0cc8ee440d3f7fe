"""Everything that only shows: tables, figures, the interactive report and animations.

Results do not import this package. They ask `comparisons.display`, with which a renderer is registered here for each
class of results. The modules that need matplotlib are loaded when the first figure is drawn.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from graphslam import SlamError

from .. import display
from .tables import RESULTS, as_html, as_text, function


def _figure(result: Any, **options: Any) -> Any:
    return function(RESULTS[type(result).__name__][1])(result, **options)


def _html(result: Any) -> str:
    text = as_html(result)
    if RESULTS[type(result).__name__][1]:
        # a table without its figure is better than neither
        with suppress(SlamError):
            text += "\n" + function("canvas.png_as_html")(_figure(result))
    return text


for _kind, (_, _drawn) in RESULTS.items():
    display.register(_kind, display.Renderer(as_text, _html, _figure if _drawn else None))
display.figure_writers.append(lambda figure, paths: function("canvas.save_figure")(figure, paths))
