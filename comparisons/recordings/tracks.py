"""The contents of a recording of a comparison: each estimate's poses over time with covariances, and its map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from graphslam import control_path
from graphslam.se2 import Array

from ..comparison import Comparison
from ..exchange import elapsed_of

#: controls that turn farther [rad] are drawn as arcs
_ARC = 0.2


@dataclass(frozen=True)
class Track:
    """The estimate of one estimator, or the ground truth.

    Attributes:
        name: of the estimator, or "truth".
        seconds: the time of each pose since the first pose of the log (n,).
        nanoseconds: the same by the clock of the log, (n,) whole numbers.
        poses: (n, 3), covariances: (n, 3, 3) or None.
        path: (k, 3) along the whole drive.
        landmarks, landmark_covariances: the map.
    """

    name: str
    seconds: Array
    nanoseconds: np.ndarray
    poses: Array
    covariances: Array | None
    path: Array
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)


def tracks(comparison: Comparison) -> Iterator[Track]:
    """The ground truth where it is known, and every estimate. In a log without times a step counts as a second."""
    log = comparison.log
    seconds = elapsed_of(log)
    # added as whole numbers: seconds since 1970 are not exact to a nanosecond
    whole, part = divmod(log.start_time, 1)
    clock = int(whole) * 1_000_000_000 + round(part * 1e9) + np.rint(seconds * 1e9).astype(np.int64)
    if log.true_poses is not None:
        known = np.asarray(np.isfinite(log.true_poses).all(axis=1))
        poses = log.true_poses[known]
        path = poses if log.true_path is None else log.true_path[np.isfinite(log.true_path).all(axis=1)]
        yield Track("truth", seconds[known], clock[known], poses, None, path, log.true_landmarks or {})
    between = control_path(log, comparison.options.motion, most_turn=_ARC)
    for result in comparison.results:
        used = result.estimated
        covariances = result.pose_covariances
        along = between.through(np.where(used[:, None], result.poses, np.nan))
        yield Track(
            result.name,
            seconds[used],
            clock[used],
            result.poses[used],
            None if covariances is None else covariances[used],
            along[np.isfinite(along[:, 0])],
            result.landmarks,
            result.landmark_covariances,
        )
