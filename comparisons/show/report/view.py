"""The data of the report of a comparison: all estimates aligned, with errors and covariances, thinned to fit.

`line_of`, `layout` and `axis` give all figures of the report one look: the colours, dashes and markers of `show.canvas`, by
their names in Plotly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphslam import Log
from graphslam.log.continuous_time import ControlPath
from graphslam.metrics import position_errors
from graphslam.se2 import Array, perpendicular, turn_matrix

from ...comparison import Comparison
from ...results import EstimatorResult
from ...results.files import elapsed_of
from .. import canvas
from ..figures import parted

#: of longer logs every N-th step is shown: a screen has no more points, and the file must stay small
MOST_STEPS = 1500
#: about so many points has the line of a path at most
MOST_POINTS = 5000


@dataclass(frozen=True, eq=False)
class Estimate:
    """One estimate at the S steps that are shown, aligned to the ground truth where that is known.

    Attributes:
        name: of the estimator.
        poses: (S, 3); NaN where the pose is not estimated.
        line: (P, 3) the path along the recorded controls; NaN before each further one of several logs.
        errors: (S,) [m], see `View.measured_from`; NaN where unknown.
        covariances: (S, 3, 3) in the aligned axes, NaN where unknown; None where none is known.
        landmarks, landmark_covariances: {id: (2,)} and {id: (2, 2)} in the aligned axes.
        landmark_errors: {id: error [m]} where it is known.
    """

    name: str
    poses: Array
    line: Array
    errors: Array
    covariances: Array | None
    landmarks: Mapping[int, Array]
    landmark_covariances: Mapping[int, Array]
    landmark_errors: Mapping[int, float]


@dataclass(frozen=True, eq=False)
class View:
    """All estimates of a comparison as they are drawn: paths of the point to which the ground truth belongs.

    Attributes:
        log: what was estimated from.
        aligned_to: what the estimates are aligned to, see `canvas.aligned_to`.
        steps: (S,) the steps shown.
        times: (S,) since the first pose [s]; None where the log has none.
        truth: (S, 3), NaN where unknown; None without ground truth.
        true_line: (P, 3) the true path as far as it is known.
        estimates: in the order of the results.
        measured_from: the path that errors are distances from, after alignment: "truth", or the name of an estimator
            where the truth is not known; None where there is nothing to compare with.
        sightings: for each step shown (K, 3): what is seen, as seen from that point, in the axes of the robot [m], and
            the id of the landmark.
    """

    log: Log
    aligned_to: str
    steps: np.ndarray
    times: Array | None
    truth: Array | None
    true_line: Array | None
    estimates: tuple[Estimate, ...]
    measured_from: str | None
    sightings: tuple[Array, ...]


def view_of(comparison: Comparison) -> View:
    """The view of a comparison."""
    log = comparison.log
    stride = max(1, -(-log.num_poses // MOST_STEPS))
    steps = np.unique(np.append(np.arange(0, log.num_poses, stride), log.num_poses - 1))
    path, measured_from = log.true_poses, "truth" if log.true_poses is not None else None
    reference = canvas.reference_of(comparison)
    if path is None and reference is not None and len(comparison.results) >= 2:
        path = np.where(reference.estimated[:, None], log.at_truth(reference.poses), np.nan)
        measured_from = reference.name
    at_origin = np.zeros((len(log.steps), 3))
    places = canvas.sensor_of(comparison).h_inverse(at_origin, log.sightings)[:, :2] - log.truth_offset
    seen = np.column_stack([places, log.landmarks])
    bounds = zip(np.searchsorted(log.steps, steps), np.searchsorted(log.steps, steps, side="right"))
    line, between = canvas.true_line(log), canvas.between_poses(log, comparison.options.motion, MOST_POINTS)
    starts = np.array([drive.start for drive in log.drives[1:]], dtype=np.int64)
    if line is not None:
        shown = np.arange(0, len(line), 1 if log.true_path is None else max(1, len(line) // MOST_POINTS))
        ends = starts if log.true_path is None else log.control_starts[starts]
        line = parted(line[shown], np.searchsorted(shown, ends))
    return View(
        log=log, aligned_to=canvas.aligned_to(log), steps=steps,
        times=None if log.times is None else elapsed_of(log)[steps],
        truth=None if log.true_poses is None else log.true_poses[steps], true_line=line,
        estimates=tuple(_estimate(comparison, result, steps, path, between) for result in comparison.results),
        measured_from=measured_from, sightings=tuple(seen[begin:end] for begin, end in bounds),
    )  # fmt: skip


def _estimate(
    comparison: Comparison, result: EstimatorResult, steps: np.ndarray, path: Array | None, between: ControlPath
) -> Estimate:
    log = comparison.log
    placement = canvas.placement_of_result(log, result)
    errors = np.full(len(result.poses), np.nan)
    if path is not None and np.count_nonzero(counted := result.estimated & np.isfinite(path[:, 0])) >= 2:
        errors = position_errors(path, log.at_truth(result.poses), mask=counted)
    covariances = result.pose_covariances
    if covariances is not None:
        # first those of the point, which a turn of the robot moves, then in the aligned axes
        turn = np.tile(np.eye(3), (len(steps), 1, 1))
        turn[:, :2, 2] = perpendicular((log.at_truth(result.poses) - result.poses)[steps, :2])
        turn = turn_matrix(placement[2]) @ turn
        covariances = turn @ covariances[steps] @ np.swapaxes(turn, 1, 2)
    poses = np.where(result.estimated[steps, None], canvas.placed(log, placement, result.poses[steps]), np.nan)
    path_of = between.through(np.where(result.estimated[:, None], result.poses, np.nan))
    path_of = parted(path_of, between.rows[[drive.start for drive in log.drives[1:]]])
    line = canvas.placed(log, placement, path_of)
    maps = canvas.place_map(placement, result.landmarks, result.landmark_covariances)
    # without the ids of the log, errors are known by true landmark only
    of_map = (comparison.metrics[result.name].landmark_errors_m or {}) if result.named else {}
    return Estimate(result.name, poses, line, errors[steps], covariances, *maps, of_map)


#: matplotlib's markers x and o
_SYMBOLS = {"x": "x-thin-open", "o": "circle-open"}
#: lines are wider on a screen than in print
_SCALE = 1.35

Figure = dict[str, Any]


def line_of(name: str) -> dict[str, Any]:
    """The properties of a scatter trace that draws an estimator."""
    style = canvas.style_of(name)
    width = _SCALE * style.get("linewidth", 1.0)
    if "marker" in style:
        marker = {"symbol": _SYMBOLS[style["marker"]], "size": 8, "color": style["color"], "maxdisplayed": 20,
                  "line": {"width": 1.6}}  # fmt: skip
        return {"mode": "lines+markers", "line": {"color": style["color"], "width": 0.7}, "marker": marker}
    _, dashes = style["linestyle"] if isinstance(style["linestyle"], tuple) else (0, ())
    # lengths in pixels, not in line widths
    dash = ",".join(f"{max(1.0, length * max(width, 1.2)):.1f}px" for length in dashes) or "solid"
    return {"mode": "lines", "line": {"color": style["color"], "width": width, "dash": dash}}


def layout(**more: Any) -> dict[str, Any]:
    """The layout that all figures share, and what one of them needs besides."""
    common: dict[str, Any] = {
        "template": "none", "autosize": True, "paper_bgcolor": "#fff", "plot_bgcolor": "#fff", "showlegend": False,
        "font": {"family": "DejaVu Sans, Verdana, sans-serif", "size": 13, "color": canvas.INK},
        "margin": {"l": 62, "r": 14, "t": 34, "b": 48}, "hovermode": "closest",
        "hoverlabel": {"align": "left", "bgcolor": "#fff", "font": {"color": canvas.INK, "size": 13}},
    }  # fmt: skip
    return common | more


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with its name and unit."""
    common = {"title": {"text": title, "standoff": 8}, "gridcolor": "#e6e6e6", "zeroline": False, "linecolor": "#888",
              "showline": True, "ticks": "outside", "automargin": True}  # fmt: skip
    return common | more


def logarithmic(values: Sequence[float]) -> dict[str, Any]:
    """A logarithmic axis for these values: with few decades it is labelled at 2 and 5, too, with many at every third."""
    decades = math.log10(max(values) / min(values)) if values else 0.0
    return {"type": "log", "exponentformat": "power", "dtick": "D2" if decades < 3 else 1 if decades < 6 else 3}


def short(value: float, digits: int = 4) -> float | None:
    """A number with the given number of significant digits, None where it is not finite: the page has to stay small."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def place(value: float) -> float | None:
    """A coordinate to a tenth of a millimetre."""
    return round(float(value), 4) if math.isfinite(value) else None
