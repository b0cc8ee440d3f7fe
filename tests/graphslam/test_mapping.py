import numpy as np
import pytest

from graphslam import Graph, Log, OptionError, SensorModel, estimate_map, load, sample_log_path, solve, textbook
from graphslam.se2 import wrap


def test_three_dimensional_map_is_the_textbooks(book_log):
    poses = solve(Graph.from_log(book_log)).poses
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
