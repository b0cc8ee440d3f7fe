"""From frames to pixels: what stands still is drawn once, and each picture is that and a few artists on top."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..plots import paper_figure
from .frame import Frame

#: inches and dots per inch of a picture; both sides have an even number of pixels, as video wants it
SIZE, DPI = (7.2, 6.4), 110

#: brings the artists of a scene up to a frame, and returns those to draw, in this order
Show = Callable[[Frame], Sequence[Artist]]


class Projector:
    """The pictures (height, width, 3) of a film, uint8, drawn when they are asked for, in any order."""

    def __init__(self, frames: Sequence[Frame], set_up: Callable[[Figure], Show]) -> None:
        self._frames = frames
        with paper_figure(SIZE) as figure:
            figure.set_dpi(DPI)
            # panels stand where the stage puts them: a layout that is found anew at each drawing would let them jump
            figure.set_layout_engine("none")
            self._show = set_up(figure)
            canvas = figure.canvas
            assert isinstance(canvas, FigureCanvasAgg)
            # within the style: ticks are made when they are first drawn
            canvas.draw()
            self._canvas = canvas
            self._still = canvas.copy_from_bbox(figure.bbox)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, number: int) -> np.ndarray:
        """A picture; negative numbers count from the end.

        Raises:
            IndexError: there is no such picture.
        """
        return self._drawn(self._show(self._frames[number]))

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[number] for number in range(len(self)))

    @property
    def still(self) -> np.ndarray:
        """What all pictures have in common, (height, width, 3)."""
        return self._drawn([])

    def _drawn(self, artists: Sequence[Artist]) -> np.ndarray:
        self._canvas.restore_region(self._still)
        renderer = self._canvas.get_renderer()
        for artist in artists:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()
