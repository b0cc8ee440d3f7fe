"""The figures of a comparison, of a log before it is solved, and of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.cells import cell_len, set_cell_size

from graphslam.log import UNIDENTIFIED
from graphslam.se2 import Array, compose, transform

from ..comparison import Comparison
from ..results import EstimatorResult
from ..results.files import elapsed_of, time_axis
from . import canvas

if TYPE_CHECKING:
    from ..evaluation import Evaluation
    from ..importing import Histogram, Overview

SIGMAS = 3.0
#: straight pieces that stand for an ellipse
CORNERS = 40
_ANGLES = np.linspace(0, 2 * np.pi, CORNERS + 1)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def ellipses(means: Mapping[int, Array], covariances: Mapping[int, Array]) -> Array:
    """The closed curves m + 3 V sqrt(D) (cos a, sin a)' with S = V D V', where the covariance S is known.

    Args:
        means: {id: (2,)} or longer; the first two numbers count.
        covariances: {id: (2, 2)} or larger; the upper left block counts.

    Returns:
        (L, CORNERS + 1, 2), in the order of ``covariances``.
    """
    m = np.array([means[j][:2] for j in covariances]).reshape(-1, 1, 2)
    variances, directions = np.linalg.eigh(np.array([S[:2, :2] for S in covariances.values()]).reshape(-1, 2, 2))
    half_axes = directions * (SIGMAS * np.sqrt(np.maximum(variances, 0)))[:, None, :]
    return np.asarray(m + np.swapaxes(half_axes @ _CIRCLE, 1, 2))


#: longer logs have some of their sightings drawn, evenly spread: more lines would only fill the page
MOST_SIGHTINGS = 3000
#: maps of more landmarks have their ellipses as an image in PDF and SVG files, which makes and opens them faster
MOST_ELLIPSES = 1000
#: estimators whose maps are drawn with ellipses
_MAPS = ("graph", "fastslam1")


def comparison_figure(comparison: Comparison) -> Figure:
    """The figure of a comparison, 7.16 inches wide (two columns of a page).

    Left: the trajectories along the recorded controls, the sightings from the graph's poses, the landmarks with the ellipses
    of three standard deviations (of each landmark given the path: its whole uncertainty is larger). Where the truth is
    known each estimate is aligned to it by the rigid motion that its errors are measured after: drawn from a common start,
    a small error of the first heading would hide all others. Paths are those of the point of the robot to which the truth
    belongs. Where only the true landmarks are known, the maps are aligned to them. Right: the position error of every
    step after that motion, whose root mean square is the ATE; in a log without true poses the norm of the correction of
    each iteration instead.
    """
    with canvas.paper_figure() as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_map(left, comparison)
        (_draw_convergence if comparison.log.true_poses is None else _draw_errors)(right, comparison)
        entries = len(left.get_legend_handles_labels()[1])
        figure.legend(loc="outside lower center", ncols=min(4, -(-entries // 2)))
    return figure


#: poses of which no line shows, because the truth is not known at those beside them
LONE: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2.5}


def draw_truth(axes: Axes, path: Array | None, landmarks: Mapping[int, Array] | None) -> list[Array]:
    """Draw the true path (n, 2 or 3) and the true landmarks where they are known; return their positions (k, 2) each."""
    positions = []
    if path is not None:
        axes.plot(*path[:, :2].T, label="ground truth", **canvas.TRUTH)
        if (single := canvas.lone(path[:, 0])).any():
            axes.plot(*path[single, :2].T, **canvas.TRUTH | LONE)
        positions.append(path[np.isfinite(path[:, 0]), :2])
    if landmarks:
        places = np.array([place[:2] for place in landmarks.values()])
        axes.plot(*places.T, label="true landmark", **canvas.TRUE_LANDMARK)
        positions.append(places)
    return positions


def parted(rows: Array, ends: np.ndarray | list[int]) -> Array:
    """Rows (n, ...) with a row of NaN before each of ``ends``, where another log begins: lines break there."""
    return np.insert(rows, ends, np.nan, axis=0)


def _draw_map(axes: Axes, comparison: Comparison) -> None:
    """Fill the left panel."""
    log, truth, reference = comparison.log, comparison.log.true_poses, canvas.reference_of(comparison)
    rest, starts = list[Array](), [drive.start for drive in log.drives]
    aligned, begun = canvas.aligned_to(log), log.initial_poses[starts]
    between = canvas.between_poses(log, comparison.options.motion)
    if (line := canvas.true_line(log)) is not None:
        line = parted(line, starts[1:] if log.true_path is None else log.control_starts[starts[1:]])
    core = draw_truth(axes, line, canvas.true_landmarks(log) if aligned else None)
    for result in comparison.results:
        placement = canvas.placement_of_result(log, result)
        unknown = ~result.estimated[:, None]
        path = parted(between.through(np.where(unknown, np.nan, result.poses)), between.rows[starts[1:]])
        poses = canvas.placed(log, placement, path)
        axes.plot(*poses[:, :2].T, label=_label(result), **canvas.style_of(result.name, len(poses)))
        (core if result is reference else rest).append(poses[np.isfinite(poses[:, 0]), :2])
        if result is reference:
            _draw_sightings(axes, comparison, np.where(unknown, np.nan, compose(placement, result.poses)))
            begun = compose(placement, log.at_truth(np.where(unknown, log.initial_poses, result.poses)[starts]))
            if (positions := log.positions) is not None and len(positions):
                crosses = transform(placement, positions.places[:, :2])
                axes.plot(*crosses.T, label="position measured", **canvas.POSITION)
                rest.append(crosses)
        # the map of a second solver of the same graph would only cover that of the first
        if result.landmarks and (result.name in _MAPS or result is reference):
            core.append(_draw_landmarks(axes, result, placement, result is reference))
    if log.steps.size and reference is not None:
        axes.plot([], [], label="sighting", **canvas.SIGHTING | {"linewidth": 0.8})
    if truth is not None:
        begun = np.where(log.covered[starts, None], truth[starts], begun)
    axes.plot(*begun[:, :2].T, label="start" if len(starts) == 1 else "start of each log", **canvas.START)
    box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    beside: dict[str, Any] = {"xytext": (4, 3), "textcoords": "offset points", "zorder": canvas.START["zorder"]}
    for number, place in enumerate(begun if len(starts) > 1 else (), start=1):
        axes.annotate(str(number), place[:2], bbox=box, **beside)
    canvas.set_limits(axes, np.concatenate(core), rest)
    how = f", aligned to {aligned}" if aligned else ""
    name = f"{len(log.sessions)} logs" if log.sessions else canvas.as_text(log.name)
    # a long name has a line of its own, since the other panel is beside the title
    heading = f"(a) {set_cell_size(name, min(cell_len(name), 52))}:" + (" " if cell_len(name + how) < 42 else "\n")
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{heading}paths and map{how}")


def _label(result: EstimatorResult) -> str:
    """The name of an estimator in the legend, with what distinguishes the two weightings of a graph."""
    options = result.options
    if result.name == "graph-marginal":
        return f"{result.name} (each sighting once)"
    if result.name != "graph" or str(options.get("edges", "landmark")).startswith("landmark"):
        return result.name
    return f"{result.name} ({options['weight']})"


def _draw_sightings(axes: Axes, comparison: Comparison, poses: Array) -> None:
    log, sensor = comparison.log, canvas.sensor_of(comparison)
    used = np.flatnonzero(np.isfinite(poses[log.steps, 0]))
    used = used[:: max(1, -(-len(used) // MOST_SIGHTINGS))]
    begins = poses[log.steps[used]]
    _draw_segments(axes, sensor.mount(begins)[:, :2], sensor.h_inverse(begins, log.sightings[used])[:, :2])


def _draw_segments(axes: Axes, begins: Array, ends: Array) -> None:
    """Lines between points (n, 2); many of them are an image in PDF and SVG files."""
    lines = LineCollection(list(np.stack([begins, ends], axis=1)), **canvas.SIGHTING)
    lines.set_rasterized(len(begins) > 1000)
    axes.add_collection(lines, autolim=False)


def _draw_landmarks(axes: Axes, result: EstimatorResult, placement: Array, solid: bool) -> Array:
    """Draw means and ellipses; return all their points (k, 2)."""
    means, covariances = canvas.place_map(placement, result.landmarks, result.landmark_covariances)
    curves, places, color = ellipses(means, covariances), np.array(list(means.values())), canvas.colour_of(result.name)
    axes.plot(places[:, 0], places[:, 1], ".", color=color, markersize=3, zorder=3.1)
    label = f"map of {result.name} (3σ)"
    drawn = PolyCollection(list(curves), zorder=3.0, label=label, **canvas.ellipse_style(color, solid=solid))
    drawn.set_rasterized(len(curves) > MOST_ELLIPSES)
    axes.add_collection(drawn, autolim=False)
    return np.concatenate([places, curves.reshape(-1, 2)])


def _draw_errors(axes: Axes, comparison: Comparison) -> None:
    medians, elapsed = [], elapsed_of(comparison.log)
    ends = [drive.start for drive in comparison.log.drives[1:]]
    for end in ends:
        axes.axvline(elapsed[end], color="0.7", linewidth=0.6, zorder=1)
    for name, errors in comparison.position_errors.items():
        style = canvas.style_of(name, len(errors))
        # errors cross each other more often than paths do
        thin = {"linewidth": 0.7 * style.get("linewidth", 1.0)}
        axes.plot(parted(elapsed, ends), parted(errors, ends), **style | thin)
        if (single := canvas.lone(errors)).any() and style["linestyle"] != "none":
            axes.plot(elapsed[single], errors[single], **style | LONE)
        medians.append(float(np.nanmedian(errors)))
    log_scale_where_apart(axes, medians)
    title = "(b) position error of every pose" + ", log after log" * bool(ends)
    axes.set(xlabel=time_axis(comparison.log), ylabel="position error [m]", title=title)
    axes.margins(x=0.02)


def log_scale_where_apart(axes: Axes, medians: list[float]) -> None:
    """A logarithmic axis where the medians of errors are more than a factor of ten apart."""
    bottom = canvas.logarithmic_from(medians)
    if bottom is not None:
        axes.set_yscale("log")
    axes.set_ylim(bottom=bottom or 0)


def _draw_convergence(axes: Axes, comparison: Comparison) -> None:
    norms = {result.name: np.asarray(result.step_norms) for result in comparison.results if len(result.step_norms)}
    for name, each in norms.items():
        style = canvas.style_of(name)
        if style["linestyle"] == "none":
            style |= {"linestyle": "-", "linewidth": 0.7}
        axes.plot(np.arange(1, len(each) + 1), each, **style)
    if any(np.any(each > 0) for each in norms.values()):
        axes.set_yscale("log")
    axes.set_xlim(0.5, max(map(len, norms.values()), default=1) + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set(xlabel="iteration", ylabel="norm of the correction", title="(b) convergence (the log has no true poses)")


def overview_figure(overview: Overview) -> Figure:
    """The figure of a log, 7.16 inches wide.

    Left: dead reckoning and every sighting, drawn from it to where it places its landmark; while the odometry is good the
    sightings of a landmark end close together. Right: when each landmark was seen, ranges, and bearings.
    """
    with canvas.paper_figure((canvas.WIDTH, 0.6 * canvas.WIDTH)) as figure:
        rows: Any = [["plan", "times", "times"], ["plan", "ranges", "bearings"]]
        panels: dict[str, Axes] = figure.subplot_mosaic(rows, width_ratios=(2, 1, 1))
        _draw_plan(panels["plan"], overview)
        _draw_times(panels["times"], overview)
        _draw_histogram(panels["ranges"], overview.ranges, "range [m]", "(c) ranges")
        _draw_histogram(panels["bearings"], overview.bearings, "bearing [rad]", "(d) bearings")
        figure.legend(loc="outside lower center", ncols=6)
    return figure


def _draw_plan(axes: Axes, overview: Overview) -> None:
    """The path and the sightings."""
    log, path = overview.log, overview.path
    line = canvas.between_poses(log, None).through(path)
    every = max(1, -(-len(log.steps) // MOST_SIGHTINGS))
    ends = overview.seen_at[::every]
    _draw_segments(axes, path[log.steps[::every], :2], ends)
    axes.plot(*ends.T, ".", label="sighting", color="0.45", markersize=2, zorder=2)
    axes.plot(*line[:, :2].T, label="dead reckoning", **canvas.style_of("dead-reckoning"))
    core = [line[:, :2], *draw_truth(axes, canvas.true_line(log), canvas.true_landmarks(log))]
    axes.plot(path[0, 0], path[0, 1], label="start", **canvas.START)
    canvas.set_limits(axes, np.concatenate(core), [ends])
    axes.set(xlabel="x [m]", ylabel="y [m]", title="(a) dead reckoning and sightings")


def _draw_times(axes: Axes, overview: Overview) -> None:
    log = overview.log
    ids, row = np.unique(log.landmarks, return_inverse=True)
    times = overview.times[log.steps]
    axes.plot(times, row, "|", color=canvas.colour_of("gtsam"), markersize=4, rasterized=len(row) > 5000)
    # of many landmarks some are named
    named = range(0, len(ids), max(1, -(-len(ids) // 12)))
    axes.set_yticks(named, ["?" if ids[k] == UNIDENTIFIED else str(ids[k]) for k in named])
    axes.set(xlabel=time_axis(log), ylabel="landmark", title="(b) when each is seen")


def _draw_histogram(axes: Axes, histogram: Histogram, label: str, title: str) -> None:
    axes.stairs(histogram.counts, histogram.edges, fill=True, color=canvas.colour_of("graph"))
    axes.set(xlabel=label, ylabel="sightings", title=title)


def _gaps(times: Array, longest: float) -> np.ndarray:
    """The rows of times (n,) [s] before which there is a gap: longer than ``longest``, and than three usual steps."""
    apart = np.diff(times)
    return np.flatnonzero(apart > max(longest, 3 * np.median(apart))) + 1


def evaluation_figure(evaluation: Evaluation) -> Figure:
    """The figure of estimates against the ground truth, 7.16 inches wide: aligned paths and maps, and position errors."""
    with canvas.paper_figure() as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        longest, truth = evaluation.options.longest_gap, evaluation.truth
        core = draw_truth(left, parted(truth.poses, _gaps(truth.times / 1e9, longest)), evaluation.true_map)
        handles, medians = list(left.lines), []
        for k, each in enumerate(evaluation.estimates):
            # ten colours, and another dash for each further ten
            style: dict[str, Any] = {
                "color": f"C{k % 10}",
                "linewidth": 1.0,
                "linestyle": ("-", "--", ":", "-.")[k // 10 % 4],
            }
            gaps = _gaps(each.times, longest)
            handles += left.plot(*parted(each.aligned, gaps)[:, :2].T, label=canvas.as_text(each.name), **style)
            if each.aligned_map:
                left.plot(*np.array(list(each.aligned_map.values())).T, "x", color=style["color"], markersize=4)
            right.plot(parted(each.times, gaps), parted(each.errors, gaps), **style)
            medians.append(float(np.nanmedian(each.errors)))
        canvas.set_limits(left, np.concatenate(core), [each.aligned[:, :2] for each in evaluation.estimates])
        left.set(xlabel="x [m]", ylabel="y [m]", title="(a) aligned paths")
        log_scale_where_apart(right, medians)
        right.set(xlabel="time [s]", ylabel="position error [m]", title="(b) position error of every pose")
        # by their names, because matplotlib itself leaves out those that begin with an underscore
        names = [str(handle.get_label()) for handle in handles]
        # about as many columns as there is room for
        columns = min(max(140 // (10 + max(map(cell_len, names))), 1), 4)
        figure.legend(handles, names, loc="outside lower center", ncols=columns)
    return figure
