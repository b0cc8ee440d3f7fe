"""The stage: what all films show in the same place, and the parts that move on it.

The upper panel is the plane, with truth and dead reckoning faint, in limits that never change. The lower one is a
curve over iterations or steps with a marker where the film is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MaxNLocator

from graphslam import Log
from graphslam.metrics import align
from graphslam.se2 import Array, compose, transform

from ..plots import DRIFTING, set_limits, style_of
from .ellipses import map_of
from .frame import Frame

#: for what lights up; none of the estimators that are filmed has it
FLASH = "#D55E00"
_TRUTH: dict[str, Any] = {"color": "0.55", "linewidth": 1.6, "zorder": 2}
_SIGHTING: dict[str, Any] = {"color": "0.6", "linewidth": 0.7, "zorder": 2.2}
_MARK: dict[str, Any] = {"color": "black", "linestyle": "none", "marker": "+", "markersize": 6, "zorder": 2.1}


def placement_of(log: Log, poses: Array, estimated: np.ndarray | None = None) -> Array:
    """The rigid motion (3,) that lays a film's last path onto the truth; none where there is no truth.

    All pictures, and dead reckoning, are drawn after this one motion, so that nothing jumps.
    """
    usable = log.covered if estimated is None else log.covered & estimated
    if log.true_poses is None or not usable.any():
        return np.zeros(3)
    return align(log.true_poses, poses, mask=usable)


class Stage:
    """The two panels, drawn with everything that stands still.

    Args:
        figure: empty.
        log: what the robot did; its truth is drawn where it has one.
        name: the estimator; gives title and colour.
        placement: the pose (3,) of the estimator's axes in the picture.
        start, end: the first and the last frame, which have to fit.
        dead_reckoning: (T+1, 3) in the estimator's axes.
        title: what the film is of.
        scale: norm, colours and label of the colour bar, where there is one.
    """

    def __init__(
        self, figure: Figure, log: Log, name: str, placement: Array, start: Frame, end: Frame, dead_reckoning: Array,
        title: str, scale: tuple[Normalize, Colormap, str] | None = None,
    ) -> None:  # fmt: skip
        self.figure, self.log, self.placement = figure, log, placement
        self.color: str = style_of(name, 0)["color"]
        width = 0.90 if scale is None else 0.805
        self.plane, self.strip = (
            figure.add_axes((0.085, 0.285, width, 0.64)),
            figure.add_axes((0.085, 0.125, width, 0.095)),
        )
        plane = self.plane
        if scale is not None:
            figure.colorbar(
                ScalarMappable(*scale[:2]),
                cax=figure.add_axes((0.91, 0.305, 0.016, 0.60)),
                label=scale[2],
                extend="both",
            )
        self._handles: dict[str, Artist] = {}
        #: truth and true landmarks, for a scene that would hide them
        self.known: list[Artist] = []
        drifting = transform(placement, dead_reckoning[:, :2])
        style = style_of(DRIFTING, 0) | {"alpha": 0.55, "linewidth": 0.9}
        self.remember("dead reckoning", *plane.plot(drifting[:, 0], drifting[:, 1], **style))
        core = [self.placed(end.poses), map_of(end, placement)[0]]
        if log.true_poses is not None:
            truth = log.true_poses
            self.known += plane.plot(truth[:, 0], truth[:, 1], **_TRUTH)
            self.remember("truth", self.known[-1])
            core.append(truth[log.covered, :2])
            if log.true_landmarks:
                marks = np.array([m[:2] for m in log.true_landmarks.values()])
                self.known += plane.plot(marks[:, 0], marks[:, 1], **_MARK)
                self.remember("true landmark", self.known[-1])
                core.append(marks)
        self.extent = set_limits(plane, np.concatenate(core), [drifting, self.placed(start.poses)])
        plane.set(xlabel="x [m]", ylabel="y [m]", title=f"{title}\n ")
        above: dict[str, Any] = {"transform": plane.transAxes, "va": "bottom", "animated": True}
        # on the second line of the title, which is left empty for it
        self._caption = plane.annotate(
            "", (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", va="bottom", animated=True
        )
        self._flash = plane.text(
            0.985, 0.975, "", ha="right", color="white", weight="bold", size=10,
            bbox={"facecolor": FLASH, "edgecolor": "none", "boxstyle": "round,pad=0.35"}, **(above | {"va": "top"}),
        )  # fmt: skip

    def placed(self, poses: Array) -> Array:
        """Positions (k, 2) in the picture of poses in the estimator's axes."""
        return transform(self.placement, np.asarray(poses)[:, :2])

    def words(self, frame: Frame) -> list[Artist]:
        """Caption and flash of a frame."""
        self._caption.set_text(frame.caption)
        self._flash.set_text(frame.flash)
        return [self._caption, self._flash] if frame.flash else [self._caption]

    def path(self, label: str, **style: Any) -> Line2D:
        """A line in the estimator's colour, to be filled picture by picture."""
        (line,) = self.plane.plot([], [], color=self.color, **({"linewidth": 1.8} | style))
        self.remember(label, line)
        line.set_animated(True)
        return line

    def sightings(self) -> LineCollection:
        """The lines from the robot to where it sees something now."""
        lines = LineCollection([], animated=True, **_SIGHTING)
        self.plane.add_collection(lines, autolim=False)
        self.remember("sighting", Line2D([], [], **_SIGHTING))
        return lines

    def legend(self) -> None:
        """One row below both panels; called when everything is on the stage."""
        self.figure.legend(
            list(self._handles.values()), list(self._handles), loc="lower center", bbox_to_anchor=(0.5, 0.0),
            ncols=-(-len(self._handles) // (1 if len(self._handles) <= 5 else 2)), handlelength=2.2,
        )  # fmt: skip

    def remember(self, label: str, handle: Artist) -> None:
        """An entry of the legend."""
        self._handles[label] = handle

    def remember_map(self, label: str) -> None:
        """The landmarks' entry of the legend."""
        self.remember(label, Patch(facecolor=(*to_rgb(self.color), 0.15), edgecolor=self.color, linewidth=0.9))


class MapArtists:
    """Landmarks and their ellipses, moved from frame to frame."""

    def __init__(self, stage: Stage, label: str) -> None:
        self._placement = stage.placement
        (self._means,) = stage.plane.plot(
            [], [], ".", color=stage.color, markersize=4, markeredgecolor="white", markeredgewidth=0.3, animated=True
        )
        self._ellipses = PolyCollection(
            [], facecolor=(*to_rgb(stage.color), 0.15), edgecolor=stage.color, linewidth=0.9, animated=True
        )
        stage.plane.add_collection(self._ellipses, autolim=False)
        stage.remember_map(label)

    def show(self, frame: Frame) -> list[Artist]:
        """The artists of a frame's map."""
        means, curves = map_of(frame, self._placement)
        self._means.set_data(means[:, 0], means[:, 1])
        self._ellipses.set_verts(list(curves))
        return [self._ellipses, self._means]


class Robot:
    """A triangle that stands where the robot is and points where it looks."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._shape = stage.extent * np.array([[0.016, 0.0], [-0.009, 0.009], [-0.009, -0.009]])
        self._patch = Polygon(
            self._shape, closed=True, facecolor=stage.color, edgecolor="black", linewidth=0.7, animated=True
        )
        stage.plane.add_patch(self._patch)

    def show(self, pose: Array) -> list[Artist]:
        """The triangle at a pose (3,) in the estimator's axes."""
        self._patch.set_xy(transform(compose(self._stage.placement, pose), self._shape))
        return [self._patch]


class Curve:
    """A curve over the numbers of all frames in the lower panel: pale as a whole, dark as far as the film has come.

    Args:
        stage: whose lower panel it is.
        numbers, values: (F,) each; values that are not finite leave gaps.
        xlabel, ylabel: of the axes.
        log_scale: whether the values are drawn by their logarithm; those not above zero leave gaps then.
    """

    def __init__(
        self, stage: Stage, numbers: np.ndarray, values: Array, xlabel: str, ylabel: str, log_scale: bool = False
    ) -> None:
        if log_scale:
            values = np.where(values > 0, values, np.nan)
        self._numbers, self._values = numbers, values
        axes = stage.strip
        axes.plot(numbers, values, color="0.78", linewidth=1.0)
        if log_scale and np.isfinite(values).any():
            axes.set_yscale("log")
        axes.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
        axes.set_xlabel(xlabel, labelpad=1)
        axes.set_ylabel(ylabel)
        axes.margins(y=0.15)
        (self._past,) = axes.plot([], [], color=stage.color, linewidth=1.6, animated=True)
        (self._now,) = axes.plot(
            [], [], "o", color=stage.color, markersize=5, markeredgecolor="black", clip_on=False, animated=True
        )

    def show(self, frame: Frame) -> list[Artist]:
        """The curve up to a frame."""
        past = self._numbers <= frame.number
        self._past.set_data(self._numbers[past], self._values[past])
        self._now.set_data(self._numbers[past][-1:], self._values[past][-1:])
        return [self._past, self._now]
