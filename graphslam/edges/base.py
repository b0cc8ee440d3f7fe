"""The interface of an edge family, and the linearisation of its edges one by one.

A graph has n nodes; ``state`` (n, 3) holds their values, poses (x, y, theta) and landmarks alike. Some information
matrices depend on the state. They are evaluated at ``reference`` (n, 3): Gauss-Newton sets it to the current state at
every step, a damped search keeps it fixed during a step so that the function it minimises stays the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self, TypeGuard

import numpy as np

from ..engine import engine
from ..errors import GraphError, quoted
from ..errors.checks import array_or_none, check_choice, first, make_read_only
from ..linear.information import BlockSystem
from ..models import FRAMES
from ..se2 import Array, lever_matrix, turn_matrix

#: the blocks of pairs, for families that do not list their pairs
_NO_BLOCKS = np.zeros(0, dtype=np.int64)
#: which of the six numbers of a symmetric matrix stands where
SYMMETRIC = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])


@dataclass(frozen=True)
class Linearization:
    """The edges of a family at one state: e (E, d), Omega_e (E, d, d), and per end node its index and Jacobian.

    ``nodes[k]`` (E,) and ``jacobians[k]`` (E, d, 3) belong to the k-th end of each edge; an anchor has one end.
    """

    residuals: Array
    information: Array
    nodes: tuple[np.ndarray, ...]
    jacobians: tuple[Array, ...]

    def __post_init__(self) -> None:
        if self.residuals.ndim != 2:
            raise GraphError(f"residuals must have the shape (E, d), a row for each edge, not {self.residuals.shape}")
        E, d = self.residuals.shape
        shapes = [self.information.shape, *(B.shape for B in self.jacobians), *(np.shape(node) for node in self.nodes)]
        if shapes != [(E, d, d), *[(E, d, 3)] * len(self.jacobians), *[(E,)] * len(self.nodes)]:
            raise GraphError(
                f"the linearisation of {E} edges with residuals of {d} numbers needs information ({E}, {d}, {d}), and for "
                f"each end nodes ({E},) and a Jacobian ({E}, {d}, 3), not the shapes {', '.join(map(str, shapes))}"
            )

    @property
    def mahalanobis(self) -> Array:
        """The cost of each edge, e' Omega e; (E,)."""
        return np.einsum("ei,eij,ej->e", self.residuals, self.information, self.residuals)


def linearization(
    nodes: tuple[np.ndarray, ...],
    residuals: Array,
    information: Array,
    levers: tuple[Array, ...],
    angle: Array | None = None,
) -> Linearization:
    """Edges whose Jacobians in world axes are -[I, u; 0, 1] at the first end and [I, v; 0, 1] at the second.

    Args:
        nodes: the node (E,) of each end.
        residuals: e (E, 3) in world axes.
        information: (E, d, d), in the axes of the result; for d = 2 the heading row is left out.
        levers: u (E, 2) and v (E, 2), one for each end.
        angle: (E,) the direction of the axes in which the result is given; default: world axes.
    """
    jacobians = [sign * lever_matrix(lever) for sign, lever in zip((-1.0, 1.0), levers)]
    if angle is not None:
        turn = turn_matrix(-angle)
        residuals, jacobians = np.einsum("eij,ej->ei", turn, residuals), [turn @ B for B in jacobians]
    d = information.shape[1]
    return Linearization(residuals[:, :d], information, nodes, tuple(B[:, :d] for B in jacobians))


@dataclass(frozen=True)
class Relations:
    """Linear relations between two nodes each, u_second - u_first = value, from which an initial state is computed.

    Headings: ``value`` (E,) [rad] and ``information`` (E,). Positions: ``value`` (E, 2) [m] in world axes and
    ``information`` (E, 2, 2).
    """

    first: np.ndarray
    second: np.ndarray
    value: Array
    information: Array


@dataclass(frozen=True)
class ConstantEdges:
    """Edges whose information is constant in the axes of their first node a, as the certificate needs them.

        e_xy = R(theta_a)' (p_b + R(theta_b) d_b - p_a) - d_a,    e_theta = wrap(theta_b - theta_a - turn)

    Attributes:
        first, second: (E,) the nodes a and b; a is -1 for an edge from the origin of the world. Numbers beyond the nodes of
            the graph are those of ``landmarks``.
        start, end: (E, 2) d_a and d_b.
        turn: (E,), or None for edges without a heading row.
        information: (E, 3, 3), or (E, 2, 2) without a heading row.
        landmarks: (K, 3) values of further nodes, over which the cost of the family is the minimum.
    """

    first: np.ndarray
    second: np.ndarray
    start: Array
    end: Array
    turn: Array | None
    information: Array
    landmarks: Array = field(default_factory=lambda: np.zeros((0, 3)))


