"""Scales of the odometry that differ between two directions are found, reported and corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from comparisons.show.language import translated
from graphslam import Drive, Graph, Log, LogError, estimate_robot, solve
from graphslam.identification.slips import Uneven, levelled
from graphslam.identification.unknowns import Unknowns
from graphslam.metrics import ate
from graphslam.models import SensorModel


def test_controls_are_levelled_by_their_direction() -> None:
    controls = np.repeat([[1.0, 0.5], [-2.0, -0.2]], 100, axis=0)
    log = Log(
        name="back and forth", controls=controls, dt=np.full(200, 0.1), steps=np.array([1]), landmarks=np.array([1]),
        sightings=np.array([[1.0, 0.0]]), initial_poses=np.zeros((201, 3)),
    )  # fmt: skip
    right = levelled(log, [Uneven(0, 0.04, 0.0), Uneven(1, -0.1, 0.0)]).controls
    # but near the change of the direction, where half a second to each side counts
    far = np.r_[0:95, 105:200]
    np.testing.assert_allclose(right[far], (controls * np.where(controls > 0, [0.98, 1.05], [1.02, 0.95]))[far])
    # noise about zero is no motion
    noise = 0.1 * np.random.default_rng(0).standard_normal(controls.shape)
    still = levelled(log.replace(controls=noise), [Uneven(0, 1.0, 0.0)]).controls
    assert abs(np.mean(still[:, 0] - noise[:, 0])) < 0.4 * abs(np.mean(np.abs(noise[:, 0])) / 2)
    assert levelled(log, ()) is log
    poses_alone = log.replace(controls=None, dt=None)
    assert levelled(poses_alone, ()) is poses_alone
    with pytest.raises(LogError, match="back and forth has no controls, and scales that differ"):
        levelled(poses_alone, [Uneven(1, 0.1, 0.0)])


def test_the_derivatives_are_those_of_finite_differences() -> None:
    log, _ = Drive(seed=7, duration=60.0, misread=0.0).simulate()
    few = log.at_steps(np.arange(0, log.num_poses, 7))
    h = 1e-4
    by_differences = Unknowns(few, few.landmarks, SensorModel()).by_differences()
    for column in (0, 1):
        plus, minus = (
            Unknowns(each, each.landmarks, SensorModel()).measured()[0]
            for each in (levelled(few, [Uneven(column, sign * h, 0.0)]) for sign in (1, -1))
        )
        np.testing.assert_allclose(by_differences[:, :, column], (plus - minus) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("column", [0, 1])
def test_the_sentence_names_the_direction_that_is_larger(column: int) -> None:
    """One that was smaller was said to be larger by a negative percentage."""
    larger, smaller = (Uneven(column, sign * 0.05, 0.01).sentence for sign in (1, -1))
    first, second = (("forward speeds", "backward speeds"), ("left turns", "right turns"))[column]
    assert larger.startswith(f"{first} are recorded larger than ") and " by 5 % (standard error 1 %)" in larger
    assert smaller.startswith(f"{second} are recorded larger than ") and " by 5 % (standard error 1 %)" in smaller
    for each in (larger, smaller):
        assert translated(each, "ja").count("標準誤差1 %") == 1


@pytest.mark.parametrize(("seed", "column", "size"), [(1004, 1, 0.1), (1007, 1, 0.1)])
def test_unequal_turns_are_found_and_corrected(seed: int, column: int, size: float) -> None:
    right, _ = replace(Drive.random(seed), duration=150.0).simulate()
    log = levelled(right, [Uneven(column, -size, 0.0)])
    robot = estimate_robot(log)
    (found,) = robot.uneven
    assert found.column == column and abs(found.difference - size) < 4 * found.error + 0.01
    (doubt,) = (each for each in robot.doubts if "left turns are recorded larger" in each)
    assert "左旋回が右旋回より" in translated(doubt, "ja")
    twice = replace(robot, uneven=(replace(found, difference=found.difference - 0.03), replace(found, difference=0.03)))
    assert [each for each in twice.doubts if "are recorded larger" in each] == [doubt]
    healthy = estimate_robot(right)
    assert healthy.uneven == ()
    wrong, best = (ate(log.true_poses, solve(Graph.from_log(each.log)).poses) for each in (robot, healthy))
    assert wrong < 1.5 * best
    # another log of the robot is corrected, too
    np.testing.assert_allclose(robot.corrected(log).controls, robot.log.controls, atol=1e-9)
