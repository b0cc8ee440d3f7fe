"""Sightings of landmark nodes as range and bearing: e = h(x, m) - z, with the information Q^-1 at the measured range.

This is the likelihood of a sensor with Gaussian noise. Its cost has false minima: where a pose comes to lie on a landmark
the bearing is undefined. `edges.cartesian` has none of them; start from its optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, wrap
from . import kernels
from .base import ConstantEdges, Linearization
from .cartesian import CartesianObservationEdges
from .observation import ObservationEdges
from .robust import loss, weight


@dataclass(frozen=True, eq=False)
class PolarObservationEdges(ObservationEdges):
    """Sightings of landmark nodes with the residual h(x, m) - z; see `ObservationEdges` for the arguments."""

    @property
    def cartesian(self) -> CartesianObservationEdges:
        """The same sightings with the Cartesian residual, in the body frame."""
        return CartesianObservationEdges(
            self.first, self.second, self.sightings, self.sensor, kernel=self.kernel, trust=self.trust
        )

    def linearize(self, state: Array, reference: Array) -> Linearization:
        d = self.sightings.shape[1]
        x, m = state[self.first], state[self.second][:, :d]
        residuals = self.sensor.h(x, m) - self.sightings
        residuals[:, 1:] = wrap(residuals[:, 1:])
        by_landmark = np.zeros((self.count, d, 3))
        by_landmark[:, :, :d] = self.sensor.H(x, m)
        information = np.linalg.inv(self.sensor.Q(self.sightings)) * self.trusted[:, None, None]
        return Linearization(residuals, information, (self.first, self.second), (self.sensor.H_pose(x, m), by_landmark))

    def constant(self, state: Array) -> ConstantEdges:
        raise GraphError("the residual h(x, m) - z of landmark nodes has no such form; use residual='cartesian'")

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        return _accumulate(
            state, self.first, self.second, self.sightings, *self._noise, *self._robust, *self._targets(system)
        )


@njit(cache=True, error_model="numpy")
def _accumulate(  # type: ignore[no-untyped-def]
    state, first, second, z, variances, offset, kernel, width, trust, at_pose, at_landmark, at_pair, values, xi
):
    # With the unit vector (c, s) from the sensor to the landmark at distance r and (p, q) = (-s, c) / r, the Jacobian
    # is M B with the rows (c, s, 0), (p, q, 0) and (p, q, -1) of M for l, phi and psi. B is that of a pair edge: turning
    # the pose is turning the landmark about it the other way, -[I, u; 0, 1] with u = (-dy, dx), d from pose to landmark.
    total = 0.0
    by_range, constant, bearing_variance, psi_variance = variances
    oriented = z.shape[1] == 3
    for k in range(len(first)):
        i, j = first[k], second[k]
        ct, st = np.cos(state[i, 2]), np.sin(state[i, 2])
        dx, dy = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1]
        sx, sy = dx - ct * offset[0] + st * offset[1], dy - st * offset[0] - ct * offset[1]
        r = np.sqrt(sx * sx + sy * sy)
        direction = np.arctan2(sy, sx)
        e0, e1, e2 = r - z[k, 0], kernels.wrap(direction - state[i, 2] - z[k, 1]), 0.0
        w0, w1, w2 = 1 / (by_range * z[k, 0] * z[k, 0] + constant), 1 / bearing_variance, 0.0
        if oriented:
            w2, e2 = 1 / psi_variance, kernels.wrap(direction - state[j, 2] - z[k, 2])
        squares = trust[k] * (w0 * e0 * e0 + w1 * e1 * e1 + w2 * e2 * e2)
        total += loss(kernel, width, squares)
        if len(values):
            f = trust[k] * weight(kernel, width, squares)
            w0, w1, w2 = f * w0, f * w1, f * w2
            c, s = sx / r, sy / r
            p, q = -s / r, c / r
            across = w1 + w2
            W = (
                w0 * c * c + across * p * p, w0 * c * s + across * p * q, w0 * s * s + across * q * q,
                -w2 * p, -w2 * q, w2,
            )  # fmt: skip
            turning = w1 * e1 + w2 * e2
            g = (w0 * e0 * c + turning * p, w0 * e0 * s + turning * q, -w2 * e2)
            slots = (at_pose[k], at_landmark[k], at_pair[k])
            kernels.add_pair(values, xi, i, j, slots, W, g, (-dy, dx), (0.0, 0.0))
    return total
