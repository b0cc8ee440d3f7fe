"""The information matrix as a picture: its blocks, and the fill-in of its factor, before and after ordering."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from graphslam import Graph
from graphslam.linear.cholesky import analyze

from ..canvas import MATRIX
from .view import Figure, axis, layout

if TYPE_CHECKING:
    pass


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
        blocks = analyze(indptr, indices, ordering=order).blocks
        made.append(Picture(cells, len(indices), blocks, n))
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
        later = below[k, k + 1 :]
        if later.any():
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
    return {
        "data": traces,
        "layout": layout(
            xaxis=axis("node, numbered as in the log", domain=[0, 0.46], **side),
            xaxis2=axis("node, in the order of elimination", domain=[0.54, 1], anchor="y2", **side),
            yaxis=axis("", scaleanchor="x", **down),
            yaxis2=axis("", scaleanchor="x2", anchor="x2", **down),
        ),
    }


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
