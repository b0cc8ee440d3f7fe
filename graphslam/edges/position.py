"""Absolute positions: a point of the robot measured in the world, by GPS, motion capture or a total station.

With the lever a, the point in the axes of the robot, and the measured place z = (x, y) or (x, y, theta),

    e = (p + R(theta) a - (x, y),  theta - theta_z),   the angle wrapped,   B = [I, R(theta) (-a_y, a_x); 0, 1],

the second part only with a heading. The information is constant in world axes. So the edge is a relative pose measured
from the origin of the world, which the certificate covers, and without a lever a prior.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from ..linear.information import BlockSystem
from ..se2 import Array, perpendicular, transform, wrap
from .base import ConstantEdges, Linearization
from .doubted import SingleEdges
from .robust import Kernel


@dataclass(frozen=True, eq=False)
class PositionEdges(SingleEdges):
    """Places ``measured`` (E, 2 or 3) of points ``levers`` (E, 2) of pose nodes (E,), with information (E, d, d).

    ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """

    nodes: np.ndarray
    measured: Array
    information: Array
    levers: Array
    _: KW_ONLY
    kernel: Kernel | None = None
    trust: Array | None = None

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

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        edges = self.linearize(state, reference)
        squares = edges.mahalanobis
        if system is not None:
            B, W = edges.jacobians[0], edges.information
            if self.kernel is not None:
                W = W * self.kernel.weight(squares)[:, None, None]
            pull = np.swapaxes(B, 1, 2) @ W
            # several positions may belong to one pose
            np.add.at(system.values, system.diagonal_slots[self.nodes], pull @ B)
            np.add.at(system.xi, self.nodes, -np.einsum("eij,ej->ei", pull, edges.residuals))
        return float(np.sum(squares if self.kernel is None else self.kernel.loss(squares)))

    def constant(self, state: Array) -> ConstantEdges:
        # a relative pose measured from the origin of the world
        information = self.weighed
        if self.kernel is not None:
            information = information * self.kernel_weights(state)[:, None, None]
        turn = self.measured[:, 2] if self.dimension == 3 else None
        origin = np.full(self.count, -1)
        return ConstantEdges(origin, self.nodes, self.measured[:, :2], self.levers, turn, information)
