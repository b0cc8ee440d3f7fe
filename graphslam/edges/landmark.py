"""Edges from a pose to a landmark that is a node of the graph.

Two residuals, one shape: e has d rows, its Jacobians are d x 3 by the pose and d x d by the landmark.

* `ObservationEdges`: e = h(x, m) - z for sightings (l, phi) or (l, phi, psi), information Q^-1 at the measured range.
  Exact where virtual-motion edges are an approximation, and linear in the number of sightings.
* `RelativePointEdges`: e = R(theta)' (m - p) - z for a measured relative position (x, y), as in g2o's EDGE_SE2_XY.

A landmark without heading uses the first two coordinates of its node; the third stays at rest (`Graph.linearize` puts a
unit on its diagonal).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from ..models import SensorModel
from ..se2 import Array, rotation, wrap
from .base import BlockSystem, Linearization, Relations
from .relative_pose import turned
from .robust import Kernel, code_and_width, loss, weight
from .sightings import trusted


@dataclass(frozen=True, eq=False)
class ObservationEdges:
    """Sightings (M, 2 or 3) of landmark nodes ``second`` (M,) from pose nodes ``first`` (M,).

    ``kernel`` and ``trust`` are those of `LandmarkSightings`.
    """

    first: np.ndarray
    second: np.ndarray
    sightings: Array
    sensor: SensorModel
    kernel: Kernel | None = None
    trust: Array | None = None

    @property
    def count(self) -> int:
        """The number of sightings."""
        return len(self.first)

    @property
    def frozen_information(self) -> bool:
        """Never: the noise belongs to the sensor's own coordinates."""
        return False

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """Two nodes each; see `EdgeFamily.cliques`."""
        return _pairs(self.first, self.second)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """See `EdgeFamily.linearize`."""
        d = self.sightings.shape[1]
        x, m = state[self.first], state[self.second][:, :d]
        residuals = self.sensor.h(x, m) - self.sightings
        residuals[:, 1:] = wrap(residuals[:, 1:])
        by_landmark = np.zeros((self.count, d, 3))
        by_landmark[:, :, :d] = self.sensor.H(x, m)
        information = np.linalg.inv(self.sensor.Q(self.sightings)) * self._robust[2][:, None, None]
        return Linearization(residuals, information, (self.first, self.second), (self.sensor.H_pose(x, m), by_landmark))

    def with_trust(self, trust: Array | None) -> ObservationEdges:
        """The same edges with another factor (M,) on the information of each sighting."""
        return replace(self, trust=trust)

    def squares(self, state: Array, reference: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting, without kernel and trust."""
        return self.with_trust(None).linearize(state, reference).mahalanobis

    def headings(self) -> Relations | None:
        """See `EdgeFamily.headings`."""
        if self.sightings.shape[1] == 2:
            return None
        variance = self.sensor.bearing_std**2 + self.sensor.orientation_std**2
        facing = self.sightings[:, 1] - self.sightings[:, 2]
        return Relations(self.first, self.second, facing, np.full(self.count, 1 / variance))

    def positions(self, state: Array) -> Relations | None:
        """See `EdgeFamily.positions`."""
        x = state[self.first]
        at_origin = np.column_stack([np.zeros((self.count, 2)), x[:, 2]])
        offset = self.sensor.h_inverse(at_origin, self.sightings[:, :2])
        information = np.linalg.inv(self.sensor.landmark_covariance(x, self.sightings[:, :2]))
        return Relations(self.first, self.second, offset, information)

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        return float(
            _observation_cost(state, self.first, self.second, self.sightings, *self._noise_and_place(), *self._robust)
        )

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        return float(
            _observations(
                state, self.first, self.second, self.sightings, *self._noise_and_place(), *self._robust,
                *system.slots_of(self), system.values, system.xi,
            )
        )  # fmt: skip

    def _noise_and_place(self) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
        s = self.sensor
        return (s.range_rate**2, s.range_std**2, s.bearing_std**2, s.orientation_std**2), s.offset

    @property
    def trusted(self) -> Array:
        """The trust (M,) that the edges work with."""
        return trusted(self.trust, len(self.first))

    @cached_property
    def _robust(self) -> tuple[int, float, Array]:
        """The kernel's code and width, and the trust (M,)."""
        return *code_and_width(self.kernel), self.trusted


@dataclass(frozen=True, eq=False)
class RelativePointEdges:
    """Positions (M, 2) of landmark nodes ``second`` seen from pose nodes ``first``, with information (M, 2, 2)."""

    first: np.ndarray
    second: np.ndarray
    measured: Array
    information: Array

    @property
    def count(self) -> int:
        """The number of edges."""
        return len(self.first)

    @property
    def frozen_information(self) -> bool:
        """Never: the information is given in the frame of the pose."""
        return False

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """Two nodes each; see `EdgeFamily.cliques`."""
        return _pairs(self.first, self.second)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """See `EdgeFamily.linearize`."""
        x, m = state[self.first], state[self.second]
        back = np.swapaxes(rotation(x[:, 2]), 1, 2)
        seen = np.einsum("eij,ej->ei", back, m[:, :2] - x[:, :2])
        by_pose, by_landmark = np.zeros((self.count, 2, 3)), np.zeros((self.count, 2, 3))
        by_pose[:, :, :2], by_landmark[:, :, :2] = -back, back
        by_pose[:, 0, 2], by_pose[:, 1, 2] = seen[:, 1], -seen[:, 0]
        return Linearization(seen - self.measured, self.information, (self.first, self.second), (by_pose, by_landmark))

    def headings(self) -> Relations | None:
        """See `EdgeFamily.headings`."""
        return None

    def positions(self, state: Array) -> Relations | None:
        """See `EdgeFamily.positions`."""
        return Relations(self.first, self.second, *turned(state, self.first, self.measured, self.information))

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        return float(_point_cost(state, self.first, self.second, self.measured, self.information))

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        arguments = (state, self.first, self.second, self.measured, self.information)
        return float(_points(*arguments, *system.slots_of(self), system.values, system.xi))


def _pairs(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(0, 2 * len(first) + 1, 2), np.sort(np.column_stack([first, second]), axis=1).ravel()


@njit(cache=True, error_model="numpy")
def _observation_cost(  # type: ignore[no-untyped-def]
    state, first, second, z, variances, offset, kernel, width, trust
):
    by_range, constant, bearing_variance, psi_variance = variances
    total = 0.0
    oriented = z.shape[1] == 3
    for k in range(len(first)):
        x, m = state[first[k]], state[second[k]]
        ux, uy = _arm(x[2], offset)
        dx, dy = m[0] - x[0] - ux, m[1] - x[1] - uy
        direction = np.arctan2(dy, dx)
        e0, e1 = np.sqrt(dx * dx + dy * dy) - z[k, 0], _wrap(direction - x[2] - z[k, 1])
        squares = e0 * e0 / (by_range * z[k, 0] * z[k, 0] + constant) + e1 * e1 / bearing_variance
        if oriented:
            e2 = _wrap(direction - m[2] - z[k, 2])
            squares += e2 * e2 / psi_variance
        total += loss(kernel, width, trust[k] * squares)
    return total


@njit(cache=True, error_model="numpy")
def _observations(  # type: ignore[no-untyped-def]
    state, first, second, z, variances, offset, kernel, width, trust, at_pose, at_landmark, at_pair, values, xi
):
    # Each row of e is uncorrelated with the others, so it adds weight * (row of B)' (row of B). With the unit vector
    # (c, s) from the sensor to the landmark at distance r, rows by the sensor's pose are -(c, s, 0) and (s, -c, -r) / r,
    # by the landmark (c, s, 0) and (-s, c, 0) / r; psi has (s, -c, 0) / r and (-s, c, -r) / r. Turning the robot moves
    # the sensor by (-uy, ux), which adds t0 to the first and ta to the other two rows' derivatives by the heading.
    total = 0.0
    oriented = z.shape[1] == 3
    by_range, constant, bearing_variance, psi_variance = variances
    for k in range(len(first)):
        i, j = first[k], second[k]
        ux, uy = _arm(state[i, 2], offset)
        dx, dy = state[j, 0] - state[i, 0] - ux, state[j, 1] - state[i, 1] - uy
        r = np.sqrt(dx * dx + dy * dy)
        c, s = dx / r, dy / r
        direction = np.arctan2(dy, dx)
        e0, e1 = r - z[k, 0], _wrap(direction - state[i, 2] - z[k, 1])
        w0, w1, w2, e2 = 1 / (by_range * z[k, 0] * z[k, 0] + constant), 1 / bearing_variance, 0.0, 0.0
        if oriented:
            w2, e2 = 1 / psi_variance, _wrap(direction - state[j, 2] - z[k, 2])
        squares = trust[k] * (w0 * e0 * e0 + w1 * e1 * e1 + w2 * e2 * e2)
        total += loss(kernel, width, squares)
        f = trust[k] * weight(kernel, width, squares)
        w0, w1, w2 = f * w0, f * w1, f * w2
        # the position parts of all rows: w0 along the line of sight, wa across it
        p, q = -s / r, c / r
        t0, ta = c * uy - s * ux, p * uy - q * ux
        t1 = ta - 1
        wa, wt = w1 + w2, w1 * t1 + w2 * ta
        h00, h01, h11 = w0 * c * c + wa * p * p, w0 * c * s + wa * p * q, w0 * s * s + wa * q * q
        hx, hy = w0 * t0 * c + wt * p, w0 * t0 * s + wt * q
        gx, gy = w0 * e0 * c + (w1 * e1 + w2 * e2) * p, w0 * e0 * s + (w1 * e1 + w2 * e2) * q
        xi[i, 0] += gx
        xi[i, 1] += gy
        xi[i, 2] -= w0 * e0 * t0 + w1 * e1 * t1 + w2 * e2 * ta
        xi[j, 0] -= gx
        xi[j, 1] -= gy
        xi[j, 2] += w2 * e2
        V = values[at_pose[k]]
        V[0, 0] += h00
        V[0, 1] += h01
        V[1, 0] += h01
        V[1, 1] += h11
        V[0, 2] -= hx
        V[2, 0] -= hx
        V[1, 2] -= hy
        V[2, 1] -= hy
        V[2, 2] += w0 * t0 * t0 + w1 * t1 * t1 + w2 * ta * ta
        V = values[at_landmark[k]]
        V[0, 0] += h00
        V[0, 1] += h01
        V[1, 0] += h01
        V[1, 1] += h11
        V[0, 2] -= w2 * p
        V[2, 0] -= w2 * p
        V[1, 2] -= w2 * q
        V[2, 1] -= w2 * q
        V[2, 2] += w2
        # rows of the pose, columns of the landmark, or the other way round; the landmark's heading meets only psi
        V = values[at_pair[k]]
        V[0, 0] -= h00
        V[0, 1] -= h01
        V[1, 0] -= h01
        V[1, 1] -= h11
        V[2, 2] -= w2 * ta
        if i < j:
            V[2, 0] += hx
            V[2, 1] += hy
            V[0, 2] += w2 * p
            V[1, 2] += w2 * q
        else:
            V[0, 2] += hx
            V[1, 2] += hy
            V[2, 0] += w2 * p
            V[2, 1] += w2 * q
    return total


@njit(cache=True)
def _point_cost(state, first, second, measured, information):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(first)):
        x, m, W = state[first[k]], state[second[k]], information[k]
        c, s = np.cos(x[2]), np.sin(x[2])
        dx, dy = m[0] - x[0], m[1] - x[1]
        ex, ey = c * dx + s * dy - measured[k, 0], -s * dx + c * dy - measured[k, 1]
        total += W[0, 0] * ex * ex + 2 * W[0, 1] * ex * ey + W[1, 1] * ey * ey
    return total


@njit(cache=True, error_model="numpy")
def _points(state, first, second, measured, information, at_pose, at_landmark, at_pair, values, xi):  # type: ignore[no-untyped-def]
    # in world axes: B by the pose is -[I, u] with u = (-dy, dx), by the landmark I; as in relative_pose.py
    total = 0.0
    for k in range(len(first)):
        i, j, W = first[k], second[k], information[k]
        c, s = np.cos(state[i, 2]), np.sin(state[i, 2])
        dx, dy = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1]
        ex = dx - c * measured[k, 0] + s * measured[k, 1]
        ey = dy - s * measured[k, 0] - c * measured[k, 1]
        a, b, d = W[0, 0], W[0, 1], W[1, 1]
        w00 = c * c * a - 2 * c * s * b + s * s * d
        w11 = s * s * a + 2 * c * s * b + c * c * d
        w01 = c * s * (a - d) + (c * c - s * s) * b
        gx, gy = w00 * ex + w01 * ey, w01 * ex + w11 * ey
        total += gx * ex + gy * ey
        p0, p1 = -w00 * dy + w01 * dx, -w01 * dy + w11 * dx
        xi[i, 0] += gx
        xi[i, 1] += gy
        xi[i, 2] += -dy * gx + dx * gy
        xi[j, 0] -= gx
        xi[j, 1] -= gy
        V = values[at_pose[k]]
        V[0, 0] += w00
        V[0, 1] += w01
        V[1, 0] += w01
        V[1, 1] += w11
        V[0, 2] += p0
        V[2, 0] += p0
        V[1, 2] += p1
        V[2, 1] += p1
        V[2, 2] += -dy * p0 + dx * p1
        V = values[at_landmark[k]]
        V[0, 0] += w00
        V[0, 1] += w01
        V[1, 0] += w01
        V[1, 1] += w11
        V = values[at_pair[k]]
        V[0, 0] -= w00
        V[0, 1] -= w01
        V[1, 0] -= w01
        V[1, 1] -= w11
        if i < j:
            V[2, 0] -= p0
            V[2, 1] -= p1
        else:
            V[0, 2] -= p0
            V[1, 2] -= p1
    return total


@njit(cache=True, inline="always")
def _wrap(angle):  # type: ignore[no-untyped-def]
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(cache=True, inline="always")
def _arm(theta, offset):  # type: ignore[no-untyped-def]
    """R(theta) o: from the robot's pose to its sensor, in world axes."""
    c, s = np.cos(theta), np.sin(theta)
    return c * offset[0] - s * offset[1], s * offset[0] + c * offset[1]
