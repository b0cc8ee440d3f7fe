"""`SightingEdges`, the base of all edges that come from sightings, and sightings grouped by landmark.

Every sighting places its landmark at y = h^-1(x, z) with covariance C = R Q R'. When the pose rotates, y moves by the
lever t = (-v_y, v_x) per radian, where v leads from the pose to the landmark. It is l (cos, sin)(theta + phi), plus
R(theta) o where the sensor sits at o on the robot.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import GraphError
from ..models import SensorModel
from ..se2 import Array, perpendicular
from .base import EngineEdges, Relations
from .doubted import DoubtedEdges
from .robust import Kernel, code_and_width


class SightingEdges(DoubtedEdges):
    """Edges that come from sightings (M, 2 or 3) by a sensor. ``noise_at`` (M, 2 or 3), or None, gives their covariance."""

    sightings: Array
    sensor: SensorModel
    noise_at: Array | None

    @property
    def dimension(self) -> int:
        return self.sightings.shape[1]

    @property
    def measurements(self) -> int:
        return len(self.sightings)

    @property
    def noisy(self) -> Array:
        """The sightings (M, 2 or 3) at which the covariance is evaluated."""
        return self.sightings if self.noise_at is None else self.noise_at

    @property
    def oriented(self) -> bool:
        """Whether the sightings measure psi."""
        return self.sightings.shape[1] == 3

    def _check_constant(self, frame: str) -> None:
        """Raise `GraphError` unless the information of the sightings is constant, but for a kernel: in the body frame."""
        if frame == "world":
            raise GraphError("the information of edges in the world frame depends on the state; use frame='body'")

    @property
    def _for_engine(self) -> tuple[Any, ...]:
        """The sightings, those at which the covariance is evaluated, the trust, the sensor, the kernel's code and width.

        The sensor is given by the variances of the range (by l², and constant), of phi and psi, and its place on the robot.
        """
        s = self.sensor
        sensor = (s.range_rate**2, s.range_std**2, s.bearing_std**2, s.orientation_std**2, *s.offset)
        return self.sightings, self.noisy, self.trusted, sensor, *code_and_width(self.kernel)


@dataclass(frozen=True, eq=False)
class LandmarkSightings(SightingEdges, EngineEdges):
    """Sightings grouped by landmark.

    Args:
        starts: (G+1,); landmark g has the sightings ``starts[g]`` to ``starts[g+1]``, by increasing node.
        nodes: (M,) the node each sighting was made from.
        sightings: (M, 2 or 3).
        sensor: gives Q.
        frame: "world" or "body".
        kernel, trust, noise_at: see `SightingEdges`.
    """

    starts: np.ndarray
    nodes: np.ndarray
    sightings: Array
    sensor: SensorModel
    _: KW_ONLY
    frame: str = "body"
    kernel: Kernel | None = None
    trust: Array | None = None
    noise_at: Array | None = None

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return self.starts, self.nodes

    @property
    def numbers(self) -> tuple[int, float]:
        # the landmark itself takes the numbers of one sighting
        count = self.sightings.shape[1] * int(np.sum(np.diff(self.starts) - 1))
        return count, count

    @cached_property
    def group(self) -> np.ndarray:
        """The landmark (M,) of each sighting, from 0 to G-1."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def placed(self, state: Array) -> tuple[Array, Array]:
        """The landmarks y = h^-1(x, z) (M, 3) of the sightings at a state, and the levers t (M, 2)."""
        poses = state[self.nodes]
        y = np.zeros((len(poses), 3))
        y[:, : self.sightings.shape[1]] = self.sensor.h_inverse(poses, self.sightings)
        return y, perpendicular(y[:, :2] - poses[:, :2])

    def headings(self) -> Relations | None:
        # consecutive sightings of a landmark only: an initial state needs no more
        if not self.oriented:
            return None
        a, b, first, second = self._consecutive
        # theta + phi - psi is the landmark's heading
        facing = self.sightings[:, 1] - self.sightings[:, 2]
        variance = 2 * (self.sensor.bearing_std**2 + self.sensor.orientation_std**2)
        return Relations(first, second, facing[a] - facing[b], np.full(len(a), 1 / variance))

    def positions(self, state: Array) -> Relations | None:
        a, b, first, second = self._consecutive
        y, _ = self.placed(state)
        towards = y[:, :2] - state[self.nodes, :2]
        covariance = self.sensor.landmark_covariance(state[self.nodes], self.noisy)[:, :2, :2]
        return Relations(first, second, towards[a] - towards[b], np.linalg.inv(covariance[a] + covariance[b]))

    @cached_property
    def _consecutive(self) -> tuple[np.ndarray, ...]:
        """Sightings of a landmark that follow each other from different nodes, first and second, and their nodes."""
        a = np.flatnonzero((self.group[1:] == self.group[:-1]) & (self.nodes[1:] != self.nodes[:-1]))
        return a, a + 1, self.nodes[a], self.nodes[a + 1]

    @cached_property
    def _place(self) -> Array:
        """The landmark (M, 2 or 3) that each sighting measures, in the frame of the pose."""
        return self.sensor.h_inverse(np.zeros((len(self.nodes), 3)), self.sightings)
