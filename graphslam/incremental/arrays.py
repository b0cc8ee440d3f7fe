# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""The arrays of an online solution: nodes, edges and the elimination tree, all of which grow by doubling.

A supernode s of the tree is a group of w nodes that are eliminated together, and r nodes, its separator, to which they
are tied and which are eliminated later. Its numbers lie at one place of ``floats``:

    panel    (3w columns of 3w + 3r rows, padded) L11 over L21, the pivots inverted, as in `linear.cholesky`;
    update   (3r columns of 3r rows, padded) what eliminating the whole subtree adds to Omega of the separator, lower
             triangle; the parts of the edges themselves are in ``Nodes.diagonal``;
    y        (3w) the forward solution L11^-1 of the right-hand side;
    carry    (3r) what eliminating the whole subtree adds to the right-hand side of the separator.

A supernode with w = 0 is a prior: a dense quadratic on its separator. Supernode 0 is the parent of all roots.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[Any]

#: places in ``Tree.counts``: the last stamp, the ends of ``floats`` and ``ints``, free supernodes, what is unused in both
STAMP, FLOATS, INTS, FREE, WASTE_FLOATS, WASTE_INTS = range(6)


class Nodes(NamedTuple):
    """Poses and landmarks; a landmark without heading has ``point`` set and ignores its third coordinate."""

    x: Array  #: (N, 3) the estimate
    d: Array  #: (N, 3) the sum of all increments, in the axes of a pose or, of a point, the world
    rhs: Array  #: (N, 3) the right-hand side, the sum over the edges of the node
    diagonal: Array  #: (N, 6) the diagonal block of Omega, symmetric, without priors
    evaluated: Array  #: (N, 3) the value at which the edges of the node were evaluated last
    passed: Array  #: (N, 3) the value that was passed down the tree last
    scale: Array  #: (N, 2) standard deviations of the edges [m, rad], in which movements are judged
    scratch: Array  #: (N, 3) zeros between the calls
    home: Whole  #: (N,) the supernode in which the node is eliminated; 0: none yet
    point: Whole  #: (N,) whether the third coordinate is held
    edges: Whole  #: (N,) the first edge of the node, -1 for none
    owned: Whole  #: (N,) the first edge that is assembled where the node is eliminated
    local: Whole  #: (N,) the number within a part of the graph, -1 between the calls
    mark: Whole  #: (N,) stamps


class Edges(NamedTuple):
    """Relative poses (3 rows) and relative points (2 rows); see `edges.relative` for the residual."""

    ends: Whole  #: (E, 2)
    rows: Whole  #: (E,) 3 or 2; 0 for an edge that was taken out
    measured: Array  #: (E, 3)
    information: Array  #: (E, 6) symmetric, as in `edges.kernels`
    robust: Whole  #: (E,) whether the kernel acts on the edge
    next: Whole  #: (E, 2) the next edge of either end
    owner: Whole  #: (E,) the end that is eliminated first
    next_owned: Whole  #: (E,)
    linear: Array  #: (E, 7) lever u, cos and sin of alpha, gamma and h, as they are in the factor
    weight: Array  #: (E,) the robust weight in the factor
    rhs: Array  #: (E, 6) what the edge adds to the right-hand side of its ends
    cost: Array  #: (E,) at the last evaluation
    mark: Whole  #: (E,) stamps
    total: Array  #: (1,) the sum of ``cost``


class Tree(NamedTuple):
    """The supernodes; see the module."""

    w: Whole
    r: Whole
    at: Whole  #: into ``floats``
    nodes_at: Whole  #: into ``ints``: w nodes in the order of elimination, then r nodes in the order of elimination
    parent: Whole
    child: Whole
    sibling: Whole
    mark: Whole
    changed: Whole  #: whether y has changed since the last backward pass
    free: Whole  #: unused numbers of supernodes
    stack: Whole
    path: Whole
    floats: Array
    ints: Whole
    counts: Whole


