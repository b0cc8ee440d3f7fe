"""The figure of trajectories and maps. The ``meta`` of every trace names its estimator and its layer.

Layers: path, landmarks, landmark-ellipses, pose-ellipses, truth, now (the robot at the step of the slider, which the
page's script moves), matches (the sightings of a landmark that was clicked). ``customdata`` of a path holds all that is
known of each pose, in the order of `COLUMNS`; the page's script turns that into text, since Plotly's templates show
unknown values as 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from graphslam.se2 import Array

from ..canvas import INK, MATCHED, colour_of, true_landmarks
from ..figures import ellipses
from .view import Estimate, Figure, View, axis, layout, line_of, place, short

#: [-, s, rad, m, m, m, -, rad]; None where unknown
COLUMNS = ("step", "time", "theta", "error", "sigma_x", "sigma_y", "rho_xy", "sigma_theta")
#: pose ellipses of an estimate: more would cover each other
MOST_ELLIPSES = 40
#: those of dead reckoning, which grow until they cover the page
MOST_DRIFTING = 8
#: with more landmarks only their positions are drawn
MOST_LANDMARKS = 400


def paths_figure(view: View) -> Figure:
    """The figure."""
    traces: list[dict[str, Any]] = []
    for estimate in view.estimates:
        traces += [*_path(view, estimate), *_map(view, estimate)]
    traces += _truth(view)
    traces.append(_matches())
    for estimate in view.estimates:
        traces += _now(estimate)
    return {
        "data": traces,
        "layout": layout(
            xaxis=axis("x [m]", constrain="domain", range=_range(view, 0)),
            yaxis=axis("y [m]", scaleanchor="x", range=_range(view, 1)),
            dragmode="pan",
            uirevision="kept",
        ),
    }


def pose_columns(view: View, estimate: Estimate) -> list[list[float | int | None]]:
    """All that is known of each pose, a row of `COLUMNS` each."""
    S = np.full((len(view.steps), 3, 3), np.nan) if estimate.covariances is None else estimate.covariances
    sigma = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = S[:, 0, 1] / (sigma[:, 0] * sigma[:, 1])
    times = np.full(len(view.steps), np.nan) if view.times is None else view.times
    return [
        [int(step), short(time, 8), *(short(value) for value in (theta, error, sx, sy, r, st))]
        for step, time, theta, error, (sx, sy, st), r in zip(
            view.steps, times, estimate.poses[:, 2], estimate.errors, sigma, rho
        )
    ]


def _path(view: View, estimate: Estimate) -> list[dict[str, Any]]:
    """The poses, with all that is known of them; their line is a trace of its own where it has other points."""
    meta, look = {"estimator": estimate.name, "layer": "path"}, line_of(estimate.name)
    poses = {
        "type": "scatter", "meta": meta, **_xy(estimate.poses), "customdata": pose_columns(view, estimate),
        "hovertemplate": "%{text}<extra></extra>", **look,
    }  # fmt: skip
    if len(estimate.line) == len(estimate.poses):
        return [poses]
    line = {
        "type": "scatter", "mode": "lines", "meta": meta | {"part": "line"}, **_xy(estimate.line), "line": look["line"],
        "hoverinfo": "skip",
    }  # fmt: skip
    # a pose without a marker still shows its values under the pointer
    return [line, poses | {"mode": "markers", "marker": look.get("marker", {"size": 6, "opacity": 0})}]


def _map(view: View, estimate: Estimate) -> list[dict[str, Any]]:
    traces: list[dict[str, Any]] = []
    if estimate.landmarks:
        traces.append({
            "type": "scatter", "mode": "markers", "meta": {"estimator": estimate.name, "layer": "landmarks"},
            **_xy(np.array(list(estimate.landmarks.values()))),
            "marker": {"color": colour_of(estimate.name), "size": 6},
            "customdata": [[j, _known(estimate, j)] for j in estimate.landmarks],
            "hovertemplate": f"<b>{estimate.name}</b>, landmark %{{customdata[0]}}<br>x %{{x:.3f}} m, y %{{y:.3f}} m"
            "<br>%{customdata[1]}<extra></extra>",
        })  # fmt: skip
    if 0 < len(estimate.landmark_covariances) <= MOST_LANDMARKS:
        maps = estimate.landmarks, estimate.landmark_covariances
        traces.append(_ellipses(estimate.name, "landmark-ellipses", 1.2, *maps))
    if (S := estimate.covariances) is not None:
        most = MOST_DRIFTING if estimate.name == "dead-reckoning" else MOST_ELLIPSES
        spread = np.unique(np.linspace(0, len(view.steps) - 1, most).astype(int))
        known = {int(k): S[k] for k in spread if np.isfinite(S[k]).all() and np.isfinite(estimate.poses[k]).all()}
        traces.append(_ellipses(estimate.name, "pose-ellipses", 0.8, dict(enumerate(estimate.poses)), known))
    return traces


def _ellipses(
    name: str, layer: str, width: float, means: Mapping[int, Array], covariances: Mapping[int, Array]
) -> dict[str, Any]:
    """One trace that draws many ellipses, with gaps between."""
    points = np.pad(ellipses(means, covariances), ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 2)
    return {
        "type": "scatter", "mode": "lines", "meta": {"estimator": name, "layer": layer}, **_xy(points),
        "line": {"color": colour_of(name), "width": width}, "hoverinfo": "skip",
    }  # fmt: skip


def _now(estimate: Estimate) -> list[dict[str, Any]]:
    """The parts that the slider moves: the sightings from the pose, its ellipse, and the pose."""
    colour, common = colour_of(estimate.name), {"type": "scatter", "x": [None], "y": [None], "hoverinfo": "skip"}
    of = {"estimator": estimate.name, "layer": "now"}
    return [
        {**common, "mode": "lines", "meta": of | {"part": "sightings"}, "line": {"color": colour, "width": 1.1}},
        {**common, "mode": "markers", "meta": of | {"part": "pose"},
         "marker": {"symbol": "arrow", "size": 15, "color": colour, "line": {"color": INK, "width": 0.6}}},
    ]  # fmt: skip


def _matches() -> dict[str, Any]:
    """Lines to a landmark from the poses that saw it, shown at a click."""
    return {
        "type": "scatter", "mode": "lines", "x": [None], "y": [None], "hoverinfo": "skip",
        "meta": {"layer": "matches"}, "visible": False,
        "line": {"color": MATCHED, "width": 1.2},
    }  # fmt: skip


def _truth(view: View) -> list[dict[str, Any]]:
    common: dict[str, Any] = {"type": "scatter", "mode": "markers", "meta": {"layer": "truth"}}
    traces: list[dict[str, Any]] = []
    if view.truth is not None:
        times = [None] * len(view.steps) if view.times is None else [short(t, 8) for t in view.times]
        time = "" if view.times is None else "<br>time %{customdata[1]:.2f} s"
        look: dict[str, Any] = {"mode": "lines", "line": {"color": INK, "width": 1.2}}
        if view.true_line is not None and len(view.true_line) != len(view.truth):
            traces.append(common | look | _xy(view.true_line) | {"hoverinfo": "skip"})
            look = {"mode": "markers", "marker": {"size": 6, "opacity": 0}}
        traces.append(common | look | {
            **_xy(view.truth),
            "customdata": [[int(t), s] for t, s in zip(view.steps, times)],
            "hovertemplate": f"<b>ground truth</b>, step %{{customdata[0]}}{time}<extra></extra>",
        })  # fmt: skip
    if view.aligned_to and (landmarks := true_landmarks(view.log)):
        traces.append(common | {
            **_xy(np.array(list(landmarks.values()))), "customdata": list(landmarks),
            "marker": {"symbol": "cross-thin", "size": 11 if len(landmarks) < 100 else 6, "color": INK,
                       "line": {"width": 1.4, "color": INK}},
            "hovertemplate": "<b>true landmark</b> %{customdata}<extra></extra>",
        })  # fmt: skip
    start = (view.estimates[0].poses if view.truth is None else view.truth)[:1] if view.estimates else np.empty((0, 3))
    traces.append(common | {
        **_xy(start), "hovertemplate": "start<extra></extra>",
        "marker": {"symbol": "square-open", "size": 11, "color": INK, "line": {"width": 1.6}},
    })  # fmt: skip
    return traces


def _known(estimate: Estimate, landmark: int) -> str:
    error = estimate.landmark_errors.get(landmark)
    deviations = _deviations(estimate.landmark_covariances.get(landmark))
    return deviations if error is None else f"error {error:.3f} m<br>{deviations}"


def _deviations(S: Array | None) -> str:
    if S is None:
        return "covariance not known"
    sx, sy = np.sqrt(S[0, 0]), np.sqrt(S[1, 1])
    return f"covariance: σx {sx:.4f} m, σy {sy:.4f} m, ρxy {S[0, 1] / max(sx * sy, 1e-300):.2f}"


def _xy(points: Array) -> dict[str, Any]:
    return {"x": [place(v) for v in points[:, 0]], "y": [place(v) for v in points[:, 1]]}


def _range(view: View, column: int) -> list[float]:
    """All that is drawn, with a margin, but for dead reckoning: it may drift far away and make the rest small."""
    drawn = [e for e in view.estimates if e.name != "dead-reckoning"] or list(view.estimates)
    parts = [e.line[:, column] for e in drawn] + [m[None, column] for e in drawn for m in e.landmarks.values()]
    if view.truth is not None:
        parts.append((view.truth if view.true_line is None else view.true_line)[:, column])
    values = np.concatenate([np.empty(0), *parts])
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return [-1.0, 1.0]
    margin = 0.06 * max(float(np.ptp(values)), 1.0)
    return [float(values.min()) - margin, float(values.max()) + margin]
