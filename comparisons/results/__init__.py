"""What the estimators found, in one form that tables, figures, reports, JSON and files read.

A result class derives from `Displayed`. Results do not import their presentation: the package `comparisons`, which stands
above both, says how `comparisons.show` is loaded.
"""

# ruff: noqa: F401

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

from graphslam.lazy import lazy_names

if TYPE_CHECKING:
    from .documents import Band, Count, LogDocument, Numbers, describe, json_line, jsonable, one_of
    from .results import (
        EstimatorResult,
        Figures,
        dead_reckoning_covariances,
        noted,
        of_expected,
        sentence,
        typical_costs,
    )

__getattr__, __dir__, __all__ = lazy_names(__name__)

#: loads the module that presents results, `comparisons.show.tables`; set by `comparisons`
presentation: list[Callable[[], Any]] = []


class Displayed:
    """A result that ``print`` shows as text and a notebook as HTML."""

    def to_json(self) -> dict[str, Any]:
        """This result as plain data, see docs/json.md."""
        # NumPy comes with it, and every import of `comparisons` imports this package
        from .documents import jsonable

        return dict(jsonable(self))

    def __str__(self) -> str:
        return str(presentation[0]().as_text(self))

    def _repr_html_(self) -> str:
        return str(presentation[0]().as_html(self))

    def figure(self, **options: Any) -> Any:
        """The matplotlib figure of this result.

        Raises:
            NotImplementedError: there is no figure of this class of results.
        """
        return presentation[0]().figure_of(self, **options)

    def save_figure(self, paths: Sequence[str | PathLike[str]], *, language: str = "en", **options: Any) -> None:
        """Write the figure into files, in the formats that their suffixes name; its texts in English or Japanese ("ja").

        Raises:
            FormatError: a file cannot be written.
        """
        presentation[0]().save_figure(self.figure(**options), paths, language)
