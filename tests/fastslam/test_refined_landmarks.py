"""Landmarks beyond linearisation, Q at the estimated range, and the lectures' steps one by one."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound, check_normal, mean_error
from importance_sampling import importance
from test_gibbs import MOTION, small

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, ParticleGibbs
from graphslam import OptionError, SensorModel, load, sample_log_path, simulate
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import between, wrap

SENSOR = SensorModel()


@pytest.mark.slow
@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("range_noise", ["measured", "estimated"])
def test_moments_and_likelihood_of_an_update(columns: int, range_noise: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sighting after those that are integrated together: prior times density, by samples of the prior."""
    monkeypatch.setattr("fastslam.filters.JOINT", 1)
    landmark, pose = np.array([3.0, 2.0, 0.4])[:columns], np.array([0.2, -0.1, 0.3])
    z = SENSOR.h(pose, landmark) + np.array([[0.3, 0.04, -0.03], [-0.3, -0.03, 0.05]])[:, :columns]
    q = np.diagonal(SENSOR.Q(z[1:]), axis1=1, axis2=2).copy()
    normals = np.random.default_rng(0).standard_normal((500_000, columns))
    slam = FastSLAM1(particles=1, start=pose, landmark_update="joint", range_noise=range_noise)
    slam.observe([0], z[:1])
    prior = slam.state.map(0)[0]
    m = prior.mean + normals @ np.linalg.cholesky(prior.covariance).T
    r = SENSOR.h(pose, m) - z[1]
    r[:, 1:] = wrap(r[:, 1:])
    variances = np.tile(q, (len(m), 1))
    if range_noise == "estimated":
        variances[:, 0] = (SENSOR.range_rate * np.hypot(*(m[:, :2] - pose[:2]).T)) ** 2
    weights = np.exp(-0.5 * np.sum(r * r / variances + np.log(2 * np.pi * variances), axis=1))
    likelihood, weights = np.log(weights.mean()), weights / weights.sum()
    mean = weights @ m
    covariance = (m - mean).T @ (weights[:, None] * (m - mean))
    assert slam._weigh(np.array([0]), z[1:].copy(), q.copy())
    found = slam._engine.log_likelihoods()
    estimate, std = slam.state.map(0)[0], np.sqrt(np.diag(covariance))
    scaled = (estimate.covariance - covariance) / np.outer(std, std)
    errors = np.array([np.abs((estimate.mean - mean) / std).max(), np.abs(scaled).max(), found[0] - likelihood])
    # Q at the estimated range makes the density less Gaussian, and the moments are approximations
    allowed = np.array([0.02, 0.05, 0.01]) if range_noise == "estimated" else np.zeros(3)
    sampling = np.sqrt(np.sum(weights**2)) * np.array([1.0, np.sqrt(2), np.sqrt(1 - 1 / np.sum(weights**2) / len(m))])
    assert np.all(np.abs(errors) < allowed + bound(13) * sampling)


def test_first_sighting_has_the_moments_of_its_posterior() -> None:
    pose, z, rng = np.array([0.2, -0.1, 0.3]), np.array([3.0, 0.4, -0.2]), np.random.default_rng(0)
    slam = FastSLAM1(particles=1, start=pose, landmark_update="joint")
    slam.observe([0], [z])
    noise = rng.standard_normal((400_000, 3)) * np.sqrt(np.diag(SENSOR.Q(z)))
    samples, weights = SENSOR.h_inverse(pose, z + noise), z[0] + noise[:, 0]
    weights /= weights.sum()
    mean, estimate = weights @ samples, slam.state.map(0)[0]
    covariance = (samples - mean).T @ (weights[:, None] * (samples - mean))
    std = np.sqrt(np.diag(covariance))
    # a mean and a covariance of three numbers, by weighted samples
    many = bound(12) * np.sqrt(np.sum(weights**2))
    np.testing.assert_allclose((estimate.mean - mean) / std, 0, atol=many)
    scale = np.outer(std, std)
    np.testing.assert_allclose(estimate.covariance / scale, covariance / scale, atol=np.sqrt(2) * many)


