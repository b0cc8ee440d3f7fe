"""Relative-pose edges: pose j measured from pose i. Odometry, loop closures of pose graphs, and motion edges.

With a measured relative pose z = (t, theta_z) the residual in the frame of pose i is

    e = (R(theta_i)' (p_j - p_i) - t,  theta_j - theta_i - theta_z),  the angle wrapped,

and its information does not depend on the state. g2o writes the same edge as z^-1 (x_i^-1 x_j), which is e turned by
R(theta_z)'; with the information turned alike the cost is the same number.

``frame="world"`` keeps e in the world's axes, R(theta_i) e, and turns the information by the heading that pose i has
in the reference state: the lectures' motion edge e = x_j - f(x_i, u), whose Omega is re-evaluated at every step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..se2 import Array, rotation, wrap
from .base import BlockSystem, Linearization, Relations


@dataclass(frozen=True, eq=False)
class RelativePoseEdges:
    """Edges from nodes ``first`` (E,) to ``second`` (E,): measured (E, 3), information (E, 3, 3) in first's frame."""

    first: np.ndarray
    second: np.ndarray
    measured: Array
    information: Array
    frame: str = "body"

    @property
    def count(self) -> int:
        """The number of edges."""
        return len(self.first)

    @property
    def frozen_information(self) -> bool:
        """In the world frame the information turns with the reference state."""
        return self.frame == "world"

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """Two nodes each; see `EdgeFamily.cliques`."""
        return np.arange(0, 2 * self.count + 1, 2), np.sort(np.column_stack([self.first, self.second]), axis=1).ravel()

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """See `EdgeFamily.linearize`."""
        a, b = state[self.first], state[self.second]
        turn = rotation(a[:, 2])
        offset = b[:, :2] - a[:, :2]
        residuals = np.empty((self.count, 3))
        residuals[:, 2] = wrap(b[:, 2] - a[:, 2] - self.measured[:, 2])
        by_first, by_second = np.zeros((self.count, 3, 3)), np.zeros((self.count, 3, 3))
        by_first[:, 2, 2], by_second[:, 2, 2] = -1.0, 1.0
        if self.frame == "world":
            reached = np.einsum("eij,ej->ei", turn, self.measured[:, :2])
            residuals[:, :2] = offset - reached
            by_first[:, :2, :2], by_second[:, :2, :2] = -np.eye(2), np.eye(2)
            by_first[:, 0, 2], by_first[:, 1, 2] = reached[:, 1], -reached[:, 0]
            frozen = np.broadcast_to(np.eye(3), (self.count, 3, 3)).copy()
            frozen[:, :2, :2] = rotation(reference[self.first, 2])
            information = frozen @ self.information @ np.swapaxes(frozen, 1, 2)
        else:
            seen = np.einsum("eji,ej->ei", turn, offset)
            residuals[:, :2] = seen - self.measured[:, :2]
            by_second[:, :2, :2] = np.swapaxes(turn, 1, 2)
            by_first[:, :2, :2] = -by_second[:, :2, :2]
            by_first[:, 0, 2], by_first[:, 1, 2] = seen[:, 1], -seen[:, 0]
            information = self.information
        return Linearization(residuals, information, (self.first, self.second), (by_first, by_second))

    def headings(self) -> Relations | None:
        """See `EdgeFamily.headings`."""
        return Relations(self.first, self.second, self.measured[:, 2], self.information[:, 2, 2])

    def positions(self, state: Array) -> Relations | None:
        """See `EdgeFamily.positions`."""
        return Relations(self.first, self.second, *turned(state, self.first, self.measured, self.information))

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        # turning residual and information together changes no cost unless the information was frozen elsewhere
        at = reference if self.frame == "world" else state
        return float(_cost(state, at, self.first, self.second, self.measured, self.information, self.frame == "world"))

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        return float(
            _accumulate(
                state, reference, self.first, self.second, self.measured, self.information, self.frame == "world",
                *system.slots_of(self), system.values, system.xi,
            )
        )  # fmt: skip


@njit(cache=True)
def _wrap(angle):  # type: ignore[no-untyped-def]
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(cache=True, error_model="numpy")
def turned(state, first, measured, information):  # type: ignore[no-untyped-def]
    """The measured positions (E, 2) and their information (E, 2, 2), turned from the frame of ``first`` to the world's.

    ``measured`` (E, 2 or 3) and ``information`` (E, 2 or 3, 2 or 3) may hold the heading, too, last.
    """
    offset, omega = np.empty((len(first), 2)), np.empty((len(first), 2, 2))
    for k in range(len(first)):
        theta, z, W = state[first[k], 2], measured[k], information[k]
        c, s = np.cos(theta), np.sin(theta)
        offset[k, 0], offset[k, 1] = c * z[0] - s * z[1], s * z[0] + c * z[1]
        a, b, d = W[0, 0], W[0, 1], W[1, 1]
        omega[k, 0, 0] = c * c * a - 2 * c * s * b + s * s * d
        omega[k, 1, 1] = s * s * a + 2 * c * s * b + c * c * d
        omega[k, 0, 1] = omega[k, 1, 0] = c * s * (a - d) + (c * c - s * s) * b
    return offset, omega


