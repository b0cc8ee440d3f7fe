"""Paths between keyframes: they follow the controls and end where the estimate says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from graphslam import Log, MotionModel
from graphslam.dense import dense_path
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
    path = dense_path(log, log.dead_reckoning())
    np.testing.assert_allclose(wrap(path.poses - MODEL.dead_reckoning([0, 0, 0], log.controls, log.dt)), 0, atol=1e-12)
    np.testing.assert_allclose(path.times, 5.0 + np.concatenate([[0], np.cumsum(log.dt)]))
    np.testing.assert_array_equal(path.rows, log.control_starts)


def test_the_poses_of_the_log_stay_and_unknown_ones_leave_gaps(log):
    poses = log.dead_reckoning() + np.random.default_rng(2).normal(0, 0.3, (5, 3))
    poses[4] = np.nan
    path = dense_path(log, poses)
    np.testing.assert_array_equal(path.poses[path.rows], poses)
    assert np.isfinite(path.poses[:12]).all() and np.isnan(path.poses[12:]).all()


def test_the_path_is_the_most_likely_one_between_its_ends(log):
    """Against the least-squares path through poses at every control, each motion edge with its own covariance."""
    motion = MotionModel(epsilon=1e-12)
    ends = compose(log.dead_reckoning()[2:4], [[0, 0, 0], [1e-5, -2e-5, 1e-5]])
    controls, dt = log.controls[4:11], log.dt[4:11]
    A = [motion.A([0, 0, 0], u, t) for u, t in zip(controls, dt)]
    root = [np.linalg.cholesky(motion.M(u, t)) for u, t in zip(controls, dt)]

    def reached(noise):
        poses = [ends[0]]
        for u, t, a, r, n in zip(controls, dt, A, root, noise.reshape(-1, 2)):
            step = motion.f([0, 0, 0], u, t) + a @ r @ n
            poses.append(compose(poses[-1], step))
        return np.array(poses)

    def cost(noise):
        return np.concatenate([noise, 1e7 * between(ends[1], reached(noise)[-1])])

    best = reached(least_squares(cost, np.zeros(14), xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
    whole = log.dead_reckoning()
    whole[2:4] = ends
    path = dense_path(log, whole, motion)
    np.testing.assert_allclose(path.poses[4:12], best, atol=1e-8)


def test_long_turns_are_divided_along_their_arc():
    log = Log(dt=[2.0], controls=[(1.0, 1.5)], steps=[0], landmarks=[0], sightings=[(1, 0)])
    path = dense_path(log, log.dead_reckoning(), most_turn=0.1)
    assert len(path.times) == 31 and path.rows.tolist() == [0, 30]
    # a circle of radius nu / omega to the left of the start
    np.testing.assert_allclose(np.hypot(path.poses[:, 0], path.poses[:, 1] - 1 / 1.5), 1 / 1.5, atol=1e-12)


def test_without_controls_the_path_is_the_poses():
    log = Log(initial_poses=np.zeros((3, 3)), steps=[0], landmarks=[0], sightings=[(1, 0)])
    np.testing.assert_array_equal(dense_path(log, np.ones((3, 3))).poses, np.ones((3, 3)))
