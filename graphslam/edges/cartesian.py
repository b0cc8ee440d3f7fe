"""Sightings of landmark nodes as positions in the robot's axes, o + l (cos phi, sin phi) with o the sensor's offset:

    e = (R(theta)' (m - p) - o - l (cos phi, sin phi),  theta_m - theta - (phi - psi)),   Omega^-1 = L Q L',

the second part, wrapped, only with psi. L = dh^-1/dz at theta = 0 and the measured range, so the information is constant:
it is the lectures' R Q R', turned into the robot's axes. So these are the edges of `edges.relative`, with the kernels and
the trust of sightings. With the landmarks eliminated they become the marginal edges. The residual is linear in the
positions, and defined everywhere, so the cost has no false minima where a pose lies on a landmark.

``frame="world"`` keeps e in world axes, m - h^-1(x, z), and evaluates R Q R' at the reference state.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..se2 import Array
from .base import ConstantEdges, EngineEdges, Linearization
from .observation import ObservationEdges
from .relative import RobustPointEdges, RobustPoseEdges


@dataclass(frozen=True, eq=False)
class CartesianObservationEdges(ObservationEdges, EngineEdges):
    """Sightings of landmark nodes with the residual in the plane; see `ObservationEdges` for the other arguments.

    Args:
        frame: "body" (the robot's axes, constant information) or "world".
    """

    frame: str = field(default="body", kw_only=True)

    @cached_property
    def relative(self) -> RobustPointEdges | RobustPoseEdges:
        """The same edges as landmarks measured in the robot's axes, the trust in their information."""
        at_origin = np.zeros((self.count, 3))
        measured = self.sensor.h_inverse(at_origin, self.sightings)
        information = np.linalg.inv(self.sensor.landmark_covariance(at_origin, self.noisy))
        information = (information + np.swapaxes(information, 1, 2)) / 2 * self.trusted[:, None, None]
        edges = RobustPoseEdges if self.oriented else RobustPointEdges
        return edges(self.first, self.second, measured, information, frame=self.frame, kernel=self.kernel)

    @property
    def state_dependent_information(self) -> bool:
        return self.relative.state_dependent_information

    def linearize(self, state: Array, reference: Array) -> Linearization:
        return self.relative.linearize(state, reference)

    def constant(self, state: Array) -> ConstantEdges:
        self._check_constant(self.frame)
        edges = self.relative.constant(state)
        weights = self.kernel_weights(state)[:, None, None]
        return edges if self.kernel is None else replace(edges, information=edges.information * weights)

    def _to_engine(self) -> Any:
        return self.relative.in_engine
