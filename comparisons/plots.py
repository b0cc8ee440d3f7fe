"""The figure of a comparison: trajectories and map on the left, errors (or convergence) on the right.

Only matplotlib's objects are used, no pyplot: nothing global changes, and any number of figures can be made at once.
Colours are those of Okabe and Ito (distinct for the colour-blind); each estimator also has its own line style or
marker and its own lightness, so that the figure survives a grey print.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from graphslam import Log, SensorModel
from graphslam.metrics import align, position_errors
from graphslam.se2 import Array, compose, inverse, transform

from .comparison import Comparison
from .estimator import EstimatorResult

DRIFTING = "dead-reckoning"

# thick light lines lie below, thin dark ones and bare markers above: where answers coincide all of them show
_STYLES: dict[str, dict[str, Any]] = {
    "dead-reckoning": {"color": "#E69F00", "linestyle": (0, (5, 1.5)), "linewidth": 1.1, "zorder": 2.1},
    "textbook": {"color": "#D55E00", "linestyle": "none", "marker": "x", "markersize": 3.6, "zorder": 3.4},
    "graph": {"color": "#56B4E9", "linestyle": "-", "linewidth": 2.3, "zorder": 2.3},
    "gtsam": {"color": "#0072B2", "linestyle": "none", "marker": "o", "markerfacecolor": "none", "zorder": 3.5},
    "isam2": {"color": "#332288", "linestyle": (0, (2, 2)), "linewidth": 1.0, "zorder": 2.8},
    "mcl": {"color": "#CC79A7", "linestyle": (0, (1, 1.2)), "linewidth": 1.4, "zorder": 2.5},
    "fastslam1": {"color": "#009E73", "linestyle": (0, (6, 1.2, 1, 1.2)), "linewidth": 1.1, "zorder": 2.6},
    "fastslam2": {"color": "#882255", "linestyle": (0, (3, 1, 1, 1, 1, 1)), "linewidth": 1.1, "zorder": 2.7},
}
_OTHER = ("#882255", "#44AA99", "#999933", "#332288")
_TRUTH: dict[str, Any] = {"color": "black", "linestyle": "-", "linewidth": 0.9, "zorder": 2.9}

#: more sightings than this are thinned out: beyond it lines only fill the page
MOST_SIGHTINGS = 3000
#: estimates whose maps are drawn with ellipses, where they ran
_MAPS = ("graph", "fastslam1")


def comparison_figure(comparison: Comparison) -> Figure:
    """The figure of a comparison, 7.16 inches wide (two columns of a page).

    Left: the trajectories, the sightings from the graph's poses, the landmarks with the ellipses of three standard
    deviations (of each landmark given the path: its whole uncertainty is larger). Where the truth is known each
    estimate is laid onto it by the rigid motion that its errors are measured after (drawn from a common start, a small
    error of the first heading would hide all others); only dead reckoning leaves from the true start, since its drift
    from there is what all others have to mend. Right: the position error of every step after that motion, whose root
    mean square is the ATE; in a log without truth the norm of the correction of each iteration instead.
    """
    with paper_figure() as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_map(left, comparison)
        if comparison.log.true_poses is not None:
            _draw_errors(right, comparison)
        else:
            _draw_convergence(right, comparison)
        handles, labels = _legend(comparison)
        figure.legend(handles, labels, loc="outside lower center", ncols=min(6, -(-len(labels) // 2)))
    return figure


@contextmanager
def paper_figure(figsize: tuple[float, float] | None = None) -> Iterator[Figure]:
    """An empty figure, filled by the block in the style of all figures here, and laid out when the block ends."""
    with _paper_style():
        figure = Figure(figsize=figsize)
        FigureCanvasAgg(figure)
        yield figure
        # once, here, where the style is known: saving then changes nothing
        figure.draw_without_rendering()


@contextmanager
def _paper_style() -> Iterator[None]:
    style = files("comparisons").joinpath("paper.mplstyle")
    with as_file(style) as path, matplotlib.rc_context(fname=path):
        yield


def save_figure(figure: Figure, paths: Sequence[Path]) -> None:
    """Write a figure, in the formats that the suffixes name, without a time stamp: same data, same file.

    Raises:
        OSError: a file cannot be written.
    """
    with _paper_style():
        for target in paths:
            metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(target.suffix, {})
            figure.savefig(target, metadata=metadata)


def png_as_html(figure: Figure) -> str:
    """A figure as an image that is part of the page."""
    stream = BytesIO()
    with _paper_style():
        figure.savefig(stream, format="png")
    return f'<img alt="figure" src="data:image/png;base64,{b64encode(stream.getvalue()).decode()}">'


def style_of(name: str, steps: int) -> dict[str, Any]:
    """The line properties of an estimator, for a line of so many points."""
    style = _STYLES.get(name)
    if style is None:
        others = sum(map(ord, name))
        style = {"color": _OTHER[others % len(_OTHER)], "linestyle": (0, (3, 1, 1, 1, 1, 1)), "zorder": 2.7}
    style = dict(style)
    if "marker" in style:
        # two rows of markers on one line take turns
        every = max(2, steps // 15)
        style["markevery"] = (every // 2 if name == "textbook" else 0, every)
    return style


def _draw_map(axes: Axes, comparison: Comparison) -> None:
    log = comparison.log
    truth = log.true_poses
    reference = reference_of(comparison)
    core: list[Array] = []
    rest: list[Array] = []
    if truth is not None:
        axes.plot(truth[:, 0], truth[:, 1], **_TRUTH)
        core.append(truth[log.covered, :2])
        if log.true_landmarks:
            landmarks = np.array([m[:2] for m in log.true_landmarks.values()])
            axes.plot(landmarks[:, 0], landmarks[:, 1], **_true_landmark_style())
            core.append(landmarks)
    for result in comparison.results:
        frame = frame_of(comparison, result)
        poses = compose(frame, result.poses)
        shown = np.where(result.estimated[:, None], poses, np.nan)
        axes.plot(shown[:, 0], shown[:, 1], **style_of(result.name, len(shown)))
        (core if result is reference else rest).append(poses[result.estimated, :2])
        if result is reference:
            _draw_sightings(axes, log, poses, result.estimated)
        if _has_map(result, reference):
            core.append(_draw_landmarks(axes, result, frame, result is reference))
    start = log.initial_poses[0] if truth is None else truth[0]
    axes.plot(start[0], start[1], **_start_style())
    set_limits(axes, np.concatenate(core), rest)
    how = "" if truth is None else ", laid onto the truth"
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"(a) {log.name}: paths and map{how}")


def _draw_sightings(axes: Axes, log: Log, poses: Array, estimated: np.ndarray) -> None:
    used = np.flatnonzero(estimated[log.steps]) if len(log.steps) else np.empty(0, dtype=int)
    used = used[:: max(1, -(-len(used) // MOST_SIGHTINGS))]
    begins = poses[log.steps[used]]
    ends = SensorModel().h_inverse(begins, log.sightings[used])[:, :2]
    lines = LineCollection(list(np.stack([begins[:, :2], ends], axis=1)), **_sighting_style())
    lines.set_rasterized(len(used) > 1000)
    axes.add_collection(lines, autolim=False)


def _draw_landmarks(axes: Axes, result: EstimatorResult, frame: Array, is_reference: bool) -> Array:
    """Means and ellipses; returns corners (2L, 2) between which all of them lie."""
    means, widths, heights, angles = _ellipses(result, frame)
    color = style_of(result.name, 0)["color"]
    axes.plot(means[:, 0], means[:, 1], ".", color=color, markersize=3, zorder=3.1)
    ellipses = EllipseCollection(
        widths, heights, angles, units="xy", offsets=means, offset_transform=axes.transData, zorder=3.0,
        **_ellipse_style(color, is_reference),
    )  # fmt: skip
    axes.add_collection(ellipses, autolim=False)
    reach = widths[:, None] / 2
    return np.concatenate([means - reach, means + reach])


def _draw_errors(axes: Axes, comparison: Comparison) -> None:
    truth = comparison.log.true_poses
    assert truth is not None
    curves = {}
    for result in comparison.results:
        if np.count_nonzero(result.estimated) >= 2:
            curves[result.name] = position_errors(truth, result.poses, mask=result.estimated)
    for name, errors in curves.items():
        style = style_of(name, len(errors))
        # errors cross each other more often than paths do
        style["linewidth"] = 0.7 * style.get("linewidth", 1.0)
        axes.plot(np.arange(len(errors)), errors, **style)
    medians = [m for m in (float(np.nanmedian(errors)) for errors in curves.values()) if m > 0]
    if medians and max(medians) > 10 * min(medians):
        axes.set_yscale("log")
        # single steps that happen to be exact would otherwise stretch the axis for nothing
        axes.set_ylim(bottom=min(medians) / 10)
    else:
        axes.set_ylim(bottom=0)
    axes.set(xlabel="step", ylabel="position error [m]", title="(b) error of every step")
    axes.margins(x=0.02)


def _draw_convergence(axes: Axes, comparison: Comparison) -> None:
    longest = 1
    for result in comparison.results:
        if len(norms := result.step_norms):
            style = {"linestyle": "-"} | {k: v for k, v in style_of(result.name, 0).items() if k != "markevery"}
            if style["linestyle"] == "none":
                style |= {"linestyle": "-", "linewidth": 0.7}
            axes.plot(np.arange(1, len(norms) + 1), norms, **style)
            longest = max(longest, len(norms))
    axes.set_yscale("log")
    axes.set_xlim(0.5, longest + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set(xlabel="iteration", ylabel="norm of the correction", title="(b) convergence (the log has no true poses)")


def frame_of(comparison: Comparison, result: EstimatorResult) -> Array:
    """The motion (3,) that a result is drawn after: onto the truth as a whole, or dead reckoning onto its start."""
    truth = comparison.log.true_poses
    if truth is None or not result.estimated.any():
        return np.zeros(3)
    if result.name == DRIFTING:
        # without a true heading it leaves from where the log has it
        known = np.flatnonzero(np.isfinite(truth).all(axis=1))
        return compose(truth[known[0]], inverse(result.poses[known[0]])) if len(known) else np.zeros(3)
    return align(truth, result.poses, mask=result.estimated)


def reference_of(comparison: Comparison) -> EstimatorResult | None:
    """The result that sightings and map are drawn of: the graph, or the best thing after it."""
    for name in ("graph", "gtsam", "textbook", "fastslam1"):
        if name in comparison:
            return comparison[name]
    return comparison.results[0] if comparison.results else None


def _has_map(result: EstimatorResult, reference: EstimatorResult | None) -> bool:
    """Whether the map of a result is drawn; that of a solver's twin would only lie on top of its own."""
    return bool(result.landmarks) and (result.name in _MAPS or result is reference)


