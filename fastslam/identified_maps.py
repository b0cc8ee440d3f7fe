"""The maps of all particles for sightings with ids: one column per landmark, never copied at resampling.

A column holds one landmark's Gaussian for each particle of the level at which it was last seen. Resampling does not touch
columns. When the landmark is seen again, each particle reads what its ancestor wrote and writes its own Gaussian into
another column. A step therefore costs what is in view, whatever the size of the map, and no two particles share a place
that one of them could change.

Rejected: copying maps at resampling (N times the landmarks at each resampling), and the literature's balanced tree per
particle (Montemerlo et al. 2002), whose log(landmarks) pointers per particle cost more cache misses than this takes in
total.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphslam.se2 import Array

from . import joint_kernels as joint
from . import landmark_kernels as kernels
from . import refined_kernels as refined
from .blocks import padded, unpack
from .genealogy import Genealogy
from .threads import Job, Threads


@dataclass(slots=True)
class _Sighted:
    """All sightings of a landmark, of which the last ``here`` are from the poses ``last`` and the others from ``past``."""

    past: Array  # (3 M, N)
    last: Array  # (3, N), perhaps still unwritten
    here: int
    evidence: Array  # (N,) log Z, see joint_kernels
    z: Array  # (M + here, 3)
    q: Array
    rates: Array  # (M + here,)


@dataclass(slots=True)
class _Column:
    level: int
    numbers: Array  # (5, N) or (9, N), see blocks
    sighted: _Sighted | None = None  # only where sightings are integrated together


class IdentifiedLandmarks:
    """The landmarks of N particles by id; ``genealogy`` knows their ancestors; n = 2 or 3 coordinates per landmark.

    ``landmark_update``: the option of `FilterOptions`. A ``range_noise``, (rate, standard deviation), replaces the
    variance of the range of all sightings but the first by that at the estimated range.
    """

    def __init__(
        self,
        genealogy: Genealogy,
        threads: Threads,
        particles: int,
        coordinates: int,
        *,
        landmark_update: str = "kalman",
        range_noise: tuple[float, float] | None = None,
    ) -> None:
        self._moments, self._jointly = landmark_update != "kalman", landmark_update == "joint"
        self._range_noise = range_noise
        self._genealogy, self._threads = genealogy, threads
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
        """The ids of the landmarks seen so far, ascending."""
        return sorted(self._columns)

    def read(self, landmark: int) -> tuple[np.ndarray, Array]:
        """Return (slots, source): the numbers of particle i are ``source[:, slots[i]]``."""
        column = self._columns[landmark]
        return self._genealogy.ancestors(column.level), column.numbers

    def initialize(self, landmark: int, poses: Array, z: Array, q: Array) -> None:
        """Schedule a first sighting: Gaussians N(h^-1(x, z), (H' Q^-1 H)^-1); z and q = diag(Q) of shape (n,)."""
        numbers = self._take_spare()
        self._jobs.append(
            (refined.initialize_by_moments if self._moments else kernels.initialize, (poses, z, q, numbers))
        )
        sighted = None
        if self._jointly:
            evidence = np.full(self._shape[1], np.log(z[0]))
            row, variances = np.array([padded(z, 0.0)]), np.array([padded(q, 1.0)])
            sighted = _Sighted(np.empty((0, self._shape[1])), poses, 1, evidence, row, variances, np.zeros(1))
        self._columns[landmark] = _Column(self._genealogy.level(), numbers, sighted)

    def place(self, landmark: int, mean: Array, covariance: Array) -> None:
        """Give all particles the same Gaussian, mean (n,) and covariance (n, n), of a landmark that is known beforehand."""
        numbers, n = np.zeros(self._shape), len(mean)
        rows, columns = np.triu_indices(n)
        numbers[:n], numbers[n:] = mean[:, None], covariance[rows, columns][:, None]
        self._columns[landmark] = _Column(self._genealogy.level(), numbers)

    def update(self, landmark: int, poses: Array, z: Array, q: Array, log_likelihood: Array) -> None:
        """Schedule a later sighting: add log N(z; h(m), V) to log_likelihood (N,), then the Kalman update."""
        column = self._columns[landmark]
        slots, source = self.read(landmark)
        # where no particle was replaced since, each reads and writes its own place
        in_place = self._genealogy.is_living(column.level)
        target = source if in_place else self._take_spare()
        if self._moments or self._range_noise is not None:
            rate, std = self._range_noise or (0.0, np.sqrt(q[0]))
            variances = np.array([std**2, *q[1:]])
        if column.sighted is not None and len(column.sighted.z) < joint.MOST:
            column.sighted = now = self._sighted(column.sighted, poses, slots, z, variances, rate)
            before, now.evidence = now.evidence, now.evidence if in_place else np.empty_like(now.evidence)
            work = now.past, poses, slots, source, target, before, now.evidence, now.z, now.q, now.rates
            self._jobs.append((joint.joint_update, (*work, float(self.coordinates - 2), log_likelihood)))
        elif self._moments or self._range_noise is not None:
            column.sighted = None
            arguments = poses, slots, source, target, z, variances, rate, self._moments, log_likelihood
            self._jobs.append((refined.refined_update, arguments))
        else:
            self._jobs.append((kernels.update, (poses, slots, source, target, z, q, log_likelihood)))
        if not in_place:
            self._read.append(source)
        column.level, column.numbers = self._genealogy.level(), target

    @staticmethod
    def _sighted(old: _Sighted, poses: Array, slots: np.ndarray, z: Array, q: Array, rate: float) -> _Sighted:
        """All sightings of a landmark with one more, the poses of the former as the present particles inherit them."""
        past, here = old.past, old.here + 1
        if poses is not old.last:
            past, here = np.concatenate([past, *[old.last] * old.here])[:, slots], 1
        return _Sighted(
            past, poses, here, old.evidence, np.vstack([old.z, padded(z, 0.0)]), np.vstack([old.q, padded(q, 1.0)]),
            np.append(old.rates, rate),
        )  # fmt: skip

    def finish(self, before: Sequence[Job] = ()) -> None:
        """Do everything that `initialize` and `update` have scheduled, after the jobs ``before``.

        The threads start once per step, not once per sighting, and each keeps its particles' poses in its cache.
        """
        self._threads.run_all([*before, *self._jobs])
        self._jobs.clear()
        # only now: one thread may have been reading these columns while another wrote for a later sighting
        self._spare += self._read
        self._read.clear()

    def end_step(self, poses: Array, step: int) -> None:
        """Landmarks with ids are never dropped, so nothing is left to do at the end of a step."""

    def gaussians(self, landmark: int, particles: slice) -> tuple[Array, Array, Array]:
        """Return means (k, n), covariances (k, n, n) and the evidence (k,), which is infinite, in some particles."""
        slots, source = self.read(landmark)
        means, covariances = unpack(source[:, slots[particles]], self.coordinates)
        return means, covariances, np.full(len(means), np.inf)

    def _take_spare(self) -> Array:
        # columns are reused, because the operating system would clear fresh memory page by page
        return self._spare.pop() if self._spare else np.empty(self._shape)
