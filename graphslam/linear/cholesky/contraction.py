# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Smaller graphs by matching: neighbours become one node, as in multilevel partitioning (Karypis and Kumar 1998)."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def contracted(n, pointer, neighbours, rounds, limit):
    """A graph whose nodes are clusters of up to 2^rounds neighbours: the cluster of each node, list pointers and lists.

    Each node is matched to the free neighbour with the fewest neighbours. In graphs of poses and landmarks these are
    consecutive poses, which see nearly the same landmarks, so that most of the edges become multiple and vanish. Nodes with
    more than ``limit`` neighbours stay alone.
    """
    cluster = np.arange(n).astype(np.int32)
    for _ in range(rounds):
        size = pointer.size - 1
        number = np.full(size, -1, np.int32)
        first, second = np.empty(size, np.int32), np.full(size, -1, np.int32)
        count = 0
        for v in range(size):
            if number[v] >= 0:
                continue
            number[v] = count
            first[count] = v
            least, low, high = limit + 1, pointer[v], pointer[v + 1]
            for p in range(low, high if high - low <= limit else low):
                w = neighbours[p]
                if number[w] < 0 and pointer[w + 1] - pointer[w] < least:
                    least = pointer[w + 1] - pointer[w]
                    second[count] = w
            if second[count] >= 0:
                number[second[count]] = count
            count += 1
        if count > 0.9 * size:
            break
        fresh = np.empty(neighbours.size, np.int32)
        start = np.zeros(count + 1, np.int64)
        mark = np.full(count, -1, np.int32)
        free = 0
        for c in range(count):
            mark[c] = c
            for turn in range(2):
                v = second[c] if turn else first[c]
                if v < 0:
                    continue
                for p in range(pointer[v], pointer[v + 1]):
                    other = number[neighbours[p]]
                    if mark[other] != c:
                        mark[other] = c
                        fresh[free] = other
                        free += 1
            start[c + 1] = free
        pointer, neighbours = start, fresh[:free]
        for v in range(n):
            cluster[v] = number[cluster[v]]
    return cluster, pointer, neighbours
