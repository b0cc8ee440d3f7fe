"""The map from a trajectory: each landmark alone, from all its sightings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from .errors import OptionError
from .log import UNIDENTIFIED, Log
from .models import SensorModel
from .se2 import Array, wrap


class LandmarkMap(dict[int, Array]):
    """{id: (x, y) or (x, y, heading)}, with ``covariances`` {id: (2, 2) or (3, 3)} given the trajectory."""

    def __init__(self, means: Mapping[int, Array], covariances: Mapping[int, Array]) -> None:
        super().__init__(means)
        self.covariances = dict(covariances)


def estimate_map(log: Log, poses: ArrayLike, *, sensor: SensorModel | None = None) -> LandmarkMap:
    """m_j = argmin over m of the sum of (m - y)' Omega (m - y), y = h^-1(x_t, z), Omega^-1 = R Q R', for each landmark.

    Headings are averaged as differences from that of the first sighting, so that headings near -pi and pi average well.

    Args:
        log: whose sightings are used; those without a landmark id are left out.
        poses: the trajectory (T+1, 3), or anything with such an attribute ``poses`` (a `Solution`).
        sensor: the noise model; default: the log's, else the book's.

    Returns:
        The map, with the covariance (sum of Omega)^-1 of each landmark given the trajectory.

    Raises:
        OptionError: the poses do not fit the log.

    Source: the lectures, section 9.1.2.
    """
    sensor = sensor or log.sensor or SensorModel()
    trajectory = np.asarray(getattr(poses, "poses", poses), dtype=float)
    if trajectory.shape != (log.num_poses, 3):
        raise OptionError(f"poses must have shape ({log.num_poses}, 3) for this log, not {trajectory.shape}")
    known = np.flatnonzero(log.landmarks != UNIDENTIFIED)
    if len(known) == 0:
        return LandmarkMap({}, {})
    order = known[np.argsort(log.landmarks[known], kind="stable")]
    ids, starts, count = np.unique(log.landmarks[order], return_index=True, return_counts=True)
    at, z = trajectory[log.steps[order]], log.sightings[order]
    y = sensor.h_inverse(at, z)
    information = np.linalg.inv(sensor.landmark_covariance(at, z))
    first = y[starts]
    offset = y - np.repeat(first, count, axis=0)
    offset[:, 2:] = wrap(offset[:, 2:])
    covariance = np.linalg.inv(np.add.reduceat(information, starts, axis=0))
    pulled = np.add.reduceat(np.einsum("kij,kj->ki", information, offset), starts, axis=0)
    mean = first + np.einsum("kij,kj->ki", covariance, pulled)
    mean[:, 2:] = wrap(mean[:, 2:])
    return LandmarkMap(dict(zip(ids.tolist(), mean)), dict(zip(ids.tolist(), covariance)))
