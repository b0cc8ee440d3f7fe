# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Fill-reducing ordering of the block graph: approximate minimum degree."""

import numpy as np
from numba import njit

from .low_degree import eliminate_low_degree, remaining, twin_lists


@njit(cache=True, error_model="numpy")
def _compacted(graph, start, length, size, room):
    """Copy of the live quotient-graph lists (``size`` > 0) with ``room`` free entries behind them."""
    total = 0
    for i in range(start.size):
        if size[i] > 0:
            total += length[i]
    fresh = np.empty(total + total // 2 + room, graph.dtype)
    free = 0
    for i in range(start.size):
        if size[i] > 0:
            first = start[i]
            start[i] = free
            for p in range(first, first + length[i]):
                fresh[free] = graph[p]
                free += 1
    return fresh, free


@njit(cache=True, error_model="numpy")
def _unlink(i, degree, head, after, before):
    """Take variable i out of its degree list."""
    a, b = after[i], before[i]
    if a >= 0:
        before[a] = b
    if b >= 0:
        after[b] = a
    else:
        head[degree[i]] = a


@njit(cache=True, error_model="numpy")
def _link(i, d, degree, head, after, before):
    """Put variable i at the front of degree list d."""
    degree[i] = d
    a = head[d]
    after[i] = a
    before[i] = -1
    if a >= 0:
        before[a] = i
    head[d] = i


@njit(cache=True, error_model="numpy")
def minimum_degree(n, pointer, neighbours, dense, turn):
    """Elimination order (n,) by approximate minimum degree; nodes of degree > ``dense`` go last.

    Nodes are eliminated in increasing ``turn`` (n,), and by degree among those of the same turn (all, where it is
    empty).

    Every list of the quotient graph holds elements first (``elements[i]`` of them), then variables. ``weight[i]``
    is the number of variables in supervariable i, 0 once it is absorbed or eliminated, negated while it belongs to
    the element under construction. Members of a supervariable are chained by ``chain``, so that the order is
    written out as the pivots are chosen and no assembly tree needs walking afterwards.
    """
    order = np.empty(n, np.int32)
    graph = np.empty(neighbours.size + neighbours.size // 2 + n + 1, np.int32)
    graph[: neighbours.size] = neighbours
    free = neighbours.size
    start = pointer[:n].copy()
    length = np.empty(n, np.int32)
    elements = np.zeros(n, np.int32)
    weight = np.ones(n, np.int32)
    size = np.ones(n, np.int8)  # 1 while the list of i (variable or element) is alive
    degree = np.zeros(n, np.int32)
    mark = np.zeros(n, np.int64)  # stamp for variables, |Le \ Lp| + stamp for elements
    head = np.full(n + 1, -1, np.int32)
    after = np.full(n, -1, np.int32)
    before = np.full(n, -1, np.int32)
    chain = np.full(n, -1, np.int32)
    tail = np.arange(n).astype(np.int32)
    mask = 1
    while mask < n:
        mask *= 2
    bucket = np.full(mask, -1, np.int32)
    mask -= 1
    sibling = np.full(n, -1, np.int32)
    code = np.zeros(n, np.int32)

    if turn.size == 0:
        turn = np.zeros(n, np.int32)
    now = turn.min() if n else 0

    done = 0
    last = n
    for i in range(n):
        length[i] = pointer[i + 1] - pointer[i]
        if length[i] > dense:
            last -= 1
            order[last] = i
            weight[i] = 0
            size[i] = 0
        elif length[i] == 0 and turn[i] == now:
            order[done] = i
            done += 1
            weight[i] = 0
            size[i] = 0
    todo = last  # the dense nodes are left out
    for i in range(n):
        if weight[i] > 0:
            d = length[i]
            if last < n:
                q = start[i]
                for p in range(start[i], start[i] + length[i]):
                    if size[graph[p]] > 0:
                        graph[q] = graph[p]
                        q += 1
                d = q - start[i]
                length[i] = d
            degree[i] = d
            if turn[i] == now:
                _link(i, d, degree, head, after, before)
    stamp = 1
    lowest = 0
    while done < todo:
        while lowest <= n and head[lowest] < 0:
            lowest += 1
        if lowest > n:
            now += 1
            lowest = 0
            for i in range(n):
                if weight[i] > 0 and turn[i] == now:
                    _link(i, degree[i], degree, head, after, before)
            continue
        pivot = head[lowest]
        _unlink(pivot, degree, head, after, before)

        # --- the new element: variables reached directly or through an adjacent element
        need = 0
        for p in range(start[pivot], start[pivot] + length[pivot]):
            need += length[graph[p]] if p < start[pivot] + elements[pivot] else 1
        if elements[pivot] > 0 and free + need > graph.size:
            graph, free = _compacted(graph, start, length, size, need + n)
        pivot_weight = weight[pivot]
        weight[pivot] = -pivot_weight
        first = free if elements[pivot] > 0 else start[pivot]
        end = first
        reach = 0
        for s in range(elements[pivot] + 1):
            if s < elements[pivot]:
                e = graph[start[pivot] + s]
                low = start[e]
                high = low + length[e]
                size[e] = 0  # absorbed
            else:
                low = start[pivot] + elements[pivot]
                high = start[pivot] + length[pivot]
            for p in range(low, high):
                i = graph[p]
                if weight[i] > 0:
                    reach += weight[i]
                    weight[i] = -weight[i]
                    graph[end] = i
                    end += 1
                    if turn[i] == now:
                        _unlink(i, degree, head, after, before)
        if elements[pivot] > 0:
            free = end
        start[pivot] = first
        length[pivot] = end - first

        # --- |Le \ Lp| of every element e that meets the new one
        for p in range(first, end):
            i = graph[p]
            w = -weight[i]
            for q in range(start[i], start[i] + elements[i]):
                e = graph[q]
                if size[e] > 0:
                    if mark[e] >= stamp:
                        mark[e] -= w
                    else:
                        mark[e] = stamp + degree[e] - w

        # --- approximate degrees, element absorption, mass elimination
        for p in range(first, end):
            i = graph[p]
            q = start[i]
            low = q
            high = low + length[i]
            middle = low + elements[i]
            external = 0
            key = 0
            for r in range(low, middle):
                e = graph[r]
                if size[e] > 0:
                    rest = mark[e] - stamp
                    if rest > 0:
                        external += rest
                        graph[q] = e
                        q += 1
                        key += e
                    else:
                        size[e] = 0  # aggressive absorption: e lies inside the new element
            kept = q - low
            # the new element takes the entry of an absorbed element or an eliminated variable; there is at least one
            for r in range(middle, high):
                j = graph[r]
                if weight[j] > 0:
                    external += weight[j]
                    graph[q] = j
                    q += 1
                    key += j
            if external == 0 and turn[i] == now:
                w = -weight[i]
                pivot_weight += w
                reach -= w
                weight[i] = 0
                size[i] = 0
                chain[tail[pivot]] = i
                tail[pivot] = tail[i]
            else:
                if external < degree[i]:
                    degree[i] = external
                if q > low + kept:
                    graph[q] = graph[low + kept]
                graph[low + kept] = pivot
                elements[i] = kept + 1
                length[i] = q - low + 1
                h = key & mask
                code[i] = h
                sibling[i] = bucket[h]
                bucket[h] = i

        # --- indistinguishable variables
        for p in range(first, end):
            i = graph[p]
            if weight[i] >= 0:
                continue
            h = code[i]
            i = bucket[h]
            bucket[h] = -1
            while i >= 0 and sibling[i] >= 0:
                stamp += n  # also lifts the stamp above every |Le \ Lp| stored so far
                low = start[i]
                for q in range(low, low + length[i]):
                    mark[graph[q]] = stamp
                previous = i
                j = sibling[i]
                while j >= 0:
                    same = length[j] == length[i] and elements[j] == elements[i] and turn[j] == turn[i]
                    if same:
                        for q in range(start[j], start[j] + length[j]):
                            if mark[graph[q]] != stamp:
                                same = False
                                break
                    if same:
                        weight[i] += weight[j]
                        weight[j] = 0
                        size[j] = 0
                        chain[tail[i]] = j
                        tail[i] = tail[j]
                        sibling[previous] = sibling[j]
                    else:
                        previous = j
                    j = sibling[j]
                i = sibling[i]
        stamp += n + 1

        # --- back to the degree lists; remove eliminated variables from the new element
        done_after = done + pivot_weight
        end_kept = first
        for p in range(first, end):
            i = graph[p]
            w = -weight[i]
            if w > 0:
                weight[i] = w
                d = min(degree[i] + reach - w, todo - done_after - w)
                if d < 0:
                    d = 0
                degree[i] = d
                if turn[i] == now:
                    _link(i, d, degree, head, after, before)
                    lowest = min(lowest, d)
                graph[end_kept] = i
                end_kept += 1
        if free == end:
            free = end_kept
        length[pivot] = end_kept - first
        degree[pivot] = reach
        weight[pivot] = 0
        if end_kept == first:
            size[pivot] = 0
        i = pivot
        while i >= 0:
            order[done] = i
            done += 1
            i = chain[i]
    return order


@njit(cache=True, error_model="numpy")
def fewest_neighbours(n, indptr, indices, limit):
    """Approximate minimum degree after the nodes of degree two and less; those with more than ``limit`` neighbours last."""
    start, graph, twin = twin_lists(n, indptr, indices)
    head, gone, length = eliminate_low_degree(n, start, graph, twin)
    nodes, pointer, neighbours = remaining(gone, start, length, graph)
    return joined(head, nodes, minimum_degree(nodes.size, pointer, neighbours, limit, np.zeros(0, np.int32)))


@njit(cache=True, error_model="numpy")
def joined(head, nodes, tail):
    """The order of all nodes: ``head``, then ``nodes`` in the order ``tail``."""
    order = np.empty(head.size + tail.size, np.int32)
    order[: head.size] = head
    for k in range(tail.size):
        order[head.size + k] = nodes[tail[k]]
    return order
