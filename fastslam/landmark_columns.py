"""The maps of all particles, one column per landmark, without a copy at resampling.

A column holds one landmark's Gaussian for each particle of the level that last saw it. Resampling does not touch
columns. When the landmark is seen again, each particle reads the place that its ancestor wrote and writes its own
into a fresh column, so a step costs what is in view, whatever the size of the map. Two particles never share a place
that either of them could change.

Rejected: copying maps at resampling (N x landmarks numbers each time), and the literature's balanced tree per particle
(Montemerlo et al. 2002), whose log(landmarks) pointers per particle cost more cache misses than this costs altogether.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphslam.se2 import Array

from . import landmark_kernels as kernels
from .crew import Crew, Job
from .genealogy import Genealogy


@dataclass(slots=True)
class _Column:
    level: int
    numbers: Array  # (5, N) or (9, N), see landmark_kernels


class LandmarkColumns:
    """Gaussians of landmarks by id for N particles whose descent a genealogy knows; n = 2 or 3 coordinates each."""

    def __init__(self, genealogy: Genealogy, crew: Crew, particles: int, coordinates: int) -> None:
        self._genealogy, self._crew = genealogy, crew
        self._shape = (5 if coordinates == 2 else 9, particles)
        self.coordinates = coordinates
        self._columns: dict[int, _Column] = {}
        self._jobs: list[Job] = []
        self._read: list[Array] = []
        self._spare: list[Array] = []

    def __contains__(self, landmark: int) -> bool:
        return landmark in self._columns

    @property
    def ids(self) -> list[int]:
        """The landmarks seen so far, in the order of their first sightings."""
        return list(self._columns)

    def read(self, landmark: int) -> tuple[np.ndarray, Array]:
        """(slots, source): particle i's numbers are ``source[:, slots[i]]``."""
        column = self._columns[landmark]
        return self._genealogy.ancestors(column.level), column.numbers

    def initialize(self, landmark: int, poses: Array, z: Array, q: Array) -> None:
        """First sighting, done by `finish`: Gaussians N(h^-1(x, z), (H' Q^-1 H)^-1); z and q = diag(Q) of shape (n,)."""
        numbers = self._take_spare()
        kernel = kernels.initialize_2d if self.coordinates == 2 else kernels.initialize_3d
        self._jobs.append((kernel, (poses, z, q, numbers)))
        self._columns[landmark] = _Column(self._genealogy.level(), numbers)

    def update(self, landmark: int, poses: Array, z: Array, q: Array, log_likelihood: Array) -> None:
        """Later sighting, done by `finish`: add log N(z; h(m), V) to log_likelihood (N,), then the Kalman update."""
        column, kernel = self._columns[landmark], kernels.update_2d if self.coordinates == 2 else kernels.update_3d
        slots, source = self.read(landmark)
        # where numbers have not changed hands each particle reads and writes its own place
        in_place = self._genealogy.is_living(column.level)
        target = source if in_place else self._take_spare()
        self._jobs.append((kernel, (poses, slots, source, target, z, q, log_likelihood)))
        if not in_place:
            self._read.append(source)
        column.level, column.numbers = self._genealogy.level(), target

    def finish(self, before: Sequence[Job] = ()) -> None:
        """Do what `initialize` and `update` were told since the last time, all of it in one go, ``before`` first.

        One start of the threads per step, not per sighting; and each thread keeps its particles' poses in its cache.
        """
        self._crew.run_all([*before, *self._jobs])
        self._jobs.clear()
        # only now: a thread may have been reading these while another one wrote for a later sighting
        self._spare += self._read
        self._read.clear()

    def gaussians(self, landmark: int, particles: np.ndarray | slice = slice(None)) -> tuple[Array, Array]:
        """Means (k, n) and covariances (k, n, n) of a landmark in some particles, headings in [-pi, pi)."""
        slots, source = self.read(landmark)
        inherited, n = source[:, slots[particles]], self.coordinates
        upper = np.triu_indices(n)
        covariances = np.empty((inherited.shape[1], n, n))
        covariances[:, upper[0], upper[1]] = covariances[:, upper[1], upper[0]] = inherited[n:].T
        return inherited[:n].T.copy(), covariances

    def _take_spare(self) -> Array:
        # columns are recycled: fresh memory would be paid for page by page
        return self._spare.pop() if self._spare else np.empty(self._shape)
