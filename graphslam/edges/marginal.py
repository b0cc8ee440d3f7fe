"""Marginal edges: each landmark as a variable, eliminated. Every sighting counts exactly once.

With y_a = h^-1(x_a, z_a) and W_a = (R_a Q_a R_a')^-1 a landmark m costs

    min over m of sum over a of (m - y_a)' W_a (m - y_a),   at  m̂ = S^-1 sum W_a y_a,   S = sum W_a,

and connects all poses that saw it by one clique. With e_a = m̂ - y_a and its Jacobian B_a = de_a/dx_a = -[I, t_a; 0, 1]
it adds

    B_a' W_a B_a  to the diagonal,   -U_a S^-1 U_b'  to every pair of poses, U_a = B_a' W_a,   -B_a' W_a e_a  to xi:

the Schur complement of the landmark. The information is blkdiag(W) - [W_a S^-1 W_b], which is no sum of pair terms.

``frame`` decides about W_a, which rotates with its own pose. ``world`` evaluates it at the reference state and keeps it
fixed. In ``body`` it rotates with the pose during a step, so that the information in the axes of the sighting is constant,
with psi or without, and the derivative of the rotation, (-e_y, e_x), is added to t_a.

Headings wrap: every e_a is taken in [-pi, pi) about m̂ itself. The search for m̂ starts at the circular mean of the
headings, so that the result does not depend on the order of the sightings.

A robust kernel acts on each sighting, and m̂ is then the robust mean. The optimum is the same as with a landmark node
and the kernel on each of its edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine import engine
from ..precision import inverses
from ..se2 import Array, perpendicular
from .base import ConstantEdges, Linearization, linearization
from .sightings import LandmarkSightings

#: which of the six numbers of a symmetric matrix stands where
_SYMMETRIC = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])


@dataclass(frozen=True, eq=False)
class MarginalEdges(LandmarkSightings):
    """One clique for each landmark; see `LandmarkSightings` for the arguments."""

    @property
    def count(self) -> int:
        return len(self.nodes)

    @property
    def state_dependent_information(self) -> bool:
        return self.frame == "world"

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The sightings one by one, as edges to their landmark, which is held at m̂; in world axes."""
        e, W, factor, lever, _, _ = self._around_means(state, reference)
        d = self.sightings.shape[1]
        information = (W * factor[:, None])[:, _SYMMETRIC][:, :d, :d]
        return linearization((self.nodes,), e, information, (self._effective(lever, e),))

    def constant(self, state: Array) -> ConstantEdges:
        """The sightings one by one, as edges to landmark nodes: the marginal cost is the minimum over these nodes."""
        self._check_constant(self.frame)
        _, _, factor, _, means, _ = self._around_means(state, state)
        place, covariance = self.sensor.places(self.sightings, noisy=self.noisy)
        information = np.linalg.inv(covariance) * factor[:, None, None]
        turn, start = place[:, 2] if self.oriented else None, place[:, :2]
        second = len(state) + self.group
        return ConstantEdges(self.nodes, second, start, np.zeros_like(start), turn, information, means)

    def kernel_weights(self, state: Array) -> Array:
        _, _, factor, *_ = self._around_means(state, state)
        return factor / self.trusted

    def weighted_cost(self, state: Array) -> float:
        # the information of the linearisation has the weights already
        return float(self.linearize(state, state).mahalanobis.sum())

    def landmarks(self, state: Array, reference: Array) -> Array:
        """m̂ (G, 3) of each landmark, the third column zero without psi."""
        return self._around_means(state, reference)[4]

    def squares(self, state: Array, reference: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting about m̂, without kernel and trust on the sighting itself."""
        e, W, *_ = self._around_means(state, reference)
        return np.einsum("mi,mij,mj->m", e, W[:, _SYMMETRIC], e)

    def map(self, poses: Array) -> tuple[Array, Array]:
        """m̂ (G, d) of each landmark, and its covariance given the poses (G, d, d): (s sum of w Omega)^-1.

        w is the trust times the weight that the kernel gives the sighting at m̂, and s is `information_per_weight`.

        Raises:
            GraphError: the sum is singular to double precision.
        """
        _, W, factor, _, means, _ = self._around_means(poses, poses)
        d = self.sightings.shape[1]
        information = np.add.reduceat(W * factor[:, None], self.starts[:-1], axis=0)[:, _SYMMETRIC][:, :d, :d]
        remedy = "the sightings of this landmark do not determine it; change the noise of the sensor"
        return means[:, :d], inverses(self.information_per_weight * information, "landmark", remedy)

    def _to_engine(self) -> Any:
        return engine.MarginalEdges(self.starts, self.nodes, *self._for_engine, self.frame == "body")

    def _around_means(self, state: Array, reference: Array) -> tuple[Array, Array, Array, Array, Array, float]:
        """e (M, 3), W (M, 6), its factor of trust and kernel (M,), the lever (M, 2), m̂ (G, 3) and the cost."""
        return self.in_engine.around_means(state, reference)

    def _effective(self, lever: Array, e: Array) -> Array:
        """The lever (M, 2), including the derivative of the rotation of W."""
        return lever if self.frame == "world" else lever + perpendicular(e[:, :2])
