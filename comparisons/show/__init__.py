"""Everything that only shows: tables, figures, the interactive report and animations.

Results do not import this package; `comparisons.display` calls these functions. Tables and figures are loaded when the
first one is made, because the command line needs `language` for its help.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from os import PathLike
from typing import Any

from graphslam.errors import SlamError


def as_text(result: object) -> str:
    """Tables and sentences of a result as plain text."""
    from . import tables

    return tables.as_text(result)


def as_html(result: object) -> str:
    """Tables, sentences and, where there is one, the figure of a result."""
    from .tables import RESULTS, function, tables_as_html

    text = tables_as_html(result)
    if RESULTS[type(result).__name__][1]:
        # a table without its figure is better than neither
        with suppress(SlamError):
            text += "\n" + function("canvas.png_as_html")(figure_of(result))
    return text


def figure_of(result: object, **options: Any) -> Any:
    """The figure of a result.

    Raises:
        NotImplementedError: there is no figure of this class of results.
    """
    from .tables import RESULTS, function

    draw = RESULTS[type(result).__name__][1]
    if not draw:
        raise NotImplementedError(f"there is no figure of {type(result).__name__}")
    return function(draw)(result, **options)


def save_figure(figure: Any, paths: Sequence[str | PathLike[str]], language: str = "en") -> None:
    """Write a figure into files, see `canvas.save_figure`."""
    from .canvas import save_figure

    save_figure(figure, paths, language)