@pytest.mark.slow
@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("range_noise", ["measured", "estimated"])
def test_evidence_and_moments_of_all_sightings(columns: int, range_noise: str) -> None:
    """The integral of the product of three sightings from different poses, by samples of a wide Gaussian."""
    rng, landmark = np.random.default_rng(0), np.array([3.0, 2.0, 0.4])[:columns]
    poses = np.array([[0.2, -0.1, 0.3], [0.9, 0.2, 0.5], [1.5, 2.5, -0.2]])
    z = SENSOR.h(poses, landmark) + np.array([[0.5, 0.04, -0.03], [-0.5, -0.03, 0.05], [0.2, 0.03, 0.02]])[:, :columns]
    z[:, 1:] = wrap(z[:, 1:])
    q = np.diagonal(SENSOR.Q(z), axis1=1, axis2=2).copy()
    slam = FastSLAM1(particles=1, start=poses[0], landmark_update="joint", range_noise=range_noise)
    found = 0.0
    for k in range(3):
        if k > 0:
            slam._engine.move_by_gaussian(0, between(poses[k - 1], poses[k]), 1e-24 * np.eye(3), False)
        slam._weigh(np.array([0]), z[k : k + 1].copy(), q[k : k + 1].copy())
        found += slam._engine.log_likelihoods()[0]
    estimate = slam.state.map(0)[0]
    L = 1.5 * np.linalg.cholesky(estimate.covariance)
    normals = rng.standard_normal((400_000, columns))
    m = estimate.mean + normals @ L.T
    log_weights = 0.5 * np.sum(normals**2, axis=1) + np.log(np.diag(L)).sum() + columns / 2 * np.log(2 * np.pi)
    for k in range(3):
        r = SENSOR.h(poses[k], m) - z[k]
        r[:, 1:] = wrap(r[:, 1:])
        variances = np.tile(q[k], (len(m), 1))
        if range_noise == "estimated" and k > 0:
            variances[:, 0] = (SENSOR.range_rate * np.hypot(*(m[:, :2] - poses[k, :2]).T)) ** 2
        log_weights -= 0.5 * np.sum(r * r / variances + np.log(2 * np.pi * variances), axis=1)
    weights = np.exp(log_weights)
    # of the first sighting alone it is the range
    assert found == pytest.approx(
        np.log(weights.mean() / z[0, 0]), abs=bound(13) * mean_error(weights) / weights.mean()
    )
    weights /= weights.sum()
    mean = weights @ m
    covariance = (m - mean).T @ (weights[:, None] * (m - mean))
    std = np.sqrt(np.diag(covariance))
    many = bound(13) * np.sqrt(np.sum(weights**2))
    np.testing.assert_allclose((estimate.mean - mean) / std, 0, atol=many)
    np.testing.assert_allclose((estimate.covariance - covariance) / np.outer(std, std), 0, atol=np.sqrt(2) * many)


@pytest.mark.slow
def test_joint_landmarks_through_resampling_repeated_sightings_and_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """A landmark seen twice from one pose, in one call or in two; and more sightings than are integrated together."""
    log = simulate(seed=3, steps=12, clean=True, orientation=False)
    twice = np.repeat(np.arange(len(log.steps)), 1 + (np.arange(len(log.steps)) % 5 == 0))
    log = log.replace(steps=log.steps[twice], landmarks=log.landmarks[twice], sightings=log.sightings[twice])
    options = {"landmark_update": "joint", "seed": 1}
    whole, split = (FastSLAM1(particles=50, start=log.initial_poses[0], ess_threshold=0.0, **options) for _ in range(2))
    for t in range(log.num_poses):
        if t:
            whole.move(log.controls[t - 1], log.dt[t - 1])
            split.move(log.controls[t - 1], log.dt[t - 1])
        seen = np.flatnonzero(log.steps == t)
        whole.observe(log.landmarks[seen], log.sightings[seen])
        for k in seen:
            split.observe(log.landmarks[[k]], log.sightings[[k]])
    np.testing.assert_allclose(whole.state.log_weights, split.state.log_weights, atol=1e-9)
    for kind in (FastSLAM1, FastSLAM2):
        results = [kind(log, particles=9000, threads=threads, **options).run() for threads in (1, 2)]
        np.testing.assert_array_equal(results[0].mean_poses, results[1].mean_poses)
        monkeypatch.setattr("fastslam.filters.JOINT", 3)
        few = kind(log, particles=9000, **options).run()
        monkeypatch.undo()
        assert results[0].resampled.any()
        assert 0 < np.abs(few.mean_poses - results[0].mean_poses)[:, :2].max() < 0.2


