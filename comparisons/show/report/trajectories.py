"""The figure of trajectories and maps. Every trace tells in ``meta`` whose it is and in which layer it lies.

Layers: path, landmarks, landmark-ellipses, pose-ellipses, truth, now (the robot at the step of the slider, which the
page's script moves). A path carries in ``customdata`` all that is known of each pose, in the order of `COLUMNS`; the
page's script puts that into words, since Plotly's templates take what is not known for 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from graphslam.se2 import Array

from ..plots import DRIFTING
from .ellipses import outlines
from .style import INK, Figure, axis, colour_of, layout, line_of, place, short
from .view import Estimate, View

#: [-, s, rad, m, m, m, -, rad]; None where unknown
COLUMNS = ("step", "time", "theta", "error", "sigma_x", "sigma_y", "rho_xy", "sigma_theta")
#: of these many poses per estimate ellipses are drawn: more would cover each other
MOST_ELLIPSES = 40
#: and of dead reckoning these: its ellipses grow until they cover the page
MOST_DRIFTING = 8
#: with more landmarks only their places are drawn
MOST_LANDMARKS = 400


def trajectories_figure(view: View) -> Figure:
    """The figure."""
    traces: list[dict[str, Any]] = []
    for estimate in view.estimates:
        traces += [_path(view, estimate), *_map(view, estimate)]
    traces += _truth(view)
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
    """What is known of each shown pose, a row of `COLUMNS` each."""
    S = estimate.covariances
    sigma = np.full((len(view.steps), 3), np.nan)
    rho = np.full(len(view.steps), np.nan)
    if S is not None:
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


def _path(view: View, estimate: Estimate) -> dict[str, Any]:
    return {
        "type": "scatter", "meta": {"estimator": estimate.name, "layer": "path"}, **_xy(estimate.poses),
        "customdata": pose_columns(view, estimate), "hovertemplate": "%{text}<extra></extra>",
        **line_of(estimate.name, len(view.steps)),
    }  # fmt: skip


def _map(view: View, estimate: Estimate) -> list[dict[str, Any]]:
    colour = colour_of(estimate.name)
    traces: list[dict[str, Any]] = []
    if estimate.landmarks:
        means = np.array(list(estimate.landmarks.values()))
        sigmas = [_deviations(estimate.landmark_covariances.get(j)) for j in estimate.landmarks]
        hover = f"<b>{estimate.name}</b>, landmark %{{customdata[0]}}<br>x %{{x:.3f}} m, y %{{y:.3f}} m<br>%{{customdata[1]}}"
        traces.append({
            "type": "scatter", "mode": "markers", "meta": {"estimator": estimate.name, "layer": "landmarks"},
            **_xy(means), "marker": {"color": colour, "size": 6},
            "customdata": [[j, s] for j, s in zip(estimate.landmarks, sigmas)],
            "hovertemplate": hover + "<extra></extra>",
        })  # fmt: skip
    if 0 < len(estimate.landmark_covariances) <= MOST_LANDMARKS:
        known = [(estimate.landmarks[j], S) for j, S in estimate.landmark_covariances.items()]
        traces.append(_ellipses(estimate.name, "landmark-ellipses", known, 1.2))
    if estimate.covariances is not None:
        most = MOST_DRIFTING if estimate.name == DRIFTING else MOST_ELLIPSES
        known = [
            (estimate.poses[k, :2], estimate.covariances[k, :2, :2])
            for k in np.unique(np.linspace(0, len(view.steps) - 1, most).astype(int))
            if np.isfinite(estimate.covariances[k]).all() and np.isfinite(estimate.poses[k]).all()
        ]
        traces.append(_ellipses(estimate.name, "pose-ellipses", known, 0.8))
    return traces


def _ellipses(name: str, layer: str, known: list[tuple[Array, Array]], width: float) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "meta": {"estimator": name, "layer": layer}, **outlines(known),
        "line": {"color": colour_of(name), "width": width}, "hoverinfo": "skip",
    }  # fmt: skip


def _now(estimate: Estimate) -> list[dict[str, Any]]:
    """What the slider moves: the sightings from the pose with its ellipse, and the pose itself."""
    colour, common = colour_of(estimate.name), {"type": "scatter", "x": [None], "y": [None], "hoverinfo": "skip"}
    of = {"estimator": estimate.name, "layer": "now"}
    return [
        {**common, "mode": "lines", "meta": of | {"part": "sightings"}, "line": {"color": colour, "width": 1.1}},
        {**common, "mode": "markers", "meta": of | {"part": "pose"},
         "marker": {"symbol": "arrow", "size": 15, "color": colour, "line": {"color": INK, "width": 0.6}}},
    ]  # fmt: skip


def _truth(view: View) -> list[dict[str, Any]]:
    traces: list[dict[str, Any]] = []
    meta = {"layer": "truth"}
    if view.truth is not None:
        times = [None] * len(view.steps) if view.times is None else [short(t, 8) for t in view.times]
        time = "" if view.times is None else "<br>time %{customdata[1]:.2f} s"
        traces.append({
            "type": "scatter", "mode": "lines", "meta": meta, **_xy(view.truth), "line": {"color": INK, "width": 1.2},
            "customdata": [[int(t), s] for t, s in zip(view.steps, times)],
            "hovertemplate": f"<b>truth</b>, step %{{customdata[0]}}{time}<extra></extra>",
        })  # fmt: skip
    # worlds may have thousands of landmarks that this robot never saw
    landmarks = view.log.true_landmarks or {}
    if view.log.identified:
        landmarks = {j: m for j, m in landmarks.items() if j in view.log.landmark_ids}
    if view.log.true_poses is not None and landmarks:
        traces.append({
            "type": "scatter", "mode": "markers", "meta": meta,
            **_xy(np.array([m[:2] for m in landmarks.values()])),
            "marker": {"symbol": "cross-thin", "size": 11 if len(landmarks) < 100 else 6, "color": INK,
                       "line": {"width": 1.4, "color": INK}},
            "customdata": list(landmarks),
            "hovertemplate": "<b>true landmark</b> %{customdata}<extra></extra>",
        })  # fmt: skip
    start = (view.estimates[0].poses if view.truth is None else view.truth)[:1] if view.estimates else np.empty((0, 3))
    traces.append({
        "type": "scatter", "mode": "markers", "meta": meta, **_xy(start), "hovertemplate": "start<extra></extra>",
        "marker": {"symbol": "square-open", "size": 11, "color": INK, "line": {"width": 1.6}},
    })  # fmt: skip
    return traces


def _deviations(S: Array | None) -> str:
    if S is None:
        return "covariance not known"
    sx, sy = np.sqrt(S[0, 0]), np.sqrt(S[1, 1])
    return f"covariance: σx {sx:.4f} m, σy {sy:.4f} m, ρxy {S[0, 1] / max(sx * sy, 1e-300):.2f}"


def _xy(points: Array) -> dict[str, Any]:
    return {"x": [place(v) for v in points[:, 0]], "y": [place(v) for v in points[:, 1]]}


def _range(view: View, column: int) -> list[float]:
    """All that is drawn, with a margin, but for dead reckoning: it may go far astray and make the rest small."""
    shown = [e for e in view.estimates if e.name != DRIFTING] or list(view.estimates)
    parts = [e.poses[:, column] for e in shown] + [m[None, column] for e in shown for m in e.landmarks.values()]
    if view.truth is not None:
        parts.append(view.truth[:, column])
    values = np.concatenate([np.empty(0), *parts])
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return [-1.0, 1.0]
    margin = 0.06 * max(float(np.ptp(values)), 1.0)
    return [float(values.min()) - margin, float(values.max()) + margin]
