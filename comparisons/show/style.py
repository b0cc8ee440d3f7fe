"""The colours, line styles and markers of all figures, animations and reports.

Most colours are those of Okabe and Ito, the others those of Paul Tol; readers with colour blindness can distinguish all
of them. Each estimator also has its own line style or marker and its own lightness, so that a figure printed in grey
remains readable.
"""

from __future__ import annotations

from typing import Any

# thick light lines are drawn first, thin dark lines and markers over them, so that all estimates that coincide are visible
ESTIMATORS: dict[str, dict[str, Any]] = {
    "dead-reckoning": {"color": "#E69F00", "linestyle": (0, (5, 1.5)), "linewidth": 1.1, "zorder": 2.1},
    "textbook": {"color": "#D55E00", "linestyle": "none", "marker": "x", "markersize": 3.6, "zorder": 3.4},
    "graph": {"color": "#56B4E9", "linestyle": "-", "linewidth": 2.3, "zorder": 2.3},
    "graph-marginal": {"color": "#663333", "linestyle": (0, (8, 1.5)), "linewidth": 1.2, "zorder": 2.75},
    "graph-no-kernel": {"color": "#666633", "linestyle": (0, (2, 1, 2, 1)), "linewidth": 1.0, "zorder": 2.75},
    "gtsam": {"color": "#0072B2", "linestyle": "none", "marker": "o", "markerfacecolor": "none", "zorder": 3.5},
    "online": {"color": "#117733", "linestyle": (0, (4, 1, 1, 1)), "linewidth": 1.3, "zorder": 2.78},
    "isam2": {"color": "#332288", "linestyle": (0, (2, 2)), "linewidth": 1.0, "zorder": 2.8},
    "mcl": {"color": "#CC79A7", "linestyle": (0, (1, 1.2)), "linewidth": 1.4, "zorder": 2.5},
    "fastslam1": {"color": "#009E73", "linestyle": (0, (6, 1.2, 1, 1.2)), "linewidth": 1.1, "zorder": 2.6},
    "fastslam2": {"color": "#882255", "linestyle": (0, (3, 1, 1, 1, 1, 1)), "linewidth": 1.1, "zorder": 2.7},
    "particle-gibbs": {"color": "#AA4466", "linestyle": (0, (1, 1, 1, 3)), "linewidth": 1.2, "zorder": 2.72},
}
#: the graphs of a consistency study, beside the estimators
CONSISTENCY: dict[str, dict[str, Any]] = {
    "landmark nodes": {"color": "#000000", "linestyle": "-"},
    "marginal": {"color": "#44AA99", "linestyle": "--"},
    "tempered": {"color": "#999933", "linestyle": "-."},
    "pairs": {"color": "#CC6677", "linestyle": ":", "linewidth": 1.6},
}
#: the solvers of pose graphs; graphslam and gtsam look as the estimators that they are
BACKENDS: dict[str, dict[str, Any]] = {
    "graphslam": {"color": ESTIMATORS["graph"]["color"], "linestyle": "-", "marker": "o", "linewidth": 2.0},
    "gtsam-lm": {"color": ESTIMATORS["gtsam"]["color"], "linestyle": "--", "marker": "s"},
    "gtsam-gn": {"color": "#117733", "linestyle": "-.", "marker": "^"},
    "g2o-gn": {"color": "#AA4499", "linestyle": ":", "marker": "x"},
    "g2o-lm": {"color": "#000000", "linestyle": (0, (5, 1.5)), "marker": "+"},
}
#: the iterations that the report compares: textbook, world frame, world frame accelerated, body frame
ITERATIONS = (
    (ESTIMATORS["textbook"]["color"], "x"), ("#999933", "diamond"), ("#CC6677", "triangle-up"),
    (ESTIMATORS["graph"]["color"], "circle"),
)  # fmt: skip
_OTHER = ("#AA4499", "#44AA99", "#999933", "#117733")

INK = "#1a1a1a"
TRUTH: dict[str, Any] = {"color": "black", "linestyle": "-", "linewidth": 0.9, "zorder": 2.9}
TRUE_LANDMARK: dict[str, Any] = {"color": "black", "linestyle": "none", "marker": "+", "markersize": 6, "zorder": 3.3}
POSITION: dict[str, Any] = {"color": "0.45", "linestyle": "none", "marker": "x", "markersize": 3, "zorder": 2.7}
SIGHTING: dict[str, Any] = {"color": "0.72", "linewidth": 0.35, "zorder": 1.5}
START: dict[str, Any] = {"color": "black", "linestyle": "none", "marker": "s", "markersize": 4, "zorder": 4}
#: resampling in an animation; no estimator that is animated has this colour
FLASH = "#D55E00"
PARTICLE = "#0072B2"
#: sightings of a landmark that was asked for
MATCHED = "#AA3377"
#: lines of sightings by what they are: their landmark is certain, uncertain, or there is none
SIGHTINGS = {"confirmed": "#117733", "unconfirmed": "#E69F00", "clutter": "#CC3311"}
#: from small to large residuals, pale to dark, so that a grey print shows it, too
RESIDUALS = ("#E6E1D8", "#F0B860", "#D55E00", "#7A1B4B", "#1B0B2E")
#: the cells of an information matrix: empty, fill-in of the factor, block
MATRIX = ("#ffffff", "#E69F00", "#0072B2")


def style_of(name: str, points: int = 0) -> dict[str, Any]:
    """The line properties of an estimator, a graph of a consistency study or a backend, for a line of ``points``."""
    style = ESTIMATORS.get(name) or CONSISTENCY.get(name) or BACKENDS.get(name)
    if style is None:
        color = _OTHER[sum(map(ord, name)) % len(_OTHER)]
        style = {"color": color, "linestyle": (0, (3, 1, 1, 1, 1, 1)), "zorder": 2.7}
    if "marker" in style and name in ESTIMATORS and points:
        # the markers of two estimators on one line take turns
        every = max(2, points // 15)
        style = style | {"markevery": (every // 2 if name == "textbook" else 0, every)}
    return dict(style)


def colour_of(name: str) -> str:
    """The colour of an estimator or graph, from `style_of`."""
    return str(style_of(name)["color"])


def ellipse_style(color: str, *, solid: bool = True) -> dict[str, Any]:
    """The look of the covariance ellipses of a map, also of their entry in the legend."""
    from matplotlib.colors import to_rgb

    style: dict[str, Any] = {"facecolor": (*to_rgb(color), 0.13), "edgecolor": color, "linewidth": 0.9}
    return style | {"linestyle": "-" if solid else (0, (3, 1))}
