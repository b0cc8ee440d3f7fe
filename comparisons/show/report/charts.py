"""The figures of the report: trajectories and maps; errors over the drive; costs over iterations, in world and body frame.

The ``meta`` of every trace of the map names its estimator and its layer: path, landmarks, landmark-ellipses, pose-ellipses,
truth, now (the robot at the step of the slider, which the page's script moves), matches (the sightings of a landmark that
was clicked). ``customdata`` of a path holds all that is known of each pose, in the order of `COLUMNS`; the page's script
turns that into text, since Plotly's templates show unknown values as 0.

`iterations` iterates the same edges in four ways, to show what the choice of the frame and of the anchor does. The lectures
reset the anchor x̂_0 at every step, so the whole graph keeps drifting; with a fixed anchor the world frame converges at a
constant rate; in the body frame the information does not depend on the state, and a few steps suffice.

`matrix_figure` shows the information matrix: its blocks, and the fill-in of its factor, before and after ordering.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from graphslam import Graph, GraphError, Log, SlamError, solve
from graphslam.edges import ANCHOR_INFORMATION
from graphslam.linear.cholesky import analyze
from graphslam.se2 import Array, difference

from ...comparison import Comparison
from ...estimators import pair_count
from ...options import RunOptions
from ...results.files import time_axis
from ..canvas import INK, ITERATIONS, MATCHED, MATRIX, colour_of, limits_of, logarithmic_from, true_landmarks
from ..figures import ellipses, parted
from .view import Estimate, Figure, View, axis, layout, line_of, logarithmic, place, short

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
    for e in view.estimates:
        meta, known = {"estimator": e.name, "layer": "path"}, {"customdata": pose_columns(view, e)}
        traces += _path(meta, line_of(e.name), e.poses, e.line, hovertemplate="%{text}<extra></extra>", **known)
        traces += _map(view, e)
    traces += _truth(view)
    # lines to a landmark from the poses that saw it, shown at a click
    traces.append(_silent({"layer": "matches"}, "lines", visible=False, line={"color": MATCHED, "width": 1.2}))
    for estimate in view.estimates:
        traces += _now(estimate)
    low, high = limits_of(_core(view), ())
    x = axis("x [m]", constrain="domain", range=[low[0], high[0]])
    y = axis("y [m]", scaleanchor="x", range=[low[1], high[1]])
    return {"data": traces, "layout": layout(xaxis=x, yaxis=y, dragmode="pan", uirevision="kept")}


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


def _path(meta: dict[str, str], look: dict[str, Any], poses: Array, line: Array, **known: Any) -> list[dict[str, Any]]:
    """Poses (n, 3) with what is known of them; their line is a trace of its own where it has other points."""
    trace = {"type": "scatter", "meta": meta, **_xy(poses), **known, **look}
    if len(line) == len(poses):
        return [trace]
    # a pose without a marker still shows its values under the pointer
    dots = {"mode": "markers", "marker": look.get("marker", {"size": 6, "opacity": 0})}
    return [_silent(meta | {"part": "line"}, "lines", line, line=look["line"]), trace | dots]


def _silent(meta: dict[str, str], mode: str, points: Array | None = None, **more: Any) -> dict[str, Any]:
    """A trace that says nothing under the pointer, of points (n, 2 or 3); without points the page's script gives them."""
    where = {"x": [None], "y": [None]} if points is None else _xy(points)
    return {"type": "scatter", "mode": mode, "meta": meta, **where, "hoverinfo": "skip", **more}


