"""`Film`, the frames of an estimator at work, to be saved or shown in a notebook; and `Scene`, the two panels of a film.

The upper panel is the plane, with ground truth and dead reckoning, in limits that never change. The lower one is a curve
over iterations or steps with a marker at the current frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from graphslam import Log, MotionModel
from graphslam.files import path_of
from graphslam.se2 import Array, transform

from .. import canvas
from ..figures import draw_truth, ellipses
from ..language import translated
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
        lines: (E, 2, 2) lines that have colours, those of large values last.
        values: what they are coloured by: (E,), or (k,) of the poses.
        dots: (n, 2) or (n, 3) particles, or sampled landmarks.
        flash: a word that lights up in the picture; empty for none.
    """

    number: int
    caption: str
    poses: Array
    estimated: np.ndarray | None = None
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)
    sightings: Array = field(default_factory=lambda: np.empty((0, 2)))
    lines: Array = field(default_factory=lambda: np.empty((0, 2, 2)))
    values: Array = field(default_factory=lambda: np.empty(0))
    dots: Array = field(default_factory=lambda: np.empty((0, 2)))
    flash: str = ""


#: brings artists of a scene up to a frame of its film
Update = Callable[[Any], object]
#: norm, colours and label of a colour bar
Scale = tuple[Normalize, Colormap, str]


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

    def __init__(self, film: Film) -> None:
        self._film, self._font = film, canvas.font_of(film.language)
        with canvas.paper_figure(SIZE) as figure:
            figure.set_dpi(DPI)
            # a layout that is computed at each frame would move the panels
            figure.set_layout_engine("none")
            self._scene = Scene(figure, film)
            self._translate(figure)
            assert isinstance(figure.canvas, FigureCanvasAgg)
            self._canvas = figure.canvas
            # within the style: ticks are made when they are first drawn
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(figure.bbox)

    def __len__(self) -> int:
        return len(self._film)

    def __getitem__(self, number: int) -> np.ndarray:  # type: ignore[override]
        return self._drawn(self._scene.at(self._film.frames[number]))

    @property
    def still(self) -> np.ndarray:
        """The pixels (height, width, 3) that are the same in all frames."""
        return self._drawn([])

    def _translate(self, drawn: Artist) -> None:
        if self._font is not None:
            canvas.translate_texts(drawn, partial(translated, language=self._film.language), self._font)

    def _drawn(self, artists: Sequence[Artist]) -> np.ndarray:
        self._canvas.restore_region(self._background)
        renderer = self._canvas.get_renderer()
        for artist in artists:
            if isinstance(artist, Text):
                self._translate(artist)
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()


@dataclass(frozen=True, eq=False, kw_only=True)
class Film:
    """The frames of an estimator at work on a log; made by `animate`.

    Attributes:
        title: of the film.
        name: the estimator, which has a colour.
        frames: the data of every picture, first to last.
        steps: the number of iterations or steps, the start included; more than frames where the film leaves some out.
        notes: what the viewer should know, one sentence each.
        parts: adds what the film shows to its scene.
        log: what the estimator worked on.
        motion: the motion model of dead reckoning.
        scale: of the lines that have colours.
        named: whether the ids of the landmarks are those of the log.
        aligned: whether the last path has to be aligned to the ground truth; localisation is in its axes.
        fps: frames per second.
        source: the file or folder of the log, where there is one.
        language: of the texts in the pictures: "en" or "ja".
    """

    title: str
    name: str = field(repr=False)
    frames: tuple[Frame, ...] = field(repr=False)
    steps: int
    notes: tuple[str, ...] = ()
    parts: Callable[[Scene], None] = field(repr=False)
    log: Log = field(repr=False)
    motion: MotionModel | None = field(repr=False)
    scale: Scale | None = field(default=None, repr=False)
    named: bool = field(default=True, repr=False)
    aligned: bool = field(default=True, repr=False)
    fps: float = 10.0
    source: Path | None = None
    language: str = "en"

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def pictures(self) -> Pictures:
        """The pictures, each drawn when it is asked for: ``film.pictures[-1]``."""
        return Pictures(self)

    def save(self, path: str | PathLike[str], *, progress: Callable[[], None] | None = None) -> Path:
        """Write the film, whole or not at all; its last picture stays for two seconds.

        Args:
            path: what to write. The suffix names the format: .gif, .mp4 (needs ffmpeg) or .html (a page with a player).
            progress: called after each picture.

        Raises:
            OptionError: the suffix is none of these, or ffmpeg is not installed or fails.
            FormatError: the place cannot be written.
        """
        path = path_of(path)
        check_can_film(path)
        write_film(self, path, progress or (lambda: None))
        return path

    def _repr_html_(self) -> str:
        """The player, in an iframe so that several films in one notebook do not interfere."""
        height, width = self.pictures[0].shape[:2]
        document, title = escape(player(self, lambda: None)), escape(self.title)
        size = f'width="{width + 40}" height="{height + 90}" style="border:0;max-width:100%"'
        return f'<iframe srcdoc="{document}" title="{title}" {size}></iframe>'


