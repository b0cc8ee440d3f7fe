# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""The arrays of an online solution: nodes, edges and the elimination tree, all of which grow by doubling.

A supernode s of the tree is a group of w nodes that are eliminated together, and r nodes, its separator, to which they
are tied and which are eliminated later. Its numbers lie at one place of ``floats``:

    panel    (3w columns of 3w + 3r rows, padded) L11 over L21, the pivots inverted, as in `cholesky`;
    update   (3r columns of 3r rows, padded) what eliminating the whole subtree adds to Omega of the separator, lower
             triangle; the parts of the edges themselves are in ``diagonal`` of the nodes;
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
#: arrays of `NODE` and `EDGE`
Nodes = NDArray[np.void]
Edges = NDArray[np.void]

#: places in ``Tree.counts``: the last stamp, the ends of ``floats`` and ``ints``, free supernodes, what is unused in both,
#: the number of the step
STAMP, FLOATS, INTS, FREE, WASTE_FLOATS, WASTE_INTS, STEP = range(7)
#: places in ``memory``, which is kept from step to step: J at the last evaluation; how far an edge in the factor may be from
#: the present one; the costs from which edges have second derivatives, and exact ones; for how many passes none is exact;
#: the work that steps have done on older edges since the last fine pass (see `advance`), how much of it is allowed, and what
#: it costs; how slowly passes converge
COST, LIMIT, CURVED_FROM, EXACT_FROM, HOLD, WORK, ALLOWED, RATE, SHRINKS = range(9)


#: poses and landmarks; a landmark without heading has ``point`` set and ignores its third coordinate
NODE = np.dtype(
    [
        ("x", float, 3),  # the estimate
        ("d", float, 3),  # the sum of all increments, in the axes of a pose or, of a point, the world
        ("rhs", float, 3),  # the right-hand side, the sum over the edges of the node
        ("diagonal", float, 6),  # the diagonal block of Omega, symmetric, without priors
        ("axes", float, 2),  # cos and sin of the heading
        ("evaluated", float, 3),  # the value at which the edges of the node were evaluated last
        ("passed", float, 3),  # the value that was passed down the tree last
        ("kept", float, 3),  # the value before the latest step that changed it
        ("scale", float, 2),  # standard deviations of the edges [m, rad], in which movements are judged
        ("scratch", float, 3),  # zeros between the calls
        ("mark", np.int64),  # stamps
        ("changed", np.int64),  # the latest step that changed the value
        ("home", np.int32),  # the supernode in which the node is eliminated; 0: none yet
        ("edges", np.int32),  # the first edge of the node, -1 for none
        ("owned", np.int32),  # the first edge that is assembled where the node is eliminated
        ("local", np.int32),  # the number within a part of the graph, -1 between the calls
        ("point", np.int8),  # whether the third coordinate is held
    ],
    align=True,
)

#: relative poses (3 rows) and relative points (2 rows); see `edges.relative` for the residual
EDGE = np.dtype(
    [
        ("measured", float, 3),
        ("information", float, 6),  # symmetric, as in `edges.kernels`
        ("linear", float, 7),  # lever u, cos and sin of alpha, gamma and h, as they are in the factor
        ("weight", float),  # the robust weight in the factor
        ("rhs", float, 6),  # what the edge adds to the right-hand side of its ends
        ("cost", float),  # at the last evaluation
        ("mark", np.int64),  # stamps
        ("ends", np.int32, 2),
        ("next", np.int32, 2),  # the next edge of either end
        ("owner", np.int32),  # the end that is eliminated first
        ("next_owned", np.int32),
        ("rows", np.int8),  # 3 or 2
        ("robust", np.int8),  # whether the kernel acts on the edge
    ],
    align=True,
)

#: supernodes; see the module
GROUP = np.dtype(
    [
        ("at", np.int64),  # into ``Tree.floats``
        ("w", np.int32),
        ("r", np.int32),
        ("nodes_at", np.int32),  # into ``Tree.ints``: w nodes, then r nodes, both in the order of elimination
        ("parent", np.int32),
        ("child", np.int32),
        ("sibling", np.int32),
        ("free", np.int32),  # unused numbers of supernodes
        ("stack", np.int32),
        ("path", np.int32),
        ("mark", np.int8),
        ("changed", np.int8),  # whether y has changed since the last backward pass
    ],
    align=True,
)


class Tree(NamedTuple):
    """The supernodes and their numbers; see the module."""

    groups: Whole
    floats: Array
    ints: Whole
    counts: Whole


def new_nodes(capacity: int) -> Nodes:
    """Nodes without edges, at the origin."""
    nodes = np.zeros(capacity, NODE)
    nodes["scale"], nodes["axes"] = np.inf, (1.0, 0.0)
    for name in ("edges", "owned", "local"):
        nodes[name] = -1
    return nodes


def new_edges(capacity: int) -> Edges:
    """Edges between no nodes."""
    edges = np.zeros(capacity, EDGE)
    for name in ("ends", "next", "owner", "next_owned"):
        edges[name] = -1
    return edges


def new_tree(capacity: int) -> Tree:
    """A tree without supernodes but number 0, the parent of the roots."""
    groups = np.zeros(capacity, GROUP)
    groups["free"] = np.arange(capacity - 1, -1, -1)
    counts = np.array([0, 0, 0, capacity - 1, 0, 0, 1], np.int64)
    return Tree(groups, np.zeros(1 << 12), np.zeros(1 << 10, np.int32), counts)


def doubled(array: Whole, larger: Whole) -> Whole:
    """The larger array with the numbers of the smaller one in front."""
    larger[: len(array)] = array
    return larger


def with_room(tree: Tree, supernodes: int, floats: int, ints: int) -> Tree:
    """The same tree with room for so many more; what is unused is given up where that is enough."""
    counts, capacity = tree.counts, len(tree.groups)
    if counts[FREE] < supernodes:
        more = max(capacity, supernodes)
        groups = doubled(tree.groups, np.zeros(capacity + more, GROUP))
        groups["free"][counts[FREE] : counts[FREE] + more] = np.arange(capacity + more - 1, capacity - 1, -1)
        tree = tree._replace(groups=groups)
        counts[FREE] += more
    if counts[FLOATS] + floats > len(tree.floats) or counts[INTS] + ints > len(tree.ints):
        # half of the new room stays free, so that this takes no time on average
        used = counts[FLOATS] - counts[WASTE_FLOATS] + floats
        used_ints = counts[INTS] - counts[WASTE_INTS] + ints
        compacted = tree._replace(
            floats=np.zeros(max(len(tree.floats), 2 * used)),
            ints=np.zeros(max(len(tree.ints), 2 * used_ints), np.int32),
        )
        _move(tree.floats, tree.ints, compacted)
        return compacted
    return tree


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
    for s in range(len(tree.groups)):
        w, r = np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
        if w + r > 0:
            _, _, count = sizes(w, r)
            tree.floats[top : top + count] = floats[tree.groups.at[s] : tree.groups.at[s] + count]
            tree.ints[top_ints : top_ints + w + r] = ints[tree.groups.nodes_at[s] : tree.groups.nodes_at[s] + w + r]
            tree.groups.at[s], tree.groups.nodes_at[s] = top, top_ints
            top += count
            top_ints += w + r
    tree.counts[FLOATS], tree.counts[INTS] = top, top_ints
    tree.counts[WASTE_FLOATS], tree.counts[WASTE_INTS] = 0, 0
