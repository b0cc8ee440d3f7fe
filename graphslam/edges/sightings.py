"""The sightings of many landmarks, landmark by landmark: what virtual-motion edges and marginal ones have in common.

Every sighting puts its landmark at y = h^-1(x, z) with covariance C = R Q R'. Turning the pose moves y by the lever t =
(-v_y, v_x), where v leads from the pose to the landmark: l (cos, sin)(theta + phi), and R(theta) o before it where the
sensor sits at o on the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numba import njit

from ..models import SensorModel
from ..se2 import Array, wrap
from .base import Relations
from .robust import Kernel, code_and_width

Self = TypeVar("Self", bound="LandmarkSightings")

#: how `prepare` treats the covariance: at the reference; in the landmark's own axes; at the reference, but turning along
WORLD, BODY, BODY_WITHOUT_PSI = 0, 1, 2


#: the least trust: a landmark all of whose sightings are wrong must still be somewhere
NO_TRUST = 1e-9


def trusted(trust: Array | None, count: int) -> Array:
    """The trust (M,) that the kernels work with."""
    return np.ones(count) if trust is None else np.maximum(trust, NO_TRUST)


@dataclass(frozen=True, eq=False)
class LandmarkSightings:
    """Sightings grouped by landmark.

    Args:
        starts: (G+1,); landmark g has the sightings ``starts[g]`` to ``starts[g+1]``, by increasing node.
        nodes: (M,) the node each sighting was made from.
        sightings: (M, 2 or 3).
        sensor: gives Q.
        frame: "world" or "body".
        kernel: the robust kernel of every edge, or None for plain squares.
        trust: (M,) a factor from 0 to 1 on the information of each sighting, or None for 1; 0 counts as `NO_TRUST`.
    """

    starts: np.ndarray
    nodes: np.ndarray
    sightings: Array
    sensor: SensorModel
    frame: str
    kernel: Kernel | None = None
    trust: Array | None = None

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """The nodes that saw a landmark; see `EdgeFamily.cliques`."""
        return self.starts, self.nodes

    def with_trust(self: Self, trust: Array | None) -> Self:
        """The same edges with another factor (M,) on the information of each sighting."""
        return replace(self, trust=trust)

    @property
    def _oriented(self) -> bool:
        return self.sightings.shape[1] == 3

    @cached_property
    def group(self) -> np.ndarray:
        """The landmark (M,) of each sighting, from 0 to G-1."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def placed(self, state: Array) -> tuple[Array, Array, Array]:
        """Per sighting at a state: y = h^-1(x, z) (M, 3), the lever t (M, 2), and gamma (M,) of the psi-given axes."""
        poses = state[self.nodes]
        direction = poses[:, 2] + self.sightings[:, 1]
        lever = self.sightings[:, :1] * np.column_stack([-np.sin(direction), np.cos(direction)])
        if not self.sensor.centred:
            arm = self.sensor.mount(poses)[:, :2] - poses[:, :2]
            lever += np.column_stack([-arm[:, 1], arm[:, 0]])
        y = np.zeros((len(poses), 3))
        y[:, 0], y[:, 1] = poses[:, 0] + lever[:, 1], poses[:, 1] - lever[:, 0]
        if self._oriented:
            y[:, 2] = wrap(direction - self.sightings[:, 2])
        return y, lever, y[:, 2]

    def headings(self) -> Relations | None:
        """See `EdgeFamily.headings`. Consecutive sightings of a landmark only: a start needs no more."""
        if not self._oriented:
            return None
        a, b = self._consecutive()
        # theta + phi - psi is the landmark's heading
        facing = self.sightings[:, 1] - self.sightings[:, 2]
        variance = 2 * (self.sensor.bearing_std**2 + self.sensor.orientation_std**2)
        return Relations(self.nodes[a], self.nodes[b], facing[a] - facing[b], np.full(len(a), 1 / variance))

    def positions(self, state: Array) -> Relations | None:
        """See `EdgeFamily.positions`. Consecutive sightings of a landmark only."""
        a, b = self._consecutive()
        _, lever, _ = self.placed(state)
        # the vector from the pose to the landmark is the lever turned back by a quarter
        towards = np.column_stack([lever[:, 1], -lever[:, 0]])
        covariance = self.sensor.landmark_covariance(state[self.nodes], self.sightings)[:, :2, :2]
        information = np.linalg.inv(covariance[a] + covariance[b])
        return Relations(self.nodes[a], self.nodes[b], towards[a] - towards[b], information)

    def _consecutive(self) -> tuple[np.ndarray, np.ndarray]:
        a = np.flatnonzero((self.group[1:] == self.group[:-1]) & (self.nodes[1:] != self.nodes[:-1]))
        return a, a + 1

    def _prepared(self, state: Array, reference: Array, mode: int) -> tuple[Array, Array, Array, Array]:
        """y (M, 3), lever (M, 2), gamma (M,) and C (M, 6) of the sightings; see `prepare`."""
        s = self.sensor
        variances = (s.range_rate**2, s.bearing_std**2, s.orientation_std**2, s.range_std**2)
        return prepare(state, reference, self.nodes, self.sightings, variances, s.offset, mode)

    @property
    def trusted(self) -> Array:
        """The trust (M,) that the edges work with."""
        return trusted(self.trust, len(self.nodes))

    @cached_property
    def _robust(self) -> tuple[int, float, Array]:
        """The kernel's code and width, and the trust (M,)."""
        return *code_and_width(self.kernel), self.trusted

    @cached_property
    def _by_node(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sightings by node: their order (M,), the start of each node (last node + 2,), their landmarks (M,)."""
        order = np.argsort(self.nodes, kind="stable")
        last = int(self.nodes.max(initial=-1))
        return (
            order,
            np.searchsorted(self.nodes[order], np.arange(last + 2)),
            self.group,
        )


@njit(cache=True, error_model="numpy")
def prepare(state, reference, nodes, z, variances, offset, mode):  # type: ignore[no-untyped-def]
    """y, the lever t, gamma and C = (c_xx, c_xy, c_yy, c_xt, c_yt, c_tt) of each sighting."""
    count, oriented = len(nodes), z.shape[1] == 3
    y, lever, gamma, C = np.zeros((count, 3)), np.empty((count, 2)), np.zeros(count), np.zeros((count, 6))
    for k in range(count):
        x, l = state[nodes[k]], z[k, 0]  # noqa: E741  # the slides' letter for the range
        direction = x[2] + z[k, 1]
        c, s = np.cos(direction), np.sin(direction)
        vx, vy = l * c, l * s
        if offset[0] != 0 or offset[1] != 0:
            ct, st = np.cos(x[2]), np.sin(x[2])
            vx += ct * offset[0] - st * offset[1]
            vy += st * offset[0] + ct * offset[1]
        lever[k, 0], lever[k, 1] = -vy, vx
        y[k, 0], y[k, 1] = x[0] + vx, x[1] + vy
        if oriented:
            y[k, 2] = direction - z[k, 2]
        if mode == BODY:
            gamma[k] = y[k, 2]
            c, s = np.cos(z[k, 2]), np.sin(z[k, 2])
        else:
            before = reference[nodes[k], 2]
            if mode == BODY_WITHOUT_PSI:
                gamma[k] = x[2] - before
            if before != x[2]:
                c, s = np.cos(before + z[k, 1]), np.sin(before + z[k, 1])
        # R Q R' with R = [[c, -l s, 0], [s, l c, 0], [0, 1, -1]]
        along, across = variances[0] * l * l + variances[3], variances[1] * l * l
        C[k, 0] = along * c * c + across * s * s
        C[k, 1] = (along - across) * c * s
        C[k, 2] = along * s * s + across * c * c
        if oriented:
            C[k, 3], C[k, 4] = -variances[1] * l * s, variances[1] * l * c
            C[k, 5] = variances[1] + variances[2]
    return y, lever, gamma, C


@njit(cache=True, error_model="numpy", inline="always")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """`se2.wrap` for the kernels."""
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))