@pytest.mark.slow
def test_moments_reach_the_exact_posterior() -> None:
    """A log on which linearised landmarks are off by 0.6 standard deviations with any number of particles."""
    # of motions of several controls the filters, too, draw from the Gaussian
    log = small(1, 2, composite=True)
    gibbs = ParticleGibbs(log, motion=MOTION, density="exact", particles=8, iterations=500, warm_up=60, chains=2).run()
    reference = importance(log, SENSOR, MOTION, gibbs.trajectories[:, ::4].reshape(-1, 4, 3))
    # the last pose and the landmarks
    mean, std, of_reference = reference.mean[6:], reference.std[6:], reference.mean_errors[6:] / reference.std[6:]
    for kind in (FastSLAM1, FastSLAM2):
        errors, spreads = {}, {}
        for update in ("kalman", "joint"):
            means = []
            for seed in range(24):
                slam = kind(log, particles=4000, seed=seed, motion=MOTION, landmark_update=update)
                slam.run()
                mixture = slam.state.mixture_map()
                means.append(np.concatenate([slam.state.mean_pose, mixture[0].mean, mixture[1].mean]))
            scaled = (np.array(means) - mean) / std
            errors[update], spreads[update] = scaled.mean(axis=0), np.hypot(mean_error(scaled), of_reference)
        check_normal(errors["joint"], spreads["joint"], 23)
        # the other by how much this approximation is off, with the same error rate
        error = bound(7, 23) * spreads["kalman"].max()
        assert np.abs(errors["kalman"]).max() > 0.55 - error


@pytest.mark.parametrize("cls", [FastSLAM1, FastSLAM2, MonteCarloLocalization])
def test_the_steps_of_the_lectures(cls: type) -> None:
    log = simulate(seed=1, steps=20, clean=True)
    motion, weights, full = (
        cls(log, particles=40, seed=2, stage=stage).run() for stage in ("motion", "weights", "resampling")
    )
    np.testing.assert_array_equal(motion.log_weights, np.log(1 / 40))
    np.testing.assert_array_equal(motion.ess, 40)
    assert not motion.resampled.any() and not weights.resampled.any() and full.resampled.any()
    assert np.ptp(weights.log_weights) > 1
    never = cls(log, particles=40, seed=2, ess_threshold=0.0).run()
    np.testing.assert_array_equal(weights.log_weights, never.log_weights)
    np.testing.assert_array_equal(weights.poses, never.poses)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stage": "walk"}, "stage must be one of motion, weights, resampling"),
        ({"landmark_update": "ukf"}, "landmark_update must be one of kalman, joint"),
        ({"range_noise": "true"}, "range_noise must be one of auto, measured, estimated"),
        (
            {"landmark_update": "joint", "association": "maximum-likelihood"},
            "^landmark_update joint needs the .* leave out landmark_update$",
        ),
        (
            {"range_noise": "estimated", "proposal_weight": "linearised"},
            "range_noise estimated needs .* exact, not linearised",
        ),
        ({"range_noise": "estimated", "association": "maximum-likelihood"}, "needs the association known"),
    ],
)
def test_bad_options(options: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        FastSLAM2(**options)


def test_what_a_filter_does_not_use_is_not_refused() -> None:
    FastSLAM1(range_noise="estimated", proposal_weight="linearised")
    log = load(sample_log_path())
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    with pytest.raises(
        OptionError, match="^landmark_update joint needs .* auto is where a log lacks ids, leave out landm"
    ):
        FastSLAM2(hidden, landmark_update="joint")
