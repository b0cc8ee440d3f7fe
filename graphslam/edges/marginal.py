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
from ..precision import inverses
from ..se2 import Array, perpendicular
from . import kernels
from .base import ConstantEdges, Linearization, linearization
from .robust import loss, weight, weight_slope
from .sightings import WORLD, LandmarkSightings

#: the most steps to a robust mean, a guard that is never reached in practice
MOST_STEPS = 1000
#: how often a re-weighting may raise the cost before its steps are halved
MOST_RAISES = 10
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

    def constant(self, state: Array) -> ConstantEdges:
        """The sightings one by one, as edges to landmark nodes: the marginal cost is the minimum over these nodes."""
        self._check_constant(self.frame)
        _, _, factor, _, means, _ = self._around_means(state, state)
        place, covariance = self._place, self.sensor.landmark_covariance(np.zeros((self.count, 3)), self.noisy)
        information = np.linalg.inv(covariance) * factor[:, None, None]
        turn, start = place[:, 2] if self.oriented else None, place[:, :2]
        second = len(state) + self.group
        return ConstantEdges(self.nodes, second, start, np.zeros_like(start), turn, information, means)

    def kernel_weights(self, state: Array) -> Array:
        _, _, factor, *_ = self._around_means(state, state)
        return factor / self.trusted

    def weighted_cost(self, state: Array) -> float:
        # the information of the linearisation has the weights already
        return float(self.linearize(state, state).mahalanobis.sum())

    def landmarks(self, state: Array, reference: Array) -> Array:
        """m̂ (G, 3) of each landmark, the third column zero without psi."""
        return self._around_means(state, reference)[4]

    def squares(self, state: Array, reference: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting about m̂, without kernel and trust on the sighting itself."""
        e, W, *_ = self._around_means(state, reference)
        return np.einsum("mi,mij,mj->m", e, W[:, _SYMMETRIC], e)

    def map(self, poses: Array) -> tuple[Array, Array]:
        """m̂ (G, d) of each landmark, and its covariance given the poses (G, d, d): (s sum of w Omega)^-1.

        w is the trust times the weight that the kernel gives the sighting at m̂, and s is `information_per_weight`.

        Raises:
            GraphError: the sum is singular to double precision.
        """
        _, W, factor, _, means, _ = self._around_means(poses, poses)
        d = self.sightings.shape[1]
        information = np.add.reduceat(W * factor[:, None], self.starts[:-1], axis=0)[:, _SYMMETRIC][:, :d, :d]
        remedy = "the sightings of this landmark do not determine it; change the noise of the sensor"
        return means[:, :d], inverses(self.information_per_weight * information, "landmark", remedy)

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

    The plain mean takes one pass, unless a heading wraps on the way; see `_search` for all others.
    """
    W, e, means, factor = np.empty_like(C), np.zeros_like(y), np.zeros((len(starts) - 1, 3)), trust.copy()
    for k in range(len(C)):
        W[k, 0], W[k, 1], W[k, 2], W[k, 3], W[k, 4], W[k, 5] = kernels.inverse(kernels.row(C, k), oriented)
    total = 0.0
    for g in range(len(starts) - 1):
        first, end = starts[g], starts[g + 1]
        # positions and headings as differences from the first sighting's: no cancellation
        x0, y0, t0 = y[first, 0], y[first, 1], y[first, 2]
        begin = _start_heading(y, W, trust, first, end) if oriented else 0.0
        S = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0)
        bx, by, bt = 0.0, 0.0, 0.0
        for k in range(first, end):
            d = (y[k, 0] - x0, y[k, 1] - y0, kernels.wrap(y[k, 2] - t0 - begin))
            e[k, 2] = d[2]
            weighted = kernels.scaled(trust[k], kernels.row(W, k))
            S = kernels.plus(S, weighted)
            pull = kernels.product(weighted, d)
            bx, by, bt = bx + pull[0], by + pull[1], bt + pull[2]
        mx, my, turn = kernels.product(kernels.inverse(S, True), (bx, by, bt))
        mt = begin + turn
        part, wrapped = 0.0, False
        for k in range(first, end):
            residual = (mx - y[k, 0] + x0, my - y[k, 1] + y0, turn - e[k, 2])
            wrapped = wrapped or abs(residual[2]) > np.pi
            e[k, 0], e[k, 1], e[k, 2] = residual
            part += trust[k] * kernels.dot(kernels.product(kernels.row(W, k), residual), residual)
        if kernel or wrapped:
            (mx, my, mt), part = _search(first, end, y, W, oriented, kernel, width, trust, (mx, my, mt), e, factor)
        total += part
        means[g, 0], means[g, 1], means[g, 2] = x0 + mx, y0 + my, kernels.wrap(t0 + mt)
    return e, W, factor, means, total