def _map(view: View, estimate: Estimate) -> list[dict[str, Any]]:
    traces: list[dict[str, Any]] = []
    if estimate.landmarks:
        traces.append({
            "type": "scatter", "mode": "markers", "meta": {"estimator": estimate.name, "layer": "landmarks"},
            **_xy(np.array(list(estimate.landmarks.values()))), "marker": {"color": colour_of(estimate.name), "size": 6},
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
    line = {"color": colour_of(name), "width": width}
    return _silent({"estimator": name, "layer": layer}, "lines", points, line=line)


def _now(estimate: Estimate) -> list[dict[str, Any]]:
    """The parts that the slider moves: the sightings from the pose, its ellipse, and the pose."""
    colour, of = colour_of(estimate.name), {"estimator": estimate.name, "layer": "now"}
    arrow = {"symbol": "arrow", "size": 15, "color": colour, "line": {"color": INK, "width": 0.6}}
    lines = _silent(of | {"part": "sightings"}, "lines", line={"color": colour, "width": 1.1})
    return [lines, _silent(of | {"part": "pose"}, "markers", marker=arrow)]


def _truth(view: View) -> list[dict[str, Any]]:
    common: dict[str, Any] = {"type": "scatter", "mode": "markers", "meta": {"layer": "truth"}}
    traces: list[dict[str, Any]] = []
    if view.truth is not None:
        times = [None] * len(view.steps) if view.times is None else [short(t, 8) for t in view.times]
        time = "" if view.times is None else "<br>time %{customdata[1]:.2f} s"
        look: dict[str, Any] = {"mode": "lines", "line": {"color": INK, "width": 1.2}}
        line = view.truth if view.true_line is None else view.true_line
        traces += _path(
            common["meta"], look, view.truth, line, customdata=[[int(t), s] for t, s in zip(view.steps, times)],
            hovertemplate=f"<b>ground truth</b>, step %{{customdata[0]}}{time}<extra></extra>",
        )  # fmt: skip
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
    error, S = estimate.landmark_errors.get(landmark), estimate.landmark_covariances.get(landmark)
    known = "covariance not known"
    if S is not None:
        sx, sy = np.sqrt(S[0, 0]), np.sqrt(S[1, 1])
        known = f"covariance: σx {sx:.4f} m, σy {sy:.4f} m, ρxy {S[0, 1] / max(sx * sy, 1e-300):.2f}"
    return known if error is None else f"error {error:.3f} m<br>{known}"


def _xy(points: Array) -> dict[str, Any]:
    return {"x": [place(v) for v in points[:, 0]], "y": [place(v) for v in points[:, 1]]}


def _core(view: View) -> Array:
    """Points (k, 2) that are in sight at first, all but dead reckoning: it may drift far away and make the rest small."""
    drawn = [e for e in view.estimates if e.name != "dead-reckoning"] or view.estimates
    parts = [*(e.line[:, :2] for e in drawn), *(m[None] for e in drawn for m in e.landmarks.values())]
    if view.truth is not None:
        parts.append((view.truth if view.true_line is None else view.true_line)[:, :2])
    points = np.concatenate([np.empty((0, 2)), *parts])
    return points if np.isfinite(points).any() else np.zeros((1, 2))


#: the most steps of each variant, and the norm of the correction below which it has ended
MOST_STEPS, TOLERANCE = 40, 1e-11
#: with more pairs of sightings this would take longer than the comparison
MOST_PAIRS = 200_000


@dataclass(frozen=True, eq=False)
class Iterations:
    """One variant: its name, J before every step and at the end, the norm of every correction."""

    name: str
    costs: Array
    step_norms: Array

    @property
    def distances(self) -> Array:
        """|J - J at the end| before every step; NaN below the rounding error of J."""
        apart = np.abs(self.costs - self.costs[-1])[:-1]
        return np.where(apart > 1e-14 * np.max(self.costs), apart, np.nan)


def iterations(log: Log, options: RunOptions) -> list[Iterations]:
    """The four variants on the virtual-motion edges of a log, all from its own initial poses.

    Motion edges are added only where virtual-motion edges alone do not determine the poses: their residuals do not
    vanish together, which slows every variant and hides what the frame does.

    Raises:
        SlamError: the log has no such edges, or too many of them.
    """
    if (pairs := pair_count(log)) > MOST_PAIRS:
        raise SlamError(f"{log.name} has {pairs} pairs of sightings, more than the limit of {MOST_PAIRS}")
    of_log = partial(Graph.from_log, log, kernel="none", motion=options.motion, sensor=options.sensor)
    try:
        world, body = of_log(edges="virtual", frame="world"), of_log(edges="virtual", frame="body")
    except GraphError:
        world, body = of_log(edges="virtual+motion", frame="world"), of_log(edges="virtual+motion", frame="body")
    variants = [plain_steps("textbook: anchor reset at every step", world, anchored=False)]
    variants.append(plain_steps("world frame, fixed anchor", world, anchored=True))
    for name, graph in (("world frame, Anderson acceleration", world), ("body frame", body)):
        solution = solve(graph, initialize="given", tolerance=TOLERANCE, max_iterations=MOST_STEPS)
        variants.append(Iterations(name, solution.costs, solution.step_norms))
    return variants


def remarks(variants: Sequence[Iterations]) -> list[str]:
    """One sentence on how each variant ended."""
    sentences = []
    for variant in variants:
        count, last = len(variant.step_norms), variant.step_norms[-1]
        end = f"below {TOLERANCE:g}" if last < TOLERANCE else f"still {last:.1e}"
        sentences.append(f"{variant.name}: after {count} steps the norm of the correction is {end}.")
    return sentences


def plain_steps(name: str, graph: Graph, *, anchored: bool) -> Iterations:
    """Solve Omega Delta = xi and add Delta, the information re-evaluated at each step, without acceleration.

    Args:
        name: of the variant.
        graph: its first family anchors node 0.
        anchored: whether x̂_0 is fixed. In the lectures it is the current x_0 at every step: Omega_0 stays in Omega, and
            the anchor's pull - Omega_0 (x_0 - x̂_0) never enters xi, nor its cost J.

    Raises:
        GraphError: the edges do not determine the poses.
    """
    state, anchor = graph.initial.copy(), graph.initial[0].copy()
    costs: list[float] = []
    norms: list[float] = []
    while len(norms) < MOST_STEPS and not (norms and norms[-1] < TOLERANCE):
        system, cost = graph.linearize(state)
        xi = system.xi.copy()
        if not anchored:
            off = difference(state[0], anchor)
            xi[0] += ANCHOR_INFORMATION @ off
            cost -= float(off @ ANCHOR_INFORMATION @ off)
        if not np.isfinite(cost):
            break
        delta = system.factorize().solve(xi)
        state = state + delta
        costs.append(cost)
        norms.append(float(np.linalg.norm(delta)))
    return Iterations(name, np.array(costs), np.array(norms))


def errors_figure(view: View) -> Figure | None:
    """The position errors after alignment, whose root mean square is the ATE; None where there is nothing to compare with.

    The first shape is the line that the slider moves.
    """
    if view.measured_from is None:
        return None
    where, name = (view.steps.astype(float) if view.times is None else view.times), time_axis(view.log)
    drawn = [e for e in view.estimates if np.isfinite(e.errors).any() and e.name != view.measured_from]
    # the lines break where another log begins
    ends = np.searchsorted(view.steps, [drive.start for drive in view.log.drives[1:]])
    steps = [None if np.isnan(t) else int(t) for t in parted(view.steps.astype(float), ends)]
    traces = [
        {
            "type": "scatter", "meta": {"estimator": estimate.name, "layer": "error"},
            "x": [place(v) for v in parted(where, ends)], "y": [short(v) for v in parted(estimate.errors, ends)],
            "customdata": steps,
            "hovertemplate": f"<b>{estimate.name}</b>, step %{{customdata}}<br>{name.split()[0]} %{{x}}<br>"
            "%{y:.4f} m<extra></extra>", **line_of(estimate.name),
        }
        for estimate in drawn
    ]  # fmt: skip
    truth = view.measured_from == "truth"
    vertical = axis("position error [m]" if truth else f"distance from {view.measured_from} [m]")
    if (low := logarithmic_from([float(np.nanmedian(e.errors)) for e in drawn])) is not None:
        high = 1.3 * max(float(np.nanmax(e.errors)) for e in drawn)
        vertical |= logarithmic([low, high]) | {"range": [float(np.log10(low)), float(np.log10(high))]}
    else:
        vertical |= {"rangemode": "tozero"}
    cursor = {"type": "line", "xref": "x", "yref": "paper", "x0": place(where[0]), "x1": place(where[0]), "y0": 0, "y1": 1,
              "line": {"color": INK, "width": 1, "dash": "dot"}}  # fmt: skip
    return {"data": traces, "layout": layout(xaxis=axis(name), yaxis=vertical, shapes=[cursor], uirevision="kept")}


def costs_figure(comparison: Comparison) -> Figure | None:
    """J (left) and the norm of the correction (right) over the iterations of each estimator; None where none iterates."""
    traces: list[dict[str, Any]] = []
    for r in comparison.results:
        traces += _pair(r.name, r.costs, r.step_norms, {"estimator": r.name, "layer": "cost"}, line_of(r.name))
    return {"data": traces, "layout": _two_panels(traces, "cost J")} if traces else None


def convergence_figure(variants: Sequence[Iterations]) -> Figure:
    """The variants of `iterations`, drawn like `costs_figure`, with a legend."""
    traces: list[dict[str, Any]] = []
    for variant, (colour, symbol) in zip(variants, ITERATIONS):
        look = {"mode": "lines+markers", "line": {"color": colour, "width": 1.6},
                "marker": {"color": colour, "symbol": symbol, "size": 7}, "legendgroup": variant.name}  # fmt: skip
        pair = _pair(variant.name, variant.distances, variant.step_norms, {"layer": "convergence"}, look)
        pair[0] |= {"showlegend": True, "name": variant.name}
        traces += pair
    legend = {"orientation": "h", "x": 0, "y": 1.02, "xanchor": "left", "yanchor": "bottom"}
    panels = _two_panels(traces, "difference of J from its end")
    more = {"showlegend": True, "legend": legend, "margin": panels["margin"] | {"t": 64}}
    return {"data": traces, "layout": panels | more}


def _pair(
    name: str, costs: np.ndarray, norms: np.ndarray, meta: dict[str, Any], look: dict[str, Any]
) -> list[dict[str, Any]]:
    """The two curves of one iteration. J is known before the first step, so it begins at 0, unless only its end is known."""
    begins = len(norms) if len(costs) == 1 else 0
    curves: list[tuple[Any, ...]] = [(costs, begins, {}, "J"), (norms, 1, {"xaxis": "x2", "yaxis": "y2"}, "norm")]
    return [
        {
            "type": "scatter", "meta": meta, "x": list(range(first, first + len(values))),
            "y": [short(v, 7) if v > 0 else None for v in values],
            "hovertemplate": f"<b>{name}</b><br>iteration %{{x}}<br>{what} %{{y:.6g}}<extra></extra>",
            "showlegend": False, "cliponaxis": False, **axes, **look,
        }
        for values, first, axes, what in curves if len(values)
    ]  # fmt: skip


def _two_panels(traces: Sequence[dict[str, Any]], cost: str) -> dict[str, Any]:
    whole = {"tick0": 0, "tickformat": "d", "rangemode": "tozero"}
    left, right = (
        [v for t in traces if ("xaxis" in t) == second for v in t["y"] if v is not None] for second in (False, True)
    )
    return layout(
        xaxis=axis("iteration", domain=[0, 0.44], **whole), yaxis=axis(cost, **logarithmic(left)),
        xaxis2=axis("iteration", domain=[0.56, 1], anchor="y2", **whole),
        yaxis2=axis("norm of the correction", anchor="x2", **logarithmic(right)),
    )  # fmt: skip


#: cells of a picture along each side; with more nodes several share a cell
MOST_CELLS = 300
#: the fill-in of larger matrices is counted, but not drawn
MOST_NODES = 4000
EMPTY, FILL, ENTRY = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Picture:
    """Omega in one order of its nodes.

    Attributes:
        cells: (c, c) of EMPTY, FILL (a block of L that Omega does not have) and ENTRY, the greatest of each cell.
        blocks: the number of 3 x 3 blocks in Omega's lower triangle.
        factor_blocks: the number of those in its factor L.
        nodes: the number of nodes.
    """

    cells: np.ndarray
    blocks: int
    factor_blocks: int
    nodes: int


def pictures(graph: Graph) -> list[Picture]:
    """Omega of a graph in the order of its nodes, and in the order of elimination (approximate minimum degree)."""
    indptr, indices = graph.system.indptr, graph.system.indices
    n = len(indptr) - 1
    columns = np.repeat(np.arange(n), np.diff(indptr))
    made = []
    for order in (np.arange(n), analyze(indptr, indices).order):
        position = np.empty(n, dtype=np.int64)
        position[order] = np.arange(n)
        a, b = position[indices], position[columns]
        rows, cols = np.maximum(a, b), np.minimum(a, b)
        cells = np.zeros((min(n, MOST_CELLS),) * 2, dtype=np.uint8)
        filled = np.nonzero(factor_pattern(n, rows, cols)) if n <= MOST_NODES else (rows, cols)
        for (r, c), what in ((filled, FILL), ((rows, cols), ENTRY)):
            r, c = r * len(cells) // n, c * len(cells) // n
            cells[r, c] = cells[c, r] = what
        made.append(Picture(cells, len(indices), analyze(indptr, indices, ordering=order).blocks, n))
    return made


def factor_pattern(n: int, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """The pattern of L in Omega = L L', (n, n) bool, from the lower triangle of Omega, diagonal included.

    Column k of L has the rows of Omega's column k and those of all columns whose first row below the diagonal is k
    (the children of k in the elimination tree). Source: George and Liu, *Computer Solution of Large Sparse Positive
    Definite Systems*, 1981, section 5.
    """
    below = np.zeros((n, n), dtype=bool)  # row k is column k of L: contiguous
    below[cols, rows] = True
    for k in range(n):
        if (later := below[k, k + 1 :]).any():
            parent = k + 1 + int(np.argmax(later))
            below[parent, parent:] |= below[k, parent:]
    return below.T


def matrix_figure(before: Picture, after: Picture) -> Figure:
    """Two pictures side by side."""
    traces: list[dict[str, Any]] = []
    scale = [[edge / 3, colour] for k, colour in enumerate(MATRIX) for edge in (k, k + 1)]
    names, second = ("node order of the log", "elimination order"), {"xaxis": "x2", "yaxis": "y2"}
    for picture, name, axes in zip((before, after), names, ({}, second)):
        c, step = len(picture.cells), picture.nodes / len(picture.cells)
        traces.append({
            "type": "heatmap", "meta": {"layer": "matrix"}, "name": name, **axes,
            "z": {"dtype": "u1", "bdata": base64.b64encode(picture.cells.tobytes()).decode(), "shape": f"{c}, {c}"},
            "x0": step / 2 - 0.5, "dx": step, "y0": step / 2 - 0.5, "dy": step,
            "zmin": 0, "zmax": 2, "colorscale": scale, "showscale": False,
            "hovertemplate": f"{name}<br>row %{{y:.0f}}, column %{{x:.0f}}<extra></extra>",
        })  # fmt: skip
    side = {"constrain": "domain", "showgrid": False, "mirror": True}
    down = side | {"autorange": "reversed"}
    panels = {
        "xaxis": axis("node, numbered as in the log", domain=[0, 0.46], **side),
        "xaxis2": axis("node, in the order of elimination", domain=[0.54, 1], anchor="y2", **side),
        "yaxis": axis("", scaleanchor="x", **down), "yaxis2": axis("", scaleanchor="x2", anchor="x2", **down),
    }  # fmt: skip
    return {"data": traces, "layout": layout(**panels)}


def description(name: str, before: Picture, after: Picture) -> str:
    """Sentences on the figures of the matrices."""
    text = (
        f"Ω of {name}: {before.nodes} nodes and {before.blocks} blocks of 3 x 3 in its lower triangle. Its factor L has "
        f"{before.factor_blocks} blocks in the node order of the log, and {after.factor_blocks} in the order of "
        "elimination (approximate minimum degree)."
    )
    if before.nodes > len(before.cells):
        text += f" {before.nodes / len(before.cells):.1f} nodes share a cell on each side."
    return text + (" The fill-in is counted, but not drawn." if before.nodes > MOST_NODES else "")
