"""A film: the frames of an estimator at work, to be saved, or seen in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from .frame import Frame
from .player import page
from .projector import Projector, Show
from .writers import check_can_film, write_film


@dataclass(frozen=True, eq=False)
class Film:
    """The frames of an estimator at work on a log; made by `animate.animate`.

    Attributes:
        title: what is seen.
        frames: the data of every picture, first to last.
        steps: how many iterations or steps there were to show, the beginning among them; more than frames where the
            film leaves some out.
        fps: pictures per second.
        notes: what the viewer should know, one sentence each.
        set_up: puts the scene onto an empty figure.
    """

    title: str
    frames: tuple[Frame, ...]
    steps: int
    fps: float
    notes: tuple[str, ...]
    set_up: Callable[[Figure], Show]

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def pictures(self) -> Projector:
        """The pictures (height, width, 3), uint8; each is drawn when it is asked for: ``film.pictures[-1]``."""
        return Projector(self.frames, self.set_up)

    def save(self, path: str | PathLike[str], progress: Callable[[], None] | None = None) -> Path:
        """Write the film, whole or not at all; its last picture stays for two seconds.

        Args:
            path: what to write; its suffix says how: .gif, .mp4 (needs ffmpeg) or .html (a page with its own player).
            progress: called after each picture.

        Raises:
            OptionError: the suffix is none of these, or ffmpeg is not installed or fails.
            FormatError: the place cannot be written.
        """
        path = Path(path)
        check_can_film(path)
        # frames that light up have colours of their own
        lit = [k for k, frame in enumerate(self.frames) if frame.flash]
        write_film(path, self.pictures, self.fps, self.title, lit, progress or _nothing)
        return path

    def _repr_html_(self) -> str:
        """The player, in a frame of its own so that several films in one notebook do not meet."""
        height, width = self._shape
        document = escape(page(self.pictures, self.fps, self.title, [], _nothing), quote=True)
        return (
            f'<iframe srcdoc="{document}" title="{escape(self.title, quote=True)}" width="{width + 40}" '
            f'height="{height + 90}" style="border:0;max-width:100%"></iframe>'
        )

    @property
    def _shape(self) -> tuple[int, int]:
        picture: np.ndarray = self.pictures[0]
        return picture.shape[0], picture.shape[1]


def _nothing() -> None:
    pass
