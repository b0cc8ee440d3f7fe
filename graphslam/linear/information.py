"""The sparse system Omega Delta = xi: the pattern of Omega is computed once per graph, its numbers at every step.

Omega is symmetric, of 3 x 3 blocks, and kept as upper block-CSC in the order of the nodes: column j has the row nodes
``indices[indptr[j]:indptr[j+1]]`` <= j in increasing order, the diagonal always last, and block k is ``values[k]``.
A slot is the number k of a block.

The pattern of Omega and the symbolic analysis of its factor, which graphs of the same structure can share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine import engine
from ..se2 import Array
from .cholesky import Factor, HermitianSymbolic, Symbolic, analyze, analyze_hermitian, symmetric

if TYPE_CHECKING:
    import scipy.sparse as sp

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


@dataclass(frozen=True, eq=False)
class BlockSystem:
    """Omega and xi of a graph with n nodes; see the module for the layout.

    The `structure` may be shared with other systems, the numbers are the system's own. ``workspace`` (n,) is scratch space
    for edges that look up slots column by column.
    """

    structure: Structure
    values: Array
    xi: Array
    workspace: np.ndarray
    _held: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict, repr=False)
    _slots: dict[tuple[int, int], tuple[np.ndarray, ...]] = field(default_factory=dict, repr=False)

    @classmethod
    def from_cliques(cls, num_nodes: int, cliques: Iterable[tuple[np.ndarray, np.ndarray]]) -> BlockSystem:
        """The empty system of nodes tied in groups, each given as (starts (G+1,), nodes), nodes not decreasing."""
        parts = list(cliques)
        nodes = np.concatenate([np.zeros(0, dtype=np.int64)] + [nodes for _, nodes in parts])
        sizes = np.concatenate([np.zeros(0, dtype=np.int64)] + [starts[1:] - starts[:-1] for starts, _ in parts])
        structure = structure_of(num_nodes, sizes, nodes)
        values = np.zeros((len(structure.indices), 3, 3))
        return cls(structure, values, np.zeros((num_nodes, 3)), np.zeros(num_nodes, np.int64))

    @property
    def indptr(self) -> np.ndarray:
        """The index (n + 1,) at which each column begins in ``indices`` and ``values``."""
        return self.structure.indptr

    @property
    def indices(self) -> np.ndarray:
        """The row node of each block."""
        return self.structure.indices

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The pattern, the numbers and the scratch space, into which families of the engine add."""
        return self.indptr, self.indices, self.values, self.xi, self.workspace

    @property
    def num_nodes(self) -> int:
        """The number n of nodes."""
        return len(self.indptr) - 1

    @property
    def symbolic(self) -> Symbolic:
        """Ordering and structure of the factor, computed once for the pattern."""
        return self.structure.symbolic

    @cached_property
    def _factor(self) -> Factor:
        return Factor(self.symbolic)

    @cached_property
    def diagonal_slots(self) -> np.ndarray:
        """The slots of the diagonal blocks, (n,)."""
        return self.indptr[1:] - 1

    def factorize(self, damping: float = 0.0) -> Factor:
        """Omega + damping diag(Omega) = L L', in memory that the next call reuses.

        Raises:
            SingularPivot: the edges leave a direction free.
        """
        return self._factor.refactorize(self.values, damping=damping)

    @property
    def factor_in_engine(self) -> Any:
        """The memory of `factorize` in the engine, which a solver may use until the next call of `factorize`."""
        return self._factor.in_engine

    def own_factor(self) -> Factor:
        """Omega = L L' in memory of its own: it becomes the caller's, and the next call of `factorize` takes other memory.

        Raises:
            SingularPivot: the edges leave a direction free.
        """
        factor = self.factorize()
        del vars(self)["_factor"]
        return factor

    def hold(self, nodes: np.ndarray) -> None:
        """Take nodes out of the system: their rows and columns become those of the identity, their xi zero."""
        engine.hold(*self.arrays, self.blocks_of(nodes), np.asarray(nodes, np.int64))

    def blocks_of(self, nodes: np.ndarray) -> np.ndarray:
        """The numbers of all blocks in the rows and columns of nodes."""
        key = tuple(nodes.tolist())
        if key not in self._held:
            self._held[key] = engine.blocks_of_nodes(self.indptr, self.indices, np.asarray(nodes, np.int64))
        return self._held[key]

    def rest(self, nodes: np.ndarray, coordinate: int) -> None:
        """Hold the coordinates of nodes from ``coordinate`` on, which no edge may touch: their diagonal becomes 1."""
        engine.rest(*self.arrays, np.asarray(nodes, np.int64), coordinate)

    def clear(self) -> None:
        """Set Omega and xi to zero, keeping the pattern."""
        self.values.fill(0.0)
        self.xi.fill(0.0)

    def diagonal(self) -> Array:
        """The scalar diagonal of Omega, (n, 3)."""
        return np.diagonal(self.values[self.diagonal_slots], axis1=1, axis2=2)

    def slots_of(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The slots of (first, first), (second, second) and of the pair's upper block for edges between nodes (E,).

        They are looked up once for each pair of arrays, which must not change afterwards.
        """
        key = (id(first), id(second))
        if key not in self._slots:
            # the arrays are kept with the slots, so that their ids cannot pass to other objects
            a, b = (np.ascontiguousarray(nodes, dtype=np.int64) for nodes in (first, second))
            pairs = engine.pair_blocks(self.indptr, self.indices, a, b)
            self._slots[key] = (self.diagonal_slots[a], self.diagonal_slots[b], pairs, first, second)
        return self._slots[key][:3]  # type: ignore[return-value]

    def to_sparse(self) -> sp.csc_matrix:
        """Omega whole, both triangles, as a SciPy matrix (3n, 3n)."""
        return symmetric(self.indptr, self.indices, self.values)
