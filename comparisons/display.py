"""The link from result objects to their presentation (`comparisons.show`), which is loaded when a result is first shown.

A result class derives from `Displayed`.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from os import PathLike
from typing import Any


def _tables() -> Any:
    """The module that presents results; it imports most of the package, this module included."""
    return import_module(".show.tables", __package__)


class Displayed:
    """A result that ``print`` shows as text and a notebook as HTML."""

    def to_json(self) -> dict[str, Any]:
        """This result as plain data, see docs/json.md."""
        # imported here, because NumPy comes with it, and every import of `comparisons` imports this module
        from .results.documents import jsonable

        return dict(jsonable(self))

    def __str__(self) -> str:
        return str(_tables().as_text(self))

    def _repr_html_(self) -> str:
        return str(_tables().as_html(self))

    def figure(self, **options: Any) -> Any:
        """The matplotlib figure of this result.

        Raises:
            NotImplementedError: there is no figure of this class of results.
        """
        return _tables().figure_of(self, **options)

    def save_figure(self, paths: Sequence[str | PathLike[str]], *, language: str = "en", **options: Any) -> None:
        """Write the figure into files, in the formats that their suffixes name; its texts in English or Japanese ("ja").

        Raises:
            FormatError: a file cannot be written.
        """
        _tables().save_figure(self.figure(**options), paths, language)
