"""A growing least-squares problem of poses and landmarks, solved after every step: arrays and calls of compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..edges.robust import Kernel, code_and_width
from ..errors import GraphError
from ..se2 import Array, turn_matrix
from .advance import APART, DONE, GROW, SHARE, UNDETERMINED, UNFINISHED, advance, complete
from .arrays import FLOATS, FREE, INTS, Edges, Nodes, Tree, doubled, new_arrays, sizes, with_room
from .batch import batch_state
from .linearize import CHANGED, CURVED
from .passes import marginals, total_cost

#: the most passes of one step, after which the batch solver takes over
PASSES = 15


#: everything is ordered again where there are so many times as many nodes as the last time
GROWTH = 1.3


class OnlineSystem:
    """Nodes and edges by number, and their solution.

    Args:
        tolerance: steps end where the next pass would lower the cost by less than this part of it.
    """

    def __init__(self, tolerance: float) -> None:
        self.nodes: Nodes = new_arrays(Nodes, 64)
        self.edges: Edges = new_arrays(Edges, 256)
        self.tree: Tree = new_arrays(Tree, 64)
        self.num_nodes = self.num_edges = 0
        self.tolerance, self.apart, self.share = tolerance, APART, SHARE
        self._robust = (*code_and_width(None), 1.0)
        self._buffers: tuple[np.ndarray, ...] = ()
        self._tallest = 64
        self._priors: list[tuple[list[int], Array, Array]] = []
        self._kernel: Kernel | None = None
        self._whole = 0
        self._limits = np.array([CHANGED, CURVED, 0.0])
        self.passes = 0

    def use_kernel(self, kernel: Kernel | None, dimension: int) -> None:
        """The robust kernel of edges with ``robust``, and the dimension of their residuals."""
        if kernel is not None:
            self._kernel = kernel = kernel.of_dimension(dimension)
            self._robust = (*code_and_width(kernel), kernel.information_per_weight(dimension))

    def add_node(self, x: Array, *, point: bool = False) -> int:
        """A new node at x (3,); returns its number."""
        if self.num_nodes == len(self.nodes.x):
            self.nodes = doubled(self.nodes)
        node, self.num_nodes = self.num_nodes, self.num_nodes + 1
        nodes = self.nodes
        nodes.x[node] = nodes.passed[node] = nodes.evaluated[node] = x
        nodes.point[node] = point
        return node

    def add_prior(self, members: list[int], information: Array) -> None:
        """A quadratic around the present values of some nodes, information (3k, 3k)."""
        centre = self.nodes.x[members].copy()
        self._priors.append((members, centre, information))
        self._hang(members, information)

    def _hang(self, members: list[int], information: Array) -> None:
        k = len(members)
        _, padded, count = sizes(0, k)
        self.tree = tree = with_room(self.tree, 1, count, k)
        counts = tree.counts
        counts[FREE] -= 1
        s = int(tree.free[counts[FREE]])
        tree.w[s], tree.r[s], tree.at[s], tree.nodes_at[s] = 0, k, counts[FLOATS], counts[INTS]
        tree.ints[counts[INTS] : counts[INTS] + k] = members
        block = np.zeros((3 * k, padded))
        block[:, : 3 * k] = information
        at = int(counts[FLOATS])
        tree.floats[at : at + 3 * k * padded] = block.ravel()
        tree.floats[at + 3 * k * padded : at + count] = 0.0
        tree.sibling[s], tree.child[0] = tree.child[0], s
        counts[FLOATS] += count
        counts[INTS] += k

    def add_edges(self, ends: np.ndarray, measured: Array, information: Array, *, robust: bool = False) -> np.ndarray:
        """Edges between nodes (E, 2): measured (E, 2 or 3), information (E, d, d); returns their numbers."""
        count, d = measured.shape
        while self.num_edges + count > len(self.edges.rows):
            self.edges = doubled(self.edges)
        new = np.arange(self.num_edges, self.num_edges + count)
        self.num_edges += count
        edges, nodes = self.edges, self.nodes
        edges.ends[new], edges.rows[new], edges.robust[new] = ends, d, robust
        edges.measured[new, :d] = measured
        edges.information[new[:, None], [0, 1, 2] if d == 2 else [0, 1, 2, 3, 4, 5]] = (
            information[:, [0, 0, 1], [0, 1, 1]] if d == 2 else information[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        )
        for e, pair in zip(new.tolist(), ends.tolist()):
            for side, node in enumerate(pair):
                edges.next[e, side] = nodes.edges[node]
                nodes.edges[node] = e
        return new

    def retract(self, num_nodes: int, num_edges: int) -> None:
        """Take out the nodes and edges from these numbers on, and eliminate all others again."""
        nodes, edges = self.nodes, self.edges
        for e in range(self.num_edges - 1, num_edges - 1, -1):
            for side in (0, 1):
                nodes.edges[edges.ends[e, side]] = edges.next[e, side]
        nodes.scale[num_nodes : self.num_nodes] = np.inf
        self.num_nodes, self.num_edges = num_nodes, num_edges
        self._restart(nodes.x[:num_nodes])
        self.solve(np.arange(num_nodes), np.arange(num_edges), [])

    def _restart(self, x: Array) -> None:
        """An empty tree, and the nodes at x (n, 3)."""
        nodes, edges = self.nodes, self.edges
        for array in (nodes.rhs, nodes.diagonal, nodes.d, edges.weight, edges.rhs, edges.cost, edges.total, nodes.home):
            array[:] = 0
        for array in (nodes.owned, nodes.local):
            array[:] = -1
        # the stamps of the new tree begin at zero
        for array in (nodes.scratch, nodes.mark, edges.mark):
            array[:] = 0
        for array in (nodes.x, nodes.passed, nodes.evaluated):
            array[: len(x)] = x
        self.tree = new_arrays(Tree, 64)
        for members, centre, information in self._priors:
            # priors are around the present values, increments being zero
            nodes.x[members] = centre
            self._hang(members, information)

    def solve(self, touched: Any, fresh: Any, newest: Any) -> None:
        """Bring the solution to the optimum after edges ``fresh`` were added at nodes ``touched``; ``newest`` go last.

        Raises:
            GraphError: a node is not determined.
        """
        if self.num_nodes > GROWTH * self._whole + 50:
            self._whole, touched = self.num_nodes, np.arange(self.num_nodes)
        touched, fresh, newest = (np.asarray(part, dtype=np.int32) for part in (touched, fresh, newest))
        self.passes, self.converged, before = 0, True, self.nodes.x[: self.num_nodes].copy()
        for batch in (False, True):
            result, node = self._advance(touched, fresh, newest)
            if result == DONE or (batch and result == UNFINISHED):
                self.converged = result == DONE
                return
            if batch:
                raise GraphError(f"node {node} is not determined")
            # the correction is too large for undamped steps, or the batch solver finds a node undetermined, too
            self.nodes.x[: self.num_nodes] = before
            counts = self.num_nodes, self.num_edges
            self._restart(batch_state(self.nodes, self.edges, counts, self._priors, self._kernel))
            touched, fresh = (np.arange(count, dtype=np.int32) for count in counts)

    def _advance(self, touched: np.ndarray, fresh: np.ndarray, newest: np.ndarray) -> tuple[int, int]:
        """Call `advance`, with larger arrays as often as it asks for them: its result, and the undetermined node."""
        late_rounds = 0
        while late_rounds < PASSES:
            result, *rest = advance(
                self.nodes, self.edges, self.tree, touched, fresh, newest, self._robust, self._room(),
                self._limits, self.tolerance, self.apart, self.share, PASSES,
            )  # fmt: skip
            if result != GROW:
                self.passes += rest[0] if result != UNDETERMINED else 0
                return result, rest[0]
            supernodes, floats, ints, tallest, late = rest
            self._tallest = max(self._tallest, tallest)
            self.tree = with_room(self.tree, supernodes, floats, ints)
            if late >= 0:
                late_rounds += 1
                touched, fresh = self.edges.owner[self._buffers[3][:late]], fresh[:0]
        return UNFINISHED, 0

    def _room(self) -> tuple[np.ndarray, ...]:
        needed = (self._tallest, 2 * len(self.nodes.x), len(self.tree.w), len(self.edges.rows))
        if tuple(map(len, self._buffers)) != needed:
            self._buffers = (np.zeros(needed[0]), *(np.zeros(n, np.int32) for n in needed[1:]))
        return self._buffers

    def complete(self) -> None:
        """Bring all nodes to the solution: steps leave out those that move by a small part of a standard deviation."""
        complete(self.nodes, self.tree, self._room())

    def cost(self) -> float:
        """The cost at the estimate, without priors."""
        self.complete()
        return float(total_cost(self.nodes, self.edges, self.num_edges, *self._robust[:2]))

    def covariance(self, members: list[int]) -> Array:
        """The joint covariance (3k, 3k) of k nodes, in world axes."""
        wanted = np.array(members, dtype=np.int32)
        # room for one number per coordinate eliminated on the way to the roots
        self.tree = with_room(self.tree, 0, 3 * self.num_nodes, 0)
        block = marginals(wanted, self.nodes, self.tree, self._room()[0])
        turn = np.zeros_like(block)
        for k, node in enumerate(members):
            angle = 0.0 if self.nodes.point[node] else self.nodes.x[node, 2]
            turn[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = turn_matrix(np.array([angle]))[0]
        return np.asarray(turn @ block @ turn.T)
