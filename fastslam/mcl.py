"""Monte Carlo localisation: where is the robot on a map that is known? What FastSLAM builds on.

Sources: Dellaert, Fox, Burgard and Thrun, *Monte Carlo localization for mobile robots*, ICRA 1999; *Probabilistic
Robotics*, section 8.3; Ueda, *LNPR*, chapter 5.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array

from . import landmark_kernels as kernels
from .arguments import reals, whole
from .particle_filter import ParticleFilter
from .state import LandmarkEstimate


class MonteCarloLocalization(ParticleFilter):
    """The particle filter on a known map: the weight is multiplied by N(z; h(x, m), Q).

    psi is used where both the sighting and the landmark have a heading, and left out otherwise.

    Args:
        log: what the robot did and saw; None to feed the filter by hand.
        landmarks: the map {id: (x, y) or (x, y, heading)} [m, m, rad]; default: the log's true landmarks.
        particles: their number N.
        seed: of the random numbers, or a generator.
        motion, sensor: the models; default: the book's.
        resampling: "systematic", "stratified", "residual" or "multinomial".
        ess_threshold: resample after sightings when ESS <= ess_threshold * N; 1 is after every step with sightings.
        start: the known first pose (3,), or one per particle (N, 3); default: the log's first initial pose.
        threads: how many; None for all cores where there are particles enough. The result is the same.

    Raises:
        OptionError: an option has an impossible value, there is no map, or the log saw a landmark that is not in it.
        LogError: the log has no controls.
    """

    def __init__(
        self,
        log: Log | None = None,
        *,
        landmarks: Mapping[int, ArrayLike] | None = None,
        particles: int = 1000,
        seed: int | np.random.Generator = 0,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        resampling: str = "systematic",
        ess_threshold: float = 0.5,
        start: ArrayLike | None = None,
        threads: int | None = None,
    ) -> None:
        super().__init__(
            log, particles=particles, seed=seed, motion=motion, sensor=sensor, resampling=resampling,
            ess_threshold=ess_threshold, start=start, threads=threads,
        )  # fmt: skip
        if landmarks is None:
            landmarks = log.true_landmarks if log is not None else None
        if landmarks is None:
            without = "" if log is None else f", and {log.name} does not tell where its landmarks are"
            raise OptionError(
                f"Monte Carlo localisation needs a map{without}: give landmarks, {{id: (x, y) or (x, y, heading)}}, or "
                "use FastSLAM, which makes its own"
            )
        if not isinstance(landmarks, Mapping):
            raise OptionError(f"landmarks must be a mapping, {{id: (x, y) or (x, y, heading)}}, not {landmarks!r}")
        self._landmarks = {}
        for j, place in landmarks.items():
            expected = "finite, (x, y) or (x, y, heading)"
            known = reals(f"landmarks[{j!r}]", place, expected)
            if known.shape not in ((2,), (3,)) or not np.all(np.isfinite(known)):
                raise OptionError(f"landmarks[{j!r}] must be {expected}, not {place!r}")
            self._landmarks[whole("the id of a landmark", j)] = known
        if log is not None and not log.identified:
            raise OptionError(
                f"{log.name} has sightings that do not tell their landmark, and localisation needs to know"
            )
        if log is not None:
            self._check_sightings(log.landmark_ids, log.sightings.shape[1])

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        for j in ids.tolist():
            if j not in self._landmarks:
                raise OptionError(
                    f"landmark {j} was seen but is not on the known map: add it to landmarks, or use FastSLAM1"
                )

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        log_likelihood = np.zeros(self.particles)
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            known = self._landmarks[j]
            n = min(len(z), len(known))
            self._crew.run(kernels.weigh_known, self._poses, known, z[:n], variances[:n], log_likelihood)
        return log_likelihood

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return {j: LandmarkEstimate(m.copy(), np.zeros((len(m), len(m)))) for j, m in self._landmarks.items()}

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return self._map(0, provisional)
