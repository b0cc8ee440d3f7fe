"""Sightings of landmark nodes as range and bearing: e = h(x, m) - z, with the information Q^-1 at the measured range.

This is the likelihood of a sensor with Gaussian noise. Its cost has false minima: where a pose comes to lie on a landmark
the bearing is undefined. `edges.cartesian` has none of them; start from its optimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..se2 import Array, wrap
from .base import ConstantEdges, EngineEdges, Linearization
from .cartesian import CartesianObservationEdges
from .observation import ObservationEdges


@dataclass(frozen=True, eq=False)
class PolarObservationEdges(ObservationEdges, EngineEdges):
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

    def _to_engine(self) -> Any:
        return engine.PolarEdges(self.first, self.second, *self._for_engine)
