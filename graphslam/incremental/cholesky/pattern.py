# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"
"""The pattern of Omega from the groups of nodes that are tied together."""

import numpy as np
from numba import njit


@njit(cache=True)
def pattern(num_nodes, sizes, nodes):
    """Column pointers and rows of the upper triangle for groups of given sizes, whose nodes follow each other."""
    # where each node occurs, and where the group of each occurrence begins
    begin = np.empty(len(nodes), dtype=np.int64)
    at = 0
    for size in sizes:
        begin[at : at + size] = at
        at += size
    by_node, occurrence = _sorted_by(num_nodes, nodes)
    # the neighbours below each node in any order, ...
    mark = np.full(num_nodes, -1, dtype=np.int64)
    count = np.zeros(num_nodes, dtype=np.int64)
    for fill in (False, True):
        if fill:
            low, high = np.empty(count.sum(), dtype=np.int64), np.empty(count.sum(), dtype=np.int64)
            mark[:] = -1
        total = 0
        for j in range(num_nodes):
            mark[j] = j
            for here in occurrence[by_node[j] : by_node[j + 1]]:
                for p in range(begin[here], here):
                    i = nodes[p]
                    if mark[i] != j:
                        mark[i] = j
                        if fill:
                            low[total], high[total] = i, j
                        else:
                            count[j] += 1
                        total += 1
    # ... and a stable sort by the neighbour, then by the node, brings them into columns with increasing rows
    _, by_low = _sorted_by(num_nodes, low)
    start, by_high = _sorted_by(num_nodes, high[by_low])
    indptr = start + np.arange(num_nodes + 1)
    indices = np.empty(indptr[num_nodes], dtype=np.int64)
    for j in range(num_nodes):
        for k in range(start[j], start[j + 1]):
            indices[k + j] = low[by_low[by_high[k]]]
        indices[indptr[j + 1] - 1] = j
    return indptr, indices


@njit(cache=True)
def _sorted_by(num_keys, keys):
    """Counting sort, stable: where each key's places start (num_keys + 1,), and the places key by key."""
    start = np.zeros(num_keys + 1, dtype=np.int64)
    for key in keys:
        start[key + 1] += 1
    start = np.cumsum(start)
    free, places = start[:-1].copy(), np.empty(len(keys), dtype=np.int64)
    for place, key in enumerate(keys):
        places[free[key]] = place
        free[key] += 1
    return start, places
