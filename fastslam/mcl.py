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

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> bool:  # noqa: ARG002
        known = [self._landmarks[j] for j in ids.tolist()]
        oriented = np.array([len(m) == 3 and sightings.shape[1] == 3 for m in known])
        places = np.array([m if len(m) == 3 else [*m, 0.0] for m in known])
        self._engine.weigh_known(places, sightings, q, oriented)
        return True

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return {j: LandmarkEstimate(m.copy(), np.zeros((len(m), len(m)))) for j, m in self._landmarks.items()}

    def _gaussians_of(self, id: int) -> tuple[Array, Array, np.ndarray]:
        m, N = self._landmarks[id], self.particles
        return np.tile(m, (N, 1)), np.zeros((N, len(m), len(m))), np.ones(N, dtype=bool)

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return self._map(0, provisional)
