# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Factorise supernodes again where edges were linearised again: the same nodes in the same order, other numbers."""

import numpy as np
from numba import njit

from .arrays import COST, CURVED_FROM, EXACT_FROM, sizes
from .cholesky.kernels import negative_gram
from .cholesky.simd import clear
from .cholesky.supernodal import _extend, _runs, factor_panel
from .linearize import between, relinearize
from .passes import forward_one, upwards

#: the least ratio of a pivot to its diagonal entry, as for batch solutions
PIVOT_TOLERANCE = 1e-12


@njit(cache=True, error_model="numpy")
def refactor(late, count, nodes, edges, tree, robust, memory, work):
    """Linearise ``count`` edges again, and factorise and solve forward from their owners up to the roots.

    Returns whether Omega is positive definite. If it is not, the tree is of no use until all of it is built again.
    """
    kernel, width, gain = robust
    homes = np.empty(count, np.int32)
    for k in range(count):
        memory[COST] += relinearize(
            late[k], nodes, edges, kernel, width, gain, (memory[CURVED_FROM], memory[EXACT_FROM])
        )
        homes[k] = nodes.home[edges.owner[late[k]]]
    path, tallest = upwards(homes, count, tree), 0
    for s in path:
        tallest = max(tallest, np.int64(tree.groups.w[s]) + np.int64(tree.groups.r[s]))
    pivots, run, relative = np.empty(3 * tallest), np.empty(tallest, np.int64), np.empty(tallest, np.int32)
    good = True
    for s in path:
        good = good and _factorize_one(s, nodes, edges, tree, gain, pivots, relative, run)
        if good:
            forward_one(s, nodes, tree, work)
        tree.groups.changed[s] = 1
    return good


@njit(cache=True, error_model="numpy")
def _factorize_one(s, nodes, edges, tree, gain, pivots, relative, run):
    """The panel and the update matrix of a supernode from its edges and children; returns whether all pivots are good."""
    x, w, r = tree.floats, np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
    ld, padded, _ = sizes(w, r)
    width, at, front = 3 * w, tree.groups.at[s], tree.groups.nodes_at[s]
    clear(x, at, width * ld)
    for q in range(w + r):
        nodes.local[tree.ints[front + q]] = q
    for q in range(w):
        _entries(tree.ints[front + q], q, at, ld, nodes, edges, x, gain)
    for part in range(2):
        # the columns of the panel first; the update matrix is written by the product before the rest is added
        if part == 1:
            for j in range(width):
                d = x[at + j * (ld + 1)]
                pivots[j] = PIVOT_TOLERANCE * d if d > 0.0 else 0.0
            bad = factor_panel(x, at, ld, width, pivots, np.int64(0))
            if bad >= 0 or r == 0:
                break
            negative_gram(x, at + width * ld, padded, x, at + width, ld, padded, 3 * r, width)
        c = tree.groups.child[s]
        while c > 0:
            _from_child(c, part, w, at, ld, padded, nodes, tree, relative, run)
            c = tree.groups.sibling[c]
    for q in range(w + r):
        nodes.local[tree.ints[front + q]] = -1
    return bad < 0


@njit(cache=True, error_model="numpy")
def _entries(node, q, at, ld, nodes, edges, x, gain):
    """The blocks of Omega in the q-th column of a panel: the diagonal, and the edges that the node owns."""
    D, t = nodes.diagonal, at + 3 * q * (ld + 1)
    x[t], x[t + 1], x[t + 2] = D[node, 0], D[node, 1], D[node, 3]
    x[t + ld + 1], x[t + ld + 2] = D[node, 2], D[node, 4]
    x[t + 2 * ld + 2] = D[node, 5] + (1.0 if nodes.point[node] else 0.0)
    e = nodes.owned[node]
    while e >= 0:
        first = edges.ends[e, 0] == node
        t = at + 3 * q * ld + 3 * np.int64(nodes.local[edges.ends[e, 1 if first else 0]])
        a, b, c = between(e, edges, gain)
        for k, row in enumerate((a, b, c)):
            for i in range(3):
                x[t + (k * ld + i if first else i * ld + k)] += row[i]
        e = edges.next_owned[e]


@njit(cache=True, error_model="numpy")
def _from_child(c, part, w, at, ld, padded, nodes, tree, relative, run):
    """Add the update matrix of a child to the panel of its parent (part 0) or to the update matrix (part 1)."""
    x, wc, rc = tree.floats, np.int64(tree.groups.w[c]), np.int64(tree.groups.r[c])
    ldc, _, _ = sizes(wc, rc)
    below, source = tree.groups.nodes_at[c] + wc, tree.groups.at[c] + 3 * wc * ldc
    step, ascending, split = ldc - 3 * wc, True, 0
    for k in range(rc):
        relative[k] = nodes.local[tree.ints[below + k]]
        ascending = ascending and (k == 0 or relative[k] > relative[k - 1])
        split += relative[k] < w
    start, lead, skip = (at, ld, np.int64(0)) if part == 0 else (at + 3 * w * ld, padded, w)
    if ascending:
        if (split > 0) if part == 0 else (split < rc):
            low, high = (np.int64(0), split) if part == 0 else (split, rc)
            _runs(relative, np.int64(0), rc, run)
            _extend(x, start, lead, skip, x, source, relative, np.int64(0), rc, low, high, run)
        return
    for j in range(rc):
        for i in range(j, rc):
            row, column = max(relative[i], relative[j]), min(relative[i], relative[j])
            if (column < w) == (part == 0):
                t, f = start + 3 * (column - skip) * lead + 3 * (row - skip), source + 3 * j * step + 3 * i
                turned = relative[i] < relative[j]
                for k in range(3):
                    for m in range(k if i == j else 0, 3):
                        x[t + (m * lead + k if turned else k * lead + m)] += x[f + k * step + m]
