"""`SightingEdges`, the base of all edges that come from sightings, and `MarginalEdges`, which eliminate each landmark.

Every sighting places its landmark at y = h^-1(x, z) with covariance C = R Q R'. When the pose rotates, y moves by the
lever t = (-v_y, v_x) per radian, where v leads from the pose to the landmark. It is l (cos, sin)(theta + phi), plus
R(theta) o where the sensor sits at o on the robot.

Marginal edges have each landmark as a variable, eliminated. Every sighting counts exactly once.

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

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from ..engine import engine
from ..linear.precision import inverses
from ..models import SensorModel, plausible_ranges
from ..se2 import Array, perpendicular
from .base import SYMMETRIC, FramedEdges, Linearization, check_nodes, check_rows, linearization
from .robust import DoubtedEdges, code_and_width

#: the most passes to the places of landmarks that are no nodes, and the change [m, rad] below which they are found
PASSES, SAME = 20, 1e-12


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

    def predicted(self, state: Array) -> Array:
        """The sightings (M, d) that a state (n, 3) predicts: of landmark nodes, or of the places that its poses give them."""
        raise NotImplementedError

    def with_noise_at(self, predicted: Array) -> Self:
        """The same edges with the noise at other sightings (M, d), such as those that a state predicts.

        Noise that grows with the range is evaluated at `models.plausible_ranges`.
        """
        noisy = predicted.copy()
        noisy[:, 0] = plausible_ranges(predicted[:, 0], self.sightings[:, 0])
        return replace(self, noise_at=noisy)  # type: ignore[call-arg]

    @property
    def oriented(self) -> bool:
        """Whether the sightings measure psi."""
        return self.sightings.shape[1] == 3

    @property
    def _for_engine(self) -> tuple[Any, ...]:
        """The sightings, those at which the covariance is evaluated, the trust, the sensor, the kernel's code and width."""
        return self.sightings, self.noisy, self.trusted, self.sensor.for_engine, *code_and_width(self.kernel)


def check_sightings(edges: SightingEdges, count: int) -> None:
    """Raise `GraphError` unless the sightings, also those for the covariance, are ``count`` rows of two or three numbers."""
    d = 3 if np.shape(edges.sightings)[1:] == (3,) else 2
    check_rows(edges, sightings=(count, d))
    if edges.noise_at is not None:
        check_rows(edges, noise_at=(count, d))


@dataclass(frozen=True, eq=False, repr=False)
class LandmarkSightings(SightingEdges, FramedEdges):
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
    noise_at: Array | None = field(default=None, kw_only=True)
    shared: ClassVar[tuple[str, ...]] = ("starts",)

    def __post_init__(self) -> None:
        check_nodes(self, "starts", "nodes")
        check_sightings(self, len(self.nodes))
        super().__post_init__()

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return self.starts, self.nodes

    def renumbered(self, number: np.ndarray) -> Self | None:
        here = number[self.nodes] >= 0
        counts = np.bincount(self.group[here])
        starts = np.concatenate([[0], np.cumsum(counts[counts > 0])])
        return replace(self.among(here), starts=starts, nodes=number[self.nodes[here]])

    @property
    def numbers(self) -> tuple[int, float]:
        # the landmark itself takes the numbers of one sighting
        count = self.sightings.shape[1] * int(np.sum(np.diff(self.starts) - 1))
        return count, count

    @property
    def marginal(self) -> MarginalEdges:
        """The same sightings with each landmark eliminated, in the body frame."""
        by_landmark = self.starts, self.nodes, self.sightings, self.sensor
        return MarginalEdges(*by_landmark, kernel=self.kernel, trust=self.trust, noise_at=self.noise_at)

    @cached_property
    def group(self) -> np.ndarray:
        """The landmark (M,) of each sighting, from 0 to G-1."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def predicted(self, state: Array) -> Array:
        edges = replace(self.marginal, noise_at=None)
        before = np.full(1, np.inf)
        # the places depend on the noise, which depends on the places
        for _ in range(PASSES):
            places = edges.landmarks(state, state)[self.group][:, : self.dimension]
            edges = edges.with_noise_at(self.sensor.h(state[self.nodes], places))
            if np.abs(edges.noisy - before).max(initial=0.0) < SAME:
                break
            before = edges.noisy
        return edges.noisy

    def placed(self, state: Array) -> tuple[Array, Array]:
        """The landmarks y = h^-1(x, z) (M, 3) of the sightings at a state, and the levers t (M, 2)."""
        poses = state[self.nodes]
        y = np.zeros((len(poses), 3))
        y[:, : self.sightings.shape[1]] = self.sensor.h_inverse(poses, self.sightings)
        return y, perpendicular(y[:, :2] - poses[:, :2])


@dataclass(frozen=True, eq=False, repr=False)
class MarginalEdges(LandmarkSightings):
    """One clique for each landmark; see `LandmarkSightings` for the arguments."""

    @property
    def count(self) -> int:
        return len(self.nodes)

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """The sightings one by one, as edges to their landmark, which is held at m̂; in world axes."""
        e, W, factor, lever, _, _ = self._around_means(state, reference)
        d = self.sightings.shape[1]
        information = (W * factor[:, None])[:, SYMMETRIC][:, :d, :d]
        if self.frame == "body":
            # the derivative of the rotation of W
            lever = lever + perpendicular(e[:, :2])
        return linearization((self.nodes,), e, information, (lever,))

    def kernel_weights(self, state: Array) -> Array:
        _, _, factor, *_ = self._around_means(state, state)
        return factor / self.trusted

    def weighted_cost(self, state: Array) -> float:
        # the information of the linearisation has the weights already
        return float(self.linearize(state, state).mahalanobis.sum())

    def landmarks(self, state: Array, reference: Array) -> Array:
        """m̂ (G, 3) of each landmark, the third column zero without psi."""
        return self._around_means(state, reference)[4]

    def squares(self, state: Array) -> Array:
        """The squared Mahalanobis norm (M,) of each sighting about m̂, without kernel and trust on the sighting itself."""
        return np.asarray(self.in_engine.squares(state, self.trusted))

    def map(self, poses: Array) -> tuple[Array, Array]:
        """m̂ (G, d) of each landmark, and its covariance given the poses (G, d, d): (s sum of w Omega)^-1.

        w is the trust times the weight that the kernel gives the sighting at m̂, and s is `information_per_weight`.

        Raises:
            GraphError: the sum is singular to double precision.
        """
        _, W, factor, _, means, _ = self._around_means(poses, poses)
        d = self.sightings.shape[1]
        information = np.add.reduceat(W * factor[:, None], self.starts[:-1], axis=0)[:, SYMMETRIC][:, :d, :d]
        remedy = "the sightings of this landmark do not determine it; change the noise of the sensor"
        return means[:, :d], inverses(self.information_per_weight * information, "landmark", remedy)

    def _to_engine(self) -> Any:
        return engine.MarginalEdges(self.starts, self.nodes, *self._for_engine, self.frame == "body")

    def _around_means(self, state: Array, reference: Array) -> tuple[Array, Array, Array, Array, Array, float]:
        """e (M, 3), W (M, 6), its factor of trust and kernel (M,), the lever (M, 2), m̂ (G, 3) and the cost."""
        return self.in_engine.around_means(state, reference)
