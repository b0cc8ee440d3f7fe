"""A growing least-squares problem of poses and landmarks, solved after every step: arrays and calls of compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ..edges.robust import Kernel, code_and_width
from ..errors import GraphError
from ..se2 import Array, turn_matrix
from .advance import APART, DONE, HELD, INDEFINITE, ROBUST_APART, advance
from .append import append, detach
from .arrays import (
    COST,
    CURVED_FROM,
    EXACT_FROM,
    FLOATS,
    FREE,
    HOLD,
    INTS,
    STEP,
    WORK,
    doubled,
    new_edges,
    new_nodes,
    new_tree,
    sizes,
    with_room,
)
from .batch import batch_state
from .lag import Prior, edges_of, take_out, without_first
from .linearize import CHANGED, CURVED, EXACT, not_gauss_newton
from .passes import backward, marginals, solve_paths, total_cost
from .refactor import refactor
from .top import BUILT, GROW, rebuild

#: the most passes of one step, after which the batch solver takes over
PASSES = 15
#: everything is ordered again where there are so many times as many nodes as the last time
GROWTH = 1.3
#: how far the edges of a factor may be from the present ones where a covariance is asked for; see `linearize.CHANGED`
KNOWN = 1e-5
#: no edges or nodes, and no increments
NONE, NOWHERE = np.zeros(0, np.int32), np.zeros((0, 3))


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
        self._priors: list[Prior] = []
        self._kernel: Kernel | None = None
        self._whole = 0
        self._memory = np.array([0.0, CHANGED, CURVED, EXACT, 0.0, 0.0, 0.0, 0.0, 0.0])
        self.passes, self.converged = 0, True
        #: whether nothing has changed since a covariance was asked for
        self._known = False
        #: whether the tree is empty, because not all nodes could be eliminated where they are
        self._lost = False

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

    def add_prior(self, nodes: Sequence[int], centres: Array, information: Array, *, points: bool = False) -> None:
        """Put nodes (k,) at places (k, 3), with information (3k, 3k) in world axes; ``points`` have no heading."""
        for node, centre in zip(nodes, centres):
            for name in ("x", "passed", "evaluated"):
                self.nodes[name][node] = centre
            self.nodes["axes"][node] = np.cos(centre[2]), np.sin(centre[2])
            self.nodes["point"][node] = points
        if not points:
            # increments of poses are in their own axes
            turn = block_diag(*turn_matrix(centres[:, 2]))
            information = turn.T @ information @ turn
        self._add_prior(np.array(nodes, np.int32), information, np.zeros(3 * len(nodes)))

    def _add_prior(self, members: np.ndarray, information: Array, carry: Array) -> None:
        rhs = carry - information @ self.nodes["d"][members].ravel()
        group = self._hang(members, information, carry)
        self._priors.append(Prior(members, information, rhs, self.nodes["x"][members], carry, group))

    def _hang(self, members: np.ndarray, information: Array, carry: Array) -> int:
        """Put a prior into the tree, where the next elimination of its nodes finds it; returns its supernode."""
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
        tree.floats[at + 3 * k * padded : at + count] = carry
        groups["sibling"][s], groups["child"][0] = groups["child"][0], s
        counts[FLOATS] += count
        counts[INTS] += k
        return s

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
        old, last = np.unique(ends[ends < known]), (self.passes, self.converged)
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
            self.passes, self.converged = last
            raise

    def _restart(self, x: Array) -> None:
        """An empty tree, and the nodes at x (n, 3)."""
        nodes, edges, n = self.nodes, self.edges, len(x)
        for name in ("rhs", "diagonal", "d", "scratch", "mark", "changed"):
            nodes[name] = 0
        nodes["home"] = np.minimum(nodes["home"], 0)
        # the stamps of the new tree begin at zero
        for name in ("linear", "weight", "rhs", "cost", "mark"):
            edges[name] = 0
        nodes["owned"], nodes["local"] = -1, -1
        self._memory[[COST, WORK]] = 0.0, np.inf
        for name in ("x", "passed", "evaluated"):
            nodes[name][:n] = x
        nodes["axes"][:n, 0], nodes["axes"][:n, 1] = np.cos(x[:, 2]), np.sin(x[:, 2])
        self.tree = new_tree(64)
        for k, prior in enumerate(self._priors):
            at = prior.members
            carry = prior.carry_at(x[at], nodes["point"][at])
            self._priors[k] = replace(prior, carry=carry, group=self._hang(at, prior.information, carry))

    def solve(self, touched: Any, fresh: Any, newest: Any) -> None:
        """Bring the solution to the optimum after edges ``fresh`` were added at nodes ``touched``; ``newest`` go last.

        Raises:
            GraphError: a node is not determined. Nothing is changed then.
        """
        if self.num_nodes > GROWTH * self._whole + 50:
            self._whole, touched = self.num_nodes, self._all_nodes()
        if self._lost:
            touched, fresh = self._all_nodes(), self._all_edges()
        touched, fresh, newest = (np.asarray(part, dtype=np.int32) for part in (touched, fresh, newest))
        self.passes, before = 0, self.nodes["d"][touched]
        if not self._eliminate(touched, fresh, newest):
            # exact second derivatives below the top may make it indefinite
            every = self._all_nodes()
            if len(touched) == len(every) or not self._eliminate(every, fresh, newest):
                raise GraphError("a node is not determined")
        self._lost = False
        self.tree.counts[STEP] += 1
        self.converged = self._iterate(newest, fresh, touched, before)
        if not self.converged:
            # the correction is too large for undamped passes
            nodes = self.nodes[: self.num_nodes]
            changed = nodes["changed"] == self.tree.counts[STEP]
            nodes["x"][changed] = nodes["kept"][changed]
            before = nodes["x"].copy()
            # states beyond floating point are no better, and are not taken
            with np.errstate(over="ignore", invalid="ignore"):
                start = batch_state(
                    self.nodes, self.edges, self._all_nodes(), self._all_edges(), self._priors, self._kernel
                )
            start = before if start is None else start
            self.converged = self._begin_at(start, newest) and self._iterate(newest)
            if not self.converged:
                self._begin_at(start, newest)

    def relinearize(self, newest: Any) -> None:
        """Linearise all edges where they are now and factorise again, in the order of the tree, and solve."""
        newest = np.asarray(newest, dtype=np.int32)
        self._factorize_again(newest)
        self.converged = not self._lost and self._iterate(newest)
        if not self.converged:
            self._begin_at(self.nodes["x"][: self.num_nodes].copy(), newest)

    def _factorize_again(self, newest: Any) -> bool:
        """The factor of Gauss-Newton at the estimate, without second derivatives; returns whether there is one."""
        self.complete()
        x, newest = self.nodes["x"][: self.num_nodes].copy(), np.asarray(newest, dtype=np.int32)
        self._memory[[CURVED_FROM, WORK]] = np.inf
        room, every = self._room(), self._all_edges()
        good = not self._lost and (
            refactor(every, len(every), self.nodes, self.edges, self.tree, self._robust, self._memory, room[0])
            or self._eliminate(self._all_nodes(), NONE, newest)
        )
        good = good or self._begin_at(x, newest)
        self._memory[CURVED_FROM] = CURVED
        if not good:
            # second derivatives may make it definite, so that steps can go on
            self._begin_at(x, newest)
        return bool(good)

    def _linearize_late(self, newest: Any) -> bool:
        """Put edges into the factor as Gauss-Newton has them, where covariances would be wrong otherwise.

        Second derivatives only help passes to converge: they are no information that the graph has, or take some away.
        Returns whether the factor exists.
        """
        if (self._lost or self._memory[CURVED_FROM] == 0.0) and not self._factorize_again(newest):
            return False
        if self._known:
            return True
        self._known = True
        late = not_gauss_newton(self.nodes, self.edges, self.num_edges, *self._robust[:2], KNOWN)
        if len(late) == 0:
            return True
        curved = self._memory[CURVED_FROM]
        self._memory[CURVED_FROM] = np.inf
        good = refactor(late, len(late), self.nodes, self.edges, self.tree, self._robust, self._memory, self._room()[0])
        self._memory[CURVED_FROM] = curved
        self._known = bool(good) or self._factorize_again(newest)
        return self._known

    def _begin_at(self, x: Array, newest: np.ndarray) -> bool:
        """Build the tree anew with all nodes at x (n, 3); returns whether they are determined. It is empty otherwise."""
        self._restart(x)
        self._lost = not self._eliminate(self._all_nodes(), self._all_edges(), newest)
        return not self._lost

    def _all_nodes(self) -> np.ndarray:
        """The nodes that are not marginalised."""
        return np.flatnonzero(self.nodes["home"][: self.num_nodes] >= 0).astype(np.int32)

    def _all_edges(self) -> np.ndarray:
        return np.flatnonzero(self.edges["ends"][: self.num_edges, 0] >= 0).astype(np.int32)

    def marginalize(self, node: int, newest: Any) -> Array:
        """Take a node out of the graph, and put a prior on its neighbours in its place; returns its last value (3,)."""
        nodes, edges = self.nodes, self.edges
        mine = [prior for prior in self._priors if node in prior.members]
        gone = edges_of(node, nodes, edges)
        around = np.unique(np.concatenate([edges["ends"][gone].ravel(), *(prior.members for prior in mine)]))
        members = np.concatenate([[node], around[around != node]]).astype(np.int32)
        value = self.values(members)[0]
        information, rhs = take_out(gone, members, nodes, edges, self._robust, self._memory)
        order = np.argsort(members)
        for prior in mine:
            at = order[np.searchsorted(members, prior.members, sorter=order)]
            at = (3 * at[:, None] + np.arange(3)).ravel()
            information[np.ix_(at, at)] += prior.information
            rhs[at] += prior.carry
        removed = np.array([nodes["home"][node], *(prior.group for prior in mine)], dtype=np.int32)
        nodes["home"][node] = -1
        self._priors = [prior for prior in self._priors if prior not in mine]
        self._add_prior(members[1:], *without_first(information, rhs))
        newest = np.asarray(newest, dtype=np.int32)
        if self._lost or not self._eliminate(members[1:], NONE, newest, removed):
            self.complete()
            self._begin_at(nodes["x"][: self.num_nodes].copy(), newest)
        return np.asarray(value)

    def crowded(self) -> bool:
        """Whether more than half of the numbers of nodes belong to nodes that were marginalised."""
        return self.num_nodes > 64 and bool(
            np.count_nonzero(self.nodes["home"][: self.num_nodes] < 0) > self.num_nodes / 2
        )

    def renumber(self) -> np.ndarray:
        """Free what belonged to marginalised nodes; returns the new number of each node."""
        old_nodes, old_edges, counts = self._all_nodes(), self._all_edges(), self.tree.counts
        # the last entry is that of number -1
        node, edge = np.full(self.num_nodes + 1, -1, np.int32), np.full(self.num_edges + 1, -1, np.int32)
        node[old_nodes], edge[old_edges] = np.arange(len(old_nodes)), np.arange(len(old_edges))
        self.nodes = doubled(self.nodes[old_nodes], new_nodes(2 * len(old_nodes) + 64))
        self.edges = doubled(self.edges[old_edges], new_edges(2 * len(old_edges) + 64))
        for name in ("edges", "owned"):
            self.nodes[name] = edge[self.nodes[name]]
        for name in ("next", "next_owned"):
            self.edges[name] = edge[self.edges[name]]
        for name in ("ends", "owner"):
            self.edges[name] = node[self.edges[name]]
        ints = self.tree.ints[: counts[INTS]]
        ints[:] = node[np.minimum(ints, self.num_nodes)]
        self._priors = [replace(prior, members=node[prior.members]) for prior in self._priors]
        self.num_nodes, self.num_edges = len(old_nodes), len(old_edges)
        self._whole = min(self._whole, self.num_nodes)
        return node

    def _eliminate(self, touched: np.ndarray, fresh: np.ndarray, newest: np.ndarray, gone: np.ndarray = NONE) -> bool:
        """Eliminate the top of the tree again, with larger arrays where needed; returns whether all nodes are determined."""
        self._known = False
        while True:
            result, count, floats, ints, tallest = rebuild(
                self.nodes,
                self.edges,
                self.tree,
                touched,
                fresh,
                gone,
                newest,
                self._robust,
                self._memory,
                self._room()[0],
            )
            if result == GROW:
                self._tallest = max(self._tallest, tallest)
                self.tree = with_room(self.tree, count, floats, ints)
            elif result == BUILT or self._memory[HOLD] > 0:
                return bool(result == BUILT)
            else:
                self._memory[[EXACT_FROM, HOLD]] = np.inf, HELD

    def _iterate(
        self, newest: np.ndarray, fresh: np.ndarray = NONE, touched: np.ndarray = NONE, before: Array = NOWHERE
    ) -> bool:
        """Passes until the optimum is reached, after new edges; see `advance`. Returns whether it is."""
        self._known = False
        done, apart = 0, APART if self._kernel is None else ROBUST_APART
        while True:
            result, passes = advance(
                self.nodes, self.edges, self.tree, self._robust, self._room(), self._memory, self.tolerance, apart, done,
                PASSES, fresh, touched, before,
            )  # fmt: skip
            self.passes, done = self.passes + passes - done, passes
            if result != INDEFINITE:
                return bool(result == DONE)
            self._memory[[EXACT_FROM, HOLD, WORK]] = np.inf, HELD, np.inf
            if not self._eliminate(self._all_nodes(), NONE, newest):
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

    def values(self, members: Any) -> Array:
        """The solution (k, 3) at some nodes."""
        room, members = self._room(), np.asarray(members, dtype=np.int64)
        homes = np.unique(self.nodes["home"][members])
        solve_paths(homes, len(homes), self.nodes, self.tree, room[0], 0.0)
        return np.asarray(self.nodes["x"][members])

    def cost(self) -> float:
        """The cost at the estimate, without priors."""
        self.complete()
        return float(total_cost(self.nodes, self.edges, self.num_edges, *self._robust[:2]))

    def covariance(self, members: list[int], newest: Any) -> Array:
        """The joint covariance (3k, 3k) of k nodes, in world axes.

        Raises:
            GraphError: the information is singular to double precision.
        """
        # making the factor of Gauss-Newton may fail where steps have not converged, and would cost the one that there is
        system = self if self.converged else deepcopy(self)
        if not system._linearize_late(newest):
            raise GraphError("there is no covariance: the edges do not determine all nodes to double precision")
        # the axes of the members are those of the solution
        system.values(members)
        room = system._room()[0]
        system.tree = with_room(system.tree, 0, len(room), 0)
        return np.asarray(marginals(np.array(members, dtype=np.int32), system.nodes, system.tree, room))
