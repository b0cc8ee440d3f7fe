# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""The elimination tree on several threads: each takes whole subtrees, one thread does the rest of the tree afterwards.

Every supernode is computed from the same numbers in the same order as on one thread, so that the factor does not depend
on the number of threads, to the last bit.
"""

import numpy as np
from numba import njit

#: the least estimated time of a factorisation, in ns, for which the threads are woken, which takes some 0.05 ms
LEAST = 1.0e6
#: the estimated time on several threads must be below this part of that on one
GAIN = 0.85
#: the most supernodes that are taken from the subtrees and left for the end
STEPS = 100


@njit(cache=True, error_model="numpy")
def _time(w, r):
    """The estimated time of a supernode of w columns and r rows below (scalars), in ns."""
    flops = w * w * w / 3.0 + w * w * r + w * r * r
    return 185.0 + 1.0 * w * (w + r) + 0.012 * flops + 0.3 * r * r


@njit(cache=True, error_model="numpy")
def divide(first, row_start, child_start, children, threads):
    """The part (ns,) of each supernode: a thread 0 to ``threads`` - 1, or ``threads`` for what comes last; or all 0.

    The tree is cut from the roots down, always in the largest subtree, and the subtrees are given to the threads, the
    largest first, each to the thread with the least work. The cut with the shortest estimated time is used.
    """
    ns = first.size - 1
    own, tree, size = np.empty(ns), np.empty(ns), np.ones(ns, np.int64)
    is_root = np.ones(ns, np.bool_)
    for s in range(ns):
        own[s] = _time(3.0 * (first[s + 1] - first[s]), 3.0 * (row_start[s + 1] - row_start[s]))
        tree[s] = own[s]
        for q in range(child_start[s], child_start[s + 1]):
            tree[s] += tree[children[q]]
            size[s] += size[children[q]]
            is_root[children[q]] = False
    part = np.zeros(ns, np.int32)
    total = own.sum()
    if total < LEAST or threads < 2:
        return part
    tasks = np.flatnonzero(is_root)
    top, best = 0.0, GAIN * total
    chosen, owner = tasks[:0], tasks[:0]
    for _ in range(STEPS):
        load, given = np.zeros(threads), np.empty(tasks.size, np.int64)
        tasks = tasks[np.argsort(-tree[tasks], kind="mergesort")]
        for k in range(tasks.size):
            given[k] = np.argmin(load)
            load[given[k]] += tree[tasks[k]]
        if top + load.max() < best:
            best, chosen, owner = top + load.max(), tasks, given
        largest = tasks[0]
        top += own[largest]
        below = children[child_start[largest] : child_start[largest + 1]]
        if top > best or below.size == 0:
            break
        tasks = np.concatenate((tasks[1:], below.astype(tasks.dtype)))
    if chosen.size == 0:
        return part
    part[:] = threads
    for k in range(chosen.size):
        part[chosen[k] + 1 - size[chosen[k]] : chosen[k] + 1] = owner[k]
    return part
