"""Symbolic analysis: elimination tree, column counts, supernodes, storage layout."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Cost model of one supernode of w columns and r rows below (nodes), in nanoseconds, fitted on one core at 3 GHz:
# fixed overhead, scalars of the panel, flops, scalars of the update matrix passed to the parent.
COST_NODE, COST_PANEL, COST_FLOP, COST_UPDATE = 100.0, 2.0, 0.05, 1.0


class Layout(NamedTuple):
    """Supernodal structure of L in elimination order (``ns`` supernodes, all in units of nodes unless noted)."""

    order: NDArray[np.int32]  #: (n,) node eliminated k-th
    position: NDArray[np.int32]  #: (n,) inverse of ``order``
    first: NDArray[np.int32]  #: (ns+1,) first column of each supernode
    row_start: NDArray[np.int64]  #: (ns+1,) into ``rows`` and ``relative``
    rows: NDArray[np.int32]  #: rows below the diagonal block of each supernode, ascending
    relative: NDArray[np.int32]  #: where those rows stand in the front of the parent supernode
    parent: NDArray[np.int32]  #: (ns,) supernodal elimination tree, -1 at a root
    child_start: NDArray[np.int32]  #: (ns+1,) into ``children``
    children: NDArray[np.int32]  #: children of each supernode
    panel_start: NDArray[np.int64]  #: (ns+1,) scalars, into the factor's panels
    stack_start: NDArray[np.int64]  #: (ns,) scalars, the update matrix on the multifrontal stack
    entry_start: NDArray[np.int64]  #: (ns+1,) into ``entry_source`` and ``entry_target``
    entry_source: NDArray[np.int64]  #: 2 * scalar of ``values`` + (1 if the block enters as it stands, not transposed)
    entry_target: NDArray[np.int64]  #: scalar inside the panel
    stack_size: int  #: scalars of the stack
    tallest: int  #: rows of the tallest front, padded, in scalars
    blocks: int  #: structural blocks of L before amalgamation
    flops: float  #: of the factorisation before amalgamation, multiply and add counted apart


@njit(cache=True, error_model="numpy")
def _permuted_lists(n, indptr, indices, position):
    """Row lists: for each row k in elimination order its columns i < k; one list of entries by column."""
    row_pointer = np.zeros(n + 1, np.int64)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1] - 1):
            a = position[indices[p]]
            row_pointer[max(a, b) + 1] += 1
    for k in range(n):
        row_pointer[k + 1] += row_pointer[k]
    fill = row_pointer[:n].copy()
    columns = np.empty(row_pointer[n], np.int32)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1] - 1):
            a = position[indices[p]]
            k = max(a, b)
            columns[fill[k]] = min(a, b)
            fill[k] += 1
    return row_pointer, columns


@njit(cache=True, error_model="numpy")
def elimination_tree(n, row_pointer, columns):
    """Elimination tree and column counts of L, diagonal included, from the row subtrees (Liu 1990).

    Walking every row subtree costs one step per block of L, which the factorisation pays tenfold; the near-linear
    count of Gilbert, Ng & Peyton would save less than 1 % of the analysis here.
    """
    parent = np.full(n, -1, np.int32)
    count = np.ones(n, np.int32)
    mark = np.full(n, -1, np.int32)
    for k in range(n):
        mark[k] = k
        for p in range(row_pointer[k], row_pointer[k + 1]):
            i = columns[p]
            while mark[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                count[i] += 1
                mark[i] = k
                i = parent[i]
    return parent, count


@njit(cache=True, error_model="numpy")
def _cost(w, r):
    w3, r3 = 3.0 * w, 3.0 * r
    flops = w3 * w3 * w3 / 3.0 + w3 * w3 * r3 + w3 * r3 * r3
    return COST_NODE + COST_PANEL * w3 * (w3 + r3) + COST_FLOP * flops + COST_UPDATE * 0.5 * r3 * r3


@njit(cache=True, error_model="numpy")
def supernodes(n, parent, count):
    """Supernodes by amalgamating a column tree bottom-up wherever the cost model gains.

    Returns the column order of the amalgamated and postordered tree, the first column of every supernode, its
    number of rows below, and the supernodal tree.
    """
    width = np.ones(n, np.int32)
    below = count - 1
    alive = np.ones(n, np.bool_)
    child = np.full(n, -1, np.int32)  # first child
    sibling = np.full(n, -1, np.int32)
    column_head = np.arange(n).astype(np.int32)
    column_next = np.full(n, -1, np.int32)
    cost = np.empty(n)
    for p in range(n):
        cost[p] = _cost(1, below[p])
        for relaxed in range(2):
            c = child[p]
            previous = -1
            while c >= 0:
                following = sibling[c]
                w = width[c] + width[p]
                if relaxed == 0:
                    merge = below[c] == width[p] + below[p]
                else:
                    merge = True
                if merge:
                    joint = _cost(w, below[p])
                    if relaxed == 1:
                        merge = joint < cost[c] + cost[p]
                if merge:
                    cost[p] = joint
                    width[p] = w
                    alive[c] = False
                    # columns of c come first
                    last = c
                    column_next[last] = column_head[p]
                    column_head[p] = column_head[c]
                    # the grandchildren take c's place; they have been weighed against c already
                    g = child[c]
                    if g < 0:
                        if previous < 0:
                            child[p] = following
                        else:
                            sibling[previous] = following
                    else:
                        if previous < 0:
                            child[p] = g
                        else:
                            sibling[previous] = g
                        while sibling[g] >= 0:
                            g = sibling[g]
                        sibling[g] = following
                        previous = g
                else:
                    previous = c
                c = following
        q = parent[p]
        if q >= 0:
            sibling[p] = child[q]
            child[q] = p
    total = 0
    for p in range(n):
        if alive[p]:
            total += 1
    # postorder without recursion
    first = np.empty(total + 1, np.int32)
    rows = np.empty(total, np.int32)
    tree = np.full(total, -1, np.int32)
    columns = np.empty(n, np.int32)
    number = np.full(n, -1, np.int32)
    stack = np.empty(n, np.int32)
    s = 0
    k = 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        depth = 0
        stack[0] = root
        while depth >= 0:
            p = stack[depth]
            c = child[p]
            if c >= 0:
                child[p] = sibling[c]
                depth += 1
                stack[depth] = c
            else:
                first[s] = k
                rows[s] = below[p]
                number[p] = s
                j = column_head[p]
                for _ in range(width[p]):
                    columns[k] = j
                    k += 1
                    j = column_next[j]
                s += 1
                depth -= 1
                # children of p are numbered: hand them their parent when p itself is
                stack[depth + 1] = p
        # second pass below sets the tree
    first[total] = n
    return columns, first, rows, tree, number


@njit(cache=True, error_model="numpy")
def _supernode_rows(n, first, count, row_pointer, columns):
    """Row structure, tree and relative indices of the supernodes; row subtrees walked on the supernodal tree."""
    ns = first.size - 1
    row_start = np.zeros(ns + 1, np.int64)
    for s in range(ns):
        row_start[s + 1] = row_start[s] + count[s]
    rows = np.empty(row_start[ns], np.int32)
    relative = np.empty(row_start[ns], np.int32)
    fill = row_start[:ns].copy()
    parent = np.full(ns, -1, np.int32)
    mark = np.full(ns, -1, np.int32)
    owner = np.empty(n, np.int32)
    for s in range(ns):
        for k in range(first[s], first[s + 1]):
            owner[k] = s
    for k in range(n):
        top = owner[k]
        mark[top] = k
        for p in range(row_pointer[k], row_pointer[k + 1]):
            t = owner[columns[p]]
            while mark[t] != k:
                if parent[t] < 0:
                    parent[t] = top
                rows[fill[t]] = k
                fill[t] += 1
                mark[t] = k
                t = parent[t]
    child_start = np.zeros(ns + 1, np.int32)
    for s in range(ns):
        if parent[s] >= 0:
            child_start[parent[s] + 1] += 1
    for s in range(ns):
        child_start[s + 1] += child_start[s]
    children = np.empty(child_start[ns], np.int32)
    place = child_start[:ns].copy()
    for s in range(ns):
        t = parent[s]
        if t >= 0:
            children[place[t]] = s
            place[t] += 1
            w = first[t + 1] - first[t]
            q = row_start[t]
            for p in range(row_start[s], row_start[s + 1]):
                k = rows[p]
                if k < first[t + 1]:
                    relative[p] = k - first[t]
                else:
                    while rows[q] != k:
                        q += 1
                    relative[p] = w + q - row_start[t]
    return row_start, rows, relative, parent, child_start, children, owner


@njit(cache=True, error_model="numpy")
def _storage(first, row_start, parent, child_start, children):
    """Panels one after another; update matrices on two stacks, one for even and one for odd depths.

    With one stack the update matrix of a supernode would have to be moved down over those of its children.
    """
    ns = first.size - 1
    panel_start = np.zeros(ns + 1, np.int64)
    stack_start = np.zeros(ns, np.int64)
    depth = np.zeros(ns, np.int8)
    tallest = 0
    for s in range(ns - 1, -1, -1):
        if parent[s] >= 0:
            depth[s] = 1 - depth[parent[s]]
    top = np.zeros(2, np.int64)
    peak = np.zeros(2, np.int64)
    for s in range(ns):
        w = 3 * (first[s + 1] - first[s])
        r = 3 * (row_start[s + 1] - row_start[s])
        padded = (r + 3) & ~3
        tallest = max(tallest, w + padded)
        panel_start[s + 1] = panel_start[s] + w * (w + padded)
        d = depth[s]
        stack_start[s] = top[d]
        top[d] += r * padded
        peak[d] = max(peak[d], top[d])
        if child_start[s + 1] > child_start[s]:
            top[1 - d] = stack_start[children[child_start[s]]]
    for s in range(ns):
        if depth[s] == 1:
            stack_start[s] += peak[0]
    return panel_start, stack_start, peak[0] + peak[1], tallest


@njit(cache=True, error_model="numpy")
def _entries(n, indptr, indices, position, owner, first, row_start, rows):
    """Where every block of the matrix goes, sorted by supernode."""
    ns = first.size - 1
    start = np.zeros(ns + 1, np.int64)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1]):
            start[owner[min(position[indices[p]], b)] + 1] += 1
    for s in range(ns):
        start[s + 1] += start[s]
    fill = start[:ns].copy()
    source = np.empty(start[ns], np.int64)
    target = np.empty(start[ns], np.int64)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1]):
            a = position[indices[p]]
            column, row = min(a, b), max(a, b)
            s = owner[column]
            q = fill[s]
            fill[s] += 1
            source[q] = 18 * p + (1 if a > b else 0)
            w = first[s + 1] - first[s]
            if row < first[s + 1]:
                local = row - first[s]
            else:
                low, high = row_start[s], row_start[s + 1]
                while high - low > 1:
                    middle = (low + high) >> 1
                    if rows[middle] <= row:
                        low = middle
                    else:
                        high = middle
                local = w + low - row_start[s]
            r = 3 * (row_start[s + 1] - row_start[s])
            ld = 3 * w + ((r + 3) & ~3)
            target[q] = 3 * local + 3 * (column - first[s]) * ld
    return start, source, target


@njit(cache=True, error_model="numpy")
def layout(n, indptr, indices, order):
    """All of the symbolic analysis for a given elimination order."""
    position = np.empty(n, np.int32)
    for k in range(n):
        position[order[k]] = k
    row_pointer, columns = _permuted_lists(n, indptr, indices, position)
    parent, count = elimination_tree(n, row_pointer, columns)
    blocks = 0
    flops = 0.0
    for k in range(n):
        blocks += count[k]
        r = 3.0 * (count[k] - 1)
        flops += 9.0 + 9.0 * r + 3.0 * r * r
    moved, first, below, _, _ = supernodes(n, parent, count)
    final = np.empty(n, np.int32)
    for k in range(n):
        final[k] = order[moved[k]]
    for k in range(n):
        position[final[k]] = k
    row_pointer, columns = _permuted_lists(n, indptr, indices, position)
    row_start, rows, relative, tree, child_start, children, owner = _supernode_rows(
        n, first, below, row_pointer, columns
    )
    panel_start, stack_start, stack_size, tallest = _storage(first, row_start, tree, child_start, children)
    entry_start, source, target = _entries(n, indptr, indices, position, owner, first, row_start, rows)
    return (
        final,
        position,
        first,
        row_start,
        rows,
        relative,
        tree,
        child_start,
        children,
        panel_start,
        stack_start,
        entry_start,
        source,
        target,
        stack_size,
        tallest,
        blocks,
        flops,
    )
