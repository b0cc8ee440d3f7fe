"""The look of the report's figures: the colours, dashes and markers of `show.style` as Plotly names them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..style import INK, style_of

#: matplotlib's markers x and o
_SYMBOLS = {"x": "x-thin-open", "o": "circle-open"}
#: lines are wider on a screen than in print
_SCALE = 1.35

Figure = dict[str, Any]


def line_of(name: str) -> dict[str, Any]:
    """The properties of a scatter trace that draws an estimator."""
    style = style_of(name)
    width = _SCALE * style.get("linewidth", 1.0)
    if "marker" in style:
        marker = {"symbol": _SYMBOLS[style["marker"]], "size": 8, "color": style["color"], "maxdisplayed": 20,
                  "line": {"width": 1.6}}  # fmt: skip
        return {"mode": "lines+markers", "line": {"color": style["color"], "width": 0.7}, "marker": marker}
    return {"mode": "lines", "line": {"color": style["color"], "width": width, "dash": dash_of(style, width)}}


def dash_of(style: dict[str, Any], width: float) -> str:
    """A line style of matplotlib as Plotly has it: lengths in pixels, not in line widths."""
    pattern = style.get("linestyle", "-")
    if not isinstance(pattern, tuple):
        return "solid"
    return ",".join(f"{max(1.0, length * max(width, 1.2)):.1f}px" for length in pattern[1])


def layout(**more: Any) -> dict[str, Any]:
    """The layout that all figures share, and what one of them needs besides."""
    common: dict[str, Any] = {
        "template": "none",
        "autosize": True,
        "font": {"family": "DejaVu Sans, Verdana, sans-serif", "size": 13, "color": INK},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "margin": {"l": 62, "r": 14, "t": 34, "b": 48},
        "showlegend": False,
        "hovermode": "closest",
        "hoverlabel": {"align": "left", "bgcolor": "#fff", "font": {"color": INK, "size": 13}},
    }
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
