"""Virtual-motion edges: two sightings of one landmark tie the two poses they were made from.

Every sighting puts the landmark at y_a = h^-1(x_a, z_a), with covariance C_a = R_a Q_a R_a'. All pairs of sightings of
a landmark from different steps give an edge

    e = y_b - y_a  (heading wrapped),   Omega^-1 = C_a + C_b,   B_a = -[I, t_a; 0, 1],  B_b = [I, t_b; 0, 1],

where t = (-l sin(theta + phi), l cos(theta + phi)) is what turning the pose does to y. Without psi the heading row is
missing. A sensor that sits at o on the robot adds R(theta) o to y, and R(theta) (-o_y, o_x) to t; C is the same.

``frame`` decides how Omega, which turns with the poses, is treated:

* ``world``: C is evaluated at the reference state and held still (the lectures).
* ``body``: the residual is turned into axes that turn with pose a, in which Omega is given by the sightings alone. The
  natural axes are the landmark's own, because there a sighting comes from direction psi, whatever the poses:
  C_a = L(l_a, psi_a) Q_a L', L(l, d) = [[cos d, -l sin d, 0], [sin d, l cos d, 0], [0, 1, -1]]. (Axes along the first
  sighting, as in `factors`, differ from these by psi_a, a constant, so the cost is the same.) Pose a puts the
  landmark's axes at gamma_a = theta_a + phi_a - psi_a. Written back in world axes Omega turns by gamma_a, e stays
  y_b - y_a, and t_a gains the derivative of the turning, (-e_y, e_x).
* ``body`` without psi: the direction between the two sightings is not measured; it is taken from the reference state:
  C is evaluated there, as for ``world``, but then turns with pose a, gamma_a = theta_a - (theta_a at the reference).
  So the edge does not change under turning the whole graph, yet its information needs re-evaluation.

The number of pairs grows with the square of the sightings per landmark; they are never listed, but visited.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from ..se2 import Array, rotation, wrap
from .base import BlockSystem, Linearization
from .robust import loss, weight
from .sightings import BODY, BODY_WITHOUT_PSI, WORLD, LandmarkSightings, wrapped


@dataclass(frozen=True, eq=False)
class VirtualMotionEdges(LandmarkSightings):
    """All pairs of sightings of each landmark; see `LandmarkSightings` for the arguments.

    Args:
        tempered: every pair of a landmark times 2/K, K the number of its sightings (the sum of their trust).

    The trust in an edge is the product of that in its two sightings.
    """

    tempered: bool = False

    @property
    def count(self) -> int:
        """The number of edges (pairs from different nodes)."""
        total = 0
        for g in range(len(self.starts) - 1):
            _, seen = np.unique(self.nodes[self.starts[g] : self.starts[g + 1]], return_counts=True)
            total += (int(seen.sum()) ** 2 - int((seen**2).sum())) // 2
        return total

    @property
    def frozen_information(self) -> bool:
        """Only with psi and in the body frame do the sightings alone give the information."""
        return self.frame == "world" or self.sightings.shape[1] == 2

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All edges listed: sighting a (E,), sighting b (E,), landmark (E,). Large: for inspection, not for solving."""
        firsts, seconds, groups = [], [], []
        for g in range(len(self.starts) - 1):
            a, b = np.triu_indices(self.starts[g + 1] - self.starts[g], k=1)
            a, b = a + self.starts[g], b + self.starts[g]
            different = self.nodes[a] != self.nodes[b]
            firsts.append(a[different])
            seconds.append(b[different])
            groups.append(np.full(different.sum(), g))
        none = [np.zeros(0, dtype=np.int64)]
        return np.concatenate(firsts or none), np.concatenate(seconds or none), np.concatenate(groups or none)

    def covariances(self, reference: Array) -> Array:
        """C (M, d, d) of each sighting in the axes that `frame` uses: the landmark's own, or the reference's world."""
        if self.frame == "body" and self.sightings.shape[1] == 3:
            # seen from direction psi in the landmark's axes: R Q R' of a pose whose theta + phi is psi
            looking = np.zeros((len(self.nodes), 3))
            looking[:, 2] = self.sightings[:, 2] - self.sightings[:, 1]
            return self.sensor.landmark_covariance(looking, self.sightings)
        return self.sensor.landmark_covariance(reference[self.nodes], self.sightings)

    def turned_by(self, state: Array, reference: Array) -> Array:
        """The angle (M,) by which the axes of `covariances` are turned when a sighting is the first of its pair."""
        if self.frame == "world":
            return np.zeros(len(self.nodes))
        if self.sightings.shape[1] == 3:
            return self.placed(state)[2]
        return state[self.nodes, 2] - reference[self.nodes, 2]

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """See `EdgeFamily.linearize`. In ``body`` the residuals are given in the turned axes."""
        d = self.sightings.shape[1]
        a, b, group = self.pairs()
        y, lever, _ = self.placed(state)
        covariance = self.covariances(reference)
        trust = self._robust[2]
        factor = self.group_weights[group] * trust[a] * trust[b]
        information = np.linalg.inv(covariance[a] + covariance[b]) * factor[:, None, None]
        residuals = y[b] - y[a]
        residuals[:, 2] = wrap(residuals[:, 2])
        by_a, by_b = np.zeros((len(a), 3, 3)), np.zeros((len(a), 3, 3))
        by_a[:], by_b[:] = -np.eye(3), np.eye(3)
        by_a[:, :2, 2], by_b[:, :2, 2] = -lever[a], lever[b]
        if self.frame == "body":
            by_a[:, 0, 2] += residuals[:, 1]
            by_a[:, 1, 2] -= residuals[:, 0]
            turn = np.broadcast_to(np.eye(3), (len(a), 3, 3)).copy()
            turn[:, :2, :2] = rotation(-self.turned_by(state, reference)[a])
            residuals = np.einsum("eij,ej->ei", turn, residuals)
            by_a, by_b = turn @ by_a, turn @ by_b
        return Linearization(residuals[:, :d], information, (self.nodes[a], self.nodes[b]), (by_a[:, :d], by_b[:, :d]))

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        y, _, gamma, C = self._prepared(state, reference, self._mode)
        return float(_cost(self.starts, self.nodes, self.group_weights, y, gamma, C, self._oriented, *self._robust))

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        y, lever, gamma, C = self._prepared(state, reference, self._mode)
        return float(
            _accumulate(
                self.starts, self.nodes, *self._by_node, self.group_weights, y, lever, gamma, C,
                self._oriented, self.frame == "body", *self._robust,
                system.indptr, system.indices, system.workspace, system.values, system.xi,
            )
        )  # fmt: skip

    @cached_property
    def group_weights(self) -> Array:
        """The factor (G,) on the information of all edges of a landmark."""
        if not self.tempered:
            return np.ones(len(self.starts) - 1)
        return 2 / np.bincount(self.group, weights=self._robust[2], minlength=len(self.starts) - 1)

    @cached_property
    def _mode(self) -> int:
        if self.frame == "world":
            return WORLD
        return BODY if self._oriented else BODY_WITHOUT_PSI


