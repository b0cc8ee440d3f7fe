"""The map from a trajectory: every landmark on its own, from all its sightings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from .errors import OptionError
from .log import Log
from .models import SensorModel
from .se2 import Array, wrap


class LandmarkMap(dict[int, Array]):
    """{id: (x, y) or (x, y, heading)}, with ``covariances`` {id: (2, 2) or (3, 3)} given the trajectory."""

    def __init__(self, means: Mapping[int, Array], covariances: Mapping[int, Array]) -> None:
        super().__init__(means)
        self.covariances = dict(covariances)


def estimate_map(log: Log, poses: ArrayLike, sensor: SensorModel | None = None) -> LandmarkMap:
    """m_j = argmin over m of the sum of (m - y)' Omega (m - y), y = h^-1(x_t, z), Omega^-1 = R Q R', for each landmark.

    Headings are averaged as differences from the first sighting's, so that a landmark that faces along -pi is not torn.

    Args:
        log: whose sightings are placed.
        poses: the trajectory (T+1, 3), or anything with such an attribute ``poses`` (a `Solution`).
        sensor: the noise model; default: the book's.

    Returns:
        The map, with the covariance (sum of Omega)^-1 of each landmark given the trajectory.

    Raises:
        OptionError: the poses do not fit the log.

    Source: the lectures, section 9.1.2.
    """
    sensor = sensor or SensorModel()
    trajectory = np.asarray(getattr(poses, "poses", poses), dtype=float)
    if trajectory.shape != (log.num_poses, 3):
        raise OptionError(f"poses must have shape ({log.num_poses}, 3) for this log, not {trajectory.shape}")
    at = trajectory[log.steps]
    y = sensor.h_inverse(at, log.sightings)
    information = np.linalg.inv(sensor.landmark_covariance(at, log.sightings))
    means, covariances = {}, {}
    for j in log.landmark_ids.tolist():
        mine = log.landmarks == j
        first = y[mine][0]
        offset = y[mine] - first
        if log.has_orientation:
            offset[:, 2] = wrap(offset[:, 2])
        covariances[j] = np.linalg.inv(information[mine].sum(axis=0))
        mean = first + covariances[j] @ np.einsum("kij,kj->i", information[mine], offset)
        if log.has_orientation:
            mean[2] = wrap(mean[2])
        means[j] = mean
    return LandmarkMap(means, covariances)
