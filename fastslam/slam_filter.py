"""What FastSLAM 1.0 and 2.0 have in common: a particle filter in which every particle carries a map."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from graphslam.checks import check_choice
from graphslam.errors import OptionError
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array

from .arguments import real
from .association import CONFIRMED, AnonymousLandmarks
from .landmark_columns import LandmarkColumns
from .particle_filter import ParticleFilter
from .state import LandmarkEstimate, weighted_covariance, weighted_mean

#: how sightings find their landmarks
ASSOCIATIONS = ("known", "maximum-likelihood")

#: ranges [m] and standard deviations may be so large, and the latter so small the other way round: products of three
#: variances, and squares of covariances, are numbers
LARGEST = 1e50


class FastSLAM(ParticleFilter):
    """A particle filter whose particles have maps of independent Gaussians; see `FastSLAM1` for the arguments."""

    def __init__(
        self,
        log: Log | None = None,
        *,
        particles: int = 1000,
        seed: int | np.random.Generator = 0,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        resampling: str = "systematic",
        ess_threshold: float = 0.5,
        start: ArrayLike | None = None,
        threads: int | None = None,
        association: str = "known",
        new_landmark_threshold: float = 1e-6,
    ) -> None:
        super().__init__(
            log, particles=particles, seed=seed, motion=motion, sensor=sensor, resampling=resampling,
            ess_threshold=ess_threshold, start=start, threads=threads,
        )  # fmt: skip
        check_choice("association", association, ASSOCIATIONS)
        new_landmark_threshold = real("new_landmark_threshold", new_landmark_threshold, "a number between 0 and 1")
        if not 0 < new_landmark_threshold < 1:
            raise OptionError(f"new_landmark_threshold must lie between 0 and 1, not {new_landmark_threshold!r}")
        if association == "known" and log is not None and not log.identified:
            raise OptionError(
                f"{log.name} has sightings that do not tell their landmark: use association='maximum-likelihood'"
            )
        self.association, self._new_landmark_threshold = association, new_landmark_threshold
        self._needs_ids = association == "known"
        self._columns: LandmarkColumns | None = None
        self._anonymous: AnonymousLandmarks | None = None
        self._coordinates: int | None = None

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        if self._coordinates is not None and columns != self._coordinates:
            raise OptionError(f"sightings so far had {self._coordinates} columns, these have {columns}")

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        # three numbers first: this is asked at every step
        if sightings[:, 0].max() > LARGEST or q.min() < LARGEST**-2 or q.max() > LARGEST**2:
            k = int(np.argmax((sightings[:, 0] > LARGEST) | np.any((q < LARGEST**-2) | (q > LARGEST**2), axis=1)))
            raise OptionError(
                f"step {self._step}: sighting {k}, of range {sightings[k, 0]:g} m with noise of standard deviations "
                f"{', '.join(f'{std:g}' for std in np.sqrt(q[k]))}, is beyond floating point; leave it out, or change "
                "the sensor model"
            )
        if self._coordinates is None:
            self._coordinates = sightings.shape[1]
            shape = self._genealogy, self._crew, self.particles, self._coordinates
            if self.association == "known":
                self._columns = LandmarkColumns(*shape)
            else:
                self._anonymous = AnonymousLandmarks(*shape, self._new_landmark_threshold)
        if self._columns is not None:
            return self._weigh_known(self._columns, ids, sightings, q)
        assert self._anonymous is not None
        return self._weigh_anonymous(self._anonymous, sightings, q)

    @abstractmethod
    def _weigh_known(self, columns: LandmarkColumns, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        """`_weigh` where the ids are to be believed."""

    def _weigh_anonymous(self, landmarks: AnonymousLandmarks, sightings: Array, q: Array) -> Array:
        """`_weigh` where each particle finds out for itself; here from the poses as they are."""
        log_likelihood, belief = np.zeros(self.particles), np.zeros((9, self.particles))
        belief[:3] = self._poses
        # the poses are not written where they are drawn, but the kernel is compiled for writable ones
        landmarks.scan(belief, belief[:3], True, np.uint64(0), sightings, q, self._step, log_likelihood)
        return log_likelihood

    def _end_step(self) -> None:
        if self._anonymous is not None:
            self._anonymous.end_step(self._poses, self._step)

    def _gaussians(self, particles: slice) -> Iterator[tuple[int, Array, Array, Array]]:
        """Of every landmark: id, means (k, n), covariances (k, n, n) and the evidence for it (k,), 0 where there is none."""
        if self._columns is not None:
            for j in sorted(self._columns.ids):
                means, covariances = self._columns.gaussians(j, particles)
                yield j, means, covariances, np.full(len(means), CONFIRMED)
        if self._anonymous is not None:
            for j in self._anonymous.ids:
                yield j, *self._anonymous.gaussians(j, particles)

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:
        least = 1.0 if provisional else CONFIRMED
        return {
            j: LandmarkEstimate(means[0], covariances[0], bool(evidence[0] >= CONFIRMED))
            for j, means, covariances, evidence in self._gaussians(slice(particle, particle + 1))
            if evidence[0] >= least
        }

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:
        estimates = {}
        for j, means, covariances, evidence in self._gaussians(slice(None)):
            owned = evidence > 0
            share, confirmed = weights @ owned, bool(weights @ (evidence >= CONFIRMED) >= 0.5)
            # what most believe in, as those believe who do
            if share < 0.5 or not (confirmed or provisional):
                continue
            among = np.where(owned, weights / share, 0.0)[owned]
            mean = weighted_mean(means[owned], among)
            within = np.tensordot(among, covariances[owned], 1)
            estimates[j] = LandmarkEstimate(mean, within + weighted_covariance(means[owned], mean, among), confirmed)
        return estimates
