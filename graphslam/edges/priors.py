"""Edges of single nodes: anchors, priors of a map or of eliminated poses, and absolute positions.

An anchor is a prior on a pose, (x - x̂)' Omega_0 (x - x̂). Without one the whole graph can move freely.

Other priors are those of a map on its landmarks, or the marginal of edges whose poses were eliminated.

An absolute position (`PositionEdges`) is a point of the robot measured in the world, by GPS, motion capture or a total
station. With the lever a, the point in the axes of the robot, and the measured place z = (x, y) or (x, y, theta),

    e = (p + R(theta) a - (x, y),  theta - theta_z),   the angle wrapped,   B = [I, R(theta) (-a_y, a_x); 0, 1],

the second part only with a heading. The information is constant in world axes. So the edge is a relative pose measured
from the origin of the world, which the certificate covers, and without a lever a prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import atan2
from typing import Any, NamedTuple

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, difference, lever_matrix, perpendicular, transform, turn_matrix, wrap
from .base import ConstantEdges, EdgeFamily, EngineEdges, Linearization, NodeEdges, check_rows
from .robust import SingleEdges, code_and_width

#: the lectures' Omega_0 = 1e6 I
ANCHOR_INFORMATION = 1e6 * np.eye(3)


@dataclass(frozen=True, eq=False, repr=False)
class AnchorEdges(NodeEdges, EngineEdges):
    """Anchors of nodes (E,) at values (E, 3) with information (E, 3, 3), e = x - x̂ with the heading wrapped."""

    values: Array
    information: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rows(self, values=(self.count, 3), information=(self.count, 3, 3))
        # J depends on the symmetric part only, and code that reads one triangle must find the same
        symmetric = (self.information + np.swapaxes(self.information, 1, 2)) / 2
        object.__setattr__(self, "information", symmetric)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        residuals = difference(state[self.nodes], self.values)
        jacobians = np.broadcast_to(np.eye(3), (self.count, 3, 3))
        return Linearization(residuals, self.information, (self.nodes,), (jacobians,))

    @property
    def numbers(self) -> tuple[int, float]:
        # they choose the frame of the world, and measure nothing
        return 0, 0.0

    def _to_engine(self) -> Any:
        no_lever = np.zeros((self.count, 2))
        return engine.PositionEdges(self.nodes, self.values, self.information, no_lever, *code_and_width(None))


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkPriors(AnchorEdges):
    """Independent priors of landmark nodes (E,): e = m - m̂ with the heading wrapped, information (E, 3, 3).

    Rows and columns of the heading are zero where the map does not give it.
    """

    @property
    def numbers(self) -> tuple[int, float]:
        rows = int(np.linalg.matrix_rank(self.information, hermitian=True).sum())
        return rows, rows


def freest_turn(values: Array, information: Array) -> Array | None:
    """The centre c (2,) about which nodes turn together at the least cost of a joint prior.

    Args:
        values: (K, 3) of the nodes.
        information: (3K, 3K), zero for coordinates about which the prior says nothing.

    Returns:
        The c that minimises d' Omega d with d_k = (perp(p_k - c), 1); None where all nodes are at one place.
    """
    places = values[:, :2]
    if not np.ptp(places, axis=0).any():
        return None
    shift = np.tile(np.eye(3)[:, :2], (len(values), 1))
    turn = np.column_stack([perpendicular(places), np.ones(len(values))]).ravel()
    x, y = np.linalg.lstsq(shift.T @ information @ shift, shift.T @ information @ turn, rcond=None)[0]
    return np.array([y, -x])


class Way(NamedTuple):
    """The residual v (3K,) of a prior of K nodes, and its Jacobian.

    The Jacobian turns the change of each node by ``turn`` (3, 3), and adds along gradient', with ``along`` =
    dv/dtheta and ``gradient`` = dtheta/dx (3K,).
    """

    v: Array
    turn: Array
    along: Array
    gradient: Array

    @classmethod
    def of(cls, nodes: Array, values: Array, pivot: Array | None) -> Way:
        """How far nodes (K, 3) are from their values (K, 3). With a ``pivot`` c, a turn of all counts as its angle:

            v_k = R(theta)' (p_k - c) - (p̂_k - c) + theta perp(p̂_k - c),   heading_k - its value,

        where theta turns the values about their centroid onto the places, as well as one angle can. To first order in theta
        this is the plain difference, which grows with theta^2, too, where the nodes turn and keep their shape.
        """
        v, n = difference(nodes, values), 3 * len(nodes)
        along, gradient = np.zeros((2, len(nodes), 3))
        if pivot is None:
            return cls(v.ravel(), np.eye(3), np.zeros(n), np.zeros(n))
        arms, spread = values[:, :2] - pivot, values[:, :2] - values[:, :2].mean(axis=0)
        across = perpendicular(spread)
        c, s = float(np.sum(spread * nodes[:, :2])), float(np.sum(across * nodes[:, :2]))
        theta = atan2(s, c)
        turn = turn_matrix(-theta)
        moved = (nodes[:, :2] - pivot) @ turn[:2, :2].T
        v[:, :2] = moved - arms + theta * perpendicular(arms)
        along[:, :2] = perpendicular(arms - moved)
        gradient[:, :2] = (c * across - s * spread) / (c * c + s * s)
        return cls(v.ravel(), turn, along.ravel(), gradient.ravel())

    def jacobian(self) -> Array:
        """dv/dx (3K, 3K)."""
        return np.kron(np.eye(len(self.v) // 3), self.turn) + np.outer(self.along, self.gradient)

    def pulled(self, force: Array) -> Array:
        """J' force (3K,)."""
        turned = force.reshape(-1, 3) @ self.turn
        return turned.ravel() + self.gradient * float(self.along @ force)

    def information(self, omega: Array) -> Array:
        """J' Omega J (3K, 3K), without products of large matrices."""
        k, turn = len(self.v) // 3, self.turn
        turned = np.einsum("ra,irjs,sb->iajb", turn, omega.reshape(k, 3, k, 3), turn, optimize=True)
        pull = omega @ self.along
        side = (pull.reshape(k, 3) @ turn).ravel() + 0.5 * float(self.along @ pull) * self.gradient
        half = np.outer(side, self.gradient)
        return turned.reshape(half.shape) + half + half.T


