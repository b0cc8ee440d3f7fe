# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Elimination of the nodes of degree two and less, ahead of the minimum degree ordering."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def twin_lists(n, indptr, indices):
    """Adjacency lists of an upper CSC pattern without diagonal; ``twin[p]`` is the same edge seen from its far end."""
    start = np.zeros(n + 1, np.int64)
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            if i != j:
                start[i + 1] += 1
                start[j + 1] += 1
    start = np.cumsum(start)
    fill = start[:n].copy()
    graph = np.empty(start[n], np.int32)
    twin = np.empty(start[n], np.int32)
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            if i != j:
                a, b = fill[i], fill[j]
                graph[a] = j
                graph[b] = i
                twin[a] = b
                twin[b] = a
                fill[i] = a + 1
                fill[j] = b + 1
    return start, graph, twin


@njit(cache=True, error_model="numpy")
def _drop(p, owner, start, length, graph, twin):
    """Remove entry p from the list of its owner by moving the last entry into its place."""
    length[owner] -= 1
    last = start[owner] + length[owner]
    if last != p:
        graph[p] = graph[last]
        twin[p] = twin[last]
        twin[twin[p]] = p


@njit(cache=True, error_model="numpy")
def eliminate_low_degree(n, start, graph, twin):
    """Eliminate nodes of degree <= 2 as long as there are any; returns their order, and the lists of what remains.

    Minimum degree would begin with the same nodes, but each would cost an update of the quotient graph. Most poses of
    a trajectory are of this kind, and here each costs a few list entries. ``twin`` makes every update local, so that a
    node with 10^5 neighbours costs nothing extra.
    """
    length = (start[1:] - start[:-1]).astype(np.int32)
    order = np.empty(n, np.int32)
    gone = np.zeros(n, np.bool_)
    stack = np.empty(n, np.int32)
    done = 0
    for v0 in range(n):
        depth = 0
        if not gone[v0] and length[v0] <= 2:
            stack[0] = v0
            depth = 1
        while depth > 0:
            depth -= 1
            v = stack[depth]
            if gone[v]:
                continue
            gone[v] = True
            order[done] = v
            done += 1
            if length[v] == 0:
                continue
            p = start[v]
            a = graph[p]
            if length[v] == 1:
                _drop(twin[p], a, start, length, graph, twin)
                b = a
            else:
                b = graph[p + 1]
                if length[b] < length[a]:
                    a, b = b, a
                    p += 1
                ta = twin[p]
                tb = twin[2 * start[v] + 1 - p]
                joined = False
                for q in range(start[a], start[a] + length[a]):
                    if graph[q] == b:
                        joined = True
                        break
                if joined:
                    _drop(ta, a, start, length, graph, twin)
                    _drop(tb, b, start, length, graph, twin)
                else:
                    graph[ta] = b
                    graph[tb] = a
                    twin[ta] = tb
                    twin[tb] = ta
            # the outer loop will reach later nodes by itself; earlier ones go onto the stack
            if length[b] <= 2 and b < v0 and not gone[b]:
                stack[depth] = b
                depth += 1
            if a != b and length[a] <= 2 and a < v0 and not gone[a]:
                stack[depth] = a
                depth += 1
    return order[:done], gone, length


@njit(cache=True, error_model="numpy")
def remaining(gone, start, length, graph):
    """The graph without the eliminated nodes: its nodes, list pointers and lists in new numbers."""
    nodes, number = np.flatnonzero(~gone), np.cumsum(~gone) - 1
    pointer = np.zeros(nodes.size + 1, np.int64)
    pointer[1:] = np.cumsum(length[nodes])
    neighbours = np.empty(pointer[-1], np.int32)
    q = 0
    for i in nodes:
        for p in range(start[i], start[i] + length[i]):
            neighbours[q] = number[graph[p]]
            q += 1
    return nodes, pointer, neighbours
