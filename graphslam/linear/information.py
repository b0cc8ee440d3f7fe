"""The sparse system Omega Delta = xi: the pattern of Omega is computed once per graph, its numbers at every step.

Omega is symmetric, of 3 x 3 blocks, and kept as upper block-CSC in the order of the nodes: column j has the row nodes
``indices[indptr[j]:indptr[j+1]]`` <= j in increasing order, the diagonal always last, and block k is ``values[k]``.
A slot is the number k of a block.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numba import njit

from ..se2 import Array
from .cholesky import Factor, Symbolic, symmetric
from .structure import Structure, structure_of


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
        """Where each column begins in ``indices`` and ``values``, (n + 1,)."""
        return self.structure.indptr

    @property
    def indices(self) -> np.ndarray:
        """The row node of each block."""
        return self.structure.indices

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
        key = tuple(nodes.tolist())
        if key not in self._held:
            self._held[key] = _slots_in_rows_and_columns(self.indptr, self.indices, nodes)
        _hold(self.values, self.xi, self._held[key], self.diagonal_slots, nodes)

    def rest(self, nodes: np.ndarray, coordinate: int) -> None:
        """Hold the coordinates of nodes from ``coordinate`` on, which no edge may touch: their diagonal becomes 1."""
        _rest(self.values, self.diagonal_slots, nodes, coordinate)

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
            self._slots[key] = (*_edge_slots(self.indptr, self.indices, first, second), first, second)
        return self._slots[key][:3]  # type: ignore[return-value]

    def to_sparse(self) -> sp.csc_matrix:
        """Omega whole, both triangles, as a SciPy matrix (3n, 3n)."""
        return symmetric(self.indptr, self.indices, self.values)


@njit(cache=True)
def _slots_in_rows_and_columns(indptr, indices, nodes):  # type: ignore[no-untyped-def]
    # compiled, because `numpy.isin` takes 0.4 ms where a whole solution of a small graph takes 2 ms
    held = np.zeros(len(indptr) - 1, dtype=np.bool_)
    held[nodes] = True
    slots = np.empty(len(indices), dtype=np.int64)
    count = 0
    for j in range(len(held)):
        for k in range(indptr[j], indptr[j + 1]):
            if held[j] or held[indices[k]]:
                slots[count] = k
                count += 1
    return slots[:count]


@njit(cache=True)
def _hold(values, xi, slots, diagonal, nodes):  # type: ignore[no-untyped-def]
    for slot in slots:
        values[slot] = 0.0
    for node in nodes:
        xi[node] = 0.0
    _rest(values, diagonal, nodes, 0)


@njit(cache=True)
def _rest(values, diagonal, nodes, coordinate):  # type: ignore[no-untyped-def]
    for node in nodes:
        for c in range(coordinate, 3):
            values[diagonal[node], c, c] = 1.0


@njit(cache=True)
def _edge_slots(indptr, indices, first, second):  # type: ignore[no-untyped-def]
    pair = np.empty(len(first), dtype=np.int64)
    for k in range(len(first)):
        row, column = min(first[k], second[k]), max(first[k], second[k])
        low, high = indptr[column], indptr[column + 1]
        pair[k] = low + np.searchsorted(indices[low:high], row)
    return indptr[first + 1] - 1, indptr[second + 1] - 1, pair
