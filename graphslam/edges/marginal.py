"""Marginal edges: each landmark as a variable, eliminated. Every sighting counts exactly once.

With y_a = h^-1(x_a, z_a) and W_a = (R_a Q_a R_a')^-1 a landmark m costs

    min over m of sum over a of (m - y_a)' W_a (m - y_a),   at  m̂ = S^-1 sum W_a y_a,   S = sum W_a,

and ties all poses that saw it into one clique. With e_a = m̂ - y_a and B_a = de_a/dx_a = -[I, t_a; 0, 1] it adds

    B_a' W_a B_a  to the diagonal,   -U_a S^-1 U_b'  to every pair of poses, U_a = B_a' W_a,   -B_a' W_a e_a  to xi:

the Schur complement of the landmark. The information is blkdiag(W) - [W_a S^-1 W_b], which is no sum of pair terms.

``frame`` decides about W_a, which turns with its own pose: ``world`` takes it at the reference; in ``body`` it turns
along, so that the information in the axes of the sighting is constant, with psi or without, and t_a gains the
derivative of the turning, (-e_y, e_x).

Headings have a seam: which turn of y_a's counts is decided by m̂ itself, every e_a lying in [-pi, pi). m̂ is sought from
the circular mean of the headings, so that nothing depends on which sighting comes first.

A robust kernel acts on each sighting, its landmark m̂ then being the robust mean: the same optimum as with a landmark
node and the kernel on each of its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..se2 import Array
from .base import BlockSystem, Linearization
from .robust import loss, weight
from .sightings import WORLD, LandmarkSightings, wrapped


@dataclass(frozen=True, eq=False)
class MarginalEdges(LandmarkSightings):
    """One clique for each landmark; see `LandmarkSightings` for the arguments."""

    @property
    def count(self) -> int:
        """The number of sightings."""
        return len(self.nodes)

    @property
    def frozen_information(self) -> bool:
        """In the body frame the information turns along with each pose."""
        return self.frame == "world"

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The sightings one by one, as edges to their landmark, which is held at m̂; in world axes."""
        e, W, lever, _ = self._placed_around_means(state, reference)
        d = self.sightings.shape[1]
        by_pose = np.zeros((self.count, 3, 3))
        by_pose[:] = -np.eye(3)
        by_pose[:, :2, 2] = -lever
        information = np.empty((self.count, 3, 3))
        for k, (i, j) in enumerate(_ENTRIES):
            information[:, i, j] = information[:, j, i] = W[:, k]
        return Linearization(e[:, :d], information[:, :d, :d], (self.nodes,), (by_pose[:, :d],))

    def landmarks(self, state: Array, reference: Array) -> Array:
        """m̂ (G, 3) of each landmark, the third column zero without psi."""
        return self._placed_around_means(state, reference)[3]

    def squares(self, state: Array, reference: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting about m̂, without kernel and trust on itself."""
        e, W, _, _ = self._placed_around_means(state, reference, whole=True)
        g = np.column_stack([
            W[:, 0] * e[:, 0] + W[:, 1] * e[:, 1] + W[:, 3] * e[:, 2],
            W[:, 1] * e[:, 0] + W[:, 2] * e[:, 1] + W[:, 4] * e[:, 2],
            W[:, 3] * e[:, 0] + W[:, 4] * e[:, 1] + W[:, 5] * e[:, 2],
        ])  # fmt: skip
        return np.einsum("mi,mi->m", g, e)

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        y, _, _, C = self._prepared(state, self._at(state, reference), WORLD)
        _, _, _, total = _around_means(self.starts, y, C, self._oriented, *self._robust)
        return float(total)

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        y, lever, _, C = self._prepared(state, self._at(state, reference), WORLD)
        e, W, _, total = _around_means(self.starts, y, C, self._oriented, *self._robust)
        if self.frame == "body":
            # the axes turn with the pose: the derivative of the turning, see the module
            lever = lever - np.column_stack([e[:, 1], -e[:, 0]])
        _accumulate(
            self.starts, self.nodes, *self._by_node, e, W, lever, self._oriented,
            system.indptr, system.indices, system.workspace, system.values, system.xi,
        )  # fmt: skip
        return float(total)

    def _at(self, state: Array, reference: Array) -> Array:
        return reference if self.frame == "world" else state

    def _placed_around_means(
        self, state: Array, reference: Array, whole: bool = False
    ) -> tuple[Array, Array, Array, Array]:
        """e (M, 3), W (M, 6), the effective lever (M, 2) and m̂ (G, 3); ``whole``: W as if trusted and not outlying."""
        y, lever, _, C = self._prepared(state, self._at(state, reference), WORLD)
        e, W, m, _ = _around_means(self.starts, y, C, self._oriented, *self._robust)
        if self.frame == "body":
            lever = lever - np.column_stack([e[:, 1], -e[:, 0]])
        if whole:
            W = _inverses(C, self._oriented)
        return e, W, lever, m


#: where the six numbers of a symmetric 3 x 3 matrix stand
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@njit(cache=True, error_model="numpy", inline="always")
def _inverse(a00, a01, a11, a02, a12, a22):  # type: ignore[no-untyped-def]
    m00, m01, m02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    f = 1 / (a00 * m00 + a01 * m01 + a02 * m02)
    return (
        f * m00, f * m01, f * (a00 * a22 - a02 * a02),
        f * m02, f * (a01 * a02 - a00 * a12), f * (a00 * a11 - a01 * a01),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _inverses(C, oriented):  # type: ignore[no-untyped-def]
    W = np.zeros_like(C)
    for k in range(len(C)):
        last = C[k, 5] if oriented else 1.0
        w00, w01, w11, w02, w12, w22 = _inverse(C[k, 0], C[k, 1], C[k, 2], C[k, 3], C[k, 4], last)
        W[k, 0], W[k, 1], W[k, 2], W[k, 3], W[k, 4] = w00, w01, w11, w02, w12
        W[k, 5] = w22 if oriented else 0.0
    return W


@njit(cache=True, error_model="numpy", inline="always")
def _between_headings(y, W, first, end):  # type: ignore[no-untyped-def]
    """Where the mean heading is sought from, as a difference from the first: 0, or their weighted circular mean.

    Within a quarter turn of the first one there is no seam, and the mean is the same from anywhere.
    """
    c, s, wide = 0.0, 0.0, False
    for k in range(first, end):
        wide = wide or abs(wrapped(y[k, 2] - y[first, 2])) > np.pi / 2
    if not wide:
        return 0.0
    for k in range(first, end):
        c += W[k, 5] * np.cos(y[k, 2] - y[first, 2])
        s += W[k, 5] * np.sin(y[k, 2] - y[first, 2])
    return np.arctan2(s, c)


@njit(cache=True, error_model="numpy")
def _around_means(starts, y, C, oriented, kernel, width, trust):  # type: ignore[no-untyped-def]
    """e = m̂ - y (M, 3), W (M, 6) with trust and kernel in it, m̂ (G, 3) and the cost.

    The robust mean is found by re-weighting from the plain one, at most 100 times; it moves by less than 1e-13 then. The
    plain one takes a second pass only where a heading crosses the seam.
    """
    W = _inverses(C, oriented)
    for k in range(len(W)):
        W[k] *= trust[k]
    e, means = np.zeros_like(y), np.zeros((len(starts) - 1, 3))
    factor = np.ones(len(y))
    total = 0.0
    for g in range(len(starts) - 1):
        first, end = starts[g], starts[g + 1]
        # positions and headings as differences from the first sighting's: no cancellation
        x0, y0, t0 = y[first, 0], y[first, 1], y[first, 2]
        mx, my, mt = 0.0, 0.0, _between_headings(y, W, first, end) if oriented else 0.0
        for _ in range(100):
            crossed = False
            s00, s01, s11, s02, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0
            bx, by, bt = 0.0, 0.0, 0.0
            for k in range(first, end):
                dx, dy, dt = y[k, 0] - x0 - mx, y[k, 1] - y0 - my, wrapped(y[k, 2] - t0 - mt)
                e[k, 2] = dt
                f = factor[k]
                w00, w01, w11 = f * W[k, 0], f * W[k, 1], f * W[k, 2]
                w02, w12, w22 = f * W[k, 3], f * W[k, 4], f * W[k, 5]
                s00, s01, s11, s02, s12, s22 = s00 + w00, s01 + w01, s11 + w11, s02 + w02, s12 + w12, s22 + w22
                bx += w00 * dx + w01 * dy + w02 * dt
                by += w01 * dx + w11 * dy + w12 * dt
                bt += w02 * dx + w12 * dy + w22 * dt
            p00, p01, p11, p02, p12, p22 = _inverse(s00, s01, s11, s02, s12, s22)
            ox, oy, ot = p00 * bx + p01 * by + p02 * bt, p01 * bx + p11 * by + p12 * bt, p02 * bx + p12 * by + p22 * bt
            mx, my, mt = mx + ox, my + oy, mt + ot
            part = 0.0
            for k in range(first, end):
                ex, ey, et = mx - y[k, 0] + x0, my - y[k, 1] + y0, ot - e[k, 2]
                if abs(et) > np.pi:
                    crossed, et = True, wrapped(et)
                e[k, 0], e[k, 1], e[k, 2] = ex, ey, et
                squares = W[k, 0] * ex * ex + W[k, 2] * ey * ey + W[k, 5] * et * et
                squares += 2 * (W[k, 1] * ex * ey + W[k, 3] * ex * et + W[k, 4] * ey * et)
                part += loss(kernel, width, squares)
                if kernel:
                    factor[k] = weight(kernel, width, squares)
            if not crossed and (not kernel or abs(ox) + abs(oy) + abs(ot) < 1e-13 * (1 + abs(mx) + abs(my))):
                break
        total += part
        means[g, 0], means[g, 1], means[g, 2] = x0 + mx, y0 + my, wrapped(t0 + mt)
    if kernel:
        for k in range(len(W)):
            W[k] *= factor[k]
    return e, W, means, total


@njit(cache=True, error_model="numpy")
def _accumulate(  # type: ignore[no-untyped-def]
    starts, nodes, order, node_starts, groups, e, W, lever, oriented, indptr, indices, slot_of, values, xi
):
    # V = U L^-T with S = L L', so that every block is -V_a V_b'
    V = np.zeros((len(nodes), 3, 3))
    for g in range(len(starts) - 1):
        s00, s01, s11, s02, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if oriented else 1.0
        for k in range(starts[g], starts[g + 1]):
            s00, s01, s11, s02, s12, s22 = (
                s00 + W[k, 0], s01 + W[k, 1], s11 + W[k, 2], s02 + W[k, 3], s12 + W[k, 4], s22 + W[k, 5],
            )  # fmt: skip
        l00 = np.sqrt(s00)
        l10, l20 = s01 / l00, s02 / l00
        l11 = np.sqrt(s11 - l10 * l10)
        l21 = (s12 - l20 * l10) / l11
        l22 = np.sqrt(s22 - l20 * l20 - l21 * l21)
        for k in range(starts[g], starts[g + 1]):
            # the rows of U = B' W without its sign: the first two of W, and t' W + the third
            tx, ty = lever[k, 0], lever[k, 1]
            w00, w01, w11, w02, w12, w22 = W[k]
            for r in range(3):
                if r == 0:
                    u0, u1, u2 = w00, w01, w02
                elif r == 1:
                    u0, u1, u2 = w01, w11, w12
                else:
                    u0, u1, u2 = tx * w00 + ty * w01 + w02, tx * w01 + ty * w11 + w12, tx * w02 + ty * w12 + w22
                v0 = u0 / l00
                v1 = (u1 - v0 * l10) / l11
                V[k, r, 0], V[k, r, 1], V[k, r, 2] = v0, v1, (u2 - v0 * l20 - v1 * l21) / l22
    for j in range(len(node_starts) - 1):
        if node_starts[j] == node_starts[j + 1]:
            continue
        for p in range(indptr[j], indptr[j + 1]):
            slot_of[indices[p]] = p
        J = values[slot_of[j]]
        for k in range(node_starts[j], node_starts[j + 1]):
            b = order[k]
            tx, ty = lever[b, 0], lever[b, 1]
            w00, w01, w11, w02, w12, w22 = W[b]
            gx = w00 * e[b, 0] + w01 * e[b, 1] + w02 * e[b, 2]
            gy = w01 * e[b, 0] + w11 * e[b, 1] + w12 * e[b, 2]
            gt = w02 * e[b, 0] + w12 * e[b, 1] + w22 * e[b, 2]
            xi[j, 0] += gx
            xi[j, 1] += gy
            xi[j, 2] += tx * gx + ty * gy + gt
            p0, p1, p2 = w00 * tx + w01 * ty + w02, w01 * tx + w11 * ty + w12, w02 * tx + w12 * ty + w22
            J[0, 0] += w00
            J[0, 1] += w01
            J[0, 2] += p0
            J[1, 0] += w01
            J[1, 1] += w11
            J[1, 2] += p1
            J[2, 0] += p0
            J[2, 1] += p1
            J[2, 2] += tx * p0 + ty * p1 + p2
            Vb = V[b]
            for a in range(starts[groups[b]], b + 1):
                Va = V[a]
                block = values[slot_of[nodes[a]]]
                for r in range(3):
                    for c in range(3):
                        block[r, c] -= Va[r, 0] * Vb[c, 0] + Va[r, 1] * Vb[c, 1] + Va[r, 2] * Vb[c, 2]
                if a < b and nodes[a] == j:
                    # two sightings from one pose: the block below the diagonal, too
                    for r in range(3):
                        for c in range(3):
                            J[r, c] -= Vb[r, 0] * Va[c, 0] + Vb[r, 1] * Va[c, 1] + Vb[r, 2] * Va[c, 2]
