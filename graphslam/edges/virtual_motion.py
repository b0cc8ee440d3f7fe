"""Virtual-motion edges: two sightings of one landmark connect the two poses from which they were made.

Every sighting places the landmark at y_a = h^-1(x_a, z_a), with covariance C_a = R_a Q_a R_a'. All pairs of sightings of
a landmark from different steps give an edge

    e = y_b - y_a  (heading wrapped),   Omega^-1 = C_a + C_b,   B_a = -[I, t_a; 0, 1],  B_b = [I, t_b; 0, 1],

where B_a and B_b are the Jacobians of e, and t = (-l sin(theta + phi), l cos(theta + phi)) is the derivative of the
position of y with respect to theta. Without psi the heading row is missing. A sensor that sits at o on the robot adds
R(theta) o to y, and R(theta) (-o_y, o_x) to t; C is the same.

``frame`` decides how Omega, which rotates with the poses, is treated:

* ``world``: C is evaluated at the reference state and kept fixed (the lectures).
* ``body`` (axes that move with a node): the residual is in axes that rotate with pose a, in which Omega follows from
  the sightings alone. The natural axes are the landmark's own, because there a sighting comes from direction psi, whatever
  the poses: C_a = L(l_a, psi_a) Q_a L', L(l, d) = [[cos d, -l sin d, 0], [sin d, l cos d, 0], [0, 1, -1]]. (Axes along the
  first sighting, as in `factors`, differ from these by psi_a, a constant, so the cost is the same.) By sighting a, these axes
  have the heading gamma_a = theta_a + phi_a - psi_a in the world. The engine turns e and Omega back into the axes of the
  world: Omega is rotated by gamma_a, e is y_b - y_a, and the derivative of the rotation, (-e_y, e_x), is added to t_a.
  `linearize` leaves them in the rotated axes; the cost is the same.
* ``body`` without psi: the direction between the two sightings is not measured; it is taken from the reference state:
  C is evaluated there, as for ``world``, but then rotates with pose a, gamma_a = theta_a - (theta_a at the reference).
  Therefore the cost does not change when the whole graph is rotated, but the information must be computed again at
  every step.

The number of pairs grows with the square of the sightings per landmark. The solver visits them without listing them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..se2 import Array, difference, perpendicular
from .base import Linearization, linearization
from .sightings import LandmarkSightings

#: the most pairs that `VirtualMotionEdges.constant` lists: some 600 MB
MOST_LISTED = 2_000_000


@dataclass(frozen=True, eq=False, repr=False)
class VirtualMotionEdges(LandmarkSightings):
    """All pairs of sightings of each landmark; see `LandmarkSightings` for the other arguments.

    Args:
        tempered: multiply every pair of a landmark by 2/K, K the number of its sightings (the sum of their trust).

    The trust in an edge is the product of the trust in its two sightings. A kernel acts on the residual r of a pair before
    tempering: the pair costs (2/K) 2 rho(r).
    """

    tempered: bool = field(default=False, kw_only=True)

    @property
    def count(self) -> int:
        return int(self._pairs_of_groups.sum())

    @cached_property
    def _pairs_of_groups(self) -> np.ndarray:
        """The number (G,) of pairs of sightings of each landmark from different poses."""
        seen, alike = np.unique(np.column_stack([self.group, self.nodes]), axis=0, return_counts=True)
        from_one_pose = np.bincount(seen[:, 0], weights=alike**2, minlength=len(self.starts) - 1)
        return (np.diff(self.starts) ** 2 - from_one_pose.astype(np.int64)) // 2

    @property
    def numbers(self) -> tuple[int, float]:
        # every pair of a landmark costs as much as it measures
        factor = 2 / np.diff(self.starts) if self.tempered else 1.0
        return super().numbers[0], self.sightings.shape[1] * float(np.sum(factor * self._pairs_of_groups))

    @property
    def state_dependent_information(self) -> bool:
        # only with psi and in the body frame do the sightings alone give the information
        return super().state_dependent_information or not self.oriented

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All edges listed: sighting a (E,), sighting b (E,), landmark (E,). Large: for inspection, not for solving."""
        edges = [np.stack(np.triu_indices(end - start, k=1)) + start for start, end in pairwise(self.starts.tolist())]
        a, b = np.concatenate([np.zeros((2, 0), dtype=np.int64), *edges], axis=1)
        different = self.nodes[a] != self.nodes[b]
        a, b = a[different], b[different]
        return a, b, self.group[a]

    def covariances(self, reference: Array) -> Array:
        """C (M, d, d) of each sighting in the axes that `frame` uses: the landmark's own, or the reference's world."""
        if self.frame == "world" or not self.oriented:
            return self.sensor.landmark_covariance(reference[self.nodes], self.noisy)
        # a sighting from direction psi in the landmark's axes: R Q R' of a pose whose theta + phi is psi
        facing = np.zeros((len(self.nodes), 3))
        facing[:, 2] = self.noisy[:, 2] - self.noisy[:, 1]
        return self.sensor.landmark_covariance(facing, self.noisy)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The edges one by one; with ``frame="body"`` the residuals are given in the rotated axes."""
        a, b, group = self.pairs()
        y, lever = self.placed(state)
        covariance = self.covariances(reference)
        factor = self.group_weights[group] * self.trusted[a] * self.trusted[b]
        information = np.linalg.inv(covariance[a] + covariance[b]) * factor[:, None, None]
        residuals = difference(y[b], y[a])
        u, angle = lever[a], None
        if self.frame == "body":
            u = u + perpendicular(residuals[:, :2])
            angle = y[a, 2] if self.oriented else (state - reference)[self.nodes[a], 2]
        return linearization((self.nodes[a], self.nodes[b]), residuals, information, (u, lever[b]), angle)

    def check_constant(self) -> None:
        if not self.oriented:
            raise GraphError(
                "without psi the information of virtual-motion edges depends on the state; use weight='marginal' or "
                "edges='landmark+motion'"
            )
        super().check_constant()
        if (pairs := int(np.sum(np.diff(self.starts) ** 2)) // 2) > MOST_LISTED:
            raise GraphError(f"{pairs} pairs of sightings are too many to list; use weight='marginal'")

    def _to_engine(self) -> Any:
        sightings = self.starts, self.nodes, *self._for_engine
        return engine.VirtualMotionEdges(*sightings, self.tempered, self.frame == "body")

    def kernel_weights(self, state: Array) -> Array:
        if self.kernel is None:
            return super().kernel_weights(state)
        return self.kernel.weight(self.linearize(state, state).mahalanobis / self.group_weights[self.pairs()[2]])

    @cached_property
    def group_weights(self) -> Array:
        """The factor (G,) on the information of all edges of a landmark."""
        if not self.tempered:
            return np.ones(len(self.starts) - 1)
        return 2 / np.bincount(self.group, weights=self.trusted, minlength=len(self.starts) - 1)