def check_nodes(owner: object, *names: str) -> None:
    """Make attributes of a frozen dataclass `node_numbers`."""
    for name in names:
        object.__setattr__(owner, name, node_numbers(owner, name, getattr(owner, name)))


def node_numbers(owner: object, name: str, nodes: Any) -> np.ndarray:
    """Nodes (E,) as whole numbers that the engine takes.

    Raises:
        GraphError: they are something else.
    """
    array = np.asarray(nodes)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise GraphError(
            f"{type(owner).__name__}: {name} must be the numbers of nodes, whole numbers in one row, not {quoted(nodes, 40)}"
        )
    return array.astype(np.int64, copy=False)


def check_rows(owner: object, **shapes: tuple[int, ...]) -> None:
    """Make attributes of a frozen dataclass arrays of floating-point numbers, one row for each edge.

    Raises:
        GraphError: one of them has another shape, or is not finite.
    """
    for name, shape in shapes.items():
        given = getattr(owner, name)
        if (array := array_or_none(given)) is None:
            raise GraphError(f"{type(owner).__name__}: {name} must be an array of numbers, not {quoted(given)}")
        if array.shape != shape:
            raise GraphError(
                f"{type(owner).__name__}: {name} must have the shape {shape}, one row for each of the {shape[0]} edges, not "
                f"{array.shape}"
            )
        if (k := first(~np.isfinite(array).all(axis=tuple(range(1, array.ndim))))) is not None:
            message = f"{type(owner).__name__}: {name} of edge {k} must be finite, not {quoted(array[k].tolist())}"
            raise GraphError(message)
        object.__setattr__(owner, name, array)


