import numpy as np
import pytest

from graphslam import (
    Graph,
    Log,
    OptionError,
    SensorModel,
    estimate_map,
    load,
    sample_log_path,
    simulate,
    solve,
    textbook,
)
from graphslam.edges.robust import Cauchy
from graphslam.se2 import wrap
from graphslam.simulation.simulator import MotionFaults, SensorFaults


def test_three_dimensional_map_is_the_textbooks(book_log):
    poses = solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none")).poses
    ours = estimate_map(book_log, poses)
    for j in book_log.landmark_ids.tolist():
        seen = [(poses[t], z) for t, k, z in zip(book_log.steps, book_log.landmarks, book_log.sightings) if k == j]
        book = textbook.solve_map(seen, SensorModel())
        # the book's heading is relative to that of the first sighting
        first = textbook.inverse_observation(*seen[0])[2]
        np.testing.assert_allclose(ours[j][:2], book[:2], atol=1e-9)
        assert abs(wrap(ours[j][2] - book[2] - first)) < 1e-9


def test_weighted_mean_by_hand():
    # both from the origin: straight ahead at 1 m and at 2 m, so variances 0.01 and 0.04 along x
    log = Log(initial_poses=np.zeros((1, 3)), steps=[0, 0], landmarks=[5, 5], sightings=[[1.0, 0.0], [2.0, 0.0]])
    sensor = SensorModel(range_rate=0.1, bearing_std=0.3)
    landmarks = estimate_map(log, log.initial_poses, sensor=sensor)
    np.testing.assert_allclose(landmarks[5], [(1 / 0.01 + 2 / 0.04) / (1 / 0.01 + 1 / 0.04), 0.0], atol=1e-12)
    across = 1 / (1 / 0.3**2 + 1 / 0.6**2)
    np.testing.assert_allclose(landmarks.covariances[5], np.diag([1 / 125, across]), atol=1e-12)


def test_a_landmark_that_faces_backwards_is_not_torn():
    psi = np.array([np.pi - 0.01, -np.pi + 0.01])
    z = np.column_stack([[1.0, 1.0], [0.0, 0.0], psi])
    log = Log(initial_poses=np.zeros((1, 3)), steps=[0, 0], landmarks=[0, 0], sightings=z)
    heading = estimate_map(log, log.initial_poses)[0][2]
    assert abs(wrap(heading - np.pi)) < 1e-9


def test_the_truth_is_inside_its_covariance():
    log = load(sample_log_path())
    landmarks = estimate_map(log, log.true_poses)
    assert set(landmarks) == set(log.landmark_ids.tolist())
    for j, covariance in landmarks.covariances.items():
        error = landmarks[j] - log.true_landmarks[j]
        error[2] = wrap(error[2])
        assert np.all(np.linalg.eigvalsh(covariance) > 0)
        assert np.linalg.norm(error[:2]) < 1.5


def test_poses_must_fit_the_log(book_log):
    with pytest.raises(OptionError, match=r"poses must have shape \(62, 3\)"):
        estimate_map(book_log, np.zeros((5, 3)))


@pytest.mark.parametrize("turned", [np.pi, 2.9])
def test_the_map_does_not_depend_on_which_sighting_comes_first(turned):
    rng = np.random.default_rng(7)
    K = 9
    poses = np.column_stack([rng.normal(size=(K, 2)), rng.uniform(-np.pi, np.pi, K)])
    sensor, landmark = SensorModel(), np.array([4.0, -1.0, 2.8])
    z = sensor.h(poses, np.tile(landmark, (K, 1))) + rng.normal(size=(K, 3)) * [0.1, 0.02, 0.02]
    z[0, 2] = wrap(z[0, 2] + turned)
    maps = []
    for order in (np.roll(np.arange(K), k) for k in range(K)):
        log = Log(initial_poses=poses[order], steps=np.arange(K), landmarks=np.zeros(K, dtype=int), sightings=z[order])
        maps.append(estimate_map(log, poses[order])[0])
    off = np.array(maps) - maps[0]
    off[:, 2] = wrap(off[:, 2])
    np.testing.assert_allclose(off, 0, atol=1e-9)
    # one wrong psi of nine: the heading is about a ninth of the turn off
    assert abs(abs(wrap(maps[0][2] - landmark[2])) - turned / K) < 0.2


