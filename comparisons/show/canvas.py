"""Matplotlib figures in the style of this project: how they are written, their colours and lines, and alignment to the truth.

Only matplotlib's objects are used, no pyplot: nothing global changes, and any number of figures can be made at once.

Most colours are those of Okabe and Ito, the others those of Paul Tol; readers with colour blindness can distinguish all
of them. Each estimator also has its own line style or marker and its own lightness, so that a figure printed in grey
remains readable.
"""

from __future__ import annotations

import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib.resources import as_file, files
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, MaxNLocator

from graphslam import Log, MotionModel, SensorModel, control_path
from graphslam.errors import printable
from graphslam.files import write_whole
from graphslam.log.continuous_time import ControlPath
from graphslam.metrics import alignment_of
from graphslam.se2 import Array, compose, rotation, transform

from .language import translated

if TYPE_CHECKING:
    from ..comparison import Comparison
    from ..results import EstimatorResult

#: two columns of a page [inches]
WIDTH = 7.16


def as_text(name: str) -> str:
    """A name that matplotlib shows as it is: between two dollar signs it would expect mathematics."""
    return printable(name).replace("$", r"\$")


@contextmanager
def paper_figure(figsize: tuple[float, float] | None = None) -> Iterator[Figure]:
    """An empty figure in the style of all figures; it is laid out when the block that fills it ends."""
    with paper_style():
        figure = Figure(figsize=figsize)
        FigureCanvasAgg(figure)
        yield figure
        # once, here, where the style is known: saving then changes nothing
        figure.draw_without_rendering()


@contextmanager
def paper_style() -> Iterator[None]:
    """Matplotlib's settings for figures that are printed."""
    style = as_file(files("comparisons.show").joinpath("paper.mplstyle"))
    with style as path, matplotlib.rc_context(fname=path), warnings.catch_warnings():
        # a name in a script that the font does not have is drawn as boxes
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        yield


def save_figure(figure: Figure, paths: Sequence[str | PathLike[str]], language: str = "en") -> None:
    """Write a figure in the formats that the suffixes name, without a time stamp: the same data give the same file.

    Its texts are in the language, in English where no font has the letters, see `font_of`.

    Raises:
        FormatError: a file cannot be written.
    """
    with paper_style(), matplotlib.rc_context({"figure.constrained_layout.use": False}):
        if (font := font_of(language)) is not None:
            translate_texts(figure, partial(translated, language=language), font)
            figure.draw_without_rendering()
        # the figure is laid out already: with a layout engine, each file would be laid out and drawn once more
        figure.set_layout_engine(None)
        for path in map(Path, paths):
            metadata = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(path.suffix.lower(), {})
            with write_whole(path) as temporary:
                figure.savefig(temporary, metadata=metadata)


#: fonts that have the letters of a language, on Linux, Windows and macOS, the best first
_FONTS = {
    "ja": (
        "Noto Sans CJK JP", "Noto Sans JP", "IPAexGothic", "IPAPGothic", "IPAGothic", "TakaoPGothic", "VL PGothic",
        "BIZ UDPGothic", "Yu Gothic", "Meiryo", "MS Gothic", "Hiragino Sans", "Hiragino Kaku Gothic Pro",
    ),
}  # fmt: skip
#: letters that the fonts of other languages lack
_LETTERS = {"ja": "語あン図"}


@cache
def font_of(language: str) -> str | None:
    """An installed font that has the letters of a language; None without one, and for English."""
    if language not in _FONTS:
        return None
    installed = {font.name: font.fname for font in fontManager.ttflist}
    known = next((name for name in _FONTS[language] if name in installed), None)
    return known or next((name for name, file in installed.items() if _has(file, _LETTERS[language])), None)


def _has(file: str, letters: str) -> bool:
    """Whether a font has a glyph for each letter; matplotlib's font of last resort has one box for all of a script."""
    with suppress(RuntimeError, OSError):
        glyphs = {get_font(file).get_char_index(ord(letter)) for letter in letters}
        return 0 not in glyphs and len(glyphs) == len(letters)
    return False


