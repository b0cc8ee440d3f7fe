"""The online solver with a lag: the prior that marginalised poses leave, and memory that stays bounded."""

import numpy as np
import pytest

from graphslam import GraphError, OnlineSolver, PoseRelations, SensorModel, simulate, solve_online
from graphslam.se2 import between, compose, wrap


def drive(lag, scale, steps=60):
    """A solver after a drive in a circle among five landmarks, with noise in proportion to ``scale``."""
    rng, move = np.random.default_rng(0), np.array([0.5, 0.0, 0.2])
    std, sensor = (
        scale * np.array([0.05, 0.05, 0.03]),
        SensorModel(range_rate=0.0, range_std=0.05 * scale, bearing_std=0.02 * scale),
    )
    solver, marks, pose = OnlineSolver(sensor=sensor, lag=lag), rng.uniform(-4, 4, (5, 2)), np.zeros(3)
    for _ in range(steps):
        pose = compose(pose, move)
        way = marks - pose[:2]
        exact = np.column_stack([np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0]) - pose[2]])
        solver.move(motion=move + rng.normal(0, std), covariance=np.diag(std**2))
        solver.observe(np.arange(5), exact + rng.normal(0, scale * np.array([0.05, 0.02]), (5, 2)))
    solver.relinearize()
    return solver


@pytest.mark.parametrize("lag", [1, 5, 20, 50])
def test_a_lag_is_exact_where_the_problem_is_linear(lag):
    whole, short = drive(None, 0.01), drive(lag, 0.01)
    joint = whole.covariance(whole.step, [0, 3], joint=True)
    std = np.sqrt(np.diag(joint))
    np.testing.assert_allclose(
        short.covariance(short.step, [0, 3], joint=True) / np.outer(std, std), joint / np.outer(std, std), atol=2e-3
    )
    assert np.abs((short.pose - whole.pose) / std[:3]).max() < 0.02
    for key, mark in whole.landmarks.items():
        np.testing.assert_allclose(short.landmarks[key], mark, atol=0.02 * std[3:].max())
    assert (short.num_final, short.step, short.poses.shape) == (60 - lag, 60, (61, 3))
    np.testing.assert_allclose(short.poses[-lag:], whole.poses[-lag:], atol=0.1 * std[:3].min())


def test_memory_is_that_of_the_lag():
    system = drive(10, 1.0, steps=400)._backend.system
    assert system.num_edges <= 1200
    assert system.bytes < 600_000
    # that of the first pose, and one for the poses since then: no landmark was new
    assert system.num_priors == 2
    assert system.num_nodes < 100


def test_a_step_with_a_lag_that_only_the_batch_solver_can_take():
    rng = np.random.default_rng(2)
    covariance, truth, solver = np.diag([0.14, 0.14, 0.1]) ** 2, [np.zeros(3)], OnlineSolver(lag=299)
    for k in range(1, 301):
        move = np.array([1.0, 0.0, np.pi / 2 if k % 75 == 0 else 0.0])
        truth.append(compose(truth[-1], move))
        solver.move(motion=move + rng.normal(0, (0.14, 0.14, 0.1)), covariance=covariance)
    with pytest.raises(GraphError, match="pose 0, which is final: with lag=299, the poses from 1 on"):
        solver.relate(0, 300, between(truth[0], truth[300]), covariance)
    solver.relate(1, 300, between(truth[1], truth[300]), covariance)
    assert np.abs(between(between(truth[1], truth[300]), between(solver.poses[1], solver.pose))).max() < 0.5
    tied = solver.poses
    solver.relinearize()
    np.testing.assert_allclose(wrap(solver.poses - tied), 0, atol=1e-3)


def corridor(lag, seed):
    """The newest pose after each step along a corridor of 90 m with landmarks at both sides."""
    rng, std, move = np.random.default_rng(seed), np.array([0.03, 0.03, 0.03]), np.array([0.5, 0.0, 0.0])
    solver, poses = OnlineSolver(sensor=SensorModel(range_rate=0.0, range_std=0.05, bearing_std=0.02), lag=lag), []
    marks = np.array([[x, y] for x in np.arange(1.0, 95.0, 2.0) for y in (-1.5, 1.5)])
    marks += rng.normal(0, 0.2, marks.shape)
    for step in range(1, 181):
        way = marks - move[:2] * step
        exact = np.column_stack([np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])])
        seen = np.flatnonzero((exact[:, 0] < 4) & (np.abs(exact[:, 1]) < 1.2))
        solver.move(motion=move + rng.normal(0, std), covariance=np.diag(std**2))
        solver.observe(seen, exact[seen] + rng.normal(0, [0.05, 0.02], (len(seen), 2)))
        poses.append(solver.pose)
    return np.array(poses), np.sqrt(np.diag(solver.covariance(solver.step)))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_corridor_with_a_lag_is_that_without(seed):
    """The heading is uncertain by 0.1 rad at the end: a prior in world axes resists the turn, and poses jump by metres."""
    (whole, std), (short, own) = corridor(None, seed), corridor(20, seed)
    assert std[1] > 5.0
    assert np.abs(short - whole)[:, :2].max() < 0.05 * std[1]
    assert np.hypot(*np.diff(short, axis=0)[:, :2].T).max() < 0.75
    np.testing.assert_allclose(own, std, rtol=0.25)


def test_numbers_of_final_poses_are_dropped() -> None:
    """Ranges from poses that had become final were taken as ranges from the newest ones, once the landmark was seen whole."""
    solver, place = OnlineSolver(lag=2), np.array([3.0, 4.0])
    for t in range(1, 11):
        solver.move(motion=[1, 0, 0], covariance=np.diag([0.05, 0.05, 0.02]) ** 2)
        if t in (5, 6):
            solver.observe([7], [[np.hypot(*(place - [t, 0])), np.nan]])
    x, y = place - [10, 0]
    solver.observe([7], [[np.hypot(x, y), np.arctan2(y, x)]])
    assert solver.landmarks[7] == pytest.approx(place, abs=1e-6) and solver.cost < 1e-9


@pytest.mark.parametrize(("first", "refused"), [(20, True), (25, True), (28, True), (29, False)])
def test_relations_of_a_log_to_final_poses_are_refused(first: int, refused: bool) -> None:
    """They were taken as relations to the newest poses, whose places in the list Python counts from its end."""
    log = simulate(seed=1, steps=60, clean=True)
    motion = between(log.true_poses[first], log.true_poses[50])
    related = log.replace(
        relations=PoseRelations(first=[first], second=[50], motions=motion[None], covariances=1e-4 * np.eye(3))
    )
    if refused:
        with pytest.raises(
            GraphError, match=f"relation from pose {first}, which is final: with lag=20, the poses from 29 on"
        ):
            solve_online(related, lag=20)
    else:
        found = solve_online(related, lag=20)
        assert between(found.poses[first], found.poses[50]) == pytest.approx(motion, abs=0.05)
