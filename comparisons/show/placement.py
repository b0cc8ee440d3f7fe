"""How estimates are aligned to the ground truth wherever they are drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from graphslam import Log
from graphslam.metrics import align
from graphslam.se2 import Array, rotation, transform

from ..comparison import Comparison
from ..results import EstimatorResult


def placement_of(log: Log, poses: Array, estimated: np.ndarray | None = None) -> Array:
    """The rigid motion (3,) that aligns poses to the ground truth, the one after which their errors are measured.

    Args:
        log: its ground truth counts, where it has one.
        poses: (T+1, 3) in the axes of the estimator.
        estimated: (T+1,) bool, which poses count; default: all.

    Returns:
        The motion as a pose; zero where there is no truth to align to.
    """
    counted = log.covered if estimated is None else log.covered & estimated
    if log.true_poses is None or not counted.any():
        return np.zeros(3)
    return align(log.true_poses, poses, mask=counted)


def place_map(
    placement: Array, landmarks: Mapping[int, Array], covariances: Mapping[int, Array]
) -> tuple[dict[int, Array], dict[int, Array]]:
    """The positions (2,) and covariances (2, 2) of landmarks, moved by a placement (3,)."""
    turn = rotation(placement[2])
    means = {j: transform(placement, m[:2]) for j, m in landmarks.items()}
    return means, {j: turn @ S[:2, :2] @ turn.T for j, S in covariances.items()}


def reference_of(comparison: Comparison) -> EstimatorResult | None:
    """The result whose sightings and map are drawn: the graph, or the best of the others."""
    for name in ("graph", "graph-marginal", "gtsam", "textbook", "fastslam1"):
        if name in comparison:
            return comparison[name]
    return comparison.results[0] if comparison.results else None


def true_landmarks(log: Log) -> dict[int, Array]:
    """The true positions (2,) of the landmarks that were seen: a world may have thousands of others."""
    seen = set(log.landmark_ids.tolist()) if log.identified else None
    return {j: np.asarray(m)[:2] for j, m in (log.true_landmarks or {}).items() if seen is None or j in seen}