@njit(cache=True, error_model="numpy")
def _information(C, a, b, c, s, oriented):  # type: ignore[no-untyped-def]
    """(C_a + C_b)^-1 turned by the angle with cosine c and sine s: w00, w01, w11, w02, w12, w22."""
    p00, p01, p11 = C[a, 0] + C[b, 0], C[a, 1] + C[b, 1], C[a, 2] + C[b, 2]
    s00 = c * c * p00 - 2 * c * s * p01 + s * s * p11
    s11 = s * s * p00 + 2 * c * s * p01 + c * c * p11
    s01 = c * s * (p00 - p11) + (c * c - s * s) * p01
    if not oriented:
        f = 1 / (s00 * s11 - s01 * s01)
        return f * s11, -f * s01, f * s00, 0.0, 0.0, 0.0
    p02, p12, s22 = C[a, 3] + C[b, 3], C[a, 4] + C[b, 4], C[a, 5] + C[b, 5]
    s02, s12 = c * p02 - s * p12, s * p02 + c * p12
    m00, m01, m02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
    f = 1 / (s00 * m00 + s01 * m01 + s02 * m02)
    return (
        f * m00, f * m01, f * (s00 * s22 - s02 * s02),
        f * m02, f * (s01 * s02 - s00 * s12), f * (s00 * s11 - s01 * s01),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _cost(starts, nodes, weights, y, gamma, C, oriented, kernel, width, trust):  # type: ignore[no-untyped-def]
    total = 0.0
    for g in range(len(starts) - 1):
        for a in range(starts[g], starts[g + 1]):
            c, s = np.cos(gamma[a]), np.sin(gamma[a])
            for b in range(a + 1, starts[g + 1]):
                if nodes[a] == nodes[b]:
                    continue
                w00, w01, w11, w02, w12, w22 = _information(C, a, b, c, s, oriented)
                ex, ey, et = y[b, 0] - y[a, 0], y[b, 1] - y[a, 1], wrapped(y[b, 2] - y[a, 2])
                squares = w00 * ex * ex + w11 * ey * ey + w22 * et * et
                squares += 2 * (w01 * ex * ey + w02 * ex * et + w12 * ey * et)
                total += loss(kernel, width, weights[g] * trust[a] * trust[b] * squares)
    return total


@njit(cache=True, error_model="numpy")
def _accumulate(  # type: ignore[no-untyped-def]
    starts, nodes, order, node_starts, groups, weights, y, lever, gamma, C, oriented, body,
    kernel, width, trust, indptr, indices, slot_of, values, xi,
):  # fmt: skip
    # Column by column of Omega: slot_of maps the rows of the current column to slots, so no list of pairs is needed.
    cosines, sines = np.cos(gamma), np.sin(gamma)
    total = 0.0
    for j in range(len(node_starts) - 1):
        if node_starts[j] == node_starts[j + 1]:
            continue
        for p in range(indptr[j], indptr[j + 1]):
            slot_of[indices[p]] = p
        J = values[slot_of[j]]
        for k in range(node_starts[j], node_starts[j + 1]):
            b = order[k]
            g = groups[b]
            weight_b = weights[g] * trust[b]
            bx, by = lever[b, 0], lever[b, 1]
            for a in range(starts[g], b):
                i = nodes[a]
                if i == j:
                    continue
                w00, w01, w11, w02, w12, w22 = _information(C, a, b, cosines[a], sines[a], oriented)
                w = weight_b * trust[a]
                w00, w01, w11, w02, w12, w22 = w * w00, w * w01, w * w11, w * w02, w * w12, w * w22
                ex, ey, et = y[b, 0] - y[a, 0], y[b, 1] - y[a, 1], wrapped(y[b, 2] - y[a, 2])
                ax, ay = lever[a, 0], lever[a, 1]
                if body:
                    ax, ay = ax - ey, ay + ex
                gx, gy, gt = (
                    w00 * ex + w01 * ey + w02 * et,
                    w01 * ex + w11 * ey + w12 * et,
                    w02 * ex + w12 * ey + w22 * et,
                )
                squares = gx * ex + gy * ey + gt * et
                if kernel:
                    total += loss(kernel, width, squares)
                    w = weight(kernel, width, squares)
                    w00, w01, w11, w02, w12, w22 = w * w00, w * w01, w * w11, w * w02, w * w12, w * w22
                    gx, gy, gt = w * gx, w * gy, w * gt
                else:
                    total += squares
                xi[i, 0] += gx
                xi[i, 1] += gy
                xi[i, 2] += ax * gx + ay * gy + gt
                xi[j, 0] -= gx
                xi[j, 1] -= gy
                xi[j, 2] -= bx * gx + by * gy + gt
                # third columns of Omega B_a and Omega B_b
                a0, a1, a2 = w00 * ax + w01 * ay + w02, w01 * ax + w11 * ay + w12, w02 * ax + w12 * ay + w22
                b0, b1, b2 = w00 * bx + w01 * by + w02, w01 * bx + w11 * by + w12, w02 * bx + w12 * by + w22
                I = values[indptr[i + 1] - 1]  # noqa: E741  # the diagonal block is the last of its column
                I[0, 0] += w00
                I[0, 1] += w01
                I[0, 2] += a0
                I[1, 0] += w01
                I[1, 1] += w11
                I[1, 2] += a1
                I[2, 0] += a0
                I[2, 1] += a1
                I[2, 2] += ax * a0 + ay * a1 + a2
                J[0, 0] += w00
                J[0, 1] += w01
                J[0, 2] += b0
                J[1, 0] += w01
                J[1, 1] += w11
                J[1, 2] += b1
                J[2, 0] += b0
                J[2, 1] += b1
                J[2, 2] += bx * b0 + by * b1 + b2
                V = values[slot_of[i]]
                V[0, 0] -= w00
                V[0, 1] -= w01
                V[0, 2] -= b0
                V[1, 0] -= w01
                V[1, 1] -= w11
                V[1, 2] -= b1
                V[2, 0] -= a0
                V[2, 1] -= a1
                V[2, 2] -= ax * b0 + ay * b1 + b2
    return total
