"""Priors on nodes: those of a map on its landmarks, or the marginal of edges whose poses were eliminated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, wrap
from .anchor import AnchorEdges
from .base import ConstantEdges, EdgeFamily, Linearization


@dataclass(frozen=True, eq=False)
class LandmarkPriors(AnchorEdges):
    """Independent priors of landmark nodes (E,): e = m - m̂ with the heading wrapped, information (E, 3, 3).

    Rows and columns of the heading are zero where the map does not give it.
    """

    @property
    def numbers(self) -> tuple[int, float]:
        rows = int(np.linalg.matrix_rank(self.information, hermitian=True).sum())
        return rows, rows


@dataclass(frozen=True, eq=False)
class PriorEdges(EdgeFamily):
    """A joint prior of K nodes: v' Omega v - 2 b' v + b' Omega^+ b, with v (3K,) the way of the nodes from their values.

    Args:
        nodes: (K,) increasing.
        values: (K, 3), in world axes; headings of v are wrapped.
        information: Omega (3K, 3K); zero for coordinates about which it says nothing.
        rhs: b (3K,), or None for zero, where the values are the mean.
    """

    nodes: np.ndarray
    values: Array
    information: Array
    rhs: Array | None = None

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(len(self.nodes), 1)

    @property
    def count(self) -> int:
        return 1

    @cached_property
    def numbers(self) -> tuple[int, float]:
        rows = int(np.linalg.matrix_rank(self.information, hermitian=True))
        return rows, rows

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0, len(self.nodes)]), self.nodes

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """One edge with one end for each node; of priors without ``rhs`` only."""
        if self.rhs is not None:
            raise GraphError("a prior that is not centred at its values has no residual")
        jacobians = np.eye(len(self.information)).reshape(-1, len(self.nodes), 3).transpose(1, 0, 2)
        ends = tuple(self.nodes[:, None])
        return Linearization(self._way(state)[None], self.information[None], ends, tuple(jacobians[:, None]))

    def constant(self, state: Array) -> ConstantEdges:
        raise GraphError(
            "the joint prior of a map ties all its landmarks to each other, which no edge between two nodes does; a map "
            "without correlations (LandmarkMap.used_as) can be certified"
        )

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        v, k = self._way(state), len(self.nodes)
        pull = self.information @ v
        if system is not None:
            blocks = self.information.reshape(k, 3, k, 3).transpose(0, 2, 1, 3)
            system.values[system.diagonal_slots[self.nodes]] += blocks[np.arange(k), np.arange(k)]
            if k > 1:
                i, j = self._pairs
                system.values[system.slots_of(*self._ends)[2]] += blocks[i, j]
            system.xi[self.nodes] += ((0.0 if self.rhs is None else self.rhs) - pull).reshape(k, 3)
        if self.rhs is None:
            return float(v @ pull)
        return float(v @ pull - 2 * self.rhs @ v + self._least)

    @cached_property
    def _least(self) -> float:
        assert self.rhs is not None
        return float(np.linalg.lstsq(self.information, self.rhs, rcond=None)[0] @ self.rhs)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """The nodes of each pair; kept, because the system finds its slots by the arrays."""
        i, j = self._pairs
        return self.nodes[i], self.nodes[j]

    def _way(self, state: Array) -> Array:
        way = state[self.nodes] - self.values
        way[:, 2] = wrap(way[:, 2])
        return way.ravel()
