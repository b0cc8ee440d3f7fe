"""The alignment of estimates to the ground truth, the same for all drawings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from graphslam import Log, MotionModel, SensorModel, control_path
from graphslam.continuous_time import ControlPath
from graphslam.metrics import alignment_of
from graphslam.se2 import Array, compose, rotation, transform

#: lines along the controls have about so many points at most, and follow the arcs of controls that turn farther [rad]
MOST_POINTS, MOST_TURN = 10_000, 1.0

if TYPE_CHECKING:
    from ..comparison import Comparison
    from ..results import EstimatorResult


def placement_of(
    log: Log,
    poses: Array,
    estimated: np.ndarray | None = None,
    landmarks: Mapping[int, Array] | None = None,
    *,
    named: bool = True,
) -> Array:
    """The rigid motion (3,) that aligns an estimate to the ground truth, the one after which its errors are measured.

    Args:
        log: its ground truth counts, where it has one.
        poses: (T+1, 3) in the axes of the estimator.
        estimated: (T+1,) bool, which poses count; default: all.
        landmarks: the map, for a log whose true landmarks are known and whose true poses are not.
        named: whether the ids of the landmarks are those of the log.

    Returns:
        The motion as a pose; zero where there is no truth to align to.
    """
    truth, true_map = log.true_poses, log.true_landmarks
    aligned = alignment_of(truth, true_map, log.at_truth(poses), landmarks or {}, mask=estimated, named=named)
    return np.zeros(3) if aligned is None else aligned[0]


def placement_of_result(log: Log, result: EstimatorResult) -> Array:
    """The same of the result of an estimator."""
    return placement_of(log, result.poses, result.estimated, result.landmarks, named=result.named)


def placed(log: Log, placement: Array, poses: Array) -> Array:
    """Poses (..., 3) as they are drawn: aligned, and of the point of the robot to which the ground truth belongs."""
    return compose(placement, log.at_truth(poses))


def between_poses(log: Log, motion: MotionModel | None, points: int = MOST_POINTS) -> ControlPath:
    """The path between poses along the recorded controls, for lines of about so many points at most."""
    interval = 0.0
    if log.dt is not None and len(log.dt) > points:
        interval = float(np.sum(log.dt)) / points
    return control_path(log, motion, interval=interval, most_turn=MOST_TURN)


def true_line(log: Log) -> Array | None:
    """The true path as far as it is known, (n, 3): at the ends of all controls, else at the poses."""
    return log.true_poses if log.true_path is None else log.true_path


def aligned_to(log: Log) -> str:
    """The reference of the alignment: "the ground truth", "the true landmarks", or "" where neither is known."""
    if np.count_nonzero(log.covered) >= 2:
        return "the ground truth"
    return "the true landmarks" if len(true_landmarks(log)) >= 2 and log.identified else ""


def place_map(
    placement: Array, landmarks: Mapping[int, Array], covariances: Mapping[int, Array]
) -> tuple[dict[int, Array], dict[int, Array]]:
    """The positions (2,) and covariances (2, 2) of landmarks, moved by a placement (3,)."""
    turn = rotation(placement[2])
    means = {j: transform(placement, m[:2]) for j, m in landmarks.items()}
    return means, {j: turn @ S[:2, :2] @ turn.T for j, S in covariances.items()}


def reference_of(comparison: Comparison) -> EstimatorResult | None:
    """The result whose sightings and map are drawn: the graph, or the best of the others."""
    for name in ("graph", "graph-marginal", "gtsam", "textbook", "fastslam1", "fastslam2"):
        if name in comparison:
            return comparison[name]
    return comparison.results[0] if comparison.results else None


def sensor_of(comparison: Comparison) -> SensorModel:
    """The sensor whose sightings are drawn."""
    return comparison.options.sensor or comparison.log.sensor or SensorModel()


def true_landmarks(log: Log) -> dict[int, Array]:
    """The true positions (2,) of the landmarks that were seen: a world may have thousands of others."""
    seen = set(log.landmark_ids.tolist()) if log.identified else None
    return {j: np.asarray(m)[:2] for j, m in (log.true_landmarks or {}).items() if seen is None or j in seen}
