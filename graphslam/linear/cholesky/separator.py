# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Smallest vertex separators between two sets of nodes, by a maximum flow of paths that share no node.

A node v has two states, in and out (2 v and 2 v + 1), between which at most one path passes, so that the most paths are as
many as the fewest nodes that cut them all (Menger 1927). The flow is kept as the node before and the node after each node
on its path; a further path may take others back. Paths are sought depth first, many in one sweep (Pothen and Fan,
*Computing the block triangular form of a sparse matrix*, 1990), towards the other end: Dinic's shortest paths took 50 to 90
sweeps for the first separator of 120,000 nodes.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: values of `before` and `after`: the node is on no path, or a path begins or ends here
NONE, END = -1, -2


class Work(NamedTuple):
    """A graph of n nodes in adjacency lists, and scratch for its separators."""

    pointer: NDArray[Any]
    neighbours: NDArray[Any]
    side: NDArray[Any]  #: (n,) of a region: 0, 1 between, 2; negative for other nodes
    part: NDArray[Any]  #: (n,)
    before: NDArray[Any]  #: (n,) the node before each node on its path, `NONE` or `END`
    after: NDArray[Any]  #: (n,)
    hops: NDArray[Any]  #: (n,) edges to side 2
    seen: NDArray[Any]  #: (2 n,) stamp of the last sweep that visited each state
    stamp: NDArray[Any]  #: (1,)
    queue: NDArray[Any]  #: (2 n + 1,), nodes or states
    arc: NDArray[Any]  #: (2 n + 1,)
    turn: NDArray[Any]  #: (2 n + 1,)


@njit(cache=True, error_model="numpy")
def workspace(pointer, neighbours):
    """The scratch of a graph."""
    n = pointer.size - 1
    return Work(
        pointer, neighbours, np.full(n, -1, np.int8), np.empty(n, np.int8), np.empty(n, np.int32), np.empty(n, np.int32),
        np.empty(n, np.int32), np.zeros(2 * n, np.int32), np.zeros(1, np.int32),
        np.empty(2 * n + 1, np.int32), np.empty(2 * n + 1, np.int64), np.empty(2 * n + 1, np.int8),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _hops(nodes, work):
    """The numbers of edges from each node to side 2; nodes of side 0 are reached, but not passed through."""
    pointer, neighbours, side, hops, queue = work.pointer, work.neighbours, work.side, work.hops, work.queue
    end = 0
    for v in nodes:
        hops[v] = 2**30
        if side[v] == 2:
            hops[v] = 0
            queue[end] = v
            end += 1
    start = 0
    while start < end:
        v = queue[start]
        start += 1
        for p in range(pointer[v], pointer[v + 1]):
            w = neighbours[p]
            if 0 <= side[w] < 2 and hops[w] == 2**30:
                hops[w] = hops[v] + 1
                if side[w] == 1:
                    queue[end] = w
                    end += 1


@njit(cache=True, error_model="numpy")
def _ends(nodes, work, source):
    """The nodes of side ``source`` with a neighbour elsewhere in the region."""
    pointer, neighbours, side = work.pointer, work.neighbours, work.side
    ends = np.empty(nodes.size, np.int32)
    count = 0
    for v in nodes:
        if side[v] == source:
            for p in range(pointer[v], pointer[v + 1]):
                other = side[neighbours[p]]
                if other >= 0 and other != source:
                    ends[count] = v
                    count += 1
                    break
    return ends[:count]


@njit(cache=True, error_model="numpy")
def _sweep(ends, work, source, before, after):
    """Paths from side ``source`` to the opposite side through the residual network, each state visited once; how many.

    If there is none, the states that can be reached are those that were ``seen`` now.
    """
    pointer, neighbours, side, hops, seen = work.pointer, work.neighbours, work.side, work.hops, work.seen
    path, arc, turn = work.queue, work.arc, work.turn
    sink, found = 2 - source, 0
    work.stamp[0] += 1
    stamp = work.stamp[0]
    for first in ends:
        if before[first] != NONE:
            continue
        path[0] = 2 * first + 1
        arc[0] = pointer[first]
        turn[0] = 0
        seen[2 * first] = stamp
        seen[2 * first + 1] = stamp
        depth = 0
        while depth >= 0:
            state = path[depth]
            v = state >> 1
            following = -1
            if state & 1:
                while following < 0 and turn[depth] < 3:
                    while arc[depth] < pointer[v + 1]:
                        w = neighbours[arc[depth]]
                        arc[depth] += 1
                        if side[w] < 0 or side[w] == source or seen[2 * w] == stamp or w == after[v]:
                            continue
                        # straight ahead through free nodes, then sideways, then back or through other paths
                        free = before[w] == NONE
                        kind = 0 if free and hops[w] < hops[v] else (1 if free and hops[w] == hops[v] else 2)
                        if kind == turn[depth]:
                            following = 2 * w
                            break
                    if following < 0:
                        turn[depth] += 1
                        arc[depth] = pointer[v]
                if following < 0 and before[v] >= 0 and seen[2 * v] != stamp:
                    following = 2 * v
            elif before[v] == NONE:
                if side[v] == sink:
                    _augment(path, depth, before, after)
                    found += 1
                    break
                if seen[2 * v + 1] != stamp:
                    following = 2 * v + 1
            elif before[v] >= 0 and seen[2 * before[v] + 1] != stamp:
                following = 2 * before[v] + 1
            if following < 0:
                depth -= 1
            else:
                seen[following] = stamp
                depth += 1
                path[depth] = following
                arc[depth] = pointer[following >> 1]
                turn[depth] = 0
    return found


@njit(cache=True, error_model="numpy")
def _augment(path, depth, before, after):
    """Send one more path along these states, some of which take others back."""
    for k in range(depth):
        v, w = path[k] >> 1, path[k + 1] >> 1
        if path[k] & 1:
            if v != w:
                after[v] = w
                before[w] = v
            else:
                after[v] = NONE
                before[v] = NONE
    before[path[0] >> 1] = END
    after[path[depth] >> 1] = END


@njit(cache=True, error_model="numpy")
def separate(nodes, work):
    """A smallest set of the ``nodes`` of a region that separates those of side 0 from those of side 2; its size.

    Afterwards ``work.side`` is 0 and 2 of the nodes on the two sides, and 1 of the separator, which may have taken nodes of
    both sides. Of the smallest separators it is the one next to side 0 or the one next to side 2, whichever divides the
    nodes more evenly.
    """
    side, part, before, after, seen = work.side, work.part, work.before, work.after, work.seen
    for v in nodes:
        before[v] = NONE
        after[v] = NONE
    _hops(nodes, work)
    ends, size, found = _ends(nodes, work, 0), 0, 1
    while found > 0:
        found = _sweep(ends, work, 0, before, after)
        size += found
    uneven = np.int64(2**62)
    for source in (0, 2):
        if source == 2:
            _sweep(_ends(nodes, work, 2), work, 2, after, before)
        stamp, inner = work.stamp[0], 0
        for v in nodes:
            # the nodes that a path from this side could still leave, and those without paths behind its ends
            inner += seen[2 * v + 1] == stamp or (side[v] == source and before[v] == NONE)
        if abs(2 * inner + size - nodes.size) < uneven:
            uneven = abs(2 * inner + size - nodes.size)
            for v in nodes:
                if seen[2 * v + 1] == stamp or (side[v] == source and before[v] == NONE):
                    part[v] = source
                else:
                    reached = seen[2 * v] == stamp or side[v] == source
                    part[v] = 1 if before[v] != NONE and reached else 2 - source
    for v in nodes:
        side[v] = part[v]
    return size