def translate_texts(drawn: Artist, translate: Callable[[str], str], font: str) -> None:
    """Translate all texts below an artist; the font has the letters that the font of the figure lacks."""
    fonts = ["DejaVu Sans", font]
    for axis in drawn.findobj(Axis):
        assert isinstance(axis, Axis)
        # labels of ticks are made anew at each drawing
        if isinstance(names := axis.get_major_formatter(), FixedFormatter):
            names.seq = [translate(str(name)) for name in names.seq]
            axis.set_tick_params(labelfontfamily=fonts)
    for text in drawn.findobj(Text):
        assert isinstance(text, Text)
        english = text.get_text()
        if (found := translate(english)) != english:
            # an empty line at the end keeps a place
            text.set_text(found + english[len(english.rstrip()) :])
            text.set_fontfamily(fonts)


def png_as_html(figure: Figure) -> str:
    """A figure as an image that is part of the page."""
    stream = BytesIO()
    with paper_style():
        figure.savefig(stream, format="png")
    return f'<img alt="figure" src="data:image/png;base64,{b64encode(stream.getvalue()).decode()}">'


def limits_of(core: Array, rest: Sequence[Array], *, least: float = 1.0, margin: float = 0.05) -> tuple[Array, Array]:
    """The lower left and the upper right corner of what is drawn of the plane.

    It is all of the core (k, 2), and of the rest what does not make the core smaller than half of the larger side, which
    counts as at least ``least`` metres long; and a margin, a part of that side.
    """
    low, high = np.nanmin(core, axis=0), np.nanmax(core, axis=0)
    reach = max(float(np.max(high - low)), least) / 2
    everything = np.concatenate([core, *rest])
    low = np.maximum(np.nanmin(everything, axis=0), low - reach)
    high = np.minimum(np.nanmax(everything, axis=0), high + reach)
    beyond = margin * max(float(np.max(high - low)), least)
    return low - beyond, high + beyond


def set_limits(axes: Axes, core: Array, rest: Sequence[Array]) -> float:
    """Show what `limits_of` says.

    Returns:
        The larger side of what can be seen [m].
    """
    low, high = limits_of(core, rest)
    # the panel keeps its size and shows more of the plane instead; auto allows matplotlib to widen the limits
    axes.set_xlim(low[0], high[0], auto=True)
    axes.set_ylim(low[1], high[1], auto=True)
    axes.set_aspect("equal", adjustable="datalim")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(9, steps=[1, 2, 5, 10]))
    return float(np.max(high - low))


def logarithmic_from(medians: Sequence[float]) -> float | None:
    """Where a logarithmic axis of errors begins; None for a linear axis, where the medians are within a factor of ten.

    Single steps that happen to be exact would otherwise stretch the axis for nothing.
    """
    positive = [median for median in medians if median > 0]
    return min(positive) / 10 if positive and max(positive) > 10 * min(positive) else None


