"""The figures of curves: errors over the drive, costs over iterations, and the iterations of world and body frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...comparison import Comparison
from ..style import INK, ITERATIONS
from .convergence import Iterations
from .traces import Figure, axis, layout, line_of, logarithmic, place, short
from .view import View

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
    """The variants of `convergence.iterations`, drawn like `costs_figure`, with a legend."""
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
