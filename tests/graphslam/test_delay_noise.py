"""Noise of the recorded controls makes the delay of the sensor too small, and the doubt says by how much."""

from __future__ import annotations

import re

import numpy as np
import pytest

from graphslam import Graph, Log, MotionModel, SensorModel, solve
from graphslam.identification.declared import ParameterEstimate
from graphslam.se2 import wrap

DELAY, RATE = 0.2, 5.0


def estimate(noise: float, seed: int) -> ParameterEstimate:
    """The delay on two minutes of 5 Hz odometry with noise of 0.05 m/s and 0.03 rad/s, or a part of it."""
    rng, motion = np.random.default_rng(seed), MotionModel.constant(0.05 * noise, 0.03 * noise, epsilon=1e-6)
    t = np.arange(600) / RATE
    u = np.column_stack([0.6 + 0.2 * np.sin(t / 5), 0.12 + 0.25 * np.sin(t / 7)])
    poses = np.zeros((600, 3))
    for k in range(599):
        poses[k + 1] = motion.f(poses[k], u[k], 1 / RATE)
    way = poses[:, :2].mean(axis=0) + rng.uniform(-10, 10, (25, 2)) - poses[:, None, :2]
    ranges, bearings = np.hypot(*way.T).T, wrap(np.arctan2(way[:, :, 1], way[:, :, 0]) - poses[:, 2, None])
    k, j = np.nonzero((ranges > 0.3) & (ranges < 8) & (np.abs(bearings) < 1.57) & (np.arange(600) % 2 == 1)[:, None])
    k, j = k[k < 590], j[k < 590]
    u = u + rng.normal(0, [0.05 * noise, 0.03 * noise], u.shape)
    errors = rng.normal(0, [0.05, 0.01], (len(k), 2))
    log = Log.from_tables(
        {"t": t, "nu": u[:, 0], "omega": u[:, 1]},
        {"t": t[k] + DELAY, "id": j, "range": ranges[k, j] + errors[:, 0], "bearing": bearings[k, j] + errors[:, 1]},
    ).replace(motion=motion, sensor=SensorModel(range_rate=0, range_std=0.05, bearing_std=0.01))
    found = solve(Graph.from_log(log, edges="landmark+motion", kernel="none", estimate=["sensor_delay"])).parameters
    assert found is not None
    return found


def test_the_doubt_says_how_much_a_delay_is_too_small() -> None:
    raw, values, deviations = [], [], []
    for seed in range(4):
        found = estimate(1.0, seed)
        said = re.search(r"it is about ([\d.]+) \+- ([\d.]+) s", found.doubt)
        assert said is not None
        raw.append(found["sensor_delay"])
        values.append(float(said[1]))
        deviations.append(float(said[2]))
    # the mean of four, at three standard errors; as estimated it is half the truth
    assert np.mean(raw) < 0.7 * DELAY
    assert np.mean(values) == pytest.approx(DELAY, abs=3 * np.mean(deviations) / 2)


def test_a_delay_of_precise_odometry_is_not_doubted() -> None:
    found = estimate(0.2, 0)
    assert not found.doubt
    assert abs(found["sensor_delay"] - DELAY) < 3 * found.deviations["sensor_delay"]
