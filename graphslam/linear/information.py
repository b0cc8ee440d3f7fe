"""The sparse system Omega Delta = xi: the pattern of Omega is computed once per graph, its numbers at every step.

Omega is symmetric, of 3 x 3 blocks, and kept as upper block-CSC in the order of the nodes: column j has the row nodes
``indices[indptr[j]:indptr[j+1]]`` <= j in increasing order, the diagonal always last, and block k is ``values[k]``.
A slot is the number k of a block.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..se2 import Array
from .cholesky import Factor, Symbolic, analyze, symmetric

if TYPE_CHECKING:
    import scipy.sparse as sp


@dataclass(frozen=True, eq=False)
class Structure:
    """The upper block-CSC pattern ``indptr`` (n + 1,) and ``indices`` of a symmetric matrix; they must not change.

    ``points`` are the nodes without a heading. Several threads may use one structure.
    """

    indptr: np.ndarray
    indices: np.ndarray
    points: np.ndarray
    #: a proof that nobody uses, whose memory is used again
    spare: list[Any] = field(default_factory=list, repr=False)
    _held: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict, repr=False)
    _slots: dict[tuple[int, int], tuple[np.ndarray, ...]] = field(default_factory=dict, repr=False)

    @classmethod
    def of_cliques(
        cls, num_nodes: int, cliques: Iterable[tuple[np.ndarray, np.ndarray]], points: Iterable[int] = ()
    ) -> Structure:
        """That of nodes tied in groups, each given as (starts (G+1,), nodes), nodes not decreasing."""
        parts = [(np.asarray(starts, np.int64), np.asarray(nodes, np.int64)) for starts, nodes in cliques]
        start, rows = engine.pattern(num_nodes, parts)
        return cls(start, rows, np.asarray(points, np.int64))

    @cached_property
    def symbolic(self) -> Symbolic:
        """Ordering and structure of the factor, computed at the first use."""
        return analyze(self.indptr, self.indices, points=self.points, check=False)

    @cached_property
    def _for_proof(self) -> Any:
        return engine.for_proof(self.symbolic.structure)

    def proof(self) -> Any:
        """A proof in the engine: the ``spare`` one, where its user gives it back, or a new one."""
        try:
            return self.spare.pop()
        except IndexError:
            return engine.Proof(self.indptr, self.indices, self._for_proof)


@dataclass(frozen=True, eq=False)
class BlockSystem:
    """Omega and xi of a graph with n nodes; see the module for the layout. Not to be shared by threads.

    ``objectives`` are those of the graphs that use this memory in the engine.
    """

    structure: Structure
    values: Array
    xi: Array
    objectives: WeakKeyDictionary[Any, Any] = field(default_factory=WeakKeyDictionary, repr=False)

    @classmethod
    def of(cls, structure: Structure) -> BlockSystem:
        """The empty system with a structure."""
        n = len(structure.indptr) - 1
        return cls(structure, np.zeros((len(structure.indices), 3, 3)), np.zeros((n, 3)))

    @classmethod
    def from_cliques(
        cls, num_nodes: int, cliques: Iterable[tuple[np.ndarray, np.ndarray]], points: Iterable[int] = ()
    ) -> BlockSystem:
        """The empty system of `Structure.of_cliques`.

        The nodes ``points`` have no heading: before it is factorised, `rest` must hold their third coordinates.
        """
        return cls.of(Structure.of_cliques(num_nodes, cliques, points))

    @classmethod
    def of_arrays(cls, indptr: np.ndarray, indices: np.ndarray, values: Array, xi: Array) -> BlockSystem:
        """The system whose arrays are given, such as those of the engine."""
        return cls(Structure(indptr, indices, np.zeros(0, np.int64)), values, xi)

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
        """The pattern and the numbers, into which families of the engine add."""
        return self.indptr, self.indices, self.values, self.xi

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
        self.objectives.clear()
        return factor

    def hold(self, nodes: np.ndarray) -> None:
        """Take nodes out of the system: their rows and columns become those of the identity, their xi zero."""
        self.values[self.blocks_of(nodes)] = 0.0
        self.xi[nodes] = 0.0
        self.rest(nodes, 0)

    def blocks_of(self, nodes: np.ndarray) -> np.ndarray:
        """The numbers of all blocks in the rows and columns of nodes."""
        key = tuple(nodes.tolist())
        held = self.structure._held
        if key not in held:
            held[key] = engine.blocks_of_nodes(self.indptr, self.indices, np.asarray(nodes, np.int64))
        return held[key]

    def rest(self, nodes: np.ndarray, coordinate: int) -> None:
        """Hold the coordinates of nodes from ``coordinate`` on, which no edge may touch: their diagonal becomes 1."""
        for c in range(coordinate, 3):
            self.values[self.diagonal_slots[nodes], c, c] = 1.0

    def clear(self) -> None:
        """Set Omega and xi to zero, keeping the pattern."""
        self.values.fill(0.0)
        self.xi.fill(0.0)

    def diagonal(self) -> Array:
        """The scalar diagonal of Omega, (n, 3)."""
        return np.diagonal(self.values[self.diagonal_slots], axis1=1, axis2=2)

    def slots_of(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The slots (E,) of the upper blocks between nodes (E,) and nodes (E,).

        They are looked up once for each pair of arrays, which must not change afterwards.
        """
        key, known = (id(first), id(second)), self.structure._slots
        if key not in known:
            a, b = (np.ascontiguousarray(nodes, dtype=np.int64) for nodes in (first, second))
            slots, k = engine.pair_blocks(self.indptr, self.indices, a, b)
            if k >= 0:
                raise GraphError(
                    f"a family has an edge between the nodes {a[k]} and {b[k]}, but no group of its cliques() has both"
                )
            # the arrays are kept with the slots, so that their ids cannot pass to other objects
            known[key] = slots, first, second
        return known[key][0]

    def to_sparse(self) -> sp.csc_matrix:
        """Omega whole, both triangles, as a SciPy matrix (3n, 3n)."""
        return symmetric(self.indptr, self.indices, self.values)


class SystemOfThread(threading.local):
    """One `BlockSystem` for each thread, ``system``: made where the thread first asks for it, and freed when it ends."""

    def __init__(self, structure: Structure) -> None:
        self.system = BlockSystem.of(structure)
