"""A film: the frames of an estimator at work, to be saved or shown in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from graphslam import Log
from graphslam.se2 import Array

from ..canvas import paper_figure
from .files import check_can_film, player, write_film

#: size of a picture [inches] and dots per inch; both sides have an even number of pixels, which video formats need
SIZE, DPI = (7.2, 6.4), 110


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """The estimate at one iteration or step, in the axes of the estimator.

    Attributes:
        number: of the iteration or step.
        caption: the text above the picture.
        poses: (k, 3) the path, of a film that goes step by step up to this step.
        estimated: (k,) bool, False for poses that are not drawn; None draws all.
        landmarks, landmark_covariances: {id: (2,) or (3,)} and {id: (n, n)}, where they are known.
        sightings: (n, 2) the places that are seen from the last pose.
        flash: a word that lights up in the picture; empty for none.
    """

    number: int
    caption: str
    poses: Array
    estimated: np.ndarray | None = None
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)
    sightings: Array = field(default_factory=lambda: np.empty((0, 2)))
    flash: str = ""


#: brings the artists of a scene up to a frame, and returns those to draw, in this order
Show = Callable[[Frame], Sequence[Artist]]


def kept(count: int, most: int) -> np.ndarray:
    """The iterations or steps that become frames: evenly spread, the first and the last among them.

    Returns:
        (min(count, most),) increasing numbers from 0 to count - 1.
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


class Pictures(Sequence[np.ndarray]):
    """The pictures (height, width, 3) of a film, uint8, drawn when they are asked for, in any order.

    What does not move is drawn once; each picture is a copy of it with a few artists on top.
    """

    def __init__(self, frames: Sequence[Frame], set_up: Callable[[Figure], Show]) -> None:
        self._frames = frames
        with paper_figure(SIZE) as figure:
            figure.set_dpi(DPI)
            # a layout that is computed at each frame would move the panels
            figure.set_layout_engine("none")
            self._show = set_up(figure)
            canvas = figure.canvas
            assert isinstance(canvas, FigureCanvasAgg)
            # within the style: ticks are made when they are first drawn
            canvas.draw()
            self._canvas, self._background = canvas, canvas.copy_from_bbox(figure.bbox)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, number: int) -> np.ndarray:  # type: ignore[override]
        return self._drawn(self._show(self._frames[number]))

    @property
    def still(self) -> np.ndarray:
        """The pixels (height, width, 3) that are the same in all frames."""
        return self._drawn([])

    def _drawn(self, artists: Sequence[Artist]) -> np.ndarray:
        self._canvas.restore_region(self._background)
        renderer = self._canvas.get_renderer()
        for artist in artists:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()


@dataclass(frozen=True, eq=False)
class Film:
    """The frames of an estimator at work on a log; made by `animate`.

    Attributes:
        title: of the film.
        frames: the data of every picture, first to last.
        steps: the number of iterations or steps, the start included; more than frames where the film leaves some out.
        fps: frames per second.
        notes: what the viewer should know, one sentence each.
        set_up: draws everything that does not move onto an empty figure.
        log: what the estimator worked on.
        source: the file or folder of the log, where there is one.
    """

    title: str
    frames: tuple[Frame, ...] = field(repr=False)
    steps: int
    fps: float
    notes: tuple[str, ...]
    set_up: Callable[[Figure], Show] = field(repr=False)
    log: Log = field(repr=False)
    source: Path | None = None

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def pictures(self) -> Pictures:
        """The pictures, each drawn when it is asked for: ``film.pictures[-1]``."""
        return Pictures(self.frames, self.set_up)

    def save(self, path: str | PathLike[str], *, progress: Callable[[], None] | None = None) -> Path:
        """Write the film, whole or not at all; its last picture stays for two seconds.

        Args:
            path: what to write. The suffix names the format: .gif, .mp4 (needs ffmpeg) or .html (a page with a player).
            progress: called after each picture.

        Raises:
            OptionError: the suffix is none of these, or ffmpeg is not installed or fails.
            FormatError: the place cannot be written.
        """
        check_can_film(Path(path))
        write_film(self, Path(path), progress or (lambda: None))
        return Path(path)

    def _repr_html_(self) -> str:
        """The player, in an iframe so that several films in one notebook do not interfere."""
        height, width = self.pictures[0].shape[:2]
        document = escape(player(self, lambda: None), quote=True)
        return (
            f'<iframe srcdoc="{document}" title="{escape(self.title, quote=True)}" width="{width + 40}" '
            f'height="{height + 90}" style="border:0;max-width:100%"></iframe>'
        )
