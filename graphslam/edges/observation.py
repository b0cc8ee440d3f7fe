"""Edges from a pose to a landmark that is a node of the graph, with the Cartesian or the polar residual.

The number of these edges is linear in the number of sightings. A landmark without heading uses the first two coordinates
of its node; `Graph.linearize` keeps the third coordinate constant.

Cartesian: the sighting is a position in the robot's axes, o + l (cos phi, sin phi) with o the sensor's offset:

    e = (R(theta)' (m - p) - o - l (cos phi, sin phi),  theta_m - theta - (phi - psi)),   Omega^-1 = L Q L',

the second part, wrapped, only with psi. L = dh^-1/dz at theta = 0 and the measured range, so the information is constant:
it is the lectures' R Q R', turned into the robot's axes. So these are the edges of `edges.relative`, with the kernels and
the trust of sightings. With the landmarks eliminated they become the marginal edges. The residual is linear in the
positions, and defined everywhere, so the cost has no false minima where a pose lies on a landmark. ``frame="world"`` keeps
e in world axes, m - h^-1(x, z), and evaluates R Q R' at the reference state.

Polar: e = h(x, m) - z, with the information Q^-1 at the measured range. This is the likelihood of a sensor with Gaussian
noise. Its cost has false minima: where a pose comes to lie on a landmark the bearing is undefined. Start it from the
optimum of the Cartesian residual.

`RangeEdges` and `BearingEdges` are sightings with one number: the range or the bearing of a landmark that is a node, the
other one not measured. With s = p + R(theta) o the place of the sensor and (x, y) = R(theta)' (m - s) the landmark in its
axes,

    range    e = abs(m - s) - l,                        Omega = 1 / ((range_rate l)² + range_std²)
    bearing  e = atan2(y, x) - phi,   the angle wrapped,   Omega = 1 / bearing_std²

One range leaves a circle, and two a pair of mirror images: the cost has more than one minimum, which
`solvers.initialize` searches.

They cannot be certified as other edges are, by a quadratic form that touches the cost from below. With d = abs(m - s) and a
residual e* at the candidate, a form below (d - l)² that touches it at d* has a weight of at most (d* - l) / d* = e* / d* on
d²: with more it is above the cost behind the sensor. Where the ranges of a landmark are too long on average, the sum of these
weights is negative, and so is the matrix S in the direction of the landmark. A form that touches the square of a bearing's
residual, which does not depend on d, has a weight below 0 on d² unless e* = 0: along the ray it must stay below a constant.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..linear.precision import inverses
from ..models import SensorModel
from ..se2 import Array, mounted, perpendicular, wrap
from .base import EngineEdges, FramedEdges, Linearization, PairEdges, check_rows
from .relative import DoubtedPointEdges, RelationEdges
from .robust import SingleEdges, code_and_width
from .sightings import SightingEdges, check_sightings


@dataclass(frozen=True, eq=False, repr=False)
class ObservationEdges(PairEdges, SightingEdges):
    """Sightings (M, 2 or 3) of landmark nodes ``second`` (M,) from pose nodes ``first`` (M,).

    ``kernel``, ``trust`` and ``noise_at`` are those of `SightingEdges`.
    """

    sightings: Array
    sensor: SensorModel
    noise_at: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_sightings(self, len(self.first))
        super().__post_init__()

    def predicted(self, state: Array) -> Array:
        return self.sensor.h(state[self.first], state[self.second][:, : self.dimension])


@dataclass(frozen=True, eq=False, repr=False)
class CartesianObservationEdges(ObservationEdges, FramedEdges):
    """Sightings of landmark nodes with the residual in the plane; see `ObservationEdges` for the other arguments.

    Args:
        frame: "body" (the robot's axes, constant information) or "world".
    """

    @cached_property
    def relative(self) -> DoubtedPointEdges | RelationEdges:
        """The same edges as landmarks measured in the robot's axes, the trust in their information."""
        measured, covariance = self.sensor.places(self.sightings, noisy=self.noisy)
        information = inverses(covariance, "sighting", "check the noise of the sensor") * self.trusted[:, None, None]
        edges = RelationEdges if self.oriented else DoubtedPointEdges
        return edges(self.first, self.second, measured, information, frame=self.frame, kernel=self.kernel)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        return self.relative.linearize(state, reference)

    def _to_engine(self) -> Any:
        return self.relative.in_engine


@dataclass(frozen=True, eq=False, repr=False)
class PolarObservationEdges(ObservationEdges, EngineEdges):
    """Sightings of landmark nodes with the residual h(x, m) - z; see `ObservationEdges` for the arguments."""

    @property
    def cartesian(self) -> CartesianObservationEdges:
        """The same sightings with the Cartesian residual, in the body frame."""
        return CartesianObservationEdges(
            self.first, self.second, self.sightings, self.sensor,
            kernel=self.kernel, trust=self.trust, noise_at=self.noise_at,
        )  # fmt: skip

    def linearize(self, state: Array, reference: Array) -> Linearization:
        d = self.sightings.shape[1]
        x, m = state[self.first], state[self.second][:, :d]
        residuals = self.sensor.h(x, m) - self.sightings
        residuals[:, 1:] = wrap(residuals[:, 1:])
        by_landmark = np.zeros((self.count, d, 3))
        by_landmark[:, :, :d] = self.sensor.H(x, m)
        information = np.linalg.inv(self.sensor.Q(self.noisy)) * self.trusted[:, None, None]
        return Linearization(residuals, information, (self.first, self.second), (self.sensor.H_pose(x, m), by_landmark))

    def check_constant(self) -> None:
        raise GraphError("the residual h(x, m) - z of landmark nodes has no such form; use residual='cartesian'")

    def _to_engine(self) -> Any:
        return engine.PolarEdges(self.first, self.second, *self._for_engine)


#: a landmark that comes nearer to the sensor than this [m] has no direction; derivatives are taken as from this distance
NEAREST = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class PartialEdges(SingleEdges, PairEdges, EngineEdges):
    """Numbers (E, 1) measured of landmark nodes ``second`` (E,) from poses ``first`` (E,), with information (E, 1, 1).

    ``offset`` (2,) is the place of the sensor on the robot; ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """

    measured: Array
    information: Array
    offset: Array
    shared: ClassVar[tuple[str, ...]] = ("offset",)

    def __post_init__(self) -> None:
        check_rows(self, measured=(self.count, 1), information=(self.count, 1, 1))
        super().__post_init__()

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

    #: why the certificate does not cover them
    _unproven: ClassVar[str] = ""

    def check_constant(self) -> None:
        raise GraphError(self._unproven)

    def _to_engine(self) -> Any:
        numbers = self.measured, self.weighed, tuple(self.offset)
        bearing = isinstance(self, BearingEdges)
        return engine.NumberEdges(bearing, self.first, self.second, *numbers, *code_and_width(self.kernel))


class RangeEdges(PartialEdges):
    """Ranges l [m]; see the module."""

    _unproven = (
        "ranges alone have no form with constant information, and a quadratic form that touches their cost from below has a "
        "negative weight on the distance wherever a range is measured too long"
    )

    def residuals(self, sensors: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        away = landmarks - sensors[:, :2]
        distance = np.hypot(away[..., 0], away[..., 1])
        unit = away / np.maximum(distance, NEAREST)[..., None]
        return distance - self.measured[:, 0], unit, np.zeros(self.count)


class BearingEdges(PartialEdges):
    """Bearings phi [rad]; see the module."""

    _unproven = (
        "bearings alone have no form with constant information, and a quadratic form that touches their cost from below has "
        "a negative weight on the distance wherever a residual is not zero"
    )

    def residuals(self, sensors: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        away = landmarks - sensors[:, :2]
        square = np.maximum(np.sum(away**2, axis=-1), NEAREST**2)
        e = wrap(np.arctan2(away[..., 1], away[..., 0]) - sensors[:, 2] - self.measured[:, 0])
        return e, perpendicular(away) / square[..., None], np.full(self.count, -1.0)
