"""Edges from a pose to a landmark that is a node of the graph: what both forms of the residual share.

`edges.cartesian` has the sighting as a position in the robot's axes, `edges.polar` as range and bearing. The number of
these edges is linear in the number of sightings. A landmark without heading uses the first two coordinates of its node;
`Graph.linearize` keeps the third coordinate constant.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from ..models import SensorModel
from ..se2 import Array
from .base import PairEdges, Relations
from .robust import Kernel
from .sightings import SightingEdges


@dataclass(frozen=True, eq=False)
class ObservationEdges(PairEdges, SightingEdges):
    """Sightings (M, 2 or 3) of landmark nodes ``second`` (M,) from pose nodes ``first`` (M,).

    ``kernel``, ``trust`` and ``noise_at`` are those of `SightingEdges`.
    """

    sightings: Array
    sensor: SensorModel
    _: KW_ONLY
    kernel: Kernel | None = None
    trust: Array | None = None
    noise_at: Array | None = None

    @property
    def numbers(self) -> tuple[int, float]:
        return self.sightings.size, float(self.sightings.shape[1] * np.sum(self.trusted))

    def headings(self) -> Relations | None:
        if not self.oriented:
            return None
        variance = self.sensor.bearing_std**2 + self.sensor.orientation_std**2
        facing = self.sightings[:, 1] - self.sightings[:, 2]
        return Relations(self.first, self.second, facing, np.full(self.count, 1 / variance))

    def positions(self, state: Array) -> Relations | None:
        x = state[self.first]
        at_origin = np.column_stack([np.zeros((self.count, 2)), x[:, 2]])
        offset = self.sensor.h_inverse(at_origin, self.sightings[:, :2])
        information = np.linalg.inv(self.sensor.landmark_covariance(x, self.noisy[:, :2]))
        return Relations(self.first, self.second, offset, information)
