"""The pattern of Omega and the symbolic analysis of its factor, which graphs of the same structure can share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from .cholesky import Symbolic, analyze

#: structures are kept as long as they have together at most so many blocks; the last one is always kept
MOST_BLOCKS = 1_000_000


@dataclass(frozen=True, eq=False)
class Structure:
    """The upper block-CSC pattern ``indptr`` (n + 1,) and ``indices`` of a symmetric matrix; both must not change."""

    indptr: np.ndarray
    indices: np.ndarray

    @cached_property
    def symbolic(self) -> Symbolic:
        """Ordering and structure of the factor, computed at the first use."""
        return analyze(self.indptr, self.indices)


class Structures:
    """The structures that were used last, by the groups of nodes that they were made from.

    A structure depends on nothing else, so that a shared one is the same to the last bit as one made again.
    """

    def __init__(self, most_blocks: int = MOST_BLOCKS) -> None:
        self._most_blocks, self._blocks = most_blocks, 0
        self._kept: dict[tuple[int, bytes, bytes], Structure] = {}

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, num_nodes: int, sizes: np.ndarray, nodes: np.ndarray) -> Structure:
        """The structure of nodes in groups: the one in stock, or a new one; the oldest ones are dropped."""
        # the dictionary compares whole keys, so that equal hashes cannot confuse two structures
        key = num_nodes, sizes.tobytes(), nodes.tobytes()
        structure = self._kept.pop(key, None)
        if structure is None:
            structure = Structure(*pattern(num_nodes, sizes, nodes))
            self._blocks += len(structure.indices)
        self._kept[key] = structure
        while self._blocks > self._most_blocks and len(self._kept) > 1:
            self._blocks -= len(self._kept.pop(next(iter(self._kept))).indices)
        return structure


_SHARED: ContextVar[Structures | None] = ContextVar("structures", default=None)


def structure_of(num_nodes: int, sizes: np.ndarray, nodes: np.ndarray) -> Structure:
    """The structure of nodes tied in groups of given sizes, whose nodes follow each other; shared inside `sharing`."""
    shared = _SHARED.get()
    if shared is not None:
        return shared.of(num_nodes, sizes, nodes)
    return Structure(*pattern(num_nodes, sizes, nodes))


@contextmanager
def sharing(structures: Structures) -> Iterator[None]:
    """Inside the block, systems of the same structure share it."""
    token = _SHARED.set(structures)
    try:
        yield
    finally:
        _SHARED.reset(token)


@njit(cache=True)
def pattern(num_nodes, sizes, nodes):  # type: ignore[no-untyped-def]
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
def _sorted_by(num_keys, keys):  # type: ignore[no-untyped-def]
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
