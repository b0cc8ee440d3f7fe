"""The webmap world, a shorter drive than in benchmarks/fastslam_webmap.py, which times it."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "fastslam_webmap.py"


@pytest.mark.slow
@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_drive(kind: type, shared_data: Callable[[str], Path]) -> None:
    world = runpy.run_path(str(BENCHMARK))
    path, models = shared_data("fastslam_webmap/webmap.txt"), {"motion": world["MOTION"], "sensor": world["SENSOR"]}
    landmarks, way_points = world["read_world"](path)
    assert landmarks.shape == (35, 2)
    assert way_points.shape == (17, 2)
    log = world["webmap_log"](path, steps=4000)
    assert np.all(log.steps % 8 == 0)
    slam = kind(log, particles=300, **models)
    result = slam.run()

    def error(poses: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum((poses - log.true_poses)[:, :2] ** 2, axis=1))))

    assert result.poses.shape == (4001, 3)
    assert error(result.poses) < 1.5
    # histories are shared back in time: far fewer rows than 300 for every step
    assert slam._engine.stored_poses < 0.2 * 300 * 4001
