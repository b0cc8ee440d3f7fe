# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Nested dissection: few nodes separate the others into two parts of similar size, and each part again (George 1973).

The nodes are ranked by distances along edges, the first and the last part of the ranks are kept apart by the fewest nodes
that can do so (a maximum flow, `separator`). Large regions are cut in a contracted graph first, and the nodes of
the clusters that separate it then in the graph itself.
"""

import numpy as np
from numba import njit

from .contraction import contracted
from .separator import separate, workspace

#: regions of up to so many nodes are not dissected
LEAF = 400
#: regions of more nodes are cut in the contracted graph first; clusters have up to 2^ROUNDS nodes
LARGE, ROUNDS = 2_000, 3
#: share of the nodes that a cut leaves on each side at least, but for the part of the contracted separator
SHARE = 0.4
#: a region whose separator would have more than this part of the smaller side's nodes stays whole
THICK = 0.5


@njit(cache=True, error_model="numpy")
def _ranked(nodes, values, order, count):
    """The nodes by value, by a counting sort into bins; the result is ``order``."""
    low, high = np.inf, -np.inf
    for v in nodes:
        low, high = min(low, values[v]), max(high, values[v])
    bins = np.int64(min(count.size - 1, high - low + 1))
    count[: bins + 1] = 0
    for v in nodes:
        count[min(np.int64(values[v] - low), bins - 1) + 1] += 1
    for b in range(bins):
        count[b + 1] += count[b]
    for v in nodes:
        b = min(np.int64(values[v] - low), bins - 1)
        order[count[b]] = v
        count[b] += 1


@njit(cache=True, error_model="numpy")
def _narrowest(order, work, rank, begin, stop, profile):
    """The fewest nodes before a cut of the order at ``begin`` to ``stop`` with a neighbour behind it, or the reverse."""
    m, pointer, neighbours, side = order.size, work.pointer, work.neighbours, work.side
    for k in range(m):
        rank[order[k]] = k
    profile[: 2 * m + 2] = 0
    for k in range(m):
        v = order[k]
        least, most = k, k
        for p in range(pointer[v], pointer[v + 1]):
            w = neighbours[p]
            if side[w] >= 0:
                r = rank[w]
                least, most = min(least, r), max(most, r)
        profile[k] += 1
        profile[most] -= 1
        profile[m + least] += 1
        profile[m + k] -= 1
    best, left, right = m, 0, 0
    for k in range(stop):
        left += profile[k]
        right += profile[m + k]
        if k >= begin:
            best = min(best, left, right)
    return best


@njit(cache=True, error_model="numpy")
def _distances(nodes, first, work, distance):
    """The numbers of edges from a node to the others of the region; the last node reached."""
    pointer, neighbours, side, queue = work.pointer, work.neighbours, work.side, work.queue
    for v in nodes:
        distance[v] = -1
    distance[first] = 0
    queue[0] = first
    start, end = 0, 1
    while start < end:
        v = queue[start]
        start += 1
        for p in range(pointer[v], pointer[v + 1]):
            w = neighbours[p]
            if side[w] >= 0 and distance[w] < 0:
                distance[w] = distance[v] + 1
                queue[end] = w
                end += 1
    return queue[end - 1]


@njit(cache=True, error_model="numpy")
def _cut(nodes, work, axes, order, rank, count, profile):
    """Separate the region in the middle; ``work.side`` as after `separate`. Returns the size of the separator.

    The axes are a's distance minus b's for two nodes far apart, the same for two nodes far from both, and their sum
    and difference. The axis with the narrowest cut is used.
    """
    m, side = nodes.size, work.side
    for v in nodes:
        side[v] = 1
    a = _distances(nodes, nodes[0], work, axes[0])
    b = _distances(nodes, a, work, axes[0])
    _distances(nodes, b, work, axes[1])
    c, far = a, -1
    for v in nodes:
        d = min(axes[0, v], axes[1, v])
        if d > far:
            c, far = v, d
    d = _distances(nodes, c, work, axes[2])
    _distances(nodes, d, work, axes[3])
    for v in nodes:
        across, along = axes[0, v] - axes[1, v], axes[2, v] - axes[3, v]
        axes[0, v], axes[1, v], axes[2, v], axes[3, v] = across, along, across + along, across - along
    begin, narrowest = np.int64(SHARE * m), m + 1
    chosen = order[1]
    for k in range(4):
        _ranked(nodes, axes[k], order[0, :m], count)
        width = _narrowest(order[0, :m], work, rank, begin, m - begin, profile)
        if width < narrowest:
            narrowest = width
            chosen[:m] = order[0, :m]
    for k in range(begin):
        side[chosen[k]] = 0
        side[chosen[m - 1 - k]] = 2
    return separate(nodes, work)


@njit(cache=True, error_model="numpy")
def _scratch(n):
    """The last arguments of `_cut`."""
    return np.empty((4, n), np.int32), np.empty((2, n), np.int32), np.empty(n, np.int32), np.empty(2 * n + 2, np.int32)


@njit(cache=True, error_model="numpy")
def _divided(region, work, low, order):
    """Move the nodes of side 0 to the front, then those of side 2, then the separator; where the second and third begin."""
    side, ends = work.side, np.zeros(3, np.int64)
    at = 0
    for wanted in (0, 2, 1):
        for v in region:
            if side[v] == wanted:
                order[at] = v
                at += 1
        ends[wanted] = at
    region[:] = order[: region.size]
    return low + ends[0], low + ends[2]


@njit(cache=True, error_model="numpy")
def _members(nodes, cluster, side):
    """The clusters of nodes, marked as a region by ``side``."""
    clusters, size = np.empty(nodes.size, np.int32), 0
    for v in nodes:
        c = cluster[v]
        if side[c] < 0:
            side[c] = 1
            clusters[size] = c
            size += 1
    return clusters[:size]


@njit(cache=True, error_model="numpy")
def _widen(nodes, work):
    """Add the neighbours of a separator to it."""
    pointer, neighbours, side, part = work.pointer, work.neighbours, work.side, work.part
    for v in nodes:
        part[v] = side[v]
    for v in nodes:
        if part[v] == 1:
            for p in range(pointer[v], pointer[v + 1]):
                w = neighbours[p]
                if side[w] >= 0:
                    side[w] = 1


@njit(cache=True, error_model="numpy")
def dissect(n, pointer, neighbours, limit):
    """The depth (n,) of the separator that each node belongs to, 0 for the first; -1 for nodes in no separator.

    Nodes with more than ``limit`` neighbours are left out: they would be in every separator.
    """
    depth_of = np.full(n, -1, np.int32)
    work, (axes, order, rank, profile) = workspace(pointer, neighbours), _scratch(n)
    count = np.empty(65536, np.int64)
    cluster, starts, lists = contracted(n, pointer, neighbours, ROUNDS if n > LARGE else 0, limit)
    coarse = workspace(starts, lists)
    coarse_axes, coarse_order, coarse_rank, coarse_profile = _scratch(starts.size - 1)
    side, coarse_side = work.side, coarse.side
    regions = np.flatnonzero(pointer[1:] - pointer[:-1] <= limit).astype(np.int32)
    stack = np.empty((n + 1, 3), np.int64)
    stack[0] = (0, regions.size, 0)
    top = 1
    while top > 0:
        top -= 1
        low, high, depth = stack[top]
        nodes = regions[low:high]
        if nodes.size <= LEAF:
            continue
        for contract in range(1 if nodes.size > LARGE and starts.size <= n else 0, -1, -1):
            if contract:
                clusters = _members(nodes, cluster, coarse_side)
                _cut(clusters, coarse, coarse_axes, coarse_order, coarse_rank, count, coarse_profile)
                _widen(clusters, coarse)
                for v in nodes:
                    side[v] = coarse_side[cluster[v]]
                coarse_side[clusters] = -1
                size = separate(nodes, work)
            else:
                size = _cut(nodes, work, axes, order, rank, count, profile)
            middle, end = _divided(nodes, work, low, order[0])
            smaller = min(middle - low, end - middle)
            if size <= THICK * smaller:
                break
        for v in nodes:
            if side[v] == 1 and size <= THICK * smaller:
                depth_of[v] = depth
            side[v] = -1
        if size <= THICK * smaller:
            stack[top] = (low, middle, depth + 1)
            stack[top + 1] = (middle, end, depth + 1)
            top += 2
    return depth_of
