"""Particle filters with a map that is known beforehand."""

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from graphslam import LandmarkMap, OptionError, SensorModel, first_fix, simulate
from graphslam.se2 import compose, wrap

LOG = simulate(seed=1, clean=True)


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("update", ["kalman", "joint"])
def test_fastslam_on_an_exact_map_is_localisation(update, orientation):
    """The same random numbers, and the same likelihoods, so far as 1e-6 m are exact."""
    log = LOG if orientation else LOG.without_orientation()
    options = {"particles": 200, "seed": 3}
    here = FastSLAM1(log, map=LOG.true_landmarks, landmark_update=update, **options).run()
    there = MonteCarloLocalization(log, map=LOG.true_landmarks, **options).run()
    assert np.allclose(here.poses, there.poses, atol=1e-9)
    assert here.log_evidence == pytest.approx(there.log_evidence, abs=0.01)
    assert all(
        np.allclose(here.landmarks[j], LOG.true_landmarks[j][: len(m)], atol=1e-4) for j, m in here.landmarks.items()
    )


def test_a_prior_is_updated_like_a_kalman_filter():
    sensor = SensorModel(range_rate=0.0, range_std=0.1, bearing_std=0.05)
    mean, S = np.array([3.0, 1.0]), np.array([[0.04, 0.01], [0.01, 0.09]])
    z, pose = np.array([3.2, 0.25]), np.zeros(3)
    filter = FastSLAM1(map=LandmarkMap({7: mean}, {7: S}), particles=1, sensor=sensor, landmark_update="kalman",
                       range_noise="measured", start=pose)  # fmt: skip
    filter.observe([7], z[None])
    H, Q = sensor.H(pose, mean), sensor.Q(z)
    K = S @ H.T @ np.linalg.inv(H @ S @ H.T + Q)
    estimate = filter.state.map()[7]
    assert np.allclose(estimate.mean, mean + K @ (z - sensor.h(pose, mean)), atol=1e-9)
    assert np.allclose(estimate.covariance, (np.eye(2) - K @ H) @ S, atol=1e-9)


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_landmarks_that_are_not_seen_stay_and_new_ones_are_added(kind):
    known = LandmarkMap({0: LOG.true_landmarks[0], 50: (9.0, 9.0, 0.0)}, {50: 0.1 * np.eye(3)})
    result = kind(LOG, map=known, particles=100).run()
    assert set(result.landmarks) == {*LOG.landmark_ids.tolist(), 50}
    assert np.allclose(result.landmarks[50], [9, 9, 0]) and np.allclose(
        result.landmark_covariances[50], 0.1 * np.eye(3)
    )
    again = result.map
    assert isinstance(again, LandmarkMap) and np.array_equal(again.covariances[50], result.landmark_covariances[50])


def test_particles_begin_around_the_first_fix():
    fix = first_fix(LOG, LOG.true_landmarks)
    filter = MonteCarloLocalization(LOG, map=LOG.true_landmarks, start=fix, particles=20_000, seed=0)
    poses = filter.state.poses
    expected = 4 * fix.covariance
    # of 20,000: a variance is known to a hundredth, a mean to a hundredth of a standard deviation
    assert np.all(np.abs(poses.mean(axis=0) - fix.pose) < 0.04 * np.sqrt(np.diagonal(expected)))
    assert np.allclose(np.cov(poses.T) / np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected))),
                       expected / np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected))), atol=0.04)  # fmt: skip


@pytest.mark.parametrize("kind", [MonteCarloLocalization, FastSLAM1, FastSLAM2])
def test_a_filter_begins_at_the_first_fix_where_its_log_begins_in_another_frame(kind):
    there = np.array([5.0, -3.0, 2.0])
    moved = {j: compose(there, m) for j, m in LOG.true_landmarks.items()}
    fix = first_fix(LOG, moved)
    here = kind(LOG, map=moved, particles=500, seed=0).state.poses
    assert np.array_equal(here, kind(LOG, map=moved, particles=500, seed=0, start=fix).state.poses)
    # a pose that is given, and one that is in the frame of the map, stay
    assert np.allclose(kind(LOG, map=moved, particles=5, start=np.zeros(3)).state.poses, 0)
    own = LOG.initial_poses[0]
    assert np.allclose(kind(LOG, map=LOG.true_landmarks, particles=5).state.poses, own)


def test_a_map_needs_the_ids_and_headings_where_sightings_have_psi():
    with pytest.raises(OptionError, match="leave out the option association"):
        FastSLAM1(LOG, map=LOG.true_landmarks, association="maximum-likelihood")
    with pytest.raises(OptionError, match="leave out smoothing"):
        FastSLAM1(LOG, map=LOG.true_landmarks, smoothing=10)
    with pytest.raises(OptionError, match="has no heading, and the sightings have psi"):
        FastSLAM1(LOG, map={j: m[:2] for j, m in LOG.true_landmarks.items()}).run()


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.3, -0.1)])
def test_localisation_heeds_the_covariances_of_its_map(offset):
    """N(z; h(x, m), Q + H C H') of each sighting; as with exact landmarks where C is almost 0, also without headings."""
    sensor = SensorModel(range_rate=0.0, range_std=0.1, bearing_std=0.05, orientation_std=0.1, offset=offset)
    places = {3: np.array([3.0, 1.0, 0.4]), 4: np.array([1.0, -2.0])}
    covariances = {3: np.diag([0.04, 0.09, 0.02]) + 0.01, 4: np.array([[0.05, 0.02], [0.02, 0.03]])}
    poses = np.random.default_rng(1).normal(size=(50, 3)) * [0.2, 0.2, 0.1]
    z = np.array([[3.1, 0.3, 0.1], [2.2, -1.0, 0.5]])

    def weighed(known):
        filter = MonteCarloLocalization(map=known, particles=50, sensor=sensor, start=poses, stage="weights")
        filter.observe([3, 4], z)
        return filter, filter.state.log_weights

    filter, found = weighed(LandmarkMap(places, covariances))
    expected = np.zeros(50)
    for k, x in enumerate(poses):
        for (j, m), seen in zip(places.items(), z):
            n = len(m)
            H = sensor.H(x, m)
            V = H @ covariances[j] @ H.T + sensor.Q(seen)[:n, :n]
            e = seen[:n] - sensor.h(x, m)
            e[1:] = wrap(e[1:])
            expected[k] -= 0.5 * (e @ np.linalg.solve(V, e) + np.linalg.slogdet(V)[1])
    assert np.allclose(found, expected - np.logaddexp.reduce(expected), atol=1e-9)
    assert np.allclose(filter.covariance(landmarks=4), covariances[4])
    assert np.allclose(filter.result().map.covariances[3], covariances[3])
    tiny = {j: 1e-16 * np.eye(len(m)) for j, m in places.items()}
    assert np.allclose(weighed(LandmarkMap(places, tiny))[1], weighed(places)[1], atol=1e-6)


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2, MonteCarloLocalization])
def test_the_landmarks_of_a_map_are_there_before_the_first_sighting(kind):
    known = {1: (1.0, 2.0, 0.3), 2: (3.0, 1.0, 0.1)}
    found = kind(particles=5, map=known)
    assert found.landmarks.keys() == found.result().landmarks.keys() == known.keys()
    assert np.all(found.covariance(landmarks=1) < 1e-9)
    # sightings without psi leave the headings out
    found.observe([1], [(2.2, 1.1)])
    np.testing.assert_allclose(found.landmarks[2][:2], (3.0, 1.0), atol=1e-5)
