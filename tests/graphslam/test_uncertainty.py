import pickle
from copy import deepcopy

import gtsam
import numpy as np
import pytest
from error_rates import bound

from graphslam import (
    AbsolutePositions,
    Drive,
    Graph,
    MotionModel,
    OptionError,
    SensorModel,
    load,
    sample_log_path,
    simulate,
    solve,
)
from graphslam.metrics import ate
from graphslam.se2 import wrap
from graphslam.solvers.gtsam_solver import to_gtsam, to_values


def in_world_axes(block, theta_i, theta_j):
    """GTSAM's covariances are in the axes of the poses."""

    def turn(theta):
        c, s = np.cos(theta), np.sin(theta)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

    return turn(theta_i) @ block @ turn(theta_j).T


@pytest.mark.nightly
def test_every_pose_of_m3500_against_gtsams_marginals(shared_data):
    graph = Graph.from_g2o(shared_data("posegraph/input_M3500_g2o.g2o"))
    solution = solve(graph, initialize="auto")
    marginals = gtsam.Marginals(to_gtsam(graph, solution.state), to_values(graph, solution.state))
    ours = solution.covariance()
    assert ours.shape == (3500, 3, 3)
    for k in range(1, 3500):
        theirs = in_world_axes(marginals.marginalCovariance(k), solution.poses[k, 2], solution.poses[k, 2])
        assert np.abs(ours[k] - theirs).max() <= 1e-6 * np.abs(theirs).max()
    np.testing.assert_array_equal(ours[0], 0)
    np.testing.assert_array_equal(solution.covariance(17), ours[17])


@pytest.mark.parametrize(
    ("kernel", "larger"), [("none", 1.0), ("huber", 1.02), ("cauchy", 1.08), ("geman-mcclure", 1.07)]
)
def test_marginals_of_gtsam_with_a_kernel_are_larger(kernel, larger):
    """The figures of docs/factors.md."""
    graph = Graph.from_log(simulate(seed=0, clean=True, steps=60), edges="landmark+motion", kernel=kernel)
    solution = solve(graph)
    values = to_values(graph, solution.state)
    marginals = gtsam.Marginals(to_gtsam(graph, solution.state), values)
    theirs = [np.trace(marginals.marginalCovariance(k)[:2, :2]) for k in range(10, 60, 10)]
    ours = [np.trace(solution.covariance(k)[:2, :2]) for k in range(10, 60, 10)]
    np.testing.assert_allclose(np.sqrt(np.divide(theirs, ours)), larger, atol=0.02 if kernel != "none" else 1e-6)


@pytest.mark.parametrize("dimensions", [3, 2])
def test_landmarks_and_blocks_between_nodes(dimensions):
    log = load(sample_log_path())
    graph = Graph.from_log(log, edges="landmark+motion", dimensions=dimensions, kernel="none")
    solution = solve(graph, initialize="auto")
    system, _ = graph.linearize(solution.state)
    inverse = np.linalg.inv(system.to_sparse().toarray())
    first = graph.num_nodes - len(graph.landmark_ids)
    assert first == log.num_poses

    def block(i, j, columns=3):
        return inverse[3 * i : 3 * i + 3, 3 * j : 3 * j + columns]

    poses, landmarks = solution.covariance(poses=[], landmarks=[])
    assert poses.shape == (0, 3, 3) and landmarks.shape == (0, dimensions, dimensions)
    np.testing.assert_allclose(solution.covariance([5, 90], joint=True)[:3, 3:], block(5, 90), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        solution.covariance([160, 159], joint=True)[:3, 3:], block(160, 159), rtol=1e-6, atol=1e-12
    )
    for k, j in enumerate(graph.landmark_ids.tolist()):
        expected = inverse[3 * (first + k) :, 3 * (first + k) :][:dimensions, :dimensions]
        np.testing.assert_allclose(solution.landmark_covariances[j], expected, rtol=1e-6, atol=1e-12)
        cross = solution.covariance(30, j, joint=True)[:3, 3:]
        np.testing.assert_allclose(cross, block(30, first + k, dimensions), rtol=1e-6, atol=1e-12)


def test_impossible_blocks(book_log):
    solution = solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none"))
    with pytest.raises(OptionError, match="landmark 3 is no node"):
        solution.covariance(0, landmarks=3, joint=True)
    with pytest.raises(OptionError, match="there is no landmark 77"):
        solution.covariance(0, landmarks=[3, 77])
    with pytest.raises(OptionError, match="poses must be an id, or a list of ids"):
        solution.covariance(0.5)
    with pytest.raises(OptionError, match="there is no pose 99"):
        solution.covariance([0, 99])


