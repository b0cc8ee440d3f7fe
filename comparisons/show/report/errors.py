"""The figure of the error of every step, over time."""

from __future__ import annotations

import numpy as np

from .style import INK, Figure, axis, layout, line_of, logarithmic, place, short
from .view import View

#: a figure with medians farther apart than this has a logarithmic axis
SPREAD = 10.0


def errors_figure(view: View) -> Figure | None:
    """The position errors after alignment, whose root mean square is the ATE; None where nothing is known to err from.

    The first shape is the line that the slider moves.
    """
    if view.judged_by is None:
        return None
    where, name = view.abscissa
    traces = []
    drawn = [e for e in view.estimates if np.isfinite(e.errors).any() and e.name != view.judged_by]
    for estimate in drawn:
        traces.append({
            "type": "scatter", "meta": {"estimator": estimate.name, "layer": "error"},
            "x": [place(v) for v in where], "y": [short(v) for v in estimate.errors],
            "customdata": [int(t) for t in view.steps],
            "hovertemplate": f"<b>{estimate.name}</b>, step %{{customdata}}<br>{name.split()[0]} %{{x}}<br>"
            "%{y:.4f} m<extra></extra>",
            **line_of(estimate.name, len(where)),
        })  # fmt: skip
    positive = [m for m in (float(np.nanmedian(e.errors)) for e in drawn) if m > 0]
    vertical = axis("position error [m]" if view.judged_by == "truth" else f"distance from {view.judged_by} [m]")
    if positive and max(positive) > SPREAD * min(positive):
        # single steps that happen to be exact would otherwise stretch the axis for nothing
        low, high = min(positive) / 10, 1.3 * max(float(np.nanmax(e.errors)) for e in drawn)
        vertical |= logarithmic([low, high]) | {"range": [float(np.log10(low)), float(np.log10(high))]}
    else:
        vertical |= {"rangemode": "tozero"}
    cursor = {"type": "line", "xref": "x", "yref": "paper", "x0": place(where[0]), "x1": place(where[0]), "y0": 0, "y1": 1,
              "line": {"color": INK, "width": 1, "dash": "dot"}}  # fmt: skip
    return {"data": traces, "layout": layout(xaxis=axis(name), yaxis=vertical, shapes=[cursor], uirevision="kept")}