def with_phantoms(seed):
    """A log in which every tenth sighting is of nothing, and the odometry is a little off."""
    return simulate(
        seed=seed,
        steps=60,
        sensor_faults=SensorFaults(
            phantom=0.1, range_bias_rate_std=0, bearing_bias_std=0, orientation_bias_std=0, oversight=0
        ),
        motion_faults=MotionFaults(velocity_bias_std=0.02),
    )


def worst(log, landmarks):
    """The greatest distance of a landmark from its true place [m]."""
    return max(float(np.linalg.norm(m[:2] - log.true_landmarks[j][:2])) for j, m in landmarks.items())


def test_the_map_of_graduated_non_convexity_leaves_out_what_was_rejected():
    log = with_phantoms(3)
    solution = solve(Graph.from_log(log, edges="virtual+motion", kernel="none"), method="gnc")
    kept = solution.trust == 1
    assert 0 < np.count_nonzero(~kept) < 0.2 * len(kept)
    by_hand = log.replace(steps=log.steps[kept], landmarks=log.landmarks[kept], sightings=log.sightings[kept])
    expected = estimate_map(by_hand, solution.poses)
    assert worst(log, solution.landmarks) < 0.5
    assert worst(log, estimate_map(log, solution.poses)) > 3
    assert worst(log, estimate_map(log, solution)) < 0.5
    for j, place in expected.items():
        np.testing.assert_allclose(solution.landmarks[j], place, atol=1e-6)
        np.testing.assert_allclose(solution.landmark_covariances[j], expected.covariances[j], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kernel", ["cauchy", "geman-mcclure"])
@pytest.mark.parametrize("weight", ["pairs", "tempered", "marginal"])
def test_the_map_of_a_kernel_is_the_robust_one(weight, kernel):
    log = with_phantoms(3)
    solution = solve(Graph.from_log(log, weight=weight, kernel=kernel, edges="virtual+motion"))
    assert worst(log, estimate_map(log, solution.poses)) > 3
    assert worst(log, solution.landmarks) < 0.6
    assert worst(log, estimate_map(log, solution)) < 0.6


def test_the_map_with_a_kernel_by_hand():
    """Where each sighting is weighed by the kernel at the mean, the weighted mean is the mean itself."""
    log, kernel, sensor = with_phantoms(1), Cauchy().of_dimension(3), SensorModel()
    trust = np.random.default_rng(0).uniform(0.1, 1, len(log.steps))
    trust[0] = np.nan
    robust = estimate_map(log, log.true_poses, kernel=kernel, trust=trust)
    trust[0] = 1
    for j in log.landmark_ids.tolist():
        here = log.landmarks == j
        at, z = log.true_poses[log.steps[here]], log.sightings[here]
        W = np.linalg.inv(sensor.landmark_covariance(at, z))
        e = robust[j] - sensor.h_inverse(at, z)
        e[:, 2] = wrap(e[:, 2])
        w = trust[here] * kernel.weight(trust[here] * np.einsum("ki,kij,kj->k", e, W, e))
        covariance = np.linalg.inv(kernel.information_per_weight(3) * np.einsum("k,kij->ij", w, W))
        np.testing.assert_allclose(robust.covariances[j], covariance, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(covariance @ np.einsum("k,kij,kj->i", w, W, e), 0, atol=1e-10)


def test_trust_must_fit_the_log(book_log):
    for trust in (np.ones(3), np.full(len(book_log.steps), 1.5)):
        with pytest.raises(OptionError, match="numbers from 0 to 1, one for each sighting"):
            estimate_map(book_log, book_log.initial_poses, trust=trust)
