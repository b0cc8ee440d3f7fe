"""`estimate_map`: the map from a log and a trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..edges import MarginalEdges
from ..edges.robust import Kernel, kernel_of
from ..errors import OptionError
from ..errors.checks import array_of
from ..linear.precision import check_magnitudes
from ..log import Log
from ..log.rows import UNIDENTIFIED
from ..maps.landmark_map import LandmarkMap
from ..models import SensorModel


def estimate_map(
    log: Log,
    poses: ArrayLike,
    *,
    sensor: SensorModel | None = None,
    kernel: Kernel | str | None = None,
    trust: ArrayLike | None = None,
) -> LandmarkMap:
    """m_j = argmin over m of the sum of w (m - y)' Omega (m - y), y = h^-1(x_t, z), Omega^-1 = R Q R', for each landmark.

    The weight w of a sighting is its trust times the weight of the kernel, 1 where there is neither.

    Headings are compared with that of the landmark itself, so the result does not depend on the order of the sightings.

    Args:
        log: whose sightings are used; those without a landmark id are left out.
        poses: the trajectory (T+1, 3), or anything with such an attribute ``poses``. A `Solution` of this log also gives
            the defaults of sensor, kernel and trust: those of its graph.
        sensor: the noise model; default: that of the solution's graph, else the log's, else the book's.
        kernel: a robust kernel on each sighting, as in `Graph.from_log`; the map is then the robust mean.
        trust: (M,) a factor from 0 to 1 on the information of each sighting, such as `Solution.trust`; NaN counts as 1.

    Returns:
        The map, with the covariance of each landmark given the trajectory: (sum of w Omega)^-1, and with a kernel that of
        the robust mean (`Kernel.information_per_weight`).

    Raises:
        OptionError: the poses or the trust do not fit the log, or there is no such kernel.
        GraphError: numbers of the log or the sensor are outside of what double precision can hold.

    Source: the lectures, section 9.1.2.
    """
    graph = getattr(poses, "graph", None)
    if graph is not None and graph.log is not None:
        own_kernel, own_trust = graph.verdict
        sensor, kernel, trust = sensor or graph.sensor, kernel or own_kernel, own_trust if trust is None else trust
    sensor = sensor or log.sensor or SensorModel()
    trajectory = array_of("poses", getattr(poses, "poses", poses))
    if trajectory.shape != (log.num_poses, 3):
        raise OptionError(f"poses must have shape ({log.num_poses}, 3) for this log, not {trajectory.shape}")
    trusted = np.ones(len(log.steps)) if trust is None else np.nan_to_num(array_of("trust", trust), nan=1.0)
    if trusted.shape != log.steps.shape or np.any((trusted < 0) | (trusted > 1)):
        raise OptionError(f"trust must be {len(log.steps)} numbers from 0 to 1, one for each sighting of this log")
    known = np.flatnonzero(log.landmarks != UNIDENTIFIED)
    if len(known) == 0:
        return LandmarkMap({}, {})
    check_magnitudes(log, None, sensor)
    rows = known[np.argsort(log.landmarks[known], kind="stable")]
    ids, starts = np.unique(log.landmarks[rows], return_index=True)
    edges = MarginalEdges(
        np.append(starts, len(rows)), log.steps[rows], log.sightings[rows], sensor,
        kernel=kernel_of(kernel), trust=trusted[rows],
    )  # fmt: skip
    means, covariances = edges.map(trajectory)
    return LandmarkMap.of_estimate(dict(zip(ids.tolist(), means)), dict(zip(ids.tolist(), covariances)))
