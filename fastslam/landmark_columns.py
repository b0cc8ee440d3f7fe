"""The maps of all particles, one column per landmark, without a copy at resampling.

A column holds one landmark's Gaussian for each particle of the generation that last saw it. Resampling does not touch
columns. When the landmark is seen again, each particle reads the row that its ancestor wrote and writes its own row
into a fresh column, so a step costs what is in view, whatever the size of the map. Two particles never share a row
that either of them could change.

Rejected: copying maps at resampling (N x landmarks numbers each time), and the literature's balanced tree per particle
(Montemerlo et al. 2002), whose log(landmarks) pointers per particle cost more cache misses than this costs altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam.se2 import Array

from . import kernels
from .genealogy import Genealogy


@dataclass(slots=True)
class _Column:
    generation: int
    rows: Array  # (N, 5) or (N, 9), see kernels


class LandmarkColumns:
    """Gaussians of landmarks by id for N particles whose descent a genealogy knows; n = 2 or 3 coordinates each."""

    def __init__(self, genealogy: Genealogy, particles: int, coordinates: int) -> None:
        self._genealogy = genealogy
        self._particles = particles
        self.coordinates = coordinates
        self._columns: dict[int, _Column] = {}
        self._spare: list[Array] = []
        self._self = np.arange(particles)

    def __contains__(self, landmark: int) -> bool:
        return landmark in self._columns

    @property
    def ids(self) -> list[int]:
        """The landmarks seen so far, in the order of their first sightings."""
        return list(self._columns)

    def initialize(self, landmark: int, poses: Array, z: Array, q: Array) -> None:
        """First sighting of a landmark: Gaussians N(h^-1(x, z), (H' Q^-1 H)^-1); z and q = diag(Q) of shape (n,)."""
        rows = self._take_spare()
        (kernels.initialize_2d if self.coordinates == 2 else kernels.initialize_3d)(poses, z, q, rows)
        self._columns[landmark] = _Column(self._genealogy.generation, rows)

    def update(self, landmark: int, poses: Array, z: Array, q: Array, log_likelihood: Array) -> None:
        """Later sighting: add log N(z; h(m), V) to log_likelihood (N,), then the Kalman update of every Gaussian."""
        column, now = self._columns[landmark], self._genealogy.generation
        kernel = kernels.update_2d if self.coordinates == 2 else kernels.update_3d
        if column.generation == now:
            kernel(poses, self._self, column.rows, column.rows, z, q, log_likelihood)
            return
        rows = self._take_spare()
        kernel(poses, self._genealogy.ancestors(column.generation), column.rows, rows, z, q, log_likelihood)
        self._spare.append(column.rows)
        self._columns[landmark] = _Column(now, rows)

    def gaussians(self, landmark: int, particles: np.ndarray | slice = slice(None)) -> tuple[Array, Array]:
        """Means (k, n) and covariances (k, n, n) of a landmark in some particles, headings in [-pi, pi)."""
        column, n = self._columns[landmark], self.coordinates
        inherited = column.rows[self._genealogy.ancestors(column.generation)[particles]]
        upper = np.triu_indices(n)
        covariances = np.empty((len(inherited), n, n))
        covariances[:, upper[0], upper[1]] = covariances[:, upper[1], upper[0]] = inherited[:, n:]
        return inherited[:, :n].copy(), covariances

    def _take_spare(self) -> Array:
        # columns are recycled: fresh memory would be paid for page by page
        return self._spare.pop() if self._spare else np.empty((self._particles, 5 if self.coordinates == 2 else 9))
