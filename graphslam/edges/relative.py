"""Relative edges: a pose or a landmark measured from a pose. Odometry, loop closures, motion edges, g2o's points.

With a measured relative pose z = (t, theta_z) of node j in the frame of pose i the residual is, in that frame,

    e = (R(theta_i)' (p_j - p_i) - t,  theta_j - theta_i - theta_z),  the angle wrapped,

and its information does not depend on the state. g2o writes the same edge as z^-1 (x_i^-1 x_j), which is e turned by
R(theta_z)'; with the information turned in the same way the cost is the same number. A relative point has the first two
rows only (g2o's EDGE_SE2_XY).

``frame="world"`` keeps e in world axes, R(theta_i) e, and turns the information by the heading that pose i has in the
reference state: the lectures' motion edge e = x_j - f(x_i, u), whose Omega is re-evaluated at every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, perpendicular, rotation, turn_matrix, wrap
from . import kernels
from .base import ConstantEdges, Linearization, PairEdges, Relations, linearization
from .robust import SQUARES, loss, weight


@dataclass(frozen=True, eq=False)
class _RelativeEdges(PairEdges):
    """Nodes ``second`` measured (E, d) in the frames of the poses ``first``, with information (E, d, d) there."""

    measured: Array
    information: Array
    frame: str = field(default="body", kw_only=True)

    @property
    def numbers(self) -> tuple[int, float]:
        return self.measured.size, self.measured.size

    @property
    def state_dependent_information(self) -> bool:
        return self.frame == "world"

    def linearize(self, state: Array, reference: Array) -> Linearization:
        a, b = state[self.first], state[self.second]
        offset = b[:, :2] - a[:, :2]
        reached = np.einsum("eij,ej->ei", rotation(a[:, 2]), self.measured[:, :2])
        residuals = np.zeros((self.count, 3))
        residuals[:, :2] = offset - reached
        d = self.measured.shape[1]
        if d == 3:
            residuals[:, 2] = wrap(b[:, 2] - a[:, 2] - self.measured[:, 2])
        ends, still = (self.first, self.second), np.zeros((self.count, 2))
        if self.frame == "body":
            return linearization(ends, residuals, self.information, (perpendicular(offset), still), a[:, 2])
        turn = turn_matrix(reference[self.first, 2])[:, :d, :d]
        information = turn @ self.information @ np.swapaxes(turn, 1, 2)
        return linearization(ends, residuals, information, (perpendicular(reached), still))

    def constant(self, state: Array) -> ConstantEdges:
        if self.frame == "world":
            raise GraphError("the information of edges in the world frame depends on the state; use frame='body'")
        d_a, turn = self.measured[:, :2], self.measured[:, 2] if self.measured.shape[1] == 3 else None
        return ConstantEdges(self.first, self.second, d_a, np.zeros_like(d_a), turn, self.information)

    def positions(self, state: Array) -> Relations | None:
        return Relations(self.first, self.second, *_turned(state, self.first, self.measured, self.information))

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        return accumulate(self, state, reference, SQUARES, 1.0, self._targets(system))


class RelativePoseEdges(_RelativeEdges):
    """Edges from nodes ``first`` (E,) to ``second`` (E,): measured (E, 3), information (E, 3, 3) in first's frame."""

    def headings(self) -> Relations | None:
        return Relations(self.first, self.second, self.measured[:, 2], self.information[:, 2, 2])


class RelativePointEdges(_RelativeEdges):
    """Positions (E, 2) of landmark nodes ``second`` measured from pose nodes ``first``, with information (E, 2, 2).

    A landmark without heading uses the first two coordinates of its node; `Graph.linearize` holds the third.
    """


def accumulate(
    edges: _RelativeEdges, state: Array, reference: Array, kernel: int, width: float, targets: tuple[np.ndarray, ...]
) -> float:
    """As `EdgeFamily.accumulate`, with a robust kernel on every edge: its code and width, see `edges.robust`."""
    add = _add_poses if edges.measured.shape[1] == 3 else _add_points
    parts = (edges.first, edges.second, edges.measured, edges.information)
    return add(state, reference, *parts, edges.frame == "world", kernel, width, *targets)


@njit(cache=True, error_model="numpy")
def _turned(state, first, measured, information):  # type: ignore[no-untyped-def]
    """The measured positions (E, 2) and their information (E, 2, 2), turned from the frame of ``first`` to the world's."""
    offset, omega = np.empty((len(first), 2)), np.empty((len(first), 2, 2))
    for k in range(len(first)):
        theta, z, W = state[first[k], 2], measured[k], information[k]
        c, s = np.cos(theta), np.sin(theta)
        offset[k, 0], offset[k, 1] = c * z[0] - s * z[1], s * z[0] + c * z[1]
        w00, w01, w11, _, _, _ = kernels.turned(c, s, (W[0, 0], W[0, 1], W[1, 1], 0.0, 0.0, 0.0))
        omega[k, 0, 0], omega[k, 0, 1], omega[k, 1, 0], omega[k, 1, 1] = w00, w01, w01, w11
    return offset, omega


def _compiled(rows: int) -> Callable[..., float]:
    """The loop over edges with 3 or 2 rows; one for both that asks in every turn would take a quarter longer."""

    # In world axes both frames have the Jacobians -[I, u; 0, 1] and [I, 0; 0, 1]: u is the derivative of the
    # rotated measurement (world: information held still) or of the offset itself (body: information turns along).
    @njit(cache=True, error_model="numpy")
    def accumulate(  # type: ignore[no-untyped-def]
        state, reference, first, second, measured, information, world, kernel, width,
        at_first, at_second, at_pair, values, xi,
    ):  # fmt: skip
        total, turned, theta, cosine, sine = 0.0, -1, 0.0, 1.0, 0.0
        for k in range(len(first)):
            i, j, z, omega = first[k], second[k], measured[k], information[k]
            if i != turned:
                # the edges of a pose often follow each other
                turned, theta = i, state[i, 2]
                cosine, sine = np.cos(theta), np.sin(theta)
            c, s = cosine, sine
            dx, dy = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1]
            rx, ry = c * z[0] - s * z[1], s * z[0] + c * z[1]
            ux, uy = -dy, dx
            if world:
                ux, uy = -ry, rx
                c, s = np.cos(reference[i, 2]), np.sin(reference[i, 2])
            et, w02, w12, w22 = 0.0, 0.0, 0.0, 0.0
            if rows == 3:
                et = kernels.wrap(state[j, 2] - theta - z[2])
                w02, w12, w22 = omega[0, 2], omega[1, 2], omega[2, 2]
            W = kernels.turned(c, s, (omega[0, 0], omega[0, 1], omega[1, 1], w02, w12, w22))
            e = (dx - rx, dy - ry, et)
            g = kernels.product(W, e)
            squares = kernels.dot(g, e)
            if not kernel:
                total += squares
            else:
                total += loss(kernel, width, squares)
                W = kernels.scaled(weight(kernel, width, squares), W)
                g = kernels.product(W, e)
            if len(values):
                slots = (at_first[k], at_second[k], at_pair[k])
                if rows == 3:
                    kernels.add_pair(values, xi, i, j, slots, W, g, (ux, uy), (0.0, 0.0))
                else:
                    kernels.add_point(values, xi, i, j, slots, W, g, (ux, uy))
        return total

    return accumulate


_add_poses, _add_points = _compiled(3), _compiled(2)
