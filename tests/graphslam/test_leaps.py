"""Motions that odometry did not measure, in logs without ids: the verdict says where the map begins again."""

from __future__ import annotations

import numpy as np
import pytest

from graphslam import Log, MotionModel, SensorModel
from graphslam.association import associate_from
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate
from graphslam.se2 import compose

MOTION = MotionModel(nn=0.03, no=0.0, on=0.02, oo=0.03, epsilon=1e-5)
SENSOR = SensorModel(range_rate=0.0, range_std=0.03, bearing_std=0.01)
STEPS, RANGE, PUSHED = 60, 5.0, 30


def circling(seed: int, push: tuple[float, float, float], *, hidden_behind: bool = False) -> Log:
    """Two rounds among landmarks, with a motion ``push`` before step `PUSHED` that odometry does not measure.

    ``hidden_behind``: from then on other landmarks are seen, as behind a door.
    """
    rng = np.random.default_rng(seed)
    maps = rng.uniform(-6, 6, (2, 14, 2))
    controls = np.tile([0.8, 0.2], (STEPS, 1))
    poses = [np.array([0.0, -3.0, 0.0])]
    for t in range(STEPS):
        poses.append(MOTION.f(poses[-1], controls[t] + 0.02 * rng.standard_normal(2), 1.0))
        if t + 1 == PUSHED:
            poses[-1] = compose(poses[-1], np.array(push))
    steps, sightings = [], []
    for t, pose in enumerate(poses):
        for place in maps[int(hidden_behind and t >= PUSHED)]:
            z = SENSOR.h(pose, place) + [0.03, 0.01] * rng.standard_normal(2)
            if 0.2 < z[0] < RANGE and rng.random() < 0.9:
                steps.append(t)
                sightings.append(z)
    return Log(
        dt=np.ones(STEPS), controls=controls, steps=np.array(steps), landmarks=np.full(len(steps), UNIDENTIFIED),
        sightings=np.array(sightings), true_poses=np.array(poses), motion=MOTION, sensor=SENSOR,
    )  # fmt: skip


@pytest.mark.parametrize("push", [(1.0, 0.0, 0.5), (-1.5, 1.0, -1.0), (4.0, 3.0, 2.5)])
def test_a_motion_that_odometry_missed_is_named(push: tuple[float, float, float]) -> None:
    """The map is doubled, and its trajectory bent; the verdict says where, and by how much."""
    log = circling(1, push)
    found = associate_from(log, start=[None, None])
    assert log.true_poses is not None and ate(log.true_poses, found.poses) > 0.3 and found.landmarks > 20
    (reason,) = (each for each in found.verdict.reasons if "hardly any landmark" in each)
    assert not found.verdict.reliable
    assert reason.startswith(f"from step {PUSHED} on") and f"missed a motion after step {PUSHED - 1} (" in reason
    said = [
        float(each.split()[0]) for each in reason.split("(")[1].split(")")[0].replace("to the left", "").split(", ")
    ]
    assert np.allclose(said, push, atol=0.25)


@pytest.mark.parametrize("hidden_behind", [False, True])
def test_drives_without_a_leap_are_not_doubted(hidden_behind: bool) -> None:
    """Neither two rounds in one place, nor a door behind which other landmarks hide those of before."""
    for seed in range(4):
        found = associate_from(circling(seed, (0.0, 0.0, 0.0), hidden_behind=hidden_behind), start=[None, None])
        assert found.verdict.reliable and not found.verdict.reasons
