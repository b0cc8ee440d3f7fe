# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Symbolic analysis: the supernodal structure of L and where everything is stored."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .elimination import elimination_tree, supernodes


class Layout(NamedTuple):
    """Supernodal structure of L in elimination order (``ns`` supernodes, all in units of nodes unless noted)."""

    order: NDArray[np.int32]  #: (n,) node eliminated k-th
    position: NDArray[np.int32]  #: (n,) inverse of ``order``
    first: NDArray[np.int32]  #: (ns+1,) first column of each supernode
    row_start: NDArray[np.int64]  #: (ns+1,) into ``rows`` and ``relative``
    rows: NDArray[np.int32]  #: rows below the diagonal block of each supernode, ascending
    relative: NDArray[np.int32]  #: where those rows stand in the front of the parent supernode
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
def permuted_lists(n, indptr, indices, position):
    """For each row k in elimination order its columns i < k (pointer, columns)."""
    row_pointer = np.zeros(n + 1, np.int64)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1] - 1):
            a = position[indices[p]]
            row_pointer[max(a, b) + 1] += 1
    row_pointer = np.cumsum(row_pointer)
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
def _supernode_rows(n, first, count, row_pointer, columns):
    """Row structure, tree and relative indices of the supernodes; row subtrees walked on the supernodal tree."""
    ns = first.size - 1
    row_start = np.zeros(ns + 1, np.int64)
    row_start[1:] = np.cumsum(count)
    rows = np.empty(row_start[ns], np.int32)
    relative = np.empty(row_start[ns], np.int32)
    fill = row_start[:ns].copy()
    parent = np.full(ns, -1, np.int32)
    mark = np.full(ns, -1, np.int32)
    owner = np.repeat(np.arange(ns), first[1:] - first[:-1])
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
    child_start = np.cumsum(child_start)
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
    return row_start, rows, relative, child_start, children, owner


@njit(cache=True, error_model="numpy")
def _panels(first, row_start):
    """Panels one after another, and the rows of the tallest front."""
    ns = first.size - 1
    panel_start = np.zeros(ns + 1, np.int64)
    tallest = 0
    for s in range(ns):
        w = 3 * (first[s + 1] - first[s])
        padded = (3 * (row_start[s + 1] - row_start[s]) + 3) & ~3
        tallest = max(tallest, w + padded)
        panel_start[s + 1] = panel_start[s] + w * (w + padded)
    return panel_start, tallest


@njit(cache=True, error_model="numpy")
def stacks(first, row_start, child_start, children, part):
    """Update matrices on two stacks for each part of the tree, one for even and one for odd depths: places, size of all.

    With one stack the update matrix of a supernode would have to be moved down over those of its children. The supernodes
    of one ``part`` (ns,) must be done in order, those of different parts may be done at the same time if neither needs the
    other. A part that follows all others may take the children of its supernodes from them; they keep their places.
    """
    ns = first.size - 1
    stack_start = np.zeros(ns, np.int64)
    stack = np.zeros(ns, np.int64)
    for s in range(ns - 1, -1, -1):
        stack[s] += 2 * part[s]
        for q in range(child_start[s], child_start[s + 1]):
            stack[children[q]] = 1 - (stack[s] & 1)
    top = np.zeros(2 * part.max() + 2, np.int64)
    peak = np.zeros(top.size, np.int64)
    for s in range(ns):
        r = 3 * (row_start[s + 1] - row_start[s])
        d = stack[s]
        stack_start[s] = top[d]
        top[d] += r * ((r + 3) & ~3)
        peak[d] = max(peak[d], top[d])
        for q in range(child_start[s], child_start[s + 1]):
            if part[children[q]] == part[s]:
                top[d ^ 1] = stack_start[children[q]]
                break
    begin = np.cumsum(peak) - peak
    for s in range(ns):
        stack_start[s] += begin[stack[s]]
    return stack_start, peak.sum()


@njit(cache=True, error_model="numpy")
def _entries(n, indptr, indices, position, owner, first, row_start, rows):
    """Where every block of the matrix goes, sorted by supernode."""
    ns = first.size - 1
    start = np.zeros(ns + 1, np.int64)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1]):
            start[owner[min(position[indices[p]], b)] + 1] += 1
    start = np.cumsum(start)
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
                local = w + np.searchsorted(rows[low:high], row)
            r = 3 * (row_start[s + 1] - row_start[s])
            ld = 3 * w + ((r + 3) & ~3)
            target[q] = 3 * local + 3 * (column - first[s]) * ld
    return start, source, target


@njit(cache=True, error_model="numpy")
def inverse(order):
    """The place (n,) of each node in an order."""
    position = np.empty_like(order)
    for k in range(order.size):
        position[order[k]] = k
    return position


@njit(cache=True, error_model="numpy")
def costs(count):
    """The blocks of L and the flops of the factorisation, multiply and add counted apart, from the column counts (n,)."""
    blocks, flops = 0, 0.0
    for rows in count:
        below = 3.0 * (rows - 1)
        blocks += rows
        flops += 9.0 + 9.0 * below + 3.0 * below * below
    return blocks, flops


@njit(cache=True, error_model="numpy")
def structure(n, indptr, indices, order):
    """The fields of `Layout` for an elimination order: structure, entries of the matrix, and sizes."""
    row_pointer, columns = permuted_lists(n, indptr, indices, inverse(order))
    parent, count = elimination_tree(n, row_pointer, columns)
    blocks, flops = costs(count)
    # amalgamation moves the columns of a supernode next to each other
    moved, first, rows_below = supernodes(n, parent, count)
    order = order[moved]
    position = inverse(order)
    row_pointer, columns = permuted_lists(n, indptr, indices, position)
    row_start, rows, relative, child_start, children, owner = _supernode_rows(
        n, first, rows_below, row_pointer, columns
    )
    panel_start, tallest = _panels(first, row_start)
    stack_start, stack_size = stacks(first, row_start, child_start, children, np.zeros(first.size - 1, np.int32))
    entries = _entries(n, indptr, indices, position, owner, first, row_start, rows)
    parts = (order, position, first, row_start, rows, relative, child_start, children, panel_start, stack_start)
    return parts, entries, (stack_size, tallest, blocks, flops)
