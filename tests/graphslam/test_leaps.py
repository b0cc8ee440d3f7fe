"""Motions that odometry did not measure, in logs without ids: the map is repaired, or doubted where places look alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from graphslam import Graph, Log, MotionModel, SensorModel, solve
from graphslam.association import associate_from, known_noise
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate, mean_nees
from graphslam.se2 import compose

MOTION = MotionModel(nn=0.03, no=0.0, on=0.02, oo=0.03, epsilon=1e-5)
SENSOR = SensorModel(range_rate=0.0, range_std=0.03, bearing_std=0.01)
STEPS, RANGE, PUSHED = 60, 5.0, 30


def circling(seed: int, push: tuple[float, float, float], *, hidden_behind: bool = False, pushes: int = 1) -> Log:
    """Two rounds among landmarks, with a motion ``push`` before step `PUSHED` that odometry does not measure.

    ``hidden_behind``: from then on other landmarks are seen, as behind a door. ``pushes``: it takes so many steps.
    """
    rng = np.random.default_rng(seed)
    maps = rng.uniform(-6, 6, (2, 14, 2))
    controls = np.tile([0.8, 0.2], (STEPS, 1))
    poses = [np.array([0.0, -3.0, 0.0])]
    for t in range(STEPS):
        poses.append(MOTION.f(poses[-1], controls[t] + 0.02 * rng.standard_normal(2), 1.0))
        if PUSHED <= t + 1 < PUSHED + pushes:
            poses[-1] = compose(poses[-1], np.array(push) / pushes)
    steps, sightings = [], []
    for t, pose in enumerate(poses):
        for place in maps[int(hidden_behind and t >= PUSHED)]:
            z = SENSOR.h(pose, place) + [0.03, 0.01] * rng.standard_normal(2)
            if 0.2 < z[0] < RANGE and rng.random() < 0.9:
                steps.append(t)
                sightings.append(z)
    return _log(poses, controls, steps, sightings)


def _log(poses: list[np.ndarray], controls: Any, steps: list[int], sightings: list[np.ndarray]) -> Log:
    return Log(
        dt=np.ones(len(controls)), controls=np.array(controls), steps=np.array(steps), true_poses=np.array(poses),
        landmarks=np.full(len(steps), UNIDENTIFIED), sightings=np.array(sightings), motion=MOTION, sensor=SENSOR,
    )  # fmt: skip


def two_rooms(seed: int, apart: float) -> Log:
    """A round in a room, the way to its copy, and a round there; a wall is between the rooms."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-5, 5, (14, 2))
    way = int(apart / 1.5)
    poses, controls = [np.array([0.0, -3.0, 0.0])], []
    for t in range(51 + way):
        control = np.array([1.5, 0.0] if 25 < t <= 25 + way else [0.8, 0.25])
        if t == 25:
            control = np.array([0.0, -poses[-1][2] % (2 * np.pi) - 2 * np.pi])
        controls.append(control)
        poses.append(MOTION.f(poses[-1], control + 0.02 * rng.standard_normal(2), 1.0))
    steps, sightings = [], []
    for t, pose in enumerate(poses):
        for place in places + [0.0 if t <= 26 + way // 2 else apart, 0.0]:
            z = SENSOR.h(pose, place) + [0.03, 0.01] * rng.standard_normal(2)
            if 0.2 < z[0] < RANGE and rng.random() < 0.9:
                steps.append(t)
                sightings.append(z)
    return _log(poses, controls, steps, sightings)


@pytest.mark.slow
@pytest.mark.parametrize("push", [(1.0, 0.0, 0.5), (-1.5, 1.0, -1.0), (4.0, 3.0, 2.5)])
def test_a_motion_that_odometry_missed_is_found_and_not_used(push: tuple[float, float, float]) -> None:
    """The result has each landmark once, and the graph of its log is right by default."""
    log = circling(1, push)
    assert log.true_poses is not None
    found = associate_from(log, start=[None, None])
    (leap,) = found.repaired
    assert (leap.last, leap.step) == (PUSHED - 1, PUSHED)
    assert np.allclose(leap.motion, push, atol=0.25)
    assert found.landmarks == 14 and found.verdict.reliable and ate(log.true_poses, found.poses) < 0.05
    assert any(
        "odometry missed a motion between steps 29 and 30" in note and "not used" in note for note in found.notes
    )
    solution = solve(Graph.from_log(found.log))
    assert ate(log.true_poses, solution.poses) < 0.05
    assert 0.2 < mean_nees(solution.poses, log.true_poses, solution.covariance()) < 3
    assert found.log.control_variances is not None
    assert np.flatnonzero(found.log.control_variances.any(axis=1)).tolist() == [PUSHED - 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "push"),
    [
        (1, (4.0, 3.0, 2.5)),
        pytest.param(101, (1.0, 0.0, 0.5), marks=pytest.mark.nightly),
        pytest.param(20, (4.0, 3.0, 2.5), marks=pytest.mark.nightly),
    ],
)
def test_a_missed_motion_is_named_where_the_noise_is_unknown(seed: int, push: tuple[float, float, float]) -> None:
    """The noise is found by the same repair, which does not keep the ids from being found with it."""
    log = circling(seed, push).replace(motion=None, sensor=None)
    assert log.true_poses is not None
    known, robot = known_noise(log)
    assert robot is not None and known.control_variances is None
    # the motion that was missed is no noise
    assert robot.motion.on < 0.04 and robot.motion.oo < 0.06
    found = associate_from(known)
    assert [(leap.last, leap.step) for leap in found.repaired] == [(PUSHED - 1, PUSHED)]
    assert found.landmarks == 14 and ate(log.true_poses, found.poses) < 0.05
    assert any("odometry missed a motion between steps 29 and 30" in note for note in found.log.notes)


