"""`Backend`, the interface of the solvers behind `OnlineSolver`, and the check of covariances that they share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..errors.checks import checked_covariance
from ..graph.trilateration import NumberRow
from ..linear.precision import inverses
from ..maps.tracker import Tracker
from ..se2 import Array

#: the variances [m², m², rad²] of a first pose that only a map or absolute positions hold
FREE_START = (1e4, 1e4, 1e2)

#: the same of a first pose that was held at the origin until the first absolute position came
RELEASED_START = (1e8, 1e8, 1e2)

#: a measured pose z (3,) of node b in the axes of node a with its information: (a, b, z, Omega)
Relation = tuple[int, int, Array, Array]


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


def information_of(covariance: ArrayLike | None, d: int = 3) -> Array:
    """The inverse of a covariance (d, d).

    Raises:
        OptionError: it is not symmetric positive definite. GraphError: its inverse is beyond double precision.
    """
    P = checked_covariance(covariance, d)
    return np.asarray(inverses(P[None], "motion", "check its covariance")[0])