def _ellipses(result: EstimatorResult, frame: Array) -> tuple[Array, Array, Array, Array]:
    """Centres (L, 2), full axes [m] of three standard deviations, the long one first, and its angle [deg]."""
    means = transform(frame, np.array([m[:2] for m in result.landmarks.values()]))
    covariances = np.array([result.landmark_covariances[j][:2, :2] for j in result.landmarks])
    variances, directions = np.linalg.eigh(covariances)
    full = 2 * 3 * np.sqrt(np.maximum(variances, 0))
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]) + frame[2])
    return means, full[:, 1], full[:, 0], angles


def set_limits(axes: Axes, core: Array, rest: Sequence[Array]) -> float:
    """Show all of the core (k, 2), and of the rest what does not make the core smaller than half of the panel.

    Returns:
        The larger side of what is shown [m].
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


def _true_landmark_style() -> dict[str, Any]:
    return {"color": "black", "linestyle": "none", "marker": "+", "markersize": 6, "zorder": 3.3}


def _sighting_style() -> dict[str, Any]:
    return {"color": "0.72", "linewidth": 0.35, "zorder": 1.5}


def _ellipse_style(color: str, is_reference: bool) -> dict[str, Any]:
    style = {"facecolor": (*to_rgb(color), 0.12), "edgecolor": color, "linewidth": 0.9}
    return style | {"linestyle": "-" if is_reference else (0, (3, 1))}


def _start_style() -> dict[str, Any]:
    return {"color": "black", "linestyle": "none", "marker": "s", "markersize": 4, "zorder": 4}


def _legend(comparison: Comparison) -> tuple[list[Any], list[str]]:
    handles: list[Any] = []
    labels: list[str] = []
    truth = comparison.log.true_poses is not None
    if truth:
        handles.append(Line2D([], [], **_TRUTH))
        labels.append("truth")
    for result in comparison.results:
        style = {k: v for k, v in style_of(result.name, 0).items() if k != "markevery"}
        handles.append(Line2D([], [], **style))
        labels.append(result.name)
    if truth and comparison.log.true_landmarks:
        handles.append(Line2D([], [], **_true_landmark_style()))
        labels.append("true landmark")
    reference = reference_of(comparison)
    for result in comparison.results:
        if _has_map(result, reference):
            color = style_of(result.name, 0)["color"]
            handles.append(Ellipse((0, 0), 1, 1, **_ellipse_style(color, result is reference)))
            labels.append(f"map of {result.name} (3σ)")
    if comparison.log.steps.size and reference is not None:
        handles.append(Line2D([], [], **_sighting_style() | {"linewidth": 0.8}))
        labels.append("sighting")
    handles.append(Line2D([], [], **_start_style()))
    labels.append("start")
    return handles, labels
