"""The figures of iterations: what the estimators did, and the same edges in the world's and in the body's frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..comparison import Comparison
from .convergence import Story
from .style import Figure, axis, layout, line_of, logarithmic, short

#: of the stories in their order; each also has a marker of its own
_COLOURS = ("#D55E00", "#E69F00", "#CC79A7", "#0072B2")
_MARKERS = ("x", "diamond", "triangle-up", "circle")


def costs_figure(comparison: Comparison) -> Figure | None:
    """J (left) and the norm of the correction (right) over the iterations of each estimator; None where none iterates."""
    traces: list[dict[str, Any]] = []
    for result in comparison.results:
        meta = {"estimator": result.name, "layer": "cost"}
        look = line_of(result.name, 0)
        traces += _pair(result.name, result.costs, result.step_norms, meta, look)
    return {"data": traces, "layout": _two_panels(traces, "cost J")} if traces else None


def convergence_figure(told: Sequence[Story]) -> Figure:
    """The stories of `convergence.stories`, drawn like `costs_figure`, with a legend."""
    traces: list[dict[str, Any]] = []
    for story, colour, marker in zip(told, _COLOURS, _MARKERS):
        look = {"mode": "lines+markers", "line": {"color": colour, "width": 1.6},
                "marker": {"color": colour, "symbol": marker, "size": 7}, "legendgroup": story.name}  # fmt: skip
        pair = _pair(story.name, story.distances, story.step_norms, {"layer": "story"}, look)
        pair[0] |= {"showlegend": True, "name": story.name}
        traces += pair
    legend = {"orientation": "h", "x": 0, "y": 1.02, "xanchor": "left", "yanchor": "bottom"}
    figure_layout = _two_panels(traces, "distance of J from its end") | {"showlegend": True, "legend": legend}
    return {"data": traces, "layout": figure_layout | {"margin": figure_layout["margin"] | {"t": 64}}}


def _pair(
    name: str, costs: np.ndarray, norms: np.ndarray, meta: dict[str, Any], look: dict[str, Any]
) -> list[dict[str, Any]]:
    """The two curves of one iteration. J is known before the first step, so it begins at 0, unless only its end is told."""
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
    left = [v for t in traces if "xaxis" not in t for v in t["y"] if v is not None]
    right = [v for t in traces if "xaxis" in t for v in t["y"] if v is not None]
    return layout(
        xaxis=axis("iteration", domain=[0, 0.44], **whole),
        xaxis2=axis("iteration", domain=[0.56, 1], anchor="y2", **whole),
        yaxis=axis(cost, **logarithmic(left)),
        yaxis2=axis("norm of the correction", anchor="x2", **logarithmic(right)),
    )
