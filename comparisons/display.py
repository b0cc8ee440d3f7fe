"""The link from result objects to their presentation, which they do not import.

A result class derives from `Displayed`. The presentation layer (`comparisons.show`) registers a `Renderer` for the class;
the package `comparisons`, which stands above both, says how that layer is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any


@dataclass(frozen=True)
class Renderer:
    """The presentation of one class of results.

    Attributes:
        text: the tables and the sentences below them, as plain text.
        html: the same as HTML, with the figure where there is one.
        figure: a matplotlib figure of the result; None where there is none.
    """

    text: Callable[[Any], str]
    html: Callable[[Any], str]
    figure: Callable[..., Any] | None = None


#: by the name of the class, so that registering loads none of them
_RENDERERS: dict[str, Renderer] = {}
#: loads the presentation layer, which registers its renderers; set by the package
load_renderers: list[Callable[[], object]] = []
#: writes a figure into files; registered by the presentation layer
figure_writers: list[Callable[[Any, Sequence[str | PathLike[str]]], None]] = []


def register(kind: str, renderer: Renderer) -> None:
    """Register a renderer for the results of the class of this name."""
    _RENDERERS[kind] = renderer


def renderer_of(result: object) -> Renderer:
    """The renderer of a result."""
    if type(result).__name__ not in _RENDERERS:
        for load in load_renderers:
            load()
    return _RENDERERS[type(result).__name__]


class Displayed:
    """A result that ``print`` shows as text and a notebook as HTML."""

    def __str__(self) -> str:
        return renderer_of(self).text(self)

    def _repr_html_(self) -> str:
        return renderer_of(self).html(self)

    def figure(self, **options: Any) -> Any:
        """The matplotlib figure of this result.

        Raises:
            NotImplementedError: there is no figure of this class of results.
        """
        draw = renderer_of(self).figure
        if draw is None:
            raise NotImplementedError(f"there is no figure of {type(self).__name__}")
        return draw(self, **options)

    def save_figure(self, paths: Sequence[str | PathLike[str]], **options: Any) -> None:
        """Write the figure into files, in the formats that their suffixes name.

        Raises:
            FormatError: a file cannot be written.
        """
        figure = self.figure(**options)
        for write in figure_writers:
            write(figure, paths)
