"""The scene of a film: two panels with everything that does not move, and the parts that do.

The upper panel is the plane, with ground truth and dead reckoning, in limits that never change. The lower one is a curve
over iterations or steps with a marker at the current frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MaxNLocator

from graphslam import Log, MotionModel
from graphslam.se2 import Array, transform

from ..canvas import as_text, set_limits
from ..ellipses import ellipses
from ..placement import aligned_to, between_poses, place_map, placed, true_landmarks, true_line
from ..style import FLASH, SIGHTING, TRUE_LANDMARK, TRUTH, colour_of, ellipse_style, style_of
from .film import Frame, Show


class Scene:
    """The two panels of a film. The parts that move are added one by one, and drawn in this order.

    Args:
        figure: empty.
        log: its ground truth is drawn where it has one.
        name: the estimator, which has a colour.
        placement: the rigid motion (3,) of everything that is drawn. It aligns the last path to the ground truth, and is
            one for the whole film, dead reckoning included, so that nothing jumps.
        frames: the first and the last have to fit into the panel.
        title: of the film.
        motion: the motion model of dead reckoning.
        scale: norm, colours and label of the colour bar, where there is one.
    """

    def __init__(
        self, figure: Figure, log: Log, name: str, placement: Array, frames: Sequence[Frame], title: str,
        motion: MotionModel | None, scale: tuple[Normalize, Colormap, str] | None = None,
    ) -> None:  # fmt: skip
        self.figure, self.log, self.placement, self.color = figure, log, placement, colour_of(name)
        self._movers: list[Show] = []
        self._handles: dict[str, Artist] = {}
        width = 0.90 if scale is None else 0.805
        self.plane = figure.add_axes((0.085, 0.285, width, 0.64))
        self.strip = figure.add_axes((0.085, 0.125, width, 0.095))
        if scale is not None:
            bar = figure.add_axes((0.91, 0.305, 0.016, 0.60))
            figure.colorbar(ScalarMappable(*scale[:2]), cax=bar, label=scale[2], extend="both")
        self.between = between_poses(log, motion)
        drifting = self.along(log.initial_poses if log.controls is None else log.dead_reckoning(motion))
        style = style_of("dead-reckoning") | {"alpha": 0.55, "linewidth": 0.9}
        self.remember("dead reckoning", *self.plane.plot(*drifting.T, **style))
        means, curves = self._map(frames[-1])
        core = [self.along(frames[-1].poses), means, curves.reshape(-1, 2)]
        #: ground truth and true landmarks, for a film whose lines would hide them
        self.known: list[Artist] = []
        if (line := true_line(log)) is not None:
            pale = TRUTH | {"color": "0.55", "linewidth": 1.6, "zorder": 2}
            self.known += self.plane.plot(*line[:, :2].T, **pale)
            self.remember("ground truth", self.known[-1])
            core.append(line[np.isfinite(line[:, 0]), :2])
        of_map = np.array(list(true_landmarks(log).values() if aligned_to(log) else [])).reshape(-1, 2)
        if len(of_map):
            self.known += self.plane.plot(*of_map.T, **TRUE_LANDMARK | {"zorder": 2.1})
            self.remember("true landmark", self.known[-1])
            core.append(of_map)
        self._content = np.concatenate(core), [drifting, self.along(frames[0].poses)]
        self.extent = set_limits(self.plane, *self._content)
        # the second line of the title is left empty for the caption
        self.plane.set(xlabel="x [m]", ylabel="y [m]", title=f"{as_text(title)}\n ")

    def placed(self, poses: Array) -> Array:
        """Positions (k, 2) in the picture of poses (k, 3) in the estimator's axes."""
        return placed(self.log, self.placement, poses)[:, :2]

    def along(self, poses: Array) -> Array:
        """Positions (n, 2) in the picture of the path through the first poses (k, 3) of a drive, along its controls."""
        return self.placed(self.between.through(poses))

    def moved(self, points: Array) -> Array:
        """Points (k, 2) in the picture of points in the estimator's axes."""
        return transform(self.placement, points)

    def remember(self, label: str, handle: Artist) -> None:
        """Add an entry to the legend."""
        self._handles[label] = handle

    def add(self, *movers: Show) -> None:
        """Add parts that move: each brings its artists up to a frame and returns them."""
        self._movers += movers

    def finish(self) -> Show:
        """Add caption and legend, and return what draws a frame."""
        caption = self.plane.annotate(
            "", (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", va="bottom", animated=True
        )
        flash = self.plane.text(
            0.985, 0.975, "", ha="right", va="top", color="white", weight="bold", size=10, animated=True,
            transform=self.plane.transAxes, bbox={"facecolor": FLASH, "edgecolor": "none", "boxstyle": "round,pad=0.35"},
        )  # fmt: skip

        def texts(frame: Frame) -> list[Artist]:
            caption.set_text(frame.caption)
            flash.set_text(frame.flash)
            return [caption, flash] if frame.flash else [caption]

        self.add(texts)
        # again, because what was added since lets matplotlib choose the limits
        set_limits(self.plane, *self._content)
        self.figure.legend(
            list(self._handles.values()), list(self._handles), loc="lower center", bbox_to_anchor=(0.5, 0.0),
            ncols=-(-len(self._handles) // (1 if len(self._handles) <= 5 else 2)), handlelength=2.2,
        )  # fmt: skip
        return lambda frame: [artist for mover in self._movers for artist in mover(frame)]

    def add_path(self, label: str, **style: Any) -> None:
        """The path so far, in the estimator's colour."""
        (line,) = self.plane.plot([], [], color=self.color, **({"linewidth": 1.8} | style))
        self.remember(label, line)
        line.set_animated(True)

        def move(frame: Frame) -> list[Artist]:
            poses = frame.poses
            line.set_data(
                *self.along(poses if frame.estimated is None else np.where(frame.estimated[:, None], poses, np.nan)).T
            )
            return [line]

        self.add(move)

    def add_lines(self, **style: Any) -> LineCollection:
        """Line segments, which a part of its own has to move."""
        lines = LineCollection([], animated=True, **style)
        self.plane.add_collection(lines, autolim=False)
        return lines

    def add_sightings(self) -> None:
        """The lines from the last pose to what is seen from it."""
        style = SIGHTING | {"color": "0.6", "linewidth": 0.7, "zorder": 2.2}
        lines = self.add_lines(**style)
        self.remember("sighting", Line2D([], [], **style))

        def move(frame: Frame) -> list[Artist]:
            ends = self.moved(frame.sightings)
            lines.set_segments(
                list(np.stack([np.broadcast_to(self.placed(frame.poses[-1:]), ends.shape), ends], axis=1))
            )
            return [lines]

        self.add(move)

    def add_map(self, label: str) -> None:
        """Landmarks and their ellipses."""
        (dots,) = self.plane.plot(
            [], [], ".", color=self.color, markersize=4, markeredgecolor="white", markeredgewidth=0.3, animated=True
        )
        curves = PolyCollection([], animated=True, **ellipse_style(self.color))
        self.plane.add_collection(curves, autolim=False)
        self.remember(label, Patch(**ellipse_style(self.color)))

        def move(frame: Frame) -> list[Artist]:
            means, polygons = self._map(frame)
            dots.set_data(*means.T)
            curves.set_verts(list(polygons))
            return [curves, dots]

        self.add(move)

    def _map(self, frame: Frame) -> tuple[Array, Array]:
        """The landmarks (L, 2) of a frame and their ellipses (L', corners, 2), placed."""
        means, covariances = place_map(self.placement, frame.landmarks, frame.landmark_covariances)
        return np.array(list(means.values())).reshape(-1, 2), ellipses(means, covariances)

    def add_robot(self) -> None:
        """A triangle at the last pose that points where the robot is heading."""
        shape = self.extent * np.array([[0.016, 0.0], [-0.009, 0.009], [-0.009, -0.009]])
        triangle = Polygon(shape, closed=True, facecolor=self.color, edgecolor="black", linewidth=0.7, animated=True)
        self.plane.add_patch(triangle)

        def move(frame: Frame) -> list[Artist]:
            triangle.set_xy(transform(placed(self.log, self.placement, frame.poses[-1]), shape))
            return [triangle]

        self.add(move)

    def add_curve(self, numbers: np.ndarray, values: Array, xlabel: str, ylabel: str, *, log: bool = False) -> None:
        """A curve (F,) over the numbers (F,) in the lower panel: pale as a whole, dark up to the current frame.

        Values that are not finite leave gaps; on a logarithmic axis so do those that are not positive.
        """
        values = np.where(values > 0, values, np.nan) if log else values
        axes = self.strip
        axes.plot(numbers, values, color="0.78", linewidth=1.0)
        if log and np.isfinite(values).any():
            axes.set_yscale("log")
        axes.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
        axes.set_xlabel(xlabel, labelpad=1)
        axes.set_ylabel(ylabel)
        axes.margins(y=0.15)
        (past,) = axes.plot([], [], color=self.color, linewidth=1.6, animated=True)
        (now,) = axes.plot(
            [], [], "o", color=self.color, markersize=5, markeredgecolor="black", clip_on=False, animated=True
        )

        def move(frame: Frame) -> list[Artist]:
            before = numbers <= frame.number
            past.set_data(numbers[before], values[before])
            now.set_data(numbers[before][-1:], values[before][-1:])
            return [past, now]

        self.add(move)
