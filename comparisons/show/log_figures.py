"""The figure of a log before it is solved: dead reckoning with all sightings, when each landmark was seen, histograms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..exchange import time_axis
from .canvas import WIDTH, as_text, paper_figure, set_limits
from .figures import MOST_SIGHTINGS, log_scale_where_apart
from .placement import between_poses, true_line
from .style import SIGHTING, START, TRUE_LANDMARK, TRUTH, colour_of, style_of

if TYPE_CHECKING:
    from ..evaluation import Evaluation
    from ..overview import Histogram, Overview


def overview_figure(overview: Overview) -> Figure:
    """The figure of a log, 7.16 inches wide.

    Left: dead reckoning and every sighting, drawn from it to where it places its landmark; while the odometry is good the
    sightings of a landmark end close together. Right: when each landmark was seen, ranges, and bearings.
    """
    with paper_figure((WIDTH, 0.6 * WIDTH)) as figure:
        panels: dict[str, Axes] = figure.subplot_mosaic(
            [["plan", "times", "times"], ["plan", "ranges", "bearings"]], width_ratios=(2, 1, 1)
        )
        legend = _draw_plan(panels["plan"], overview)
        _draw_times(panels["times"], overview)
        _draw_histogram(panels["ranges"], overview.ranges, "range [m]", "(c) ranges")
        _draw_histogram(panels["bearings"], overview.bearings, "bearing [rad]", "(d) bearings")
        figure.legend(list(legend.values()), list(legend), loc="outside lower center", ncols=6)
    return figure


def _draw_plan(axes: Axes, overview: Overview) -> dict[str, Any]:
    """The path and the sightings; returns the entries of the legend."""
    log, path = overview.log, overview.path
    line = between_poses(log, None).through(path)
    legend: dict[str, Any] = {}
    every = max(1, -(-len(log.steps) // MOST_SIGHTINGS))
    begins, ends = path[log.steps[::every], :2], overview.seen_at[::every]
    lines = LineCollection(list(np.stack([begins, ends], axis=1)), **SIGHTING)
    lines.set_rasterized(True)
    axes.add_collection(lines, autolim=False)
    (legend["sighting"],) = axes.plot(*ends.T, ".", color="0.45", markersize=2, zorder=2)
    (legend["dead reckoning"],) = axes.plot(line[:, 0], line[:, 1], **style_of("dead-reckoning"))
    core = [line[:, :2]]
    if (truth := true_line(log)) is not None:
        (legend["ground truth"],) = axes.plot(truth[:, 0], truth[:, 1], **TRUTH)
        core.append(truth[np.isfinite(truth[:, 0]), :2])
    if log.true_landmarks:
        places = np.array([place[:2] for place in log.true_landmarks.values()])
        (legend["true landmark"],) = axes.plot(*places.T, **TRUE_LANDMARK)
        core.append(places)
    (legend["start"],) = axes.plot(path[0, 0], path[0, 1], **START)
    set_limits(axes, np.concatenate(core), [ends])
    axes.set(xlabel="x [m]", ylabel="y [m]", title="(a) dead reckoning and sightings")
    return legend


def _draw_times(axes: Axes, overview: Overview) -> None:
    log = overview.log
    ids, row = np.unique(log.landmarks, return_inverse=True)
    times = overview.times[log.steps]
    axes.plot(times, row, "|", color=colour_of("gtsam"), markersize=4, rasterized=len(row) > 5000)
    if len(ids) <= 12:
        axes.set_yticks(range(len(ids)), [str(id) if id >= -(2**62) else "?" for id in ids.tolist()])
    axes.set(xlabel=time_axis(log), ylabel="landmark", title="(b) when each is seen")


def _draw_histogram(axes: Axes, histogram: Histogram, label: str, title: str) -> None:
    axes.stairs(histogram.counts, histogram.edges, fill=True, color=colour_of("graph"))
    axes.set(xlabel=label, ylabel="sightings", title=title)


def evaluation_figure(evaluation: Evaluation) -> Figure:
    """The figure of estimates against the ground truth, 7.16 inches wide: aligned paths and maps, and position errors."""
    with paper_figure() as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        legend: dict[str, Any] = {}
        true = evaluation.truth.poses
        (legend["ground truth"],) = left.plot(true[:, 0], true[:, 1], **TRUTH)
        if evaluation.true_map:
            places = np.array([place[:2] for place in evaluation.true_map.values()])
            (legend["true landmark"],) = left.plot(*places.T, **TRUE_LANDMARK)
        medians = []
        for k, each in enumerate(evaluation.estimates):
            style = {"color": f"C{k % 10}", "linewidth": 1.0}
            (legend[as_text(each.name)],) = left.plot(each.aligned[:, 0], each.aligned[:, 1], **style)
            if each.aligned_map:
                left.plot(*np.array(list(each.aligned_map.values())).T, "x", color=style["color"], markersize=4)
            right.plot(each.times, each.errors, **style)
            medians.append(float(np.median(each.errors)))
        core = [true[:, :2], *([places] if evaluation.true_map else [])]
        set_limits(left, np.concatenate(core), [each.aligned[:, :2] for each in evaluation.estimates])
        left.set(xlabel="x [m]", ylabel="y [m]", title="(a) aligned paths")
        log_scale_where_apart(right, medians)
        right.set(xlabel="time [s]", ylabel="position error [m]", title="(b) position error of every pose")
        figure.legend(list(legend.values()), list(legend), loc="outside lower center", ncols=min(4, len(legend)))
    return figure
