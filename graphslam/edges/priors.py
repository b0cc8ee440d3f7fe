"""Anchor: a prior on a pose, (x - x̂)' Omega_0 (x - x̂). Without an anchor the whole graph can move freely.

Priors on nodes: those of a map on its landmarks, or the marginal of edges whose poses were eliminated.

Absolute positions: a point of the robot measured in the world, by GPS, motion capture or a total station.

With the lever a, the point in the axes of the robot, and the measured place z = (x, y) or (x, y, theta),

    e = (p + R(theta) a - (x, y),  theta - theta_z),   the angle wrapped,   B = [I, R(theta) (-a_y, a_x); 0, 1],

the second part only with a heading. The information is constant in world axes. So the edge is a relative pose measured
from the origin of the world, which the certificate covers, and without a lever a prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, difference, perpendicular, transform, wrap
from .base import ConstantEdges, EdgeFamily, EngineEdges, Linearization
from .robust import SingleEdges, code_and_width

#: the lectures' Omega_0 = 1e6 I
ANCHOR_INFORMATION = 1e6 * np.eye(3)


@dataclass(frozen=True, eq=False)
class AnchorEdges(EngineEdges):
    """Anchors of nodes (E,) at values (E, 3) with information (E, 3, 3), e = x - x̂ with the heading wrapped."""

    nodes: np.ndarray
    values: Array
    information: Array

    def __post_init__(self) -> None:
        # J depends on the symmetric part only, and code that reads one triangle must find the same
        symmetric = (self.information + np.swapaxes(self.information, 1, 2)) / 2
        object.__setattr__(self, "information", symmetric)

    @property
    def count(self) -> int:
        return len(self.nodes)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.count + 1), self.nodes

    def linearize(self, state: Array, reference: Array) -> Linearization:
        residuals = difference(state[self.nodes], self.values)
        jacobians = np.broadcast_to(np.eye(3), (self.count, 3, 3))
        return Linearization(residuals, self.information, (self.nodes,), (jacobians,))

    def constant(self, state: Array) -> ConstantEdges:
        # a relative pose measured from the origin of the world
        ends = np.full(self.count, -1), self.nodes
        return ConstantEdges(*ends, self.values[:, :2], np.zeros((self.count, 2)), self.values[:, 2], self.information)

    def _to_engine(self) -> Any:
        no_lever = np.zeros((self.count, 2))
        return engine.PositionEdges(self.nodes, self.values, self.information, no_lever, *code_and_width(None))


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
        return difference(state[self.nodes], self.values).ravel()


@dataclass(frozen=True, eq=False)
class PositionEdges(SingleEdges, EngineEdges):
    """Places ``measured`` (E, 2 or 3) of points ``levers`` (E, 2) of pose nodes (E,), with information (E, d, d).

    ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """

    nodes: np.ndarray
    measured: Array
    information: Array
    levers: Array

    @property
    def count(self) -> int:
        return len(self.nodes)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.count + 1), self.nodes

    def points(self, state: Array) -> Array:
        """The points p + R(theta) a (E, 2) at a state (n, 3)."""
        return transform(state[self.nodes], self.levers)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        points, d = self.points(state), self.dimension
        residuals = np.zeros((self.count, 3))
        residuals[:, :2] = points - self.measured[:, :2]
        B = np.tile(np.eye(3), (self.count, 1, 1))
        B[:, :2, 2] = perpendicular(points - state[self.nodes, :2])
        if d == 3:
            residuals[:, 2] = wrap(state[self.nodes, 2] - self.measured[:, 2])
        return Linearization(residuals[:, :d], self.weighed, (self.nodes,), (B[:, :d],))

    def constant(self, state: Array) -> ConstantEdges:
        # a relative pose measured from the origin of the world
        information = self.weighed
        if self.kernel is not None:
            information = information * self.kernel_weights(state)[:, None, None]
        turn = self.measured[:, 2] if self.dimension == 3 else None
        origin = np.full(self.count, -1)
        return ConstantEdges(origin, self.nodes, self.measured[:, :2], self.levers, turn, information)

    def _to_engine(self) -> Any:
        kernel = code_and_width(self.kernel)
        return engine.PositionEdges(self.nodes, self.measured, self.weighed, self.levers, *kernel)
