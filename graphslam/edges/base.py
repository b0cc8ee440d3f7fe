"""What a family of edges must be able to do, and how it looks when taken apart edge by edge.

A graph has n nodes; ``state`` (n, 3) holds their values, poses (x, y, theta) and landmarks alike. Some information
matrices depend on the state; they are taken at ``reference`` (n, 3), which Gauss-Newton sets to the current state at
every step, while a damped search holds it still so that what it minimises is one function.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..se2 import Array


@dataclass(frozen=True)
class Linearization:
    """The edges of a family at one state: e (E, d), Omega_e (E, d, d), and per end node its index and Jacobian.

    ``nodes[k]`` (E,) and ``jacobians[k]`` (E, d, 3) belong to the k-th end of each edge; an anchor has one end.
    """

    residuals: Array
    information: Array
    nodes: tuple[np.ndarray, ...]
    jacobians: tuple[Array, ...]

    @property
    def mahalanobis(self) -> Array:
        """The cost of each edge, e' Omega e; (E,)."""
        return np.einsum("ei,eij,ej->e", self.residuals, self.information, self.residuals)


@dataclass(frozen=True)
class Relations:
    """Linear relations between two nodes each, u_second - u_first = value, for `initialize`.

    Headings: ``value`` (E,) [rad] and ``information`` (E,). Positions: ``value`` (E, 2) [m] in world axes and
    ``information`` (E, 2, 2).
    """

    first: np.ndarray
    second: np.ndarray
    value: Array
    information: Array


class EdgeFamily(Protocol):
    """Edges of one kind. All of them write e' Omega e into the cost, B' Omega B into Omega and -B' Omega e into xi."""

    @property
    def count(self) -> int:
        """The number of edges."""

    @property
    def frozen_information(self) -> bool:
        """Whether Omega_e depends on the reference state."""

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """The groups of nodes that the edges tie, as (starts, nodes): group g is ``nodes[starts[g]:starts[g+1]]``.

        Within a group the nodes do not decrease, and every pair of different nodes has an edge.
        """

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The edges one by one, for inspection and tests."""

    def cost(self, state: Array, reference: Array) -> float:
        """The sum of e' Omega e."""

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """Add the edges to Omega and xi, in place, and return their cost."""

    def headings(self) -> Relations | None:
        """The relative headings that the edges measure; None where they measure none."""

    def positions(self, state: Array) -> Relations | None:
        """The relative positions that the edges measure, with all headings taken from the state."""


class BlockSystem(Protocol):
    """The part of `information.BlockSystem` that edges write to; see there."""

    @property
    def indptr(self) -> np.ndarray: ...  # noqa: D102
    @property
    def indices(self) -> np.ndarray: ...  # noqa: D102
    @property
    def values(self) -> Array: ...  # noqa: D102
    @property
    def xi(self) -> Array: ...  # noqa: D102
    @property
    def workspace(self) -> np.ndarray: ...  # noqa: D102

    def slots(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """The slots of blocks (row, column), row <= column."""

    def slots_of(self, edges: BinaryEdges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The slots that edges between two nodes write to: (first, first), (second, second), the pair's upper."""


class BinaryEdges(Protocol):
    """Edges that each tie a first and a second node, (E,) each."""

    @property
    def first(self) -> np.ndarray:
        """The node at the first end of each edge."""

    @property
    def second(self) -> np.ndarray:
        """The node at the second end of each edge."""
