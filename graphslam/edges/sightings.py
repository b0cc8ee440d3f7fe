"""`SightingEdges`, the base of all edges that come from sightings, and sightings grouped by landmark.

Every sighting places its landmark at y = h^-1(x, z) with covariance C = R Q R'. When the pose rotates, y moves by the
lever t = (-v_y, v_x) per radian, where v leads from the pose to the landmark. It is l (cos, sin)(theta + phi), plus
R(theta) o where the sensor sits at o on the robot.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..errors import GraphError
from ..models import SensorModel
from ..se2 import Array, perpendicular
from .base import EdgeFamily, EngineEdges, Relations
from .robust import Kernel, code_and_width

Self = TypeVar("Self", bound="SightingEdges")

#: the least trust: a landmark all of whose sightings are wrong must still be somewhere
NO_TRUST = 1e-9


class SightingEdges(EdgeFamily):
    """Edges that come from sightings (M, 2 or 3) by a sensor.

    ``kernel`` is the robust kernel of every edge, or None for plain squares; its default width is that for the dimension
    of a sighting. ``trust`` (M,) is a factor from 0 to 1 on
    the information of each sighting, or None for 1; graduated non-convexity sets it. 0 counts as `NO_TRUST`.
    """

    sightings: Array
    sensor: SensorModel
    kernel: Kernel | None
    trust: Array | None
    noise_at: Array | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kernel is not None:
            object.__setattr__(self, "kernel", self.kernel.of_dimension(self.sightings.shape[1]))

    def with_trust(self: Self, trust: Array | None) -> Self:
        """The same edges with another factor (M,) on the information of each sighting."""
        return replace(self, trust=trust)  # type: ignore[type-var]

    @cached_property
    def trusted(self) -> Array:
        """The trust (M,) that the edges work with."""
        return np.ones(len(self.sightings)) if self.trust is None else np.maximum(self.trust, NO_TRUST)

    @property
    def noisy(self) -> Array:
        """The sightings (M, 2 or 3) at which the covariance is evaluated."""
        return self.sightings if self.noise_at is None else self.noise_at

    @property
    def oriented(self) -> bool:
        """Whether the sightings measure psi."""
        return self.sightings.shape[1] == 3

    def kernel_weights(self, state: Array) -> Array:
        """The weight (E,) that the kernel gives each edge at a state, 1 without a kernel."""
        squares = self.linearize(state, state).mahalanobis
        return np.ones(len(squares)) if self.kernel is None else self.kernel.weight(squares)

    def weighted_cost(self, state: Array) -> float:
        if self.kernel is None:
            return self.cost(state, state)
        return float(self.linearize(state, state).mahalanobis @ self.kernel_weights(state))

    @property
    def information_per_weight(self) -> float:
        return 1.0 if self.kernel is None else self.kernel.information_per_weight(self.sightings.shape[1])

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
