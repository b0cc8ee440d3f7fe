"""Sightings with one number: the range or the bearing of a landmark that is a node, the other one not measured.

With s = p + R(theta) o the place of the sensor and (x, y) = R(theta)' (m - s) the landmark in its axes,

    range    e = abs(m - s) - l,                        Omega = 1 / ((range_rate l)² + range_std²)
    bearing  e = atan2(y, x) - phi,   the angle wrapped,   Omega = 1 / bearing_std²

One range leaves a circle, and two a pair of mirror images: the cost has more than one minimum, which
`solvers.mirror_images` searches. The residuals have no form with constant information, so they cannot be certified.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from ..errors import GraphError
from ..linear.information import BlockSystem
from ..se2 import Array, mounted, perpendicular, wrap
from .base import ConstantEdges, Linearization, PairEdges
from .doubted import SingleEdges
from .robust import Kernel

#: a landmark that comes nearer to the sensor than this [m] has no direction; derivatives are taken as from this distance
NEAREST = 1e-6


@dataclass(frozen=True, eq=False)
class PartialEdges(SingleEdges, PairEdges):
    """Numbers (E, 1) measured of landmark nodes ``second`` (E,) from poses ``first`` (E,), with information (E, 1, 1).

    ``offset`` (2,) is the place of the sensor on the robot; ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """

    measured: Array
    information: Array
    offset: Array
    _: KW_ONLY
    kernel: Kernel | None = None
    trust: Array | None = None

    def residuals(self, sensors: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """e (..., E) of landmarks (..., E, 2) from the places of sensors (E, 3), de/dm (..., E, 2) and de/dtheta (E,).

        de/dtheta is that of the direction of the sensor alone, as if it stood on the robot's pose.
        """
        raise NotImplementedError

    def linearize(self, state: Array, reference: Array) -> Linearization:
        poses = state[self.first]
        sensors = mounted(poses, tuple(self.offset))
        e, by_landmark, by_turn = self.residuals(sensors, state[self.second, :2])
        A, B = np.zeros((self.count, 1, 3)), np.zeros((self.count, 1, 3))
        B[:, 0, :2], A[:, 0, :2] = by_landmark, -by_landmark
        # the sensor moves by the lever R(theta) (-o_y, o_x) when the robot turns
        lever = perpendicular(sensors[:, :2] - poses[:, :2])
        A[:, 0, 2] = by_turn - np.einsum("ei,ei->e", by_landmark, lever)
        return Linearization(e[:, None], self.weighed, (self.first, self.second), (A, B))

    def accumulate(self, state: Array, reference: Array, system: BlockSystem | None) -> float:
        edges = self.linearize(state, reference)
        squares = edges.mahalanobis
        if system is not None:
            A, B = (jacobian[:, 0] for jacobian in edges.jacobians)
            w = edges.information[:, 0, 0]
            if self.kernel is not None:
                w = w * self.kernel.weight(squares)
            first, second, pairs = system.slots_of(self.first, self.second)
            # landmarks come after poses, so that the upper block of a pair has the pose's rows
            for slots, left, right in ((first, A, A), (second, B, B), (pairs, A, B)):
                np.add.at(system.values, slots, w[:, None, None] * left[:, :, None] * right[:, None, :])
            pull = w * edges.residuals[:, 0]
            np.add.at(system.xi, self.first, -pull[:, None] * A)
            np.add.at(system.xi, self.second, -pull[:, None] * B)
        return float(np.sum(squares if self.kernel is None else self.kernel.loss(squares)))

    def constant(self, state: Array) -> ConstantEdges:
        raise GraphError("ranges and bearings alone have no form with constant information")


class RangeEdges(PartialEdges):
    """Ranges l [m]; see the module."""

    def residuals(self, sensors: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        away = landmarks - sensors[:, :2]
        distance = np.hypot(away[..., 0], away[..., 1])
        unit = away / np.maximum(distance, NEAREST)[..., None]
        return distance - self.measured[:, 0], unit, np.zeros(self.count)


class BearingEdges(PartialEdges):
    """Bearings phi [rad]; see the module."""

    def residuals(self, sensors: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        away = landmarks - sensors[:, :2]
        square = np.maximum(np.sum(away**2, axis=-1), NEAREST**2)
        e = wrap(np.arctan2(away[..., 1], away[..., 0]) - sensors[:, 2] - self.measured[:, 0])
        return e, perpendicular(away) / square[..., None], np.full(self.count, -1.0)
