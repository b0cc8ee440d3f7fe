"""Marginal edges: each landmark as a variable, eliminated. Every sighting counts exactly once.

With y_a = h^-1(x_a, z_a) and W_a = (R_a Q_a R_a')^-1 a landmark m costs

    min over m of sum over a of (m - y_a)' W_a (m - y_a),   at  m̂ = S^-1 sum W_a y_a,   S = sum W_a,

and connects all poses that saw it by one clique. With e_a = m̂ - y_a and its Jacobian B_a = de_a/dx_a = -[I, t_a; 0, 1]
it adds

    B_a' W_a B_a  to the diagonal,   -U_a S^-1 U_b'  to every pair of poses, U_a = B_a' W_a,   -B_a' W_a e_a  to xi:

the Schur complement of the landmark. The information is blkdiag(W) - [W_a S^-1 W_b], which is no sum of pair terms.

``frame`` decides about W_a, which rotates with its own pose. ``world`` evaluates it at the reference state and keeps it
fixed. In ``body`` it rotates with the pose during a step, so that the information in the axes of the sighting is constant,
with psi or without, and the derivative of the rotation, (-e_y, e_x), is added to t_a.

Headings wrap: every e_a is taken in [-pi, pi) about m̂ itself. The search for m̂ starts at the circular mean of the
headings, so that the result does not depend on the order of the sightings.

A robust kernel acts on each sighting, and m̂ is then the robust mean. The optimum is the same as with a landmark node
and the kernel on each of its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..linear.information import BlockSystem
from ..se2 import Array, perpendicular
from . import kernels
from .base import Linearization, linearization
from .robust import loss, weight
from .sightings import WORLD, LandmarkSightings

#: which of the six numbers of a symmetric matrix stands where
_SYMMETRIC = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])


@dataclass(frozen=True, eq=False)
class MarginalEdges(LandmarkSightings):
    """One clique for each landmark; see `LandmarkSightings` for the arguments."""

    @property
    def count(self) -> int:
        return len(self.nodes)

    @property
    def state_dependent_information(self) -> bool:
        return self.frame == "world"

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The sightings one by one, as edges to their landmark, which is held at m̂; in world axes."""
        e, W, factor, lever, _, _ = self._around_means(state, reference)
        d = self.sightings.shape[1]
        information = (W * factor[:, None])[:, _SYMMETRIC][:, :d, :d]
        return linearization((self.nodes,), e, information, (self._effective(lever, e),))

    def landmarks(self, state: Array, reference: Array) -> Array:
        """m̂ (G, 3) of each landmark, the third column zero without psi."""
        return self._around_means(state, reference)[4]

    def squares(self, state: Array, reference: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting about m̂, without kernel and trust on the sighting itself."""
        e, W, *_ = self._around_means(state, reference)
        return np.einsum("mi,mij,mj->m", e, W[:, _SYMMETRIC], e)

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        e, W, factor, lever, _, total = self._around_means(state, reference)
        if system is not None:
            _accumulate(
                self.starts, self.nodes, *self._by_node, e, W * factor[:, None], self._effective(lever, e),
                self.oriented, *self._targets(system),
            )  # fmt: skip
        return total

    def _around_means(self, state: Array, reference: Array) -> tuple[Array, Array, Array, Array, Array, float]:
        """e (M, 3), W (M, 6), its factor of trust and kernel (M,), the lever (M, 2), m̂ (G, 3) and the cost."""
        at = reference if self.frame == "world" else state
        y, lever, _, C = self._prepared(state, at, WORLD)
        e, W, factor, means, total = _around_means(self.starts, y, C, self.oriented, *self._robust)
        return e, W, factor, lever, means, total

    def _effective(self, lever: Array, e: Array) -> Array:
        """The lever (M, 2), including the derivative of the rotation of W."""
        return lever if self.frame == "world" else lever + perpendicular(e[:, :2])


@njit(error_model="numpy", inline="always")
def _start_heading(y, W, trust, first, end):  # type: ignore[no-untyped-def]
    """Where the search for the mean heading starts, as a difference from the first: 0, or the weighted circular mean.

    Within a quarter turn of the first one no heading wraps, and the mean is the same from anywhere.
    """
    c, s, wide = 0.0, 0.0, False
    for k in range(first, end):
        wide = wide or abs(kernels.wrap(y[k, 2] - y[first, 2])) > np.pi / 2
    if not wide:
        return 0.0
    for k in range(first, end):
        c += trust[k] * W[k, 5] * np.cos(y[k, 2] - y[first, 2])
        s += trust[k] * W[k, 5] * np.sin(y[k, 2] - y[first, 2])
    return np.arctan2(s, c)


@njit(cache=True, error_model="numpy")
def _around_means(starts, y, C, oriented, kernel, width, trust):  # type: ignore[no-untyped-def]
    """e = m̂ - y (M, 3), W = C^-1 (M, 6), the factor that trust and kernel put on it (M,), m̂ (G, 3) and the cost.

    The robust mean is found by re-weighting from the plain one, in at most 100 steps; the last one is below 1e-13. The
    plain one takes a second pass only where a heading wraps on the way.
    """
    W, e, means, factor = np.empty_like(C), np.zeros_like(y), np.zeros((len(starts) - 1, 3)), trust.copy()
    for k in range(len(C)):
        W[k, 0], W[k, 1], W[k, 2], W[k, 3], W[k, 4], W[k, 5] = kernels.inverse(kernels.row(C, k), oriented)
    total = 0.0
    for g in range(len(starts) - 1):
        first, end = starts[g], starts[g + 1]
        # positions and headings as differences from the first sighting's: no cancellation
        x0, y0, t0 = y[first, 0], y[first, 1], y[first, 2]
        mx, my, mt = 0.0, 0.0, _start_heading(y, W, trust, first, end) if oriented else 0.0
        for _ in range(100):
            wrapped = False
            S = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0)
            bx, by, bt = 0.0, 0.0, 0.0
            for k in range(first, end):
                d = (y[k, 0] - x0 - mx, y[k, 1] - y0 - my, kernels.wrap(y[k, 2] - t0 - mt))
                e[k, 2] = d[2]
                weighted = kernels.scaled(factor[k], kernels.row(W, k))
                S = kernels.plus(S, weighted)
                pull = kernels.product(weighted, d)
                bx, by, bt = bx + pull[0], by + pull[1], bt + pull[2]
            ox, oy, ot = kernels.product(kernels.inverse(S, True), (bx, by, bt))
            mx, my, mt = mx + ox, my + oy, mt + ot
            part = 0.0
            for k in range(first, end):
                et = ot - e[k, 2]
                if abs(et) > np.pi:
                    wrapped, et = True, kernels.wrap(et)
                residual = (mx - y[k, 0] + x0, my - y[k, 1] + y0, et)
                e[k, 0], e[k, 1], e[k, 2] = residual
                squares = trust[k] * kernels.dot(kernels.product(kernels.row(W, k), residual), residual)
                part += loss(kernel, width, squares)
                if kernel:
                    factor[k] = trust[k] * weight(kernel, width, squares)
            if not wrapped and (not kernel or abs(ox) + abs(oy) + abs(ot) < 1e-13 * (1 + abs(mx) + abs(my))):
                break
        total += part
        means[g, 0], means[g, 1], means[g, 2] = x0 + mx, y0 + my, kernels.wrap(t0 + mt)
    return e, W, factor, means, total


@njit(cache=True, error_model="numpy")
def _accumulate(  # type: ignore[no-untyped-def]
    starts, nodes, order, node_starts, groups, e, W, lever, oriented, indptr, indices, slot_of, values, xi
):
    # V = U L^-T with S = L L', so that every block is -V_a V_b'
    V = np.zeros((len(nodes), 3, 3))
    for g in range(len(starts) - 1):
        S = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0)
        for k in range(starts[g], starts[g + 1]):
            S = kernels.plus(S, kernels.row(W, k))
        s00, s01, s11, s02, s12, s22 = S
        l00 = np.sqrt(s00)
        l10, l20 = s01 / l00, s02 / l00
        l11 = np.sqrt(s11 - l10 * l10)
        l21 = (s12 - l20 * l10) / l11
        l22 = np.sqrt(s22 - l20 * l20 - l21 * l21)
        for k in range(starts[g], starts[g + 1]):
            # the rows of U = B' W without its sign: the first two of W, and t' W + the third
            w00, w01, w11, w02, w12, _ = kernels.row(W, k)
            third = kernels.product(kernels.row(W, k), (lever[k, 0], lever[k, 1], 1.0))
            for r, (u0, u1, u2) in enumerate(((w00, w01, w02), (w01, w11, w12), third)):
                v0 = u0 / l00
                v1 = (u1 - v0 * l10) / l11
                V[k, r, 0], V[k, r, 1], V[k, r, 2] = v0, v1, (u2 - v0 * l20 - v1 * l21) / l22
    for j in range(len(node_starts) - 1):
        if node_starts[j] == node_starts[j + 1]:
            continue
        for p in range(indptr[j], indptr[j + 1]):
            slot_of[indices[p]] = p
        diagonal = values[slot_of[j]]
        for k in range(node_starts[j], node_starts[j + 1]):
            b = order[k]
            t = (lever[b, 0], lever[b, 1])
            kernels.add_block(diagonal, kernels.row(W, b), t)
            kernels.add_gradient(xi[j], 1.0, kernels.product(kernels.row(W, b), (e[b, 0], e[b, 1], e[b, 2])), t)
            for a in range(starts[groups[b]], b + 1):
                _subtract_product(values[slot_of[nodes[a]]], V[a], V[b])
                if a < b and nodes[a] == j:
                    # two sightings from one pose: the block below the diagonal, too
                    _subtract_product(diagonal, V[b], V[a])


@njit(error_model="numpy", inline="always")
def _subtract_product(block, A, B):  # type: ignore[no-untyped-def]
    """block -= A B'."""
    for r in range(3):
        for c in range(3):
            block[r, c] -= A[r, 0] * B[c, 0] + A[r, 1] * B[c, 1] + A[r, 2] * B[c, 2]