# thick light lines are drawn first, thin dark lines and markers over them, so that all estimates that coincide are visible
STYLES: dict[str, dict[str, Any]] = {
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
    "graphslam": {"color": STYLES["graph"]["color"], "linestyle": "-", "marker": "o", "linewidth": 2.0},
    "gtsam-lm": {"color": STYLES["gtsam"]["color"], "linestyle": "--", "marker": "s"},
    "gtsam-gn": {"color": "#117733", "linestyle": "-.", "marker": "^"},
    "g2o-gn": {"color": "#AA4499", "linestyle": ":", "marker": "x"},
    "g2o-lm": {"color": "#000000", "linestyle": (0, (5, 1.5)), "marker": "+"},
}
#: the iterations that the report compares: textbook, world frame, world frame accelerated, body frame
ITERATIONS = (
    (STYLES["textbook"]["color"], "x"), ("#999933", "diamond"), ("#CC6677", "triangle-up"),
    (STYLES["graph"]["color"], "circle"),
)  # fmt: skip
_OTHER = ("#AA4499", "#44AA99", "#999933")

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
    other = {"color": _OTHER[sum(map(ord, name)) % len(_OTHER)], "linestyle": (0, (3, 1, 1, 1, 1, 1)), "zorder": 2.7}
    style = STYLES.get(name) or CONSISTENCY.get(name) or BACKENDS.get(name) or other
    if "marker" in style and name in STYLES and points:
        # the markers of two estimators on one line take turns
        every = max(2, points // 15)
        style = style | {"markevery": (every // 2 if name == "textbook" else 0, every)}
    return dict(style)


def colour_of(name: str) -> str:
    """The colour of an estimator or graph, from `style_of`."""
    return str(style_of(name)["color"])


def ellipse_style(color: str, *, solid: bool = True) -> dict[str, Any]:
    """The look of the covariance ellipses of a map, also of their entry in the legend."""
    style: dict[str, Any] = {"facecolor": (*to_rgb(color), 0.13), "edgecolor": color, "linewidth": 0.9}
    return style | {"linestyle": "-" if solid else (0, (3, 1))}


#: lines along the controls have about so many points at most, and follow the arcs of controls that turn farther [rad]
MOST_POINTS, MOST_TURN = 10_000, 1.0


def placement_of(
    log: Log, poses: Array, estimated: np.ndarray | None = None, landmarks: Mapping[int, Array] | None = None, *,
    named: bool = True,
) -> Array:  # fmt: skip
    """The rigid motion (3,) that aligns an estimate to the ground truth, the one after which its errors are measured.

    Args:
        log: its ground truth counts, where it has one.
        poses: (T+1, 3) in the axes of the estimator.
        estimated: (T+1,) bool, which poses count; default: all.
        landmarks: the map, for a log whose true landmarks are known and whose true poses are not.
        named: whether the ids of the landmarks are those of the log.

    Returns:
        The motion as a pose; zero where there is no truth to align to.
    """
    truth, true_map = log.true_poses, log.true_landmarks
    aligned = alignment_of(truth, true_map, log.at_truth(poses), landmarks or {}, mask=estimated, named=named)
    return np.zeros(3) if aligned is None else aligned[0]


def placement_of_result(log: Log, result: EstimatorResult) -> Array:
    """The same of the result of an estimator."""
    return placement_of(log, result.poses, result.estimated, result.landmarks, named=result.named)


def placed(log: Log, placement: Array, poses: Array) -> Array:
    """Poses (..., 3) as they are drawn: aligned, and of the point of the robot to which the ground truth belongs."""
    return compose(placement, log.at_truth(poses))


def between_poses(log: Log, motion: MotionModel | None, points: int = MOST_POINTS) -> ControlPath:
    """The path between poses along the recorded controls, for lines of about so many points at most."""
    interval = 0.0 if log.dt is None or len(log.dt) <= points else float(np.sum(log.dt)) / points
    return control_path(log, motion, interval=interval, most_turn=MOST_TURN)


def lone(values: Array) -> np.ndarray:
    """Which numbers (n,) are known while those beside them are not, so that a line does not show them."""
    known = np.concatenate([[False], np.isfinite(values), [False]])
    return known[1:-1] & ~known[:-2] & ~known[2:]


def true_line(log: Log) -> Array | None:
    """The true path as far as it is known, (n, 3): at the ends of all controls, else at the poses."""
    return log.true_poses if log.true_path is None else log.true_path


def aligned_to(log: Log) -> str:
    """The reference of the alignment: "the ground truth", "the true landmarks", or "" where neither is known."""
    if np.count_nonzero(log.covered) >= 2:
        return "the ground truth"
    return "the true landmarks" if len(true_landmarks(log)) >= 2 and log.identified else ""


def place_map(
    placement: Array, landmarks: Mapping[int, Array], covariances: Mapping[int, Array]
) -> tuple[dict[int, Array], dict[int, Array]]:
    """The positions (2,) and covariances (2, 2) of landmarks, moved by a placement (3,)."""
    turn = rotation(placement[2])
    means = {j: transform(placement, m[:2]) for j, m in landmarks.items()}
    return means, {j: turn @ S[:2, :2] @ turn.T for j, S in covariances.items()}


def reference_of(comparison: Comparison) -> EstimatorResult | None:
    """The result whose sightings and map are drawn: the graph, or the best of the others."""
    best = ("graph", "graph-marginal", "gtsam", "textbook", "fastslam1", "fastslam2")
    return next(iter([*(comparison[name] for name in best if name in comparison), *comparison.results]), None)


def sensor_of(comparison: Comparison) -> SensorModel:
    """The sensor whose sightings are drawn."""
    return comparison.options.sensor or comparison.log.sensor or SensorModel()


def true_landmarks(log: Log) -> dict[int, Array]:
    """The true positions (2,) of the landmarks that were seen: a world may have thousands of others."""
    seen = set(log.landmark_ids.tolist()) if log.identified else None
    return {j: np.asarray(m)[:2] for j, m in (log.true_landmarks or {}).items() if seen is None or j in seen}
