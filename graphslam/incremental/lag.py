# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Priors, and taking the edges of an old pose out of an online solution.

Eliminating the increments d_0 of a node from Omega d = rhs of its edges and priors leaves on its neighbours

    Omega_rr - Omega_r0 Omega_00^-1 Omega_0r,    rhs_r - Omega_r0 Omega_00^-1 rhs_0,

which is a prior on them: dense, and exact for the linearisation that the edges had last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..se2 import Array, wrap
from .arrays import COST
from .linearize import between, diagonals, relinearize


@dataclass(frozen=True, eq=False)
class Prior:
    """d' information d - 2 rhs' d in J, with the increments d (3k,) of k nodes from ``centre`` (k, 3).

    Attributes:
        carry: ``rhs`` for the increments of the tree.
        group: the supernode of the prior in the tree.
    """

    members: np.ndarray
    information: Array
    rhs: Array
    centre: Array
    carry: Array
    group: int

    def carry_at(self, x: Array, point: np.ndarray) -> Array:
        """``rhs`` for increments from values x (k, 3) of the nodes, of which some are points."""
        move, pose = x - self.centre, point == 0
        c, s = np.cos(self.centre[:, 2]), np.sin(self.centre[:, 2])
        ahead, left = c * move[:, 0] + s * move[:, 1], c * move[:, 1] - s * move[:, 0]
        move[pose] = np.column_stack([ahead, left, wrap(move[:, 2])])[pose]
        return np.asarray(self.rhs - self.information @ move.ravel())


def without_first(information: Array, rhs: Array) -> tuple[Array, Array]:
    """The system of all nodes but the first, which is eliminated."""
    share = np.linalg.solve(information[:3, :3], np.column_stack([information[:3, 3:], rhs[:3]]))
    left = information[3:, 3:] - information[3:, :3] @ share[:, :-1]
    return (left + left.T) / 2, rhs[3:] - information[3:, :3] @ share[:, -1]


@njit(cache=True, error_model="numpy")
def edges_of(node, nodes, edges):
    """The edges of a node."""
    found = np.empty(len(edges), np.int32)
    count, e = 0, nodes.edges[node]
    while e >= 0:
        found[count] = e
        count += 1
        e = edges.next[e, 0 if edges.ends[e, 0] == node else 1]
    return found[:count].copy()


@njit(cache=True, error_model="numpy")
def take_out(gone, members, nodes, edges, robust, memory):
    """Take edges out; returns what they add to Omega (3k, 3k) and to the right-hand side (3k,) of k nodes."""
    kernel, width, gain = robust
    k = len(members)
    Omega, rhs = np.zeros((3 * k, 3 * k)), np.zeros(3 * k)
    for q in range(k):
        nodes.local[members[q]] = q
    for e in gone:
        memory[COST] += relinearize(e, nodes, edges, kernel, width, gain, (np.inf, np.inf))
        parts, cross = diagonals(e, edges, gain), between(e, edges, gain)
        a, b = 3 * nodes.local[edges.ends[e, 0]], 3 * nodes.local[edges.ends[e, 1]]
        for p in range(3):
            for q in range(3):
                Omega[a + p, b + q] += cross[p][q]
                Omega[b + q, a + p] += cross[p][q]
        for end in range(2):
            node, at, D = edges.ends[e, end], (a, b)[end], parts[end]
            block = ((D[0], D[1], D[3]), (D[1], D[2], D[4]), (D[3], D[4], D[5]))
            for p in range(3):
                for q in range(3):
                    Omega[at + p, at + q] += block[p][q]
                rhs[at + p] += edges.rhs[e, 3 * end + p]
                nodes.rhs[node, p] -= edges.rhs[e, 3 * end + p]
            for c in range(6):
                nodes.diagonal[node, c] -= D[c]
            _unlink(e, node, nodes, edges)
        memory[COST] -= edges.cost[e]
        edges.ends[e, 0], edges.ends[e, 1] = -1, -1
    for node in members:
        nodes.local[node] = -1
    return Omega, rhs


@njit(cache=True, error_model="numpy")
def _unlink(e, node, nodes, edges):
    """Take an edge out of the list of one of its ends."""
    after = edges.next[e, 0 if edges.ends[e, 0] == node else 1]
    at = nodes.edges[node]
    if at == e:
        nodes.edges[node] = after
        return
    while True:
        side = 0 if edges.ends[at, 0] == node else 1
        if edges.next[at, side] == e:
            edges.next[at, side] = after
            return
        at = edges.next[at, side]
