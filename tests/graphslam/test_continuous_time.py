"""Paths between keyframes: they follow the controls and end where the estimate says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from graphslam import Log, LogError, MotionModel, load, save, simulate
from graphslam.log.continuous_time import control_path, with_poses_every
from graphslam.se2 import between, compose, wrap

MODEL = MotionModel(epsilon=1e-6)


@pytest.fixture(scope="module")
def log() -> Log:
    """Four motions of one to seven controls each."""
    rng = np.random.default_rng(1)
    starts = np.array([0, 1, 4, 11, 13])
    controls = np.column_stack([rng.uniform(0.1, 0.5, 13), rng.uniform(-0.6, 0.9, 13)])
    return Log(
        dt=rng.uniform(0.2, 1.0, 13), controls=controls, control_starts=starts, steps=[0], landmarks=[0],
        sightings=[(1, 0)], initial_poses=None, motion=MODEL, start_time=5.0,
    )  # fmt: skip


def test_dead_reckoning_is_followed_exactly(log):
    path = control_path(log)
    through = path.through(log.dead_reckoning())
    np.testing.assert_allclose(wrap(through - MODEL.dead_reckoning([0, 0, 0], log.controls, log.dt)), 0, atol=1e-12)
    np.testing.assert_allclose(path.times, 5.0 + np.concatenate([[0], np.cumsum(log.dt)]))
    np.testing.assert_array_equal(path.rows, log.control_starts)


def test_the_poses_of_the_log_stay_and_unknown_ones_leave_gaps(log):
    poses = log.dead_reckoning() + np.random.default_rng(2).normal(0, 0.3, (5, 3))
    poses[4] = np.nan
    path = control_path(log)
    through = path.through(poses)
    np.testing.assert_array_equal(through[path.rows], poses)
    assert np.isfinite(through[:12]).all() and np.isnan(through[12:]).all()
    # the first poses of a drive, as they are known on the way
    np.testing.assert_array_equal(path.through(poses[:3]), through[:5])
    np.testing.assert_array_equal(path.through(poses[:1]), poses[:1])


@pytest.mark.parametrize("slip", [0.0, 0.1])
def test_the_path_is_the_most_likely_one_between_its_ends(log, slip):
    """Against the least-squares path through poses at every control, each motion edge with its own covariance."""
    motion = MotionModel(epsilon=1e-12, slip=slip)
    ends = compose(log.dead_reckoning()[2:4], [[0, 0, 0], [1e-5, -2e-5, 1e-5]])
    controls, dt = log.controls[4:11], log.dt[4:11]
    A = [motion.A([0, 0, 0], u, t) for u, t in zip(controls, dt)]
    root = [np.linalg.cholesky(motion.M(u, t)) for u, t in zip(controls, dt)]

    def reached(noise):
        poses = [ends[0]]
        for u, t, a, r, n in zip(controls, dt, A, root, noise.reshape(-1, 3)):
            chord = u[1] * t / 2
            aside = n[2] * slip * np.sqrt(abs(u[0]) * t) * np.array([-np.sin(chord), np.cos(chord), 0])
            step = motion.f([0, 0, 0], u, t) + a @ r @ n[:2] + aside
            poses.append(compose(poses[-1], step))
        return np.array(poses)

    def cost(noise):
        return np.concatenate([noise, 1e7 * between(ends[1], reached(noise)[-1])])

    best = reached(least_squares(cost, np.zeros(21), xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
    whole = log.dead_reckoning()
    whole[2:4] = ends
    np.testing.assert_allclose(control_path(log, motion).through(whole)[4:12], best, atol=1e-8)


def test_long_turns_are_divided_along_their_arc():
    log = Log(dt=[2.0], controls=[(1.0, 1.5)], steps=[0], landmarks=[0], sightings=[(1, 0)])
    path = control_path(log, most_turn=0.1)
    poses = path.through(log.dead_reckoning())
    assert len(path.times) == len(poses) == 31 and path.rows.tolist() == [0, 30]
    # a circle of radius nu / omega to the left of the start
    np.testing.assert_allclose(np.hypot(poses[:, 0], poses[:, 1] - 1 / 1.5), 1 / 1.5, atol=1e-12)


def test_without_controls_the_path_is_the_poses():
    log = Log(initial_poses=np.zeros((3, 3)), steps=[0], landmarks=[0], sightings=[(1, 0)])
    np.testing.assert_array_equal(control_path(log).through(np.ones((3, 3))), np.ones((3, 3)))


def test_rows_at_the_interval_are_all_kept():
    # sums of 0.1 are not whole multiples of 0.1
    log = Log(
        dt=0.1, controls=np.ones((40, 2)), control_starts=[0, 7, 40], steps=[0], landmarks=[0], sightings=[(1, 0)],
        initial_poses=np.zeros((3, 3)),
    )  # fmt: skip
    assert len(control_path(log, interval=0.1).times) == 41


def test_an_interval_keeps_the_poses_of_the_log_and_leaves_out_other_rows(log):
    poses = log.dead_reckoning() + np.random.default_rng(2).normal(0, 0.1, (5, 3))
    whole, some = control_path(log), control_path(log, interval=1.5)
    assert len(some.times) < len(whole.times)
    kept = np.searchsorted(whole.times, some.times)
    np.testing.assert_array_equal(whole.times[kept], some.times)
    np.testing.assert_array_equal(kept[some.rows], whole.rows)
    np.testing.assert_array_equal(some.through(poses), whole.through(poses)[kept])


@pytest.mark.parametrize("seconds", [0.3, 0.7, 5.0])
def test_further_poses_change_neither_the_drive_nor_what_is_known_of_it(log, seconds):
    motion = MotionModel(epsilon=1e-12)
    exact = motion.dead_reckoning([0, 0, 0], log.controls, log.dt)
    log = log.replace(
        true_poses=exact[log.control_starts], true_path=exact, steps=[0, 2, 4], landmarks=[0, 1, 2],
        sightings=np.ones((3, 2)), control_variances=np.full((13, 2), 1e-3),
    )  # fmt: skip
    more = with_poses_every(log, seconds)
    assert np.diff(more.times).max() <= max(seconds, 1e-9) + 1e-9
    kept = np.searchsorted(more.times, log.times - 1e-9)
    np.testing.assert_allclose(more.times[kept], log.times, atol=1e-12)
    np.testing.assert_array_equal(more.steps, kept[[0, 2, 4]])
    np.testing.assert_array_equal(more.true_poses[kept], log.true_poses)
    np.testing.assert_allclose(wrap(more.dead_reckoning()[kept] - log.dead_reckoning()), 0, atol=1e-12)
    np.testing.assert_allclose(wrap(more.initial_poses - more.dead_reckoning()), 0, atol=1e-12)
    known = np.isfinite(more.true_poses[:, 0])
    np.testing.assert_allclose(more.true_poses[known], more.dead_reckoning()[known], atol=0.02)
    # joined again, the motions and their noise are those of before
    back = more.at_steps(kept)
    for model in (motion, MotionModel.constant(0.1, 0.3, epsilon=1e-12)):
        (motions, noise), (expected, before) = back.motions(model), log.motions(model)
        np.testing.assert_allclose(motions, expected, atol=1e-10)
        # across the drive the noise of parts of a control is a little different, because they are independent
        np.testing.assert_allclose(noise[:, 2, 2], before[:, 2, 2], rtol=1e-9)
    assert with_poses_every(log, 60.0) is log


def test_a_log_of_any_format_takes_further_poses(tmp_path):
    log = simulate(seed=1, steps=5, clean=True)
    save(log.replace(true_poses=None, true_landmarks=None), tmp_path / "log.txt")
    save(log, tmp_path / "log.npz")
    for name in ("log.txt", "log.npz"):
        more = load(tmp_path / name, keep_every=1.0)
        assert more.num_poses == 16 and len(more.steps) == len(log.steps)
    assert more.covered.sum() == 6
    save(more, tmp_path / "more.npz")
    assert load(tmp_path / "more.npz").equals(more)
    with pytest.raises(LogError, match="has no controls"):
        with_poses_every(log.replace(controls=None, dt=None), 1.0)


def test_the_truth_between_poses_stays_with_coarser_logs():
    log = simulate(seed=1, steps=6, clean=True)
    coarse = log.at_steps([0, 2, 5])
    np.testing.assert_array_equal(coarse.true_path, log.true_poses[:6])
    np.testing.assert_array_equal(coarse.at_steps([1, 2]).true_path, log.true_poses[2:6])
    assert coarse.replace(true_poses=None).true_path is None
