"""A robot on a small circle at a constant speed: its log does not tell the scale of the wheels from the place of the sensor.

The sightings tell the circle of the sensor, whose radius is R, and the odometry the scale times that of the robot. So only
scale * (R + sensor_left) is determined, and a small error of the derivatives decides on both.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from graphslam import Graph, Log, MotionModel, SensorModel, estimate_robot, simulate, solve
from graphslam.metrics import ate
from graphslam.se2 import Array, wrap

RADIUS, SPEED, RATE, DURATION = 0.5, 0.5, 20, 600
MOTION, SENSOR = MotionModel.constant(0.03, 0.03, epsilon=1e-8), SensorModel(range_rate=0.02, bearing_std=0.01)


def circling(seed: int, wheel_scale: float = 1.0) -> tuple[Log, Array]:
    """Ten minutes of noisy 20 Hz odometry and two scans of 25 landmarks a second, and the true poses (T+1, 3) of its log."""
    rng, rows = np.random.default_rng(seed), DURATION * RATE
    control = np.array([SPEED, SPEED / RADIUS])

    def true_poses(times: Array) -> Array:
        return MotionModel().f(np.zeros(3), control, times)

    t = np.arange(rows) / RATE
    recorded = control * [wheel_scale, 1.0] + 0.03 * rng.standard_normal((rows, 2))
    scans = np.arange(0.2, DURATION - 0.5, 0.5)
    poses, places = true_poses(scans), rng.uniform(-6, 6, (25, 2))
    way = places - poses[:, None, :2]
    ranges, bearings = np.hypot(*way.T).T, wrap(np.arctan2(way[:, :, 1], way[:, :, 0]) - poses[:, 2, None])
    k, j = np.nonzero(ranges < 6)
    seen = ranges[k, j] * (1 + 0.02 * rng.standard_normal(len(k))), bearings[k, j] + 0.01 * rng.standard_normal(len(k))
    log = Log.from_tables(
        {"t": t, "nu": recorded[:, 0], "omega": recorded[:, 1]},
        {"t": scans[k], "id": j, "range": seen[0], "bearing": seen[1]},
    )
    assert log.times is not None
    return log, true_poses(log.times)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.nightly)])
def test_noise_of_recorded_speeds_is_no_scale_of_the_wheels(seed: int) -> None:
    """With controls averaged over half a second as the derivative, the scale is 1.1 and the error four times the expected."""
    log, truth = circling(seed)
    solution = solve(Graph.from_log(log))
    assert ate(truth, solution.poses) < 2 * solution.expected_ate


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1])
def test_wheels_and_sensor_are_not_both_held_where_one_of_them_is_wrong(seed: int) -> None:
    found = estimate_robot(circling(seed, wheel_scale=1.04)[0]).parameters
    # those that are held have no place among the estimated ones
    p = {"wheel_scale": 1.0, "sensor_left": 0.0} | dict(zip(found.names, found.values.tolist()))
    assert p["wheel_scale"] * (RADIUS + p["sensor_left"]) / RADIUS == pytest.approx(1.04, abs=0.005)


@pytest.mark.nightly
def test_the_doubt_says_how_much_the_squares_of_the_noise_change_a_scale() -> None:
    values, deviations = [], []
    for seed in (1, 3, 5):
        log = circling(seed)[0].replace(motion=MOTION, sensor=SENSOR)
        both = {"wheel_scale": 0.05, "sensor_left": 0.03}
        found = solve(Graph.from_log(log, edges="landmark+motion", estimate=both)).parameters
        assert found is not None and found["wheel_scale"] > 1.2
        said = re.search(r"about wheel_scale ([\d.]+) \+- ([\d.]+)\.", found.doubt)
        assert said is not None
        values.append(float(said[1]))
        deviations.append(float(said[2]))
    assert np.mean(values) == pytest.approx(1.0, abs=3 * np.mean(deviations) / 3**0.5)
    # alone it is determined by all of the way
    alone = solve(Graph.from_log(log, edges="landmark+motion", estimate=["wheel_scale"])).parameters
    assert alone is not None and not alone.doubt


@pytest.mark.parametrize("way_points", [None, ((0.0, -3.0), (3.0, 0.0), (0.0, 3.0), (-3.0, 0.0)) * 5])
def test_noise_of_commands_makes_no_scale_too_large(way_points: tuple[tuple[float, float], ...] | None) -> None:
    """A robot that follows commands with noise, as the book's, has the noise in its motions, not in the record."""
    log = simulate(steps=150, dt=1.0, clean=True, way_points=way_points, seed=4)
    found = solve(Graph.from_log(log, noise="book", estimate={"wheel_scale": 0.05, "turn_scale": 0.05})).parameters
    assert found is not None and abs(found["turn_scale"] - 1) < 0.15
    assert not found.doubt