class EdgeFamily(ABC):
    """Edges of one kind. All of them write e' Omega e into the cost, B' Omega B into Omega and -B' Omega e into xi."""

    # a family may have two bases, each with its own checks
    def __post_init__(self) -> None:  # noqa: B027
        pass

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.count} {'edge' if self.count == 1 else 'edges'}>"

    @property
    @abstractmethod
    def count(self) -> int:
        """The number of edges."""

    @property
    def numbers(self) -> tuple[int, float]:
        """The number of independent numbers that the edges measure, and the mean of their cost at the true state.

        Here these are the residuals of `linearize`, as if all were independent and had no kernel; 0 where it fails for nodes
        in a row.
        """
        row = np.arange(3.0 * (self.node_range[1] + 1)).reshape(-1, 3) * [1.0, 0.0, 0.0]
        try:
            with np.errstate(all="ignore"):
                count = self.linearize(row, row).residuals.size
        except Exception:  # code of a user, which may refuse this state
            count = 0
        return count, float(count)

    @property
    def state_dependent_information(self) -> bool:
        """Whether Omega_e depends on the reference state."""
        return False

    @property
    def information_per_weight(self) -> float:
        """The information that an edge contributes to the estimate, over the information that it has in Omega.

        1 without a robust kernel; see `robust.Kernel.information_per_weight`.
        """
        return 1.0

    @abstractmethod
    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """The groups of nodes that the edges connect, as (starts, nodes): group g is ``nodes[starts[g]:starts[g+1]]``.

        Within a group the nodes do not decrease, and every pair of different nodes has an edge.
        """

    #: attributes that have no row for each edge, whatever their length is
    shared: ClassVar[tuple[str, ...]] = ()

    def among(self, chosen: np.ndarray) -> Self:
        """Some of the edges (E,) bool, or of the sightings that make them, of a family that is a dataclass."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in self.shared}  # type: ignore[arg-type]
        of_edges = {name: each for name, each in columns.items() if isinstance(each, np.ndarray)}
        return replace(self, **{name: each[chosen] for name, each in of_edges.items() if len(each) == len(chosen)})  # type: ignore[type-var]

    def renumbered(self, number: np.ndarray) -> Self | None:
        """The edges between nodes with a new number (n,), not -1, and these numbers; None where they cannot be divided."""
        return None

    @cached_property
    def node_range(self) -> tuple[int, int]:
        """The lowest and the highest node that the edges tie; (0, -1) without edges.

        Raises:
            GraphError: `cliques` does not return what it should; from nodes that decrease Omega would be wrong.
        """
        given = self.cliques()
        if not isinstance(given, tuple) or len(given) != 2:
            message = f"{type(self).__name__}: cliques() must return two arrays, starts and nodes, not {quoted(given)}"
            raise GraphError(message)
        starts, nodes = (node_numbers(self, "what cliques() returns", part) for part in given)
        if not len(starts) or starts[0] != 0 or starts[-1] != len(nodes) or (np.diff(starts) < 0).any():
            raise GraphError(
                f"{type(self).__name__}: the starts of cliques() must not decrease from 0 to the number of its nodes, "
                f"{len(nodes)}, but are {quoted(starts.tolist(), 40)}"
            )
        falls, ends = np.diff(nodes) < 0, starts[(starts > 0) & (starts < len(nodes))]
        falls[ends - 1] = False
        if (k := first(falls)) is not None:
            raise GraphError(
                f"{type(self).__name__}: the nodes of each group of cliques() must not decrease, but node {nodes[k + 1]} "
                f"follows node {nodes[k]}: sort them, such as the sightings of a landmark"
            )
        return (int(nodes.min()), int(nodes.max())) if len(nodes) else (0, -1)

    @abstractmethod
    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The edges one by one, for inspection and tests."""

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        """Add the edges to Omega and xi of ``system`` in place, where one is given, and return their cost.

        Computed from `linearize`, whose arrays of nodes must be the same at every call; with a robust kernel on each edge
        where the family has a ``kernel``.
        """
        edges, kernel = self.linearize(state, reference), getattr(self, "kernel", None)
        if not isinstance(edges, Linearization):
            raise GraphError(f"{type(self).__name__}: linearize() must return a Linearization, not {quoted(edges)}")
        squares = edges.mahalanobis
        if system is not None:
            W = edges.information if kernel is None else edges.information * kernel.weight(squares)[:, None, None]
            ends = list(zip(edges.nodes, edges.jacobians))
            for k, (node, B) in enumerate(ends):
                pull = np.swapaxes(B, 1, 2) @ W
                # several edges may belong to one node
                np.add.at(system.values, system.diagonal_slots[node], pull @ B)
                np.add.at(system.xi, node, -np.einsum("eij,ej->ei", pull, edges.residuals))
                for other, C in ends[k + 1 :]:
                    block = pull @ C
                    # the upper block of a pair has the rows of the lower node
                    block = np.where((node < other)[:, None, None], block, np.swapaxes(block, 1, 2))
                    np.add.at(system.values, system.slots_of(node, other), block)
        return float(np.sum(squares if kernel is None else kernel.loss(squares)))

    def cost(self, state: Array, reference: Array) -> float:
        """The sum of e' Omega e."""
        return self.accumulate(state, reference, None)

    def weighted_cost(self, state: Array) -> float:
        """The sum of w e' Omega e with the weights w that a robust kernel gives the edges; without one the cost."""
        if getattr(self, "kernel", None) is None:
            return self.cost(state, state)
        return float(self.linearize(state, state).mahalanobis @ self.kernel_weights(state))

    def kernel_weights(self, state: Array) -> Array:
        """The weight (E,) that the kernel gives each edge at a state, 1 without a kernel."""
        squares, kernel = self.linearize(state, state).mahalanobis, getattr(self, "kernel", None)
        return np.ones(len(squares)) if kernel is None else kernel.weight(squares)

    def constant(self, state: Array) -> ConstantEdges:
        """The edges in the form that `solvers.certificate` needs, at a state (n, 3); a kernel keeps its weights there.

        Raises:
            GraphError: their information depends on the state, or their residual has another form.
        """
        raise GraphError(f"{type(self).__name__} have no form with constant information")

    def headings(self) -> Relations | None:
        """The relative headings that the edges measure; None where they measure none."""
        return None

    def positions(self, state: Array) -> Relations | None:
        """The relative positions that the edges measure, with all headings taken from the state; None for none."""
        return None