@njit(cache=True, error_model="numpy")
def _search(first, end, y, W, oriented, kernel, width, trust, start, e, factor):  # type: ignore[no-untyped-def]
    """The robust mean (3,) of the sightings ``first`` to ``end``, from a start (3,), and its cost; fills e and factor.

    The mean is a difference from the first sighting. Re-weighting lowers the cost from anywhere, but near the minimum it
    may take thousands of steps. There Newton's method takes over, with H = sum of w W + 2 w' (W e) (W e)', w' = dw / dr².
    A Newton step that raises the cost is replaced by re-weighting. Re-weighting itself can raise the cost only by
    wrapping a heading: W ties headings to positions, so that the cost jumps there. Where it has done so `MOST_RAISES`
    times, the steps go to and fro over a jump. They are then halved, and the lower side of the jump is the end.
    """
    x0, y0, t0 = y[first, 0], y[first, 1], y[first, 2]
    mean, back, step = start, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    best, size, scale, newton, done, raises = np.inf, np.inf, 1.0, False, False, 0
    for _ in range(MOST_STEPS):
        mx, my, mt = mean[0] + scale * step[0], mean[1] + scale * step[1], mean[2] + scale * step[2]
        A, D = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        bx, by, bt, cost = 0.0, 0.0, 0.0, 0.0
        for k in range(first, end):
            residual = (mx - y[k, 0] + x0, my - y[k, 1] + y0, kernels.wrap(mt - y[k, 2] + t0))
            e[k, 0], e[k, 1], e[k, 2] = residual
            p, q, r = kernels.product(kernels.row(W, k), residual)
            squares = trust[k] * kernels.dot((p, q, r), residual)
            cost += loss(kernel, width, squares)
            w = trust[k] * weight(kernel, width, squares)
            factor[k] = w
            bx, by, bt = bx - w * p, by - w * q, bt - w * r
            A = kernels.plus(A, kernels.scaled(w, kernels.row(W, k)))
            bend = 2 * trust[k] ** 2 * weight_slope(kernel, width, squares)
            D = kernels.plus(D, kernels.scaled(bend, (p * p, p * q, q * q, p * r, q * r, r * r)))
        if done:
            break
        smallest = 1e-14 * (1 + abs(mx) + abs(my))
        raised = not cost <= best * (1 + 1e-13)
        raises += raised and not newton
        if raised and (newton or raises > MOST_RAISES):
            if newton:
                step, newton, size = back, False, np.inf
            else:
                scale /= 2
                done = scale * (abs(step[0]) + abs(step[1]) + abs(step[2])) < smallest
                if done:
                    step = (0.0, 0.0, 0.0)
            continue
        best, mean, scale = cost, (mx, my, mt), min(1.0, 2 * scale)
        back = kernels.product(kernels.inverse(A, True), (bx, by, bt))
        step, newton = back, False
        if kernel and kernels.dot(back, (bx, by, bt)) < 0.01:
            # the step is below a tenth of the mean's standard deviation
            H = kernels.plus(A, D)
            inverse = kernels.inverse(H, True)
            # positive definite by its leading minors; inverse[5] is the quotient of the last two
            if H[0] > 0 and H[0] * H[2] > H[1] * H[1] and inverse[5] > 0:
                step, newton = kernels.product(inverse, (bx, by, bt)), True
        before, size = size, abs(step[0]) + abs(step[1]) + abs(step[2])
        # below rounding, or stopped by it
        if size < smallest or (newton and before <= size < 1e4 * smallest):
            break
    return mean, best


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