def new_arrays(kind: Any, capacity: int, *, floats: int = 1 << 12) -> Any:
    """Arrays for ``capacity`` rows."""
    fields: dict[str, NDArray[Any]] = {}
    if kind is Nodes:
        fields = {name: np.zeros((capacity, 3)) for name in ("x", "d", "rhs", "evaluated", "passed", "scratch")}
        fields["diagonal"] = np.zeros((capacity, 6))
        fields |= {"scale": np.full((capacity, 2), np.inf), "point": np.zeros(capacity, np.bool_)}
        fields |= {name: np.full(capacity, -1, np.int32) for name in ("edges", "owned", "local")}
        fields |= {"home": np.zeros(capacity, np.int32), "mark": np.zeros(capacity, np.int64)}
    elif kind is Edges:
        fields = {name: np.full((capacity, 2), -1, np.int32) for name in ("ends", "next")}
        fields |= {name: np.full(capacity, -1, np.int32) for name in ("owner", "next_owned")}
        fields |= {"rows": np.zeros(capacity, np.int8), "robust": np.zeros(capacity, np.bool_)}
        widths = {"measured": 3, "information": 6, "linear": 7, "rhs": 6}
        fields |= {name: np.zeros((capacity, width)) for name, width in widths.items()}
        fields |= {"weight": np.zeros(capacity), "cost": np.zeros(capacity), "mark": np.zeros(capacity, np.int64)}
        fields["total"] = np.zeros(1)
    else:
        names = ("w", "r", "nodes_at", "parent", "child", "sibling", "stack", "path")
        fields = {name: np.zeros(capacity, np.int32) for name in names}
        fields |= {"at": np.zeros(capacity, np.int64), "free": np.arange(capacity - 1, -1, -1, dtype=np.int32)}
        fields |= {"mark": np.zeros(capacity, np.int8), "changed": np.zeros(capacity, np.int8)}
        fields |= {"floats": np.zeros(floats), "ints": np.zeros(floats // 4, np.int32)}
        # number 0 is the parent of the roots
        fields["counts"] = np.array([0, 0, 0, capacity - 1, 0, 0], np.int64)
    return kind(**fields)


def doubled(arrays: Any) -> Any:
    """The same nodes or edges in arrays of twice the length."""
    larger = new_arrays(type(arrays), 2 * len(arrays[0]))
    for before, after in zip(arrays, larger):
        after[: len(before)] = before
    return larger


def with_room(tree: Tree, supernodes: int, floats: int, ints: int) -> Tree:
    """The same tree with room for so many more; what is unused is given up where that is enough."""
    counts, capacity = tree.counts, len(tree.w)
    parts = tree._asdict()
    if counts[FREE] < supernodes:
        more = max(capacity, supernodes)
        for name in ("w", "r", "at", "nodes_at", "parent", "child", "sibling", "mark", "changed", "stack", "path"):
            parts[name] = np.concatenate([parts[name], np.zeros(more, parts[name].dtype)])
        free = np.zeros(capacity + more, np.int32)
        free[: counts[FREE]] = tree.free[: counts[FREE]]
        free[counts[FREE] : counts[FREE] + more] = np.arange(capacity + more - 1, capacity - 1, -1)
        parts["free"] = free
        counts[FREE] += more
    if counts[FLOATS] + floats > len(tree.floats) or counts[INTS] + ints > len(tree.ints):
        # half of the new room stays free, so that this takes no time on average
        used = counts[FLOATS] - counts[WASTE_FLOATS] + floats
        used_ints = counts[INTS] - counts[WASTE_INTS] + ints
        parts["floats"] = np.zeros(max(len(tree.floats), 2 * used))
        parts["ints"] = np.zeros(max(len(tree.ints), 2 * used_ints), np.int32)
        compacted = Tree(**parts)
        _move(tree.floats, tree.ints, compacted)
        return compacted
    return Tree(**parts)


@njit(cache=True, error_model="numpy")
def sizes(w, r):
    """Of a supernode: rows of the panel, rows of the update (both padded), and all its numbers."""
    padded = (3 * r + 3) & ~3
    rows = 3 * w + padded
    return rows, padded, 3 * w * rows + 3 * r * padded + 3 * w + 3 * r


@njit(cache=True, error_model="numpy")
def _move(floats, ints, tree):
    """Copy what the supernodes use into the arrays of ``tree``, one after another."""
    top, top_ints = 0, 0
    for s in range(len(tree.w)):
        w, r = np.int64(tree.w[s]), np.int64(tree.r[s])
        if w + r > 0:
            _, _, count = sizes(w, r)
            tree.floats[top : top + count] = floats[tree.at[s] : tree.at[s] + count]
            tree.ints[top_ints : top_ints + w + r] = ints[tree.nodes_at[s] : tree.nodes_at[s] + w + r]
            tree.at[s], tree.nodes_at[s] = top, top_ints
            top += count
            top_ints += w + r
    tree.counts[FLOATS], tree.counts[INTS] = top, top_ints
    tree.counts[WASTE_FLOATS], tree.counts[WASTE_INTS] = 0, 0