class EngineEdges(EdgeFamily):
    """A family whose sums the engine computes (``engine/include/vmslam/edges``)."""

    @cached_property
    def in_engine(self) -> Any:
        """The same edges in the engine, made at the first use. From then on the arrays of the family cannot be written to."""
        # a copy, because other threads may add cached properties meanwhile
        own = vars(self).copy().items()
        make_read_only(self, *(name for name, value in own if isinstance(value, np.ndarray)))
        return self._to_engine()

    @abstractmethod
    def _to_engine(self) -> Any: ...

    def blocks(self, system: BlockSystem) -> np.ndarray:
        """The block between the ends of each edge, (E,), for families that list their edges."""
        return _NO_BLOCKS

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        if system is None:
            return self.in_engine.cost(state, reference)
        return self.in_engine.add(state, reference, *system.arrays, self.blocks(system))

    def check_constant(self) -> None:
        """Raise `GraphError` unless the edges have a form with constant information; its message says why not."""

    def constant(self, state: Array) -> ConstantEdges:
        self.check_constant()
        edges = engine.ConstantEdges()
        edges.take(self.in_engine, state)
        first, second, start, end, turn, upper, landmarks = edges.arrays
        d = 2 if turn is None else 3
        return ConstantEdges(first, second, start, end, turn, upper[:, SYMMETRIC][:, :d, :d], landmarks)

    def headings(self) -> Relations | None:
        return _relations(self.in_engine.headings())

    def positions(self, state: Array) -> Relations | None:
        return _relations(self.in_engine.positions(state))

    def __getstate__(self) -> dict[str, Any]:
        # another process makes its own
        return {name: value for name, value in vars(self).copy().items() if name != "in_engine"}


def is_of_engine(family: EdgeFamily) -> TypeGuard[EngineEdges]:
    """Whether a family is of the engine, and no derived class has sums, headings or positions of its own."""
    kind, own = type(family), EngineEdges
    return isinstance(family, own) and (kind.accumulate, kind.headings, kind.positions) == _OF_ENGINE


_OF_ENGINE = EngineEdges.accumulate, EngineEdges.headings, EngineEdges.positions


@dataclass(frozen=True, eq=False, repr=False)
class FramedEdges(EngineEdges):
    """Edges whose information is constant in the axes of a node, ``frame`` "body", or kept fixed in those of the "world"."""

    frame: str = field(default="body", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("frame", self.frame, FRAMES)

    @property
    def state_dependent_information(self) -> bool:
        return self.frame == "world"

    def check_constant(self) -> None:
        if self.frame == "world":
            raise GraphError("the information of edges in the world frame depends on the state; use frame='body'")


def _relations(arrays: tuple[np.ndarray, ...]) -> Relations | None:
    return Relations(*arrays) if len(arrays[0]) else None


@dataclass(frozen=True, eq=False, repr=False)
class NodeEdges(EdgeFamily):
    """Edges of single nodes ``nodes`` (E,)."""

    nodes: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        check_nodes(self, "nodes")

    @property
    def count(self) -> int:
        return len(self.nodes)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.count + 1), self.nodes

    def renumbered(self, number: np.ndarray) -> Self | None:
        here = number[self.nodes] >= 0
        return replace(self.among(here), nodes=number[self.nodes[here]])


@dataclass(frozen=True, eq=False, repr=False)
class PairEdges(EdgeFamily):
    """Edges that connect two nodes each, ``first`` (E,) and ``second`` (E,)."""

    first: np.ndarray
    second: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        check_nodes(self, "first", "second")
        if len(self.first) != len(self.second):
            sizes = f"{len(self.first)} and {len(self.second)}"
            raise GraphError(f"{type(self).__name__}: first and second must name as many nodes each, not {sizes}")
        if (k := first(self.first == self.second)) is not None:
            raise GraphError(f"edge {k} goes from node {self.second[k]} to itself; an edge ties two nodes")

    @property
    def count(self) -> int:
        return len(self.first)

    @cached_property
    def node_range(self) -> tuple[int, int]:
        """The lowest and the highest node that the edges tie; (0, -1) without edges."""
        if not self.count:
            return 0, -1
        ends = self.first, self.second
        return min(int(each.min()) for each in ends), max(int(each.max()) for each in ends)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        ends = np.empty((self.count, 2), dtype=np.int64)
        np.minimum(self.first, self.second, out=ends[:, 0])
        np.maximum(self.first, self.second, out=ends[:, 1])
        return np.arange(0, 2 * self.count + 1, 2), ends.ravel()

    def renumbered(self, number: np.ndarray) -> Self | None:
        here = (number[self.first] >= 0) & (number[self.second] >= 0)
        return replace(self.among(here), first=number[self.first[here]], second=number[self.second[here]])

    def blocks(self, system: BlockSystem) -> np.ndarray:
        """The block between the ends of each edge, (E,)."""
        return system.slots_of(self.first, self.second)
