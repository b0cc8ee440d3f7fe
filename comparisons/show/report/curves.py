"""The figures of curves: errors over the drive, costs over iterations, and the iterations of world and body frame.

The same edges iterated in four ways: what the choice of the frame and the anchor does to the iteration.

The lectures reset the anchor x̂_0 at every step, so the whole graph keeps drifting; with a fixed anchor the world frame
converges at a constant rate; in the body frame the information does not depend on the state, and a few steps suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphslam import Graph, GraphError, Log, SlamError, solve
from graphslam.edges import ANCHOR_INFORMATION
from graphslam.se2 import Array, difference

from ...comparison import Comparison
from ...estimators import pair_count
from ...options import RunOptions
from ..canvas import INK, ITERATIONS
from .view import Figure, View, axis, layout, line_of, logarithmic, place, short

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
    try:
        world, body = _graphs(log, options, "virtual")
    except GraphError:
        world, body = _graphs(log, options, "virtual+motion")
    variants = [
        plain_steps("textbook: anchor reset at every step", world, anchored=False),
        plain_steps("world frame, fixed anchor", world, anchored=True),
    ]
    for name, graph in (("world frame, Anderson acceleration", world), ("body frame", body)):
        solution = solve(graph, initialize="given", tolerance=TOLERANCE, max_iterations=MOST_STEPS)
        variants.append(Iterations(name, solution.costs, solution.step_norms))
    return variants


def _graphs(log: Log, options: RunOptions, edges: str) -> list[Graph]:
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    return [Graph.from_log(log, edges=edges, frame=frame, kernel="none", **models) for frame in ("world", "body")]


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


#: a figure whose medians differ by a larger factor has a logarithmic axis
SPREAD = 10.0


def errors_figure(view: View) -> Figure | None:
    """The position errors after alignment, whose root mean square is the ATE; None where there is nothing to compare with.

    The first shape is the line that the slider moves.
    """
    if view.measured_from is None:
        return None
    where, name = view.abscissa
    drawn = [e for e in view.estimates if np.isfinite(e.errors).any() and e.name != view.measured_from]
    traces = [
        {
            "type": "scatter", "meta": {"estimator": estimate.name, "layer": "error"},
            "x": [place(v) for v in where], "y": [short(v) for v in estimate.errors],
            "customdata": [int(t) for t in view.steps],
            "hovertemplate": f"<b>{estimate.name}</b>, step %{{customdata}}<br>{name.split()[0]} %{{x}}<br>"
            "%{y:.4f} m<extra></extra>",
            **line_of(estimate.name),
        }
        for estimate in drawn
    ]  # fmt: skip
    positive = [m for m in (float(np.nanmedian(e.errors)) for e in drawn) if m > 0]
    truth = view.measured_from == "truth"
    vertical = axis("position error [m]" if truth else f"distance from {view.measured_from} [m]")
    if positive and max(positive) > SPREAD * min(positive):
        # single steps that happen to be exact would otherwise stretch the axis for nothing
        low, high = min(positive) / 10, 1.3 * max(float(np.nanmax(e.errors)) for e in drawn)
        vertical |= logarithmic([low, high]) | {"range": [float(np.log10(low)), float(np.log10(high))]}
    else:
        vertical |= {"rangemode": "tozero"}
    cursor = {"type": "line", "xref": "x", "yref": "paper", "x0": place(where[0]), "x1": place(where[0]), "y0": 0, "y1": 1,
              "line": {"color": INK, "width": 1, "dash": "dot"}}  # fmt: skip
    return {"data": traces, "layout": layout(xaxis=axis(name), yaxis=vertical, shapes=[cursor], uirevision="kept")}


def costs_figure(comparison: Comparison) -> Figure | None:
    """J (left) and the norm of the correction (right) over the iterations of each estimator; None where none iterates."""
    traces: list[dict[str, Any]] = []
    for result in comparison.results:
        meta = {"estimator": result.name, "layer": "cost"}
        traces += _pair(result.name, result.costs, result.step_norms, meta, line_of(result.name))
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
    pair: list[dict[str, Any]] = []
    for values, first, axes, what in ((costs, begins, {}, "J"), (norms, 1, {"xaxis": "x2", "yaxis": "y2"}, "norm")):
        if len(values):
            pair.append({
                "type": "scatter", "meta": meta, "x": list(range(first, first + len(values))),
                "y": [short(v, 7) if v > 0 else None for v in values],
                "hovertemplate": f"<b>{name}</b><br>iteration %{{x}}<br>{what} %{{y:.6g}}<extra></extra>",
                "showlegend": False, "cliponaxis": False, **axes, **look,
            })  # fmt: skip
    return pair


def _two_panels(traces: Sequence[dict[str, Any]], cost: str) -> dict[str, Any]:
    whole = {"tick0": 0, "tickformat": "d", "rangemode": "tozero"}
    left, right = (
        [v for t in traces if ("xaxis" in t) == second for v in t["y"] if v is not None] for second in (False, True)
    )
    return layout(
        xaxis=axis("iteration", domain=[0, 0.44], **whole),
        xaxis2=axis("iteration", domain=[0.56, 1], anchor="y2", **whole),
        yaxis=axis(cost, **logarithmic(left)),
        yaxis2=axis("norm of the correction", anchor="x2", **logarithmic(right)),
    )