@njit(cache=True)
def _cost(state, reference, first, second, measured, information, world):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(first)):
        a, b, z, W = state[first[k]], state[second[k]], measured[k], information[k]
        c, s = np.cos(a[2]), np.sin(a[2])
        dx, dy = b[0] - a[0], b[1] - a[1]
        ex, ey = c * dx + s * dy - z[0], -s * dx + c * dy - z[1]
        if world:
            # out of the frame of today's heading into that of the frozen one
            lag = a[2] - reference[first[k], 2]
            c, s = np.cos(lag), np.sin(lag)
            ex, ey = c * ex - s * ey, s * ex + c * ey
        et = _wrap(b[2] - a[2] - z[2])
        total += W[0, 0] * ex * ex + W[1, 1] * ey * ey + W[2, 2] * et * et
        total += 2 * (W[0, 1] * ex * ey + W[0, 2] * ex * et + W[1, 2] * ey * et)
    return total


@njit(cache=True, error_model="numpy")
def _accumulate(  # type: ignore[no-untyped-def]
    state, reference, first, second, measured, information, world, slot_first, slot_second, slot_pair, values, xi
):
    # In the world's axes both frames have Jacobians -[I, u; 0, 1] and [I, 0; 0, 1]: u is the derivative of the
    # rotated measurement (world: information held still) or of the offset itself (body: information turns along).
    total = 0.0
    for k in range(len(first)):
        i, j = first[k], second[k]
        theta = state[i, 2]
        c, s = np.cos(theta), np.sin(theta)
        dx, dy = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1]
        rx, ry = c * measured[k, 0] - s * measured[k, 1], s * measured[k, 0] + c * measured[k, 1]
        ex, ey = dx - rx, dy - ry
        et = _wrap(state[j, 2] - theta - measured[k, 2])
        if world:
            ux, uy = -ry, rx
            theta = reference[i, 2]
            c, s = np.cos(theta), np.sin(theta)
        else:
            ux, uy = -dy, dx
        W = information[k]
        # Omega = blkdiag(R, 1) W blkdiag(R, 1)'
        a, b, d = W[0, 0], W[0, 1], W[1, 1]
        w00 = c * c * a - 2 * c * s * b + s * s * d
        w11 = s * s * a + 2 * c * s * b + c * c * d
        w01 = c * s * (a - d) + (c * c - s * s) * b
        w02, w12 = c * W[0, 2] - s * W[1, 2], s * W[0, 2] + c * W[1, 2]
        w22 = W[2, 2]
        gx, gy, gt = w00 * ex + w01 * ey + w02 * et, w01 * ex + w11 * ey + w12 * et, w02 * ex + w12 * ey + w22 * et
        total += gx * ex + gy * ey + gt * et
        # third row of B_i' Omega, B_i = [I, u; 0, 1]
        p0, p1, p2 = w00 * ux + w01 * uy + w02, w01 * ux + w11 * uy + w12, w02 * ux + w12 * uy + w22
        xi[i, 0] += gx
        xi[i, 1] += gy
        xi[i, 2] += ux * gx + uy * gy + gt
        xi[j, 0] -= gx
        xi[j, 1] -= gy
        xi[j, 2] -= gt
        V = values[slot_first[k]]
        V[0, 0] += w00
        V[0, 1] += w01
        V[0, 2] += p0
        V[1, 0] += w01
        V[1, 1] += w11
        V[1, 2] += p1
        V[2, 0] += p0
        V[2, 1] += p1
        V[2, 2] += ux * p0 + uy * p1 + p2
        V = values[slot_second[k]]
        V[0, 0] += w00
        V[0, 1] += w01
        V[0, 2] += w02
        V[1, 0] += w01
        V[1, 1] += w11
        V[1, 2] += w12
        V[2, 0] += w02
        V[2, 1] += w12
        V[2, 2] += w22
        V = values[slot_pair[k]]
        if i < j:
            V[0, 0] -= w00
            V[0, 1] -= w01
            V[0, 2] -= w02
            V[1, 0] -= w01
            V[1, 1] -= w11
            V[1, 2] -= w12
            V[2, 0] -= p0
            V[2, 1] -= p1
            V[2, 2] -= p2
        else:
            V[0, 0] -= w00
            V[0, 1] -= w01
            V[0, 2] -= p0
            V[1, 0] -= w01
            V[1, 1] -= w11
            V[1, 2] -= p1
            V[2, 0] -= w02
            V[2, 1] -= w12
            V[2, 2] -= p2
    return total
