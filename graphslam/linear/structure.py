"""The pattern of Omega and the symbolic analysis of its factor, which graphs of the same structure can share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..engine import engine
from .cholesky import Symbolic, analyze
from .hermitian import HermitianSymbolic, analyze_hermitian

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

    @cached_property
    def hermitian(self) -> HermitianSymbolic:
        """The structure of the factor of a Hermitian matrix of this pattern, in the same order."""
        return analyze_hermitian(self.indptr, self.indices, self.symbolic.order)


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
            structure = _made(num_nodes, sizes, nodes)
            self._blocks += len(structure.indices)
        self._kept[key] = structure
        while self._blocks > self._most_blocks and len(self._kept) > 1:
            self._blocks -= len(self._kept.pop(next(iter(self._kept))).indices)
        return structure


def _made(num_nodes: int, sizes: np.ndarray, nodes: np.ndarray) -> Structure:
    return Structure(*engine.pattern(num_nodes, np.asarray(sizes, np.int64), np.asarray(nodes, np.int64)))


_SHARED: ContextVar[Structures | None] = ContextVar("structures", default=None)


def structure_of(num_nodes: int, sizes: np.ndarray, nodes: np.ndarray) -> Structure:
    """The structure of nodes tied in groups of given sizes, whose nodes follow each other; shared inside `sharing`."""
    shared = _SHARED.get()
    if shared is not None:
        return shared.of(num_nodes, sizes, nodes)
    return _made(num_nodes, sizes, nodes)


@contextmanager
def sharing(structures: Structures) -> Iterator[None]:
    """Inside the block, systems of the same structure share it."""
    token = _SHARED.set(structures)
    try:
        yield
    finally:
        _SHARED.reset(token)
