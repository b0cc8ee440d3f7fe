"""Monte Carlo localisation: the pose of the robot on a known map. FastSLAM extends it.

Sources: Dellaert, Fox, Burgard and Thrun, *Monte Carlo localization for mobile robots*, ICRA 1999; *Probabilistic
Robotics*, section 8.3; Ueda, *LNPR*, chapter 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError, quoted
from graphslam.log import Log
from graphslam.se2 import Array

from . import landmark_kernels as kernels
from .checks import finite, whole
from .particle_filter import ParticleFilter
from .state import LandmarkEstimate


class MonteCarloLocalization(ParticleFilter):
    """The particle filter on a known map: the weight is multiplied by N(z; h(x, m), Q).

    psi is used where both the sighting and the landmark have a heading, and ignored otherwise.

    Args:
        log: controls and sightings; None for a filter that is used with `move` and `observe`.
        landmarks: the map {id: (x, y) or (x, y, heading)} [m, m, rad]; default: the log's true landmarks.
        keywords: all other arguments of `ParticleFilter`.

    Raises:
        OptionError: an option has an impossible value, there is no map, or the log has sightings of other landmarks.
        LogError: the log has no controls.
    """

    HAS_MAPS = False
    _HOW_WITHOUT_IDS = (
        "by which Monte Carlo localisation knows its landmarks: take FastSLAM, which finds out, or first give the log ids "
        "by graphslam.associate"
    )

    def __init__(
        self, log: Log | None = None, *, landmarks: Mapping[int, ArrayLike] | None = None, **keywords: Any
    ) -> None:
        super().__init__(log, **keywords)
        if landmarks is None:
            landmarks = getattr(log, "true_landmarks", None)
        if landmarks is None:
            without = "" if log is None else f", and {log.name} has no true landmarks"
            raise OptionError(
                f"Monte Carlo localisation needs a map{without}: give landmarks, {{id: (x, y) or (x, y, heading)}}, or "
                "use FastSLAM, which makes its own"
            )
        if not isinstance(landmarks, Mapping):
            raise OptionError(
                f"landmarks must be a mapping, {{id: (x, y) or (x, y, heading)}}, not {quoted(landmarks)}"
            )
        expected = "finite, (x, y) or (x, y, heading)"
        self._landmarks = {
            whole("the id of a landmark", j): finite(f"landmarks[{j!r}]", place, expected, [(2,), (3,)])
            for j, place in landmarks.items()
        }
        if log is not None:
            self._check_sightings(log.landmark_ids, log.sightings.shape[1])

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        for j in ids.tolist():
            if j not in self._landmarks:
                raise OptionError(
                    f"landmark {j} was seen but is not on the known map: add it to landmarks, or use FastSLAM1"
                )

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> Array | None:  # noqa: ARG002
        log_likelihood = np.zeros(self.particles)
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            known = self._landmarks[j]
            n = min(len(z), len(known))
            self._threads.run(kernels.weigh_known, self._poses, known[:n], z[:n], variances[:n], log_likelihood)
        return log_likelihood

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return {j: LandmarkEstimate(m.copy(), np.zeros((len(m), len(m)))) for j, m in self._landmarks.items()}

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return self._map(0, provisional)
