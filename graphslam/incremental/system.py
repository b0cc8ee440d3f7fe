"""A growing least-squares problem of poses and landmarks, solved after every step: arrays and calls of compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..edges.robust import Kernel, code_and_width
from ..errors import GraphError
from ..se2 import Array
from .advance import APART, DONE, INDEFINITE, ROBUST_APART, SHARE, advance
from .append import append, detach
from .arrays import (
    COST,
    CURVED_FROM,
    FLOATS,
    FREE,
    HOLD,
    INTS,
    doubled,
    new_edges,
    new_nodes,
    new_tree,
    sizes,
    with_room,
)
from .batch import batch_state
from .linearize import CHANGED, CURVED
from .passes import backward, marginals, total_cost
from .refactor import refactor
from .top import BUILT, GROW, rebuild

#: the most passes of one step, after which the batch solver takes over
PASSES = 15
#: everything is ordered again where there are so many times as many nodes as the last time
GROWTH = 1.3
#: for so many passes second derivatives stay out of Omega once they have made it indefinite
PLAIN = 4


class OnlineSystem:
    """Nodes and edges by number, and their solution.

    Args:
        tolerance: steps end where the next pass would lower the cost by less than this part of it.
    """

    def __init__(self, tolerance: float) -> None:
        self.nodes, self.edges, self.tree = new_nodes(64), new_edges(256), new_tree(64)
        self.num_nodes = self.num_edges = 0
        self.tolerance = tolerance
        self._robust = (*code_and_width(None), 1.0)
        self._buffers: tuple[np.ndarray, ...] = ()
        self._tallest = 64
        self._priors: list[tuple[list[int], Array, Array]] = []
        self._kernel: Kernel | None = None
        self._whole = 0
        self._memory = np.array([0.0, CHANGED, CURVED, 0.0])
        self.passes, self.converged = 0, True

    def use_kernel(self, kernel: Kernel | None, dimension: int) -> None:
        """The robust kernel of sightings, and the dimension of their residuals."""
        if kernel is not None:
            self._kernel = kernel = kernel.of_dimension(dimension)
            self._robust = (*code_and_width(kernel), kernel.information_per_weight(dimension))

    def add_node(self) -> int:
        """A new node, at the origin until an edge leads to it; returns its number."""
        if self.num_nodes == len(self.nodes):
            self.nodes = doubled(self.nodes, new_nodes(2 * self.num_nodes))
        self.num_nodes += 1
        return self.num_nodes - 1

    def add_prior(self, node: int, centre: Array, information: Array) -> None:
        """Put a node at a place (3,), with information (3, 3)."""
        for name in ("x", "passed", "evaluated"):
            self.nodes[name][node] = centre
        self.nodes["axes"][node] = np.cos(centre[2]), np.sin(centre[2])
        self._priors.append(([node], centre[None], information))
        self._hang([node], information)

    def _hang(self, members: list[int], information: Array) -> None:
        k = len(members)
        _, padded, count = sizes(0, k)
        self.tree = tree = with_room(self.tree, 1, count, k)
        counts, groups = tree.counts, tree.groups
        counts[FREE] -= 1
        s, at = int(groups["free"][counts[FREE]]), int(counts[FLOATS])
        groups["w"][s], groups["r"][s], groups["at"][s], groups["nodes_at"][s] = 0, k, at, counts[INTS]
        tree.ints[counts[INTS] : counts[INTS] + k] = members
        block = np.zeros((3 * k, padded))
        block[:, : 3 * k] = information
        tree.floats[at : at + 3 * k * padded] = block.ravel()
        tree.floats[at + 3 * k * padded : at + count] = 0.0
        groups["sibling"][s], groups["child"][0] = groups["child"][0], s
        counts[FLOATS] += count
        counts[INTS] += k

    def add(
        self, known: int, ends: np.ndarray, kinds: np.ndarray, measured: Array, information: Array, rows: np.ndarray,
        newest: list[int],
    ) -> None:  # fmt: skip
        """Add edges (see `append`) to new nodes, those from number ``known`` on, or between others, and solve.

        Raises:
            GraphError: a node is not determined. The system then is as before, without the new nodes.
        """
        count, before = len(rows), self.num_edges
        if count == 0:
            # a known pose from which nothing is seen
            self.passes = 0
            return
        while before + count > len(self.edges):
            self.edges = doubled(self.edges, new_edges(2 * len(self.edges)))
        self.num_edges += count
        fresh, whole, memory = np.arange(before, before + count, dtype=np.int32), self._whole, self._memory.copy()
        old = np.unique(ends[ends < known])
        scales = self.nodes["scale"][old]
        touched = append(
            self.nodes, self.edges, known, fresh, ends, kinds, measured, information, rows, self._kernel is not None
        )
        try:
            self.solve(touched, fresh, newest)
        except GraphError:
            detach(self.nodes, self.edges, before, self.num_edges)
            self.nodes["scale"][old] = scales
            self.nodes[known : self.num_nodes] = new_nodes(self.num_nodes - known)
            self.edges[before : self.num_edges] = new_edges(count)
            self.num_nodes, self.num_edges, self._whole, self._memory = known, before, whole, memory
            raise

    def _restart(self, x: Array) -> None:
        """An empty tree, and the nodes at x (n, 3)."""
        nodes, edges, n = self.nodes, self.edges, len(x)
        for name in ("rhs", "diagonal", "d", "home", "scratch", "mark"):
            nodes[name] = 0
        # the stamps of the new tree begin at zero
        for name in ("linear", "weight", "rhs", "cost", "mark"):
            edges[name] = 0
        nodes["owned"], nodes["local"] = -1, -1
        self._memory[[COST, CURVED_FROM, HOLD]] = 0.0, CURVED, 0.0
        for members, centre, _ in self._priors:
            # priors are around the present values, increments being zero
            x[members] = centre
        for name in ("x", "passed", "evaluated"):
            nodes[name][:n] = x
        nodes["axes"][:n, 0], nodes["axes"][:n, 1] = np.cos(x[:, 2]), np.sin(x[:, 2])
        self.tree = new_tree(64)
        for members, _, information in self._priors:
            self._hang(members, information)

    def solve(self, touched: Any, fresh: Any, newest: Any) -> None:
        """Bring the solution to the optimum after edges ``fresh`` were added at nodes ``touched``; ``newest`` go last.

        Raises:
            GraphError: a node is not determined. Nothing is changed then.
        """
        if self.num_nodes > GROWTH * self._whole + 50:
            self._whole, touched = self.num_nodes, np.arange(self.num_nodes)
        touched, fresh, newest = (np.asarray(part, dtype=np.int32) for part in (touched, fresh, newest))
        self.passes, before = 0, self.nodes["x"][: self.num_nodes].copy()
        if not self._eliminate(touched, fresh, newest):
            # second derivatives below the top may make it indefinite, so without them everywhere
            every = np.arange(self.num_nodes, dtype=np.int32)
            if len(touched) == len(every) or not self._eliminate(every, fresh, newest):
                raise GraphError("a node is not determined")
        self.converged = self._iterate(newest)
        if not self.converged:
            # the correction is too large for undamped passes
            counts = self.num_nodes, self.num_edges
            self.nodes["x"][: counts[0]] = before
            start = batch_state(self.nodes, self.edges, counts, self._priors, self._kernel)
            start = before if start is None else start
            self._begin_at(start, newest)
            self.converged = self._iterate(newest)
            if not self.converged:
                self._begin_at(start, newest)

    def relinearize(self, newest: Any) -> None:
        """Linearise all edges where they are now and factorise again, in the order of the tree, and solve."""
        self.complete()
        room, every = self._room(), np.arange(self.num_edges, dtype=np.int32)
        if not refactor(every, len(every), self.nodes, self.edges, self.tree, self._robust, self._memory, room[0]):
            nodes = np.arange(self.num_nodes, dtype=np.int32)
            self._memory[[CURVED_FROM, HOLD]] = np.inf, PLAIN
            self._eliminate(nodes, nodes[:0], np.asarray(newest, dtype=np.int32))
        self.converged = self._iterate(np.asarray(newest, dtype=np.int32))

    def _begin_at(self, x: Array, newest: np.ndarray) -> None:
        """Build the tree anew with all nodes at x (n, 3)."""
        self._restart(x)
        nodes, edges = (np.arange(count, dtype=np.int32) for count in (self.num_nodes, self.num_edges))
        self._eliminate(nodes, edges, newest)

    def _eliminate(self, touched: np.ndarray, fresh: np.ndarray, newest: np.ndarray) -> bool:
        """Eliminate the top of the tree again, with larger arrays where needed; returns whether all nodes are determined.

        Second derivatives are left out for some passes where Omega is not positive definite with them.
        """
        while True:
            result, count, floats, ints, tallest = rebuild(
                self.nodes, self.edges, self.tree, touched, fresh, newest, self._robust, self._memory, self._room()[0]
            )
            if result == GROW:
                self._tallest = max(self._tallest, tallest)
                self.tree = with_room(self.tree, count, floats, ints)
            elif result == BUILT or self._memory[CURVED_FROM] == np.inf:
                return bool(result == BUILT)
            else:
                self._memory[[CURVED_FROM, HOLD]] = np.inf, PLAIN

    def _iterate(self, newest: np.ndarray) -> bool:
        """Passes until the optimum is reached; returns whether it is."""
        done, apart = 0, APART if self._kernel is None else ROBUST_APART
        while True:
            result, passes = advance(
                self.nodes, self.edges, self.tree, self._robust, self._room(), self._memory, self.tolerance, apart,
                SHARE, done, PASSES,
            )  # fmt: skip
            self.passes, done = self.passes + passes - done, passes
            if result != INDEFINITE:
                return bool(result == DONE)
            self._memory[[CURVED_FROM, HOLD]] = np.inf, PLAIN
            nodes = np.arange(self.num_nodes, dtype=np.int32)
            if not self._eliminate(nodes, nodes[:0], newest):
                return False

    def _room(self) -> tuple[np.ndarray, ...]:
        needed = (self._tallest, 2 * len(self.nodes), len(self.tree.groups), len(self.edges))
        if tuple(map(len, self._buffers)) != needed:
            self._buffers = (np.zeros(needed[0]), *(np.zeros(n, np.int32) for n in needed[1:]))
        return self._buffers

    def complete(self) -> None:
        """Bring all nodes to the solution: steps leave out those that move by a small part of a standard deviation."""
        room = self._room()
        backward(self.nodes, self.tree, room[0], -1.0, np.inf, room[1], 0)

    def cost(self) -> float:
        """The cost at the estimate, without priors."""
        self.complete()
        return float(total_cost(self.nodes, self.edges, self.num_edges, *self._robust[:2]))

    def covariance(self, members: list[int]) -> Array:
        """The joint covariance (3k, 3k) of k nodes, in world axes."""
        room = self._room()[0]
        self.tree = with_room(self.tree, 0, len(room), 0)
        return np.asarray(marginals(np.array(members, dtype=np.int32), self.nodes, self.tree, room))