class Scene:
    """The two panels of a film. The parts that move are added one by one, and drawn in this order.

    One rigid motion of everything that is drawn, dead reckoning included, aligns the last path to the ground truth, so that
    nothing jumps. The first and the last frame have to fit into the panel.

    Args:
        figure: empty.
        film: its ground truth is drawn where its log has one.
    """

    def __init__(self, figure: Figure, film: Film) -> None:
        log, scale, last = film.log, film.scale, film.frames[-1]
        self.figure, self.log, self.color, self.placement = figure, log, canvas.colour_of(film.name), np.zeros(3)
        if film.aligned:
            self.placement = canvas.placement_of(log, last.poses, last.estimated, last.landmarks, named=film.named)
        self._moving: list[tuple[Update, tuple[Artist, ...]]] = []
        self._handles: dict[str, Artist] = {}
        width = 0.90 if scale is None else 0.805
        self.plane = figure.add_axes((0.085, 0.285, width, 0.64))
        self.strip = figure.add_axes((0.085, 0.125, width, 0.095))
        if scale is not None:
            bar = figure.add_axes((0.91, 0.305, 0.016, 0.60))
            figure.colorbar(ScalarMappable(*scale[:2]), cax=bar, label=scale[2], extend="both")
        self.between = canvas.between_poses(log, film.motion)
        drifting = self.along(log.initial_poses if log.controls is None else log.dead_reckoning(film.motion))
        style = canvas.style_of("dead-reckoning") | {"alpha": 0.55, "linewidth": 0.9}
        self.remember("dead reckoning", *self.plane.plot(*drifting.T, **style))
        means, curves = self._map(last)
        core = [self.along(last.poses), means, curves.reshape(-1, 2)]
        landmarks = canvas.true_landmarks(log) if canvas.aligned_to(log) else None
        core += draw_truth(self.plane, canvas.true_line(log), landmarks)
        #: ground truth and true landmarks, for a film whose lines would hide them
        self.known = self.plane.lines[1:]
        for line in self.known:
            line.set_zorder(2)
            label = str(line.get_label())
            if label != "true landmark":
                line.set(color="0.55", linewidth=1.6)
            # poses of which no line shows belong to the same entry
            if not label.startswith("_"):
                self.remember(label, line)
        content = np.concatenate(core), [drifting, self.along(film.frames[0].poses)]
        self.extent = canvas.set_limits(self.plane, *content)
        # the second line of the title is left empty for the caption
        self.plane.set(xlabel="x [m]", ylabel="y [m]", title=f"{canvas.as_text(film.title)}\n ")
        film.parts(self)
        self._add_texts()
        # again, because what was added since lets matplotlib choose the limits
        canvas.set_limits(self.plane, *content)
        figure.legend(
            list(self._handles.values()), list(self._handles), loc="lower center", bbox_to_anchor=(0.5, 0.0),
            ncols=-(-len(self._handles) // (1 if len(self._handles) <= 5 else 2)), handlelength=2.2,
        )  # fmt: skip

    def at(self, frame: Frame) -> list[Artist]:
        """What moves, as it is at a frame, in the order in which it is drawn."""
        for update, _ in self._moving:
            update(frame)
        return [artist for _, artists in self._moving for artist in artists]

    def placed(self, poses: Array) -> Array:
        """Positions (k, 2) in the picture of poses (k, 3) in the estimator's axes."""
        return canvas.placed(self.log, self.placement, poses)[:, :2]

    def along(self, poses: Array) -> Array:
        """Positions (n, 2) in the picture of the path through the first poses (k, 3) of a drive, along its controls."""
        return self.placed(self.between.through(poses))

    def moved(self, points: Array) -> Array:
        """Points (k, 2) in the picture of points in the estimator's axes."""
        return transform(self.placement, points)

    def remember(self, label: str, handle: Artist) -> None:
        """Add an entry to the legend."""
        self._handles[label] = handle

    def add(self, update: Update, *artists: Artist) -> None:
        """Add artists that move: ``update`` brings them up to a frame."""
        for artist in artists:
            artist.set_animated(True)
        self._moving.append((update, artists))

    def _add_texts(self) -> None:
        """The caption, and the word that lights up."""
        above: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "bottom"}
        caption = self.plane.annotate("", (0, 1), (0, 4), **above)
        flash = self.plane.text(
            0.985, 0.975, "", ha="right", va="top", color="white", weight="bold", size=10, transform=self.plane.transAxes,
            bbox={"facecolor": canvas.FLASH, "edgecolor": "none", "boxstyle": "round,pad=0.35"},
        )  # fmt: skip

        def update(frame: Frame) -> None:
            caption.set_text(frame.caption)
            flash.set_text(frame.flash)

        self.add(update, caption, flash)

    def add_path(self, label: str, **style: Any) -> None:
        """The path so far, in the estimator's colour."""
        (line,) = self.plane.plot([], [], color=self.color, **({"linewidth": 1.8} | style))
        self.remember(label, line)

        def update(frame: Frame) -> None:
            drawn = np.ones(len(frame.poses), dtype=bool) if frame.estimated is None else frame.estimated
            line.set_data(*self.along(np.where(drawn[:, None], frame.poses, np.nan)).T)

        self.add(update, line)

    def add_lines(self, **style: Any) -> LineCollection:
        """Line segments, which a part of its own has to move."""
        lines = LineCollection([], **style)
        self.plane.add_collection(lines, autolim=False)
        return lines

    def add_coloured(
        self, norm: Normalize, colours: Colormap, drawn: Callable[[Any], tuple[Array, Array]] | None = None, **style: Any,
    ) -> None:  # fmt: skip
        """Lines (E, 2, 2) in the picture in the colours of values (E,): those that a frame has, or ``drawn`` of a frame."""
        lines = self.add_lines(cmap=colours, norm=norm, **style)

        def update(frame: Frame) -> None:
            own = self.moved(frame.lines.reshape(-1, 2)).reshape(-1, 2, 2), frame.values
            segments, values = own if drawn is None else drawn(frame)
            lines.set_segments(list(segments))
            lines.set_array(values)

        self.add(update, lines)

    def add_sightings(self) -> None:
        """The lines from the last pose to what is seen from it."""
        style = canvas.SIGHTING | {"color": "0.6", "linewidth": 0.7, "zorder": 2.2}
        lines = self.add_lines(**style)
        self.remember("sighting", Line2D([], [], **style))

        def update(frame: Frame) -> None:
            ends = self.moved(frame.sightings)
            begins = np.broadcast_to(self.placed(frame.poses[-1:]), ends.shape)
            lines.set_segments(list(np.stack([begins, ends], axis=1)))

        self.add(update, lines)

    def add_map(self, label: str) -> None:
        """Landmarks and their ellipses."""
        (dots,) = self.plane.plot(
            [], [], ".", color=self.color, markersize=4, markeredgecolor="white", markeredgewidth=0.3
        )
        curves = PolyCollection([], **canvas.ellipse_style(self.color))
        self.plane.add_collection(curves, autolim=False)
        self.remember(label, Patch(**canvas.ellipse_style(self.color)))

        def update(frame: Frame) -> None:
            means, polygons = self._map(frame)
            dots.set_data(*means.T)
            curves.set_verts(list(polygons))

        self.add(update, curves, dots)

    def _map(self, frame: Frame) -> tuple[Array, Array]:
        """The landmarks (L, 2) of a frame and their ellipses (L', corners, 2), placed."""
        means, covariances = canvas.place_map(self.placement, frame.landmarks, frame.landmark_covariances)
        return np.array(list(means.values())).reshape(-1, 2), ellipses(means, covariances)

    def add_robot(self) -> None:
        """A triangle at the last pose that points where the robot is heading."""
        shape = self.extent * np.array([[0.016, 0.0], [-0.009, 0.009], [-0.009, -0.009]])
        triangle = Polygon(shape, closed=True, facecolor=self.color, edgecolor="black", linewidth=0.7)
        self.plane.add_patch(triangle)

        def update(frame: Frame) -> None:
            triangle.set_xy(transform(canvas.placed(self.log, self.placement, frame.poses[-1]), shape))

        self.add(update, triangle)

    def add_curve(self, numbers: np.ndarray, values: Array, xlabel: str, ylabel: str, *, log: bool = False) -> None:
        """A curve (F,) over the numbers (F,) in the lower panel: pale as a whole, dark up to the current frame.

        Values that are not finite leave gaps. With ``log`` those that are not positive do, too, and the axis is logarithmic
        where they are more than a factor of ten apart.
        """
        values = np.where(values > 0, values, np.nan) if log else values
        known = values[np.isfinite(values)].tolist()
        axes = self.strip
        axes.plot(numbers, values, color="0.78", linewidth=1.0)
        if log and canvas.logarithmic_from(known) is not None:
            axes.set_yscale("log")
        axes.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
        axes.set_xlabel(xlabel, labelpad=1)
        axes.set_ylabel(ylabel)
        axes.margins(y=0.15)
        (past,) = axes.plot([], [], color=self.color, linewidth=1.6)
        (now,) = axes.plot([], [], "o", color=self.color, markersize=5, markeredgecolor="black", clip_on=False)

        def update(frame: Frame) -> None:
            before = numbers <= frame.number
            past.set_data(numbers[before], values[before])
            now.set_data(numbers[before][-1:], values[before][-1:])

        self.add(update, past, now)
