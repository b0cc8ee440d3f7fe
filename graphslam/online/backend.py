"""`Backend`, the interface of the solvers behind `OnlineSolver`, what they share, and J as the noise models predict it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import Kernel
from ..errors.checks import checked_covariance
from ..graph.trilateration import NumberRow
from ..linear.precision import inverses
from ..maps.tracker import Tracker
from ..se2 import Array
from ..solvers.contradictions import misfit_of_noise

#: the variances [m², m², rad²] of a first pose that only a map or absolute positions hold
FREE_START = (1e4, 1e4, 1e2)

#: the same of a first pose that was held at the origin until the first absolute position came
RELEASED_START = (1e8, 1e8, 1e2)

#: a measured pose z (3,) of node b in the axes of node a with its information: (a, b, z, Omega)
Relation = tuple[int, int, Array, Array]


#: kinds of measurements: how many numbers one has, and whether the robust kernel acts on it
Measured = tuple[int, bool]

#: a lag of L poses makes headings look more certain than they are, so that J of right drives is up to 1 + SHORT / L times
#: what it should be: at most 1.37 times with L = 2, 1.21 with 5 and 1.14 with 10
SHORT = 1.0


class Backend(Protocol):
    """Poses, landmarks and edges, with the estimate after each change; its methods take checked numbers.

    Attributes:
        num_final: the number of poses that cannot change any more, the first ones.
        columns: the number of values of a sighting, 2 or 3; None before the first one.
        tracker: of the robot in a map, where there is one.
        notes: what contradicts the map, one sentence each.
        misfit: a sentence where J is clearly above what the noise models predict; empty otherwise, or where it is not known.
    """

    num_final: int = 0
    tracker: Tracker | None = None
    notes: Sequence[str] = ()
    misfit: str = ""
    columns: int | None

    @property
    def num_poses(self) -> int:
        """The number of poses so far."""

    @property
    def landmark_ids(self) -> Sequence[int]:
        """The ids of the landmarks that are nodes."""

    def relate(self, *relations: Relation) -> None:
        """Add relations between two poses each, and solve once; one of all poses may be the next, new one."""

    def observe(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        """Add sightings (K, 2 or 3) of landmarks from a pose; of (range, bearing) one may be NaN."""

    def locate(self, pose: int, measured: Array, information: Array, lever: Array) -> None:
        """Add an absolute position of a point of the robot; see `OnlineSolver.locate`."""

    def release(self, motion: Array, position: Callable[[], None]) -> None:
        """Let the first absolute position say where the world is: the first pose was anchored for want of anything better.

        Args:
            motion: (3,) by which everything moves, so that the position is met.
            position: adds it.
        """

    @property
    def waiting(self) -> dict[int, tuple[NumberRow, ...]]:
        """The ranges or bearings alone of each landmark that waits for a place."""

    def place(self, landmark: int, place: Array) -> None:
        """Put a landmark that has been waiting at a place (2,)."""

    def look_again(self) -> None:
        """Try other places of landmarks that single numbers have placed, and take the lowest J; ISAM2 does not."""

    def relinearize(self) -> None:
        """Linearise all edges at the estimate, and solve again."""

    @property
    def converged(self) -> bool:
        """Whether the last update ended at the minimum."""

    @property
    def cost(self) -> float:
        """J without the anchor."""

    @property
    def pose(self) -> Array:
        """The newest pose (3,)."""

    @property
    def poses(self) -> Array:
        """All poses so far (t+1, 3)."""

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (2,) or (3,)} of the landmarks that are nodes."""

    def covariance(self, poses: Sequence[int], landmarks: Sequence[int]) -> Array:
        """The joint covariance of poses (3 rows each), then landmarks (2 or 3 rows each), in world axes.

        Raises:
            GraphError: the edges do not determine it.
        """


@dataclass
class ExpectedCost:
    """What J should be by the noise models, from the number of measurements.

    With a lag, a constant of J is unknown, because edges become priors. Then J is that of windows of lag + 1 poses that
    follow each other, and so is its mean.

    Attributes:
        kernel, lag: those of the solver.
        measured: how many measurements of each kind there are.
        of_poses: the same for each pose that is not final, with a lag.
        of_kept: the same for final poses that stay nodes, which are part of all later windows.
        windows: the sum of J of the windows, and the mean of it at the true state.
    """

    kernel: Kernel | None
    lag: int | None
    measured: Counter[Measured] = field(default_factory=Counter[Measured])
    of_poses: dict[int, Counter[Measured]] = field(default_factory=dict)
    of_kept: Counter[Measured] = field(default_factory=Counter[Measured])
    windows: tuple[float, float] = (0.0, 0.0)

    def count(self, pose: int, measured: Mapping[Measured, int]) -> None:
        """Count what was measured from a pose."""
        # `Counter.update` is slow for a few kinds
        for kind, count in measured.items():
            self.measured[kind] += count
        if self.lag is not None:
            self.of_poses.setdefault(pose, Counter()).update(measured)

    def window_ends(self, num_poses: int, relations: Sequence[Relation]) -> bool:
        """Whether relations make the pose that begins the next window."""
        if self.lag is None or num_poses % (self.lag + 1):
            return False
        return any(max(first, second) == num_poses for first, second, _, _ in relations)

    def add_window(self, cost: float) -> None:
        """Add J of the poses that are not final."""
        now = sum(self.of_poses.values(), self.of_kept)
        self.windows = self.windows[0] + cost, self.windows[1] + self._at_truth(now)

    def becomes_final(self, pose: int, stays: bool) -> None:
        """Note that the oldest pose becomes final, and whether it stays a node."""
        counts = self.of_poses.pop(pose, Counter())
        if stays:
            # its motions become parts of the priors of the poses beside it
            self.of_kept += Counter({kind: count for kind, count in counts.items() if kind != (3, False)})

    def misfit(self, cost: float | None, unknowns: int) -> str:
        """A sentence where J is clearly above its mean.

        Args:
            cost: J of all edges; None where the windows count.
            unknowns: as for `mean`.
        """
        if cost is not None or self.lag is None:
            return misfit_of_noise(cost or 0.0, self.mean(unknowns))
        return misfit_of_noise(self.windows[0], self.windows[1] * self._part_left(unknowns) * (1 + SHORT / self.lag))

    def mean(self, unknowns: int) -> float:
        """The mean of J of all edges where so many numbers are estimated, which lowers it; see `Graph.expected_cost`."""
        return self._at_truth(self.measured) * self._part_left(unknowns)

    def _part_left(self, unknowns: int) -> float:
        rows = sum(numbers * count for (numbers, _), count in self.measured.items())
        return max(1 - unknowns / max(rows, 1), 1e-3)

    def _at_truth(self, measured: Counter[Measured]) -> float:
        """The mean of J of these measurements at the true state."""
        return sum(
            count * (self.kernel.mean_loss(numbers) if self.kernel and doubted else numbers)
            for (numbers, doubted), count in measured.items()
        )


def information_of(covariance: ArrayLike | None, d: int = 3) -> Array:
    """The inverse of a covariance (d, d).

    Raises:
        OptionError: it is not symmetric positive definite. GraphError: its inverse is beyond double precision.
    """
    P = checked_covariance(covariance, d)
    return np.asarray(inverses(P[None], "motion", "check its covariance")[0])