def test_poses_of_a_pose_graph_are_named_by_their_ids(tmp_path):
    """A chain with ids 10, 20, 30: with unit information the variance of a position grows by 1 per edge."""
    edges = "".join(f"EDGE_SE2 {i} {j} 0 0 0 1 0 0 1 0 1\n" for i, j in ((10, 20), (20, 30)))
    (tmp_path / "chain.g2o").write_text("".join(f"VERTEX_SE2 {i} 0 0 0\n" for i in (10, 20, 30)) + edges)
    solution = solve(Graph.from_g2o(tmp_path / "chain.g2o"))
    for id, variance in ((10, 0), (20, 1), (30, 2)):
        np.testing.assert_allclose(solution.covariance(id), variance * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(solution.covariance([20, 30], joint=True)[:3, 3:], np.eye(3), atol=1e-12)
    with pytest.raises(OptionError, match="there is no pose 2; the ids of the poses are 3 whole numbers from 10 to 30"):
        solution.covariance(2)


def test_nees_is_that_of_the_dense_covariance():
    log = simulate(seed=4, clean=True, steps=20)
    graph = Graph.from_log(log, edges="landmark+motion", kernel="none")
    solution = solve(graph)
    error = solution.poses - log.true_poses
    error[:, 2] = wrap(error[:, 2])
    system, _ = graph.linearize(solution.state)
    covariance = np.linalg.inv(system.to_sparse().toarray())
    size = 3 * log.num_poses
    each = [e @ np.linalg.inv(covariance[k : k + 3, k : k + 3]) @ e / 3 for e, k in zip(error, range(0, size, 3))]
    np.testing.assert_allclose(solution.nees(log.true_poses), each, rtol=1e-5)
    # given the first pose: the information of all others with the landmarks eliminated
    of_poses = np.linalg.inv(covariance[:size, :size])[3:, 3:]
    e = error[1:].ravel()
    assert solution.joint_nees(log.true_poses) == pytest.approx(e @ of_poses @ e / len(e), rel=1e-5)
    unknown = log.true_poses.copy()
    unknown[3, 2] = np.nan
    assert np.flatnonzero(np.isnan(solution.nees(unknown))).tolist() == [3]


@pytest.mark.parametrize("uncertain", [True, False])
def test_the_expected_ate_is_that_of_samples(uncertain):
    """Errors drawn from the whole covariance, aligned by the best rigid motion."""
    log = Drive(seed=8, duration=20.0, landmarks=12).simulate()[0].replace(motion=MotionModel(), sensor=SensorModel())
    if uncertain:
        log = log.replace(uncertain={"wheel_scale": 0.1, "turn_rate_bias": 0.05})
    solution = solve(Graph.from_log(log, edges="landmark+motion"))
    poses = len(solution.poses)
    covariance = solution.covariance(joint=True)
    values, vectors = np.linalg.eigh(covariance)
    rng, scale = np.random.default_rng(0), 1e-3
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # small, because the expectation is of the first order
    drawn = (root @ rng.standard_normal((3 * poses, 2000))).T.reshape(-1, poses, 3) * scale
    squares = np.array([(ate(solution.poses, solution.poses + e) / scale) ** 2 for e in drawn])
    error = squares.std() / len(squares) ** 0.5
    assert abs(squares.mean() - solution.expected_ate**2) < bound(2) * error
    assert (solution.graph.held is not None) == uncertain


@pytest.mark.parametrize("estimate", [(), ("range_scale",)])
def test_a_solution_can_be_pickled_when_its_covariances_are_known(estimate: tuple[str, ...]) -> None:
    """The engine's factors stay behind, and are made again."""
    solution = solve(Graph.from_log(simulate(seed=1, steps=30), edges="landmark+motion", estimate=list(estimate)))
    covariances, landmarks = solution.covariance(), solution.landmark_covariances
    joint, place = solution.covariance(poses=[3, 20], joint=True), solution.map
    for other in (pickle.loads(pickle.dumps(solution)), deepcopy(solution)):
        np.testing.assert_array_equal(other.poses, solution.poses)
        np.testing.assert_allclose(other.covariance(), covariances, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(other.covariance(poses=[3, 20], joint=True), joint, rtol=1e-9, atol=1e-15)
        assert other.landmark_covariances.keys() == landmarks.keys() and other.map.keys() == place.keys()
    graph = pickle.loads(pickle.dumps(solution.graph))
    assert solve(graph).cost == pytest.approx(solution.cost, rel=1e-9)


def test_what_is_empty_has_an_answer_or_a_reason():
    log = simulate(seed=1, steps=20, clean=True)
    solution = solve(Graph.from_log(log, edges="landmark+motion"))
    assert solution.covariance([], joint=True).shape == (0, 0)
    assert solve(Graph.from_log(log.at_steps([0]))).joint_nees(log.true_poses[:1]) is np.nan
    places = log.true_poses[[0, 10, 20], :2]
    positions = AbsolutePositions(steps=[0, 10, 20], places=places, covariances=np.tile(0.01 * np.eye(2), (3, 1, 1)))
    unseen = log.with_sightings(np.zeros(len(log.steps), dtype=bool), positions=positions)
    for edges in ("landmark+motion", "virtual+motion"):
        with pytest.raises(OptionError, match="has no map"):
            _ = solve(Graph.from_log(unseen, edges=edges)).map
