# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"
"""Elimination tree, column counts and relaxed supernodes."""

import numpy as np
from numba import njit

# Cost model of one supernode of w columns and r rows below (nodes), in nanoseconds: fixed overhead, scalars of the
# panel, flops, scalars of the update matrix passed to the parent. They were fitted by timing settings on seven pose graphs, a
# field of 10^4 poses and a path of 10^5. With 100, 2, 0.05 and 1 the factorisation of CSAIL, INTEL, M3500 and dlr takes 5 to
# 8 % longer; with an overhead of 200 the solution of the path takes 1.6 times as long, because of memory.
COST_NODE, COST_PANEL, COST_FLOP, COST_UPDATE = 150.0, 2.0, 0.04, 2.0


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

    Returns the column order of the amalgamated and postordered tree, the first column of every supernode and its
    number of rows below.
    """
    width = np.ones(n, np.int32)
    below = count - 1
    alive = np.ones(n, np.bool_)
    child = np.full(n, -1, np.int32)
    sibling = np.full(n, -1, np.int32)
    column_head = np.arange(n).astype(np.int32)
    column_next = np.full(n, -1, np.int32)
    cost = np.empty(n)
    for p in range(n):
        cost[p] = _cost(np.int64(1), below[p])
        # first merge the children that add no zeros, so that the others are compared with the full width
        for relaxed in range(2):
            c = child[p]
            previous = -1
            while c >= 0:
                following = sibling[c]
                w = width[c] + width[p]
                merge = _cost(w, below[p]) < cost[c] + cost[p] if relaxed else below[c] == width[p] + below[p]
                if merge:
                    cost[p] = _cost(w, below[p])
                    width[p] = w
                    alive[c] = False
                    column_next[c] = column_head[p]
                    column_head[p] = column_head[c]
                    # the grandchildren take the place of c; they are not tested again, as they were tested against c
                    g = child[c]
                    if previous < 0:
                        child[p] = g if g >= 0 else following
                    else:
                        sibling[previous] = g if g >= 0 else following
                    if g >= 0:
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
    total = np.count_nonzero(alive)
    # a stack instead of recursion: the tree of a path is as deep as the path is long
    first = np.empty(total + 1, np.int32)
    rows = np.empty(total, np.int32)
    columns = np.empty(n, np.int32)
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
                j = column_head[p]
                for _ in range(width[p]):
                    columns[k] = j
                    k += 1
                    j = column_next[j]
                s += 1
                depth -= 1
    first[total] = n
    return columns, first, rows