@dataclass(frozen=True, eq=False, repr=False)
class PriorEdges(EdgeFamily):
    """A joint prior of K nodes: v' Omega v - 2 b' v + b' Omega^+ b, with v (3K,) the way of the nodes from their values.

    Args:
        nodes: (K,) increasing.
        values: (K, 3), in world axes; headings of v are wrapped.
        information: Omega (3K, 3K); zero for coordinates about which it says nothing.
        rhs: b (3K,), or None for zero, where the values are the mean.
        pivot: the centre of `freest_turn`, for a prior that turns with its nodes (`Way.of`), such as that of a map, of whose
            landmarks the heading of the whole is known worst; None for one that is quadratic in the nodes.
    """

    nodes: np.ndarray
    values: Array
    information: Array
    rhs: Array | None = None
    pivot: Array | None = None

    @property
    def count(self) -> int:
        return 1

    @cached_property
    def numbers(self) -> tuple[int, float]:
        rows = int(np.linalg.matrix_rank(self.information, hermitian=True))
        return rows, rows

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0, len(self.nodes)]), self.nodes

    def renumbered(self, number: np.ndarray) -> PriorEdges | None:
        nodes = number[self.nodes]
        return None if (nodes < 0).any() else replace(self, nodes=nodes)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """One edge with one end for each node; of priors without ``rhs`` only."""
        if self.rhs is not None:
            raise GraphError("a prior that is not centred at its values has no residual")
        way = self._way(state)
        jacobians = way.jacobian().reshape(-1, len(self.nodes), 3).transpose(1, 0, 2)
        ends = tuple(self.nodes[:, None])
        return Linearization(way.v[None], self.information[None], ends, tuple(jacobians[:, None]))

    def constant(self, state: Array) -> ConstantEdges:
        raise GraphError(
            "the joint prior of a map ties all its landmarks to each other, which no edge between two nodes does; a map "
            "without correlations (LandmarkMap.used_as) can be certified"
        )

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        way, k = self._way(state), len(self.nodes)
        v = way.v
        pull = self.information @ v
        if system is not None:
            blocks = way.information(self.information).reshape(k, 3, k, 3).transpose(0, 2, 1, 3)
            system.values[system.diagonal_slots[self.nodes]] += blocks[np.arange(k), np.arange(k)]
            if k > 1:
                i, j, *ends = self._pairs
                system.values[system.slots_of(*ends)] += blocks[i, j]
            system.xi[self.nodes] += way.pulled((0.0 if self.rhs is None else self.rhs) - pull).reshape(k, 3)
        return float(v @ pull) if self.rhs is None else float(v @ pull - 2 * self.rhs @ v + self._least)

    @cached_property
    def _least(self) -> float:
        assert self.rhs is not None
        return float(np.linalg.lstsq(self.information, self.rhs, rcond=None)[0] @ self.rhs)

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, ...]:
        """The places of each pair among the nodes, and its nodes; kept, because the system finds its slots by the arrays."""
        i, j = np.triu_indices(len(self.nodes), 1)
        return i, j, self.nodes[i], self.nodes[j]

    def _way(self, state: Array) -> Way:
        return Way.of(state[self.nodes], self.values, self.pivot)


@dataclass(frozen=True, eq=False, repr=False)
class PositionEdges(SingleEdges, NodeEdges, EngineEdges):
    """Places ``measured`` (E, 2 or 3) of points ``levers`` (E, 2) of pose nodes (E,), with information (E, d, d).

    ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """

    measured: Array
    information: Array
    levers: Array

    def __post_init__(self) -> None:
        d = 3 if np.shape(self.measured)[1:] == (3,) else 2
        check_rows(self, measured=(self.count, d), information=(self.count, d, d), levers=(self.count, 2))
        super().__post_init__()

    def points(self, state: Array) -> Array:
        """The points p + R(theta) a (E, 2) at a state (n, 3)."""
        return transform(state[self.nodes], self.levers)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        points, d = self.points(state), self.dimension
        residuals = np.zeros((self.count, 3))
        residuals[:, :2] = points - self.measured[:, :2]
        B = lever_matrix(perpendicular(points - state[self.nodes, :2]))
        if d == 3:
            residuals[:, 2] = wrap(state[self.nodes, 2] - self.measured[:, 2])
        return Linearization(residuals[:, :d], self.weighed, (self.nodes,), (B[:, :d],))

    def _to_engine(self) -> Any:
        kernel = code_and_width(self.kernel)
        return engine.PositionEdges(self.nodes, self.measured, self.weighed, self.levers, *kernel)