@pytest.mark.slow
def test_wheels_that_spin_during_several_scans_are_not_believed_in_any_of_them() -> None:
    """With the first of two steps alone as unknown, the ATE is 0.074 m and the map is said to be reliable."""
    log = circling(21, (1.0, 0.0, 0.5), pushes=2)
    found = associate_from(log, start=[None, None])
    assert [(leap.last, leap.step) for leap in found.repaired] == [(PUSHED - 1, PUSHED + 1)]
    assert log.true_poses is not None and ate(log.true_poses, found.poses) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (7, 20))])
def test_the_place_after_a_declared_gap_is_found(seed: int) -> None:
    """The copies of the map need not overlap there, and chance matches across the gap are given up."""
    log, variances = circling(seed, (4.0, 3.0, 2.5)), np.zeros((STEPS, 3))
    variances[PUSHED - 1] = [25.0, np.pi**2, 25.0]
    found = associate_from(log.replace(control_variances=variances))
    assert log.true_poses is not None and ate(log.true_poses, found.poses) < 0.05
    assert found.landmarks == 14 and len(found.repaired) == 1


@pytest.mark.parametrize(("apart", "doubted"), [(11.0, True), (14.0, False)])
def test_two_rooms_that_look_alike_stay_two(apart: float, doubted: bool) -> None:
    """The odometry is right there; a doubt is the most that is said."""
    found = associate_from(two_rooms(1, apart), start=[None, None])
    assert found.repaired == () and found.landmarks == 28
    assert any("two places look alike" in reason for reason in found.verdict.reasons) == doubted


@pytest.mark.slow
@pytest.mark.parametrize("hidden_behind", [False, True])
def test_drives_without_a_leap_are_not_doubted(hidden_behind: bool) -> None:
    """Neither two rounds in one place, nor a door behind which other landmarks hide those of before."""
    for seed in range(4):
        found = associate_from(circling(seed, (0.0, 0.0, 0.0), hidden_behind=hidden_behind), start=[None, None])
        assert found.verdict.reliable and not found.verdict.reasons
