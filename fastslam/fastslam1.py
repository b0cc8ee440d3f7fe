"""FastSLAM 1.0: every particle carries a trajectory and, given that, a map of independent Gaussians.

Sources: Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999; Montemerlo, Thrun, Koller and Wegbreit,
*FastSLAM*, AAAI 2002; *Probabilistic Robotics*, section 13.3; Ueda, *LNPR*, chapter 8.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array

from .landmark_columns import LandmarkColumns
from .particle_filter import ParticleFilter
from .state import LandmarkEstimate, weighted_covariance, weighted_mean


class FastSLAM1(ParticleFilter):
    """FastSLAM 1.0 with known data association, on sightings with or without psi (with it landmarks have a heading).

    A first sighting starts a landmark at N(h^-1(x, z), (H' Q^-1 H)^-1) and does not weigh. A later one multiplies the
    weight by N(z; h(m), V), V = H S H' + Q, and then moves the landmark by K = S H' V^-1. A particle that stands
    on its landmark (nearer than 1e-9 m) cannot tell the bearing: its likelihood is 0 and that landmark stays as it is.

    Args:
        log: what the robot did and saw; None to feed the filter by hand.
        particles: their number N.
        seed: of the random numbers, or a generator.
        motion, sensor: the models; default: the book's.
        resampling: "systematic", "stratified", "residual" or "multinomial".
        ess_threshold: resample after sightings when ESS <= ess_threshold * N; 1 is the lectures' way, after every step
            with sightings of known landmarks.
        start: the known first pose (3,), or one per particle (N, 3); default: the log's first initial pose.

    Raises:
        OptionError: an option has an impossible value.
        LogError: the log has no controls.
    """

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
    ) -> None:
        super().__init__(
            log, particles=particles, seed=seed, motion=motion, sensor=sensor, resampling=resampling,
            ess_threshold=ess_threshold, start=start,
        )  # fmt: skip
        self._columns: LandmarkColumns | None = None

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        if self._columns is not None and columns != self._columns.coordinates:
            raise OptionError(f"sightings so far had {self._columns.coordinates} columns, these have {columns}")

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        if self._columns is None:
            self._columns = LandmarkColumns(self._genealogy, self.particles, sightings.shape[1])
        columns, log_likelihood = self._columns, None
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            if j not in columns:
                columns.initialize(j, self._poses, z, variances)
                continue
            if log_likelihood is None:
                log_likelihood = np.zeros(self.particles)
            columns.update(j, self._poses, z, variances, log_likelihood)
        return log_likelihood

    def _map(self, particle: int) -> dict[int, LandmarkEstimate]:
        if self._columns is None:
            return {}
        estimates = {}
        for j in sorted(self._columns.ids):
            means, covariances = self._columns.gaussians(j, slice(particle, particle + 1))
            estimates[j] = LandmarkEstimate(means[0], covariances[0])
        return estimates

    def _mixture(self, weights: Array) -> dict[int, LandmarkEstimate]:
        estimates = {}
        for j in sorted(self._columns.ids) if self._columns is not None else ():
            means, covariances = self._columns.gaussians(j)  # type: ignore[union-attr]
            mean = weighted_mean(means, weights)
            within = np.tensordot(weights, covariances, 1)
            estimates[j] = LandmarkEstimate(mean, within + weighted_covariance(means, mean, weights))
        return estimates
