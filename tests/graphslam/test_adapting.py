"""What an association tells about the robot: slip sideways, and parameters."""

import numpy as np
import pytest
from error_rates import bound

from graphslam import Graph, GraphError, Log, MotionModel, SensorModel, simulate, solve
from graphslam.association import associate_from, score
from graphslam.association.adapting import Robot, slipping
from graphslam.metrics import ate
from graphslam.se2 import compose

MOTION = MotionModel(nn=0.02, no=0.001, on=0.03, oo=0.02, epsilon=1e-6)
SENSOR = SensorModel(range_rate=0.02, bearing_std=0.01)
ROUTE = ((12, -3), (12, 6), (-12, 6), (-12, -3))


def drifting(slip: float, seed: int = 0, steps: int = 400) -> Log:
    """A robot that turns about a course, and slides sideways by ``slip`` [m] a step, for some five steps the same way."""
    rng = np.random.default_rng(seed)
    start = simulate(
        seed=seed, steps=steps, clean=True, motion=MOTION, sensor=SENSOR, way_points=ROUTE, dt=1.5, turn_rate=0.4,
        landmarks=[*rng.uniform([-17, -8], [17, 11], (40, 2))], max_range=7,
    )  # fmt: skip
    assert start.controls is not None and start.true_poses is not None
    poses, sideways, kept = [start.true_poses[0]], 0.0, 0.8
    for u, dt in zip(start.controls, start.dt):
        sideways = kept * sideways + np.sqrt(1 - kept**2) * slip * rng.standard_normal()
        moved = MOTION.f(np.zeros(3), u, dt) + [0.0, sideways, 0.02 * dt**0.5 * 0.2 * rng.standard_normal()]
        poses.append(compose(poses[-1], moved))
    true, map = np.array(poses), np.array(list(start.true_landmarks.values()))[:, :2]
    at, seen = np.nonzero(
        SENSOR.sees(true[:, None], map) & (np.hypot(*np.moveaxis(true[:, None, :2] - map, -1, 0)) < 7)
    )
    z = SENSOR.h(true[at], map[seen])
    z += rng.standard_normal(z.shape) * np.sqrt(np.diagonal(SENSOR.Q(z), axis1=1, axis2=2))
    return start.replace(
        steps=at, landmarks=seen, sightings=z, true_poses=true, motion=MOTION, sensor=SENSOR, true_landmarks=None
    )


@pytest.mark.parametrize(("slip", "raised", "gaps"), [(0.0, False, 0), (0.02, True, 0), (0.02, True, 3)])
def test_slip_over_long_ways_is_found_where_there_is_some(slip: float, raised: bool, gaps: int) -> None:
    log = drifting(slip)
    if gaps:
        # across a gap in the odometry the robot may be anywhere, which says nothing about its slip elsewhere
        variances = np.zeros((log.num_poses - 1, 3))
        variances[60 : 60 + gaps] = 1.0
        log = log.replace(control_variances=variances)
    first = solve(Graph.from_log(log, edges="landmark+motion", kernel="none"))
    found = slipping(Robot(log, MOTION, SENSOR), np.searchsorted(log.landmark_ids, log.landmarks), first.poses).motion
    if not raised:
        assert found == MOTION
        return
    # over 13 steps the variance of a slip that is kept by 0.8 counts 1 + 2 sum of (1 - k / 13) 0.8^k times
    k = np.arange(1, 13)
    expected = slip**2 * (1 + 2 * np.sum((1 - k / 13) * 0.8**k))
    assert log.controls is not None and log.dt is not None
    far = np.mean(np.abs(log.controls[:, 0]) * log.dt)
    assert expected / 1.7 < found.slip**2 * far < expected * 1.7
    assert found.changed(slip=0.0) == MOTION
    second = solve(Graph.from_log(log, motion=found, edges="landmark+motion", kernel="none"))
    assert ate(second.poses, log.true_poses) < 0.9 * ate(first.poses, log.true_poses)


@pytest.mark.slow
def test_association_estimates_parameters_on_the_way() -> None:
    log = drifting(0.0, seed=1, steps=120)
    biased = log.replace(sightings=log.sightings + [0.1, 0.06])
    found = associate_from(biased, estimate=["bearing_bias", "range-bias"], slip=False)
    assert score(found.ids, log.landmarks).precision > 0.99
    assert found.parameters is not None
    for name, truth in {"bearing_bias": 0.06, "range_bias": 0.1}.items():
        assert abs(found.parameters[name] - truth) < bound(2) * found.parameters.deviations[name]
    assert any("estimated parameters" in note for note in found.notes)
    assert found.log.motion == found.motion == MOTION
    with pytest.raises(GraphError, match="size of the world"):
        associate_from(biased, estimate=["wheel_scale", "range_scale"])
