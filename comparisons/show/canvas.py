"""Matplotlib figures in the style of this project, and how they are written.

Only matplotlib's objects are used, no pyplot: nothing global changes, and any number of figures can be made at once.
"""

from __future__ import annotations

import warnings
from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from io import BytesIO
from os import PathLike
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from graphslam.errors import printable
from graphslam.files import write_whole
from graphslam.se2 import Array

#: two columns of a page [inches]
WIDTH = 7.16


def as_text(name: str) -> str:
    """A name that matplotlib shows as it is: between two dollar signs it would expect mathematics."""
    return printable(name).replace("$", r"\$")


@contextmanager
def paper_figure(figsize: tuple[float, float] | None = None) -> Iterator[Figure]:
    """An empty figure in the style of all figures; it is laid out when the block that fills it ends."""
    with paper_style():
        figure = Figure(figsize=figsize)
        FigureCanvasAgg(figure)
        yield figure
        # once, here, where the style is known: saving then changes nothing
        figure.draw_without_rendering()


@contextmanager
def paper_style() -> Iterator[None]:
    """Matplotlib's settings for figures that are printed."""
    style = as_file(files("comparisons.show").joinpath("paper.mplstyle"))
    with style as path, matplotlib.rc_context(fname=path), warnings.catch_warnings():
        # a name in a script that the font does not have is drawn as boxes
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        yield


def save_figure(figure: Figure, paths: Sequence[str | PathLike[str]]) -> None:
    """Write a figure in the formats that the suffixes name, without a time stamp: the same data give the same file.

    Raises:
        FormatError: a file cannot be written.
    """
    with paper_style(), matplotlib.rc_context({"figure.constrained_layout.use": False}):
        # the figure is laid out already: with a layout engine, each file would be laid out and drawn once more
        figure.set_layout_engine(None)
        for path in map(Path, paths):
            metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(path.suffix.lower(), {})
            with write_whole(path) as temporary:
                figure.savefig(temporary, metadata=metadata)


def png_as_html(figure: Figure) -> str:
    """A figure as an image that is part of the page."""
    stream = BytesIO()
    with paper_style():
        figure.savefig(stream, format="png")
    return f'<img alt="figure" src="data:image/png;base64,{b64encode(stream.getvalue()).decode()}">'


def set_limits(axes: Axes, core: Array, rest: Sequence[Array]) -> float:
    """Show all of the core (k, 2), and of the rest what does not make the core smaller than half of the panel.

    Returns:
        The larger side of what can be seen [m].
    """
    low, high = np.nanmin(core, axis=0), np.nanmax(core, axis=0)
    reach = np.full(2, max(float(np.max(high - low)), 1.0) / 2)
    everything = np.concatenate([core, *rest])
    low = np.maximum(np.nanmin(everything, axis=0), low - reach)
    high = np.minimum(np.nanmax(everything, axis=0), high + reach)
    margin = 0.05 * max(float(np.max(high - low)), 1.0)
    # the panel keeps its size and shows more of the plane instead; auto allows matplotlib to widen the limits
    axes.set_xlim(low[0] - margin, high[0] + margin, auto=True)
    axes.set_ylim(low[1] - margin, high[1] + margin, auto=True)
    axes.set_aspect("equal", adjustable="datalim")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(9, steps=[1, 2, 5, 10]))
    return float(np.max(high - low)) + 2 * margin
