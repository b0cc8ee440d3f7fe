"""Ground truth of another point of the robot, such as a GPS antenna: errors are measured there."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

import comparisons
from comparisons.show.canvas import placed, placement_of
from graphslam import Log, LogError, OptionError, Stream, calibrate, load, save, simulate, synchronize
from graphslam.metrics import ate, evaluate
from graphslam.se2 import compose, mounted

ANTENNA = (3.78, 0.5)


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=4, steps=40, clean=True)


@pytest.fixture(scope="module")
def with_antenna(log: Log) -> Log:
    # by hand: p + R(theta) (ahead, left)
    c, s = np.cos(log.true_poses[:, 2]), np.sin(log.true_poses[:, 2])
    x = log.true_poses[:, 0] + 3.78 * c - 0.5 * s
    y = log.true_poses[:, 1] + 3.78 * s + 0.5 * c
    return log.replace(true_poses=np.column_stack([x, y, log.true_poses[:, 2]]), truth_offset=ANTENNA)


def test_the_true_path_of_the_robot_has_no_error_at_its_antenna(log, with_antenna):
    gps = with_antenna.replace(
        true_poses=np.column_stack([with_antenna.true_poses[:, :2], np.full(len(log.true_poses), np.nan)])
    )
    for each in (with_antenna, gps):
        metrics = evaluate(each.true_poses, None, each.at_truth(log.true_poses), {})
        assert metrics.ate_m == pytest.approx(0, abs=1e-12)
        # without the offset the same path seems to be metres off: the robot drives a circle
        assert ate(each.true_poses, log.true_poses) > 1.0


def test_the_truth_of_the_robot_itself(log, with_antenna):
    np.testing.assert_allclose(with_antenna.robot_truth, log.true_poses, atol=1e-12)
    assert log.robot_truth is log.true_poses
    some = with_antenna.true_poses.copy()
    some[3, 2], some[5] = np.nan, np.nan
    robot = with_antenna.replace(true_poses=some).robot_truth
    assert np.isnan(robot[[3, 5]]).all() and np.isfinite(robot[[0, 1, 2, 4]]).all()


def test_every_metric_is_that_of_the_robot_s_own_truth(log, with_antenna):
    a, b = (comparisons.run(each, estimators=["dead-reckoning", "graph"]) for each in (log, with_antenna))
    assert b.nees["graph"] == pytest.approx(a.nees["graph"])
    assert b.metrics["graph"].rpe_rad == pytest.approx(a.metrics["graph"].rpe_rad)
    moved = with_antenna.at_truth(b["graph"].poses)
    assert b.metrics["graph"].ate_m == pytest.approx(ate(with_antenna.true_poses, moved))
    assert "3.78 m ahead and 0.5 m to the left" in str(b)
    assert b.to_json()["log"]["truth_offset"] == [3.78, 0.5]


@pytest.mark.slow
def test_calibration_is_the_same(log, with_antenna):
    a, b = calibrate(log, source="truth"), calibrate(with_antenna, source="truth")
    # the search ends within a hundredth of the standard errors
    assert asdict(b.motion) == pytest.approx(asdict(a.motion), rel=1e-3)
    assert b.sensor.range_rate == pytest.approx(a.sensor.range_rate, rel=1e-3)


def test_what_is_drawn_lies_on_the_truth(log, with_antenna):
    bent = compose([3, 4, 1], log.true_poses)
    np.testing.assert_allclose(
        placed(with_antenna, placement_of(with_antenna, bent), bent), with_antenna.true_poses, atol=1e-9
    )


def test_files_and_coarse_logs_keep_it(with_antenna, tmp_path):
    save(with_antenna, tmp_path / "log.npz")
    assert load(tmp_path / "log.npz").equals(with_antenna)
    assert with_antenna.at_steps([0, 5, 9]).truth_offset == ANTENNA
    assert not with_antenna.equals(with_antenna.replace(truth_offset=(0, 0)))


def test_a_drive_starts_where_the_antenna_says():
    times = np.arange(0.0, 5.0)
    truth = Stream(times, np.column_stack([times, np.zeros(5), np.full(5, np.pi / 2)]))
    log = synchronize(
        Stream(times, np.tile([1.0, 0.0], (5, 1))), Stream(times[1:3], np.ones((2, 2))), np.zeros(2),
        truth=truth, truth_offset=(2.0, 0.0),
    )  # fmt: skip
    np.testing.assert_allclose(log.initial_poses[0], [1, -2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(mounted(log.initial_poses[0], (2.0, 0.0)), log.true_poses[0], atol=1e-12)


@pytest.mark.parametrize("wrong", ["ahead", (1, 2, 3), (np.nan, 0)])
def test_what_is_no_place_on_the_robot(log, wrong):
    with pytest.raises(OptionError, match=r"truth_offset must be \(ahead, to the left\)"):
        log.replace(truth_offset=wrong)
    assert log.replace(truth_offset=2).truth_offset == (2.0, 0.0)


def test_evaluate_finds_the_errors_of_run(with_antenna, tmp_path):
    save(with_antenna, tmp_path / "log.npz")
    comparison = comparisons.run(with_antenna, estimators=["graph"])
    comparison.save(tmp_path / "out", figures=())
    row = comparison.table["graph"]
    found = comparisons.evaluate(tmp_path / "log.npz", tmp_path / "out" / "graph.tum")
    for name in ("ate_m", "rpe_m", "rpe_rad", "heading_rad"):
        assert getattr(found.estimates[0], name) == pytest.approx(getattr(row, name), abs=1e-6)
    assert not found.notes
    # a trajectory alone has no such point, and a note says so
    alone = comparisons.evaluate(tmp_path / "out" / "truth.tum", tmp_path / "out" / "graph.tum")
    assert alone.notes[0].startswith("truth: its positions are not those of the robot's pose")
    flat = tmp_path / "flat.csv"
    flat.write_text("t,x,y\n" + "".join(f"{t},{t},0\n" for t in with_antenna.times.tolist()))
    with pytest.raises(LogError, match="it has no headings, and log is the truth of a point off the robot's pose"):
        comparisons.evaluate(tmp_path / "log.npz", flat)


def test_covariances_are_those_of_the_robot(with_antenna, log, tmp_path):
    """The errors of poses with covariances are those of the robot itself, not of its antenna."""
    C = np.diag([0.01, 0.02, 0.001])
    poses = log.true_poses + np.random.default_rng(0).multivariate_normal(np.zeros(3), C, log.num_poses)
    covariances = np.tile(C, (log.num_poses, 1, 1))
    np.savez(tmp_path / "mine.npz", times=log.times, poses=poses, covariances=covariances)
    for name, each in (("a", log), ("b", with_antenna)):
        save(each, tmp_path / f"{name}.npz")
    a, b = (comparisons.evaluate(tmp_path / f"{n}.npz", tmp_path / "mine.npz").estimates[0].nees for n in "ab")
    assert b == pytest.approx(a)
