# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Eliminate the top of the tree again: all supernodes from changed nodes up to the roots, in a new order.

What hangs below the top stays as it is and enters by its update matrices and carries. This is the Bayes tree of iSAM2
(Kaess et al., IJRR 2012). Its supernodes are eliminated by the kernels of `cholesky`, which take the new ones in one call
with the old ones as children.
"""

import numpy as np
from numba import njit

from .arrays import COST, CURVED_FROM, EXACT_FROM, FLOATS, FREE, INTS, WASTE_FLOATS, WASTE_INTS, sizes
from .cholesky.ordering import fewest_neighbours
from .cholesky.pattern import pattern
from .cholesky.supernodal import factorize
from .cholesky.symbolic import Layout, structure
from .linearize import between, relinearize
from .passes import forward_one
from .refactor import PIVOT_TOLERANCE

#: results of `rebuild`
BUILT, GROW, UNDETERMINED = range(3)


@njit(cache=True, error_model="numpy")
def _collect(nodes, edges, tree, touched, fresh, gone):
    """The top: its supernodes, nodes, edges, and the supernodes that hang below it."""
    removed = np.empty(len(tree.groups), np.int32)
    count, members = 0, 0
    for k in range(len(touched) + len(gone)):
        s = nodes.home[touched[k]] if k < len(touched) else gone[k - len(touched)]
        while s > 0 and not tree.groups.mark[s]:
            tree.groups.mark[s] = 1
            removed[count] = s
            count += 1
            members += tree.groups.w[s]
            s = tree.groups.parent[s]
    removed = removed[:count]
    top = np.empty(members + len(touched), np.int32)
    size = 0
    for s in removed:
        for q in range(tree.groups.w[s]):
            node = tree.ints[tree.groups.nodes_at[s] + q]
            # a node that was taken out has no home
            if nodes.home[node] == s:
                top[size], nodes.local[node] = node, size
                size += 1
    for node in touched:
        if nodes.local[node] < 0:
            nodes.local[node] = size
            top[size] = node
            size += 1
    top = top[:size]
    number = len(fresh)
    for node in top:
        e = nodes.owned[node]
        while e >= 0:
            number += 1
            e = edges.next_owned[e]
    inside = np.empty(number, np.int32)
    inside[: len(fresh)] = fresh
    number = len(fresh)
    for node in top:
        e = nodes.owned[node]
        while e >= 0:
            # an edge that was taken out has no ends
            if edges.ends[e, 0] >= 0:
                inside[number] = e
                number += 1
            e = edges.next_owned[e]
    inside = inside[:number]
    number = 0
    for turn in range(2):
        if turn:
            below = np.empty(number, np.int32)
            number = 0
        # a new prior hangs below supernode 0
        for k in range(-1, len(removed)):
            c = tree.groups.child[removed[k] if k >= 0 else 0]
            while c > 0:
                if not tree.groups.mark[c] and (k >= 0 or tree.groups.w[c] == 0):
                    if turn:
                        below[number] = c
                    number += 1
                c = tree.groups.sibling[c]
    for s in removed:
        tree.groups.mark[s] = 0
    return removed, top, inside, below


@njit(cache=True, error_model="numpy")
def _cliques(nodes, edges, tree, inside, below):
    """The groups of local nodes that the edges and the supernodes below tie together: their sizes, and the nodes."""
    total = 2 * len(inside)
    for s in below:
        total += tree.groups.r[s]
    group, members = np.empty(len(inside) + len(below), np.int64), np.empty(total, np.int64)
    at = 0
    for k in range(len(inside)):
        a, b = nodes.local[edges.ends[inside[k], 0]], nodes.local[edges.ends[inside[k], 1]]
        group[k] = 2
        members[at], members[at + 1] = min(a, b), max(a, b)
        at += 2
    for k in range(len(below)):
        s = below[k]
        group[len(inside) + k] = tree.groups.r[s]
        start = tree.groups.nodes_at[s] + tree.groups.w[s]
        for q in range(tree.groups.r[s]):
            members[at + q] = nodes.local[tree.ints[start + q]]
        members[at : at + tree.groups.r[s]].sort()
        at += tree.groups.r[s]
    return group, members


@njit(cache=True, error_model="numpy")
def _ordered(n, indptr, indices, last):
    """Minimum degree, with the nodes marked ``last`` behind all others."""
    order = fewest_neighbours(n, indptr, indices, n)
    result, place = np.empty(n, np.int32), 0
    for turn in range(2):
        for k in range(n):
            if last[order[k]] == turn:
                result[place] = order[k]
                place += 1
    return result


@njit(cache=True, error_model="numpy")
def _slot(indptr, indices, row, column):
    """The number of the block in a row and column."""
    low, high = indptr[column], indptr[column + 1]
    while high - low > 1:
        middle = (low + high) >> 1
        if indices[middle] <= row:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, error_model="numpy")
def _assemble(nodes, edges, top, inside, fresh, indptr, indices, robust, memory):
    """Omega of the top without what hangs below, from its edges linearised at the estimate."""
    values = np.zeros((len(indices), 3, 3))
    kernel, width, gain = robust
    for q in range(len(inside)):
        e = inside[q]
        # far from the minimum second derivatives mislead: new edges (the first ones) are without, unless all are new
        bent = (np.inf, np.inf) if q < fresh < len(inside) else (memory[CURVED_FROM], memory[EXACT_FROM])
        memory[COST] += relinearize(e, nodes, edges, kernel, width, gain, bent)
        i, j = np.int64(nodes.local[edges.ends[e, 0]]), np.int64(nodes.local[edges.ends[e, 1]])
        block = values[_slot(indptr, indices, min(i, j), max(i, j))]
        for a, row in enumerate(between(e, edges, gain)):
            for b in range(3):
                if i < j:
                    block[a, b] += row[b]
                else:
                    block[b, a] += row[b]
    for k in range(len(top)):
        D, node = nodes.diagonal, top[k]
        block = values[indptr[k + 1] - 1]
        block[0, 0], block[0, 1], block[1, 1] = D[node, 0], D[node, 1], D[node, 2]
        block[0, 2], block[1, 2], block[2, 2] = D[node, 3], D[node, 4], D[node, 5] + (1.0 if nodes.point[node] else 0.0)
    return values


@njit(cache=True, error_model="numpy")
def _with_children(layout, nodes, tree, below, spare):
    """The layout with the supernodes below the top as further children, numbered behind its own supernodes.

    Their rows have to ascend in the new order. Updates for which they do not are copied in that order to ``spare`` on.
    """
    first, count, total = layout.first, len(layout.first) - 1, 0
    owner = np.empty(first[count], np.int32)
    for s in range(count):
        owner[first[s] : first[s + 1]] = s
    for s in below:
        total += tree.groups.r[s]
    row_start = np.empty(count + len(below) + 1, np.int64)
    row_start[: count + 1] = layout.row_start[: count + 1]
    relative = np.empty(len(layout.relative) + total, np.int32)
    relative[: len(layout.relative)] = layout.relative
    stack_start = np.empty(count + len(below), np.int64)
    stack_start[:count] = layout.stack_start[:count]
    parent = np.empty(len(below), np.int32)
    for k in range(len(below)):
        s, start = below[k], row_start[count + k]
        w, r = np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
        row_start[count + k + 1] = start + r
        ld, padded, _ = sizes(w, r)
        rows, source = tree.groups.nodes_at[s] + w, tree.groups.at[s] + 3 * w * ld
        places = np.empty(r, np.int32)
        for q in range(r):
            places[q] = layout.position[nodes.local[tree.ints[rows + q]]]
        sorted_by = np.argsort(places)
        if np.any(sorted_by[1:] < sorted_by[:-1]):
            for a in range(r):
                for b in range(a + 1):
                    high, low = max(sorted_by[a], sorted_by[b]), min(sorted_by[a], sorted_by[b])
                    turned = sorted_by[a] < sorted_by[b]
                    for c in range(3):
                        for d in range(3):
                            i, j = (d, c) if turned or (a == b and c < d) else (c, d)
                            tree.floats[spare + 3 * a + c + (3 * b + d) * padded] = tree.floats[
                                source + 3 * high + i + (3 * low + j) * padded
                            ]
            source, spare = spare, spare + 3 * r * padded
        stack_start[count + k] = source
        t = owner[places[sorted_by[0]]]
        parent[k] = t
        base = layout.row_start[t]
        for q in range(r):
            place = places[sorted_by[q]]
            if place < first[t + 1]:
                relative[start + q] = place - first[t]
            else:
                while layout.rows[base] != place:
                    base += 1
                relative[start + q] = first[t + 1] - first[t] + base - layout.row_start[t]
    child_start = np.zeros(count + 1, np.int32)
    for s in range(count):
        child_start[s + 1] = layout.child_start[s + 1] - layout.child_start[s]
    for t in parent:
        child_start[t + 1] += 1
    child_start = np.cumsum(child_start).astype(layout.child_start.dtype)
    children, free = np.empty(child_start[count], np.int32), child_start[:count].copy()
    for s in range(count):
        for q in range(layout.child_start[s], layout.child_start[s + 1]):
            children[free[s]] = layout.children[q]
            free[s] += 1
    for k in range(len(below)):
        children[free[parent[k]]] = count + k
        free[parent[k]] += 1
    return Layout(
        layout.order, layout.position, first, row_start, layout.rows, relative, child_start, children,
        layout.panel_start, stack_start, layout.entry_start, layout.entry_source, layout.entry_target,
        layout.stack_size, layout.tallest, layout.blocks, layout.flops,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _copy(nodes, edges, top, inside, of_nodes, of_edges, back):
    """Keep what linearising edges again changes in their nodes (9 numbers) and in them (15), or put it back."""
    for k in range(len(top)):
        for c in range(9):
            values, at = (nodes.rhs, c) if c < 3 else (nodes.diagonal, c - 3)
            if back:
                values[top[k], at] = of_nodes[k, c]
            else:
                of_nodes[k, c] = values[top[k], at]
    for k in range(len(inside)):
        e = inside[k]
        for c in range(13):
            values, at = (edges.linear, c) if c < 7 else (edges.rhs, c - 7)
            if back:
                values[e, at] = of_edges[k, c]
            else:
                of_edges[k, c] = values[e, at]
        if back:
            edges.weight[e], edges.cost[e] = of_edges[k, 13], of_edges[k, 14]
        else:
            of_edges[k, 13], of_edges[k, 14] = edges.weight[e], edges.cost[e]


@njit(cache=True, error_model="numpy")
def rebuild(nodes, edges, tree, touched, fresh, gone, newest, robust, memory, work):
    """Eliminate the top again, with new edges, without the supernodes ``gone``, and with the nodes ``newest`` last.

    Returns BUILT and zeros; or GROW, and for how many supernodes, floats, ints and rows of ``work`` there must be room; or
    UNDETERMINED and a node that is not determined. In the last two cases nothing is changed.
    """
    removed, top, inside, below = _collect(nodes, edges, tree, touched, fresh, gone)
    n = len(top)
    indptr, wide = pattern(n, *_cliques(nodes, edges, tree, inside, below))
    indices = wide.astype(np.int32)
    last = np.zeros(n, np.int8)
    for node in newest:
        if nodes.local[node] >= 0:
            last[nodes.local[node]] = 1
    parts, entries, measures = structure(n, indptr, indices, _ordered(n, indptr, indices, last))
    order, position, first, row_start, rows, relative, child_start, children, panel_start, stack_start = parts
    count, floats, tallest = len(first) - 1, 0, measures[1]
    for s in range(count):
        floats += sizes(np.int64(first[s + 1] - first[s]), row_start[s + 1] - row_start[s])[2]
    ints, copies = n + len(rows), 0
    for s in below:
        copies += sizes(np.int64(0), np.int64(tree.groups.r[s]))[2]
    room = tree.counts[FLOATS] + floats + copies <= len(tree.floats) and tree.counts[INTS] + ints <= len(tree.ints)
    if not room or tree.counts[FREE] < count or tallest > len(work):
        for node in top:
            nodes.local[node] = -1
        return GROW, count, floats + copies, ints, tallest
    of_nodes, of_edges, cost = np.empty((n, 9)), np.empty((len(inside), 15)), memory[COST]
    _copy(nodes, edges, top, inside, of_nodes, of_edges, False)
    values = _assemble(nodes, edges, top, inside, len(fresh), indptr, indices, robust, memory)
    at = tree.counts[FLOATS]
    for s in range(count):
        w, r = np.int64(first[s + 1] - first[s]), row_start[s + 1] - row_start[s]
        ld, _, number = sizes(w, r)
        panel_start[s], stack_start[s] = at, at + 3 * w * ld
        at += number
    layout = _with_children(
        Layout(
            order, position, first, row_start, rows, relative, child_start, children, panel_start, stack_start,
            entries[0], entries[1], entries[2], measures[0], measures[1], measures[2], measures[3],
        ),
        nodes, tree, below, at,
    )  # fmt: skip
    run = np.empty(tallest // 3 + 1, np.int64)
    scratch = (tree.floats, tree.floats, np.empty(3 * n), run)
    bad = factorize(values.reshape(-1), layout, np.arange(len(layout.first) - 1), *scratch, PIVOT_TOLERANCE, 0.0)
    if bad >= 0:
        _copy(nodes, edges, top, inside, of_nodes, of_edges, True)
        memory[COST] = cost
        for node in top:
            nodes.local[node] = -1
        return UNDETERMINED, np.int64(top[order[bad // 3]]), 0, 0, tallest
    tree.counts[FLOATS] = at
    _link(nodes, edges, tree, removed, top, inside, below, layout)
    for k in range(count):
        s = nodes.home[top[order[first[k]]]]
        forward_one(s, nodes, tree, work)
        tree.groups.changed[s] = 1
    return BUILT, 0, 0, 0, tallest


@njit(cache=True, error_model="numpy")
def release(tree, s):
    """Give up a supernode."""
    counts, w, r = tree.counts, np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
    counts[WASTE_FLOATS] += sizes(w, r)[2]
    counts[WASTE_INTS] += w + r
    tree.groups.w[s], tree.groups.r[s], tree.groups.child[s], tree.groups.changed[s] = 0, 0, 0, 0
    tree.groups.free[counts[FREE]] = s
    counts[FREE] += 1


@njit(cache=True, error_model="numpy")
def _link(nodes, edges, tree, removed, top, inside, below, layout):
    """Put the supernodes of a layout in the place of those removed."""
    first, row_start, rows, order = layout.first, layout.row_start, layout.rows, layout.order
    # roots that stay are those of no removed supernode; there are none in a graph of one piece
    for s in removed:
        release(tree, s)
    tree.groups.child[0] = 0
    counts, count = tree.counts, len(first) - 1
    names = np.empty(count, np.int32)
    for k in range(count):
        counts[FREE] -= 1
        s = tree.groups.free[counts[FREE]]
        names[k] = s
        w, r = first[k + 1] - first[k], row_start[k + 1] - row_start[k]
        tree.groups.w[s], tree.groups.r[s], tree.groups.at[s], tree.groups.nodes_at[s] = (
            w,
            r,
            layout.panel_start[k],
            counts[INTS],
        )
        tree.groups.child[s], tree.groups.parent[s], tree.groups.sibling[s] = 0, 0, 0
        for q in range(w):
            node = top[order[first[k] + q]]
            nodes.home[node] = s
            nodes.owned[node] = -1
            tree.ints[counts[INTS] + q] = node
        for q in range(r):
            tree.ints[counts[INTS] + w + q] = top[order[rows[row_start[k] + q]]]
        counts[INTS] += w + r
        ld, padded, _ = sizes(np.int64(w), np.int64(r))
        y = tree.groups.at[s] + 3 * w * ld + 3 * r * padded
        for q in range(3 * (w + r)):
            tree.floats[y + q] = 0.0
    for k in range(count):
        s, parent = names[k], 0
        if tree.groups.r[s] > 0:
            parent = nodes.home[tree.ints[tree.groups.nodes_at[s] + tree.groups.w[s]]]
        _hang(tree, s, parent)
    for s in below:
        lowest = -1
        for q in range(tree.groups.r[s]):
            node = tree.ints[tree.groups.nodes_at[s] + tree.groups.w[s] + q]
            place = layout.position[nodes.local[node]]
            if lowest < 0 or place < lowest:
                lowest = place
        _hang(tree, s, nodes.home[top[order[lowest]]] if lowest >= 0 else 0)
    for e in inside:
        i, j = edges.ends[e, 0], edges.ends[e, 1]
        owner = i if layout.position[nodes.local[i]] < layout.position[nodes.local[j]] else j
        edges.owner[e], edges.next_owned[e] = owner, nodes.owned[owner]
        nodes.owned[owner] = e
    for node in top:
        nodes.local[node] = -1


@njit(cache=True, error_model="numpy")
def _hang(tree, s, parent):
    """Make s a child of a supernode."""
    tree.groups.parent[s], tree.groups.sibling[s] = parent, tree.groups.child[parent]
    tree.groups.child[parent] = s
