from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound

from fastslam import FastSLAM1, MonteCarloLocalization
from graphslam import Log, MotionModel, SensorModel, simulate
from graphslam.se2 import wrap

QUIET = {
    "motion": MotionModel(nn=0.04, no=0.0005, on=0.03, oo=0.04, epsilon=1e-6),
    "sensor": SensorModel(range_rate=0.03, bearing_std=0.01, orientation_std=0.01),
}


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b)[:, :2] ** 2, axis=1))))


@pytest.mark.parametrize("psi", [True, False])
def test_near_the_truth_on_clean_logs(psi: bool) -> None:
    errors = []
    for seed in range(6):
        log = simulate(seed=seed, clean=True, orientation=psi, **QUIET)
        result = FastSLAM1(log, particles=500, seed=seed, **QUIET).run()
        assert rms(result.poses, log.true_poses) < 0.5 * max(rms(log.initial_poses, log.true_poses), 0.3)
        errors.append([rms(result.poses, log.true_poses), rms(result.mean_poses, log.true_poses)])
        errors[-1].append(
            np.sqrt(np.mean([np.sum((m - log.true_landmarks[j])[:2] ** 2) for j, m in result.landmarks.items()]))
        )
    assert np.median(errors, axis=0).max() < 0.2


def test_sample_like_log() -> None:
    """The mean of these 30 runs is 7 of its standard errors below the limit, and `bound(1, 29)` is 6.2."""
    log = simulate()
    dead_reckoning = rms(log.initial_poses, log.true_poses)
    errors = [rms(FastSLAM1(log, particles=300, seed=seed).run().poses, log.true_poses) for seed in range(30)]
    assert np.mean(errors) < 0.6 * dead_reckoning
    known_map = rms(MonteCarloLocalization(log).run().poses, log.true_poses)
    assert known_map < np.mean(errors)


def test_long_log_shapes() -> None:
    log = simulate(seed=1, steps=500)
    slam = FastSLAM1(log, particles=200)
    states = list(slam)
    result = slam.result()
    assert [state.step for state in states] == list(range(501))
    assert result.poses.shape == result.mean_poses.shape == (501, 3)
    assert result.landmarks.keys() == result.landmark_covariances.keys() == set(log.landmark_ids.tolist())
    assert np.all((result.poses[:, 2] >= -np.pi) & (result.poses[:, 2] < np.pi))
    assert np.all((result.ess >= 1) & (result.ess <= 200))
    assert result.ancestors[-1] <= 200
    assert np.all(np.diff(result.ancestors) >= 0)
    assert np.exp(result.log_weights).sum() == pytest.approx(1, rel=1e-12)
    np.testing.assert_array_equal(result.resampled, [state.resampled for state in states])
    np.testing.assert_array_equal(result.poses[0], log.initial_poses[0])
    np.testing.assert_array_equal(result.poses[-1], states[-1].best_pose)
    np.testing.assert_allclose(result.mean_poses[-1], states[-1].mean_pose, atol=1e-12)
    for covariance in result.landmark_covariances.values():
        assert np.all(np.linalg.eigvalsh(covariance) > 0)


def test_one_iteration_is_a_loop_over_the_rest() -> None:
    log = simulate(seed=3)
    whole = FastSLAM1(log, particles=50).run()
    slam = FastSLAM1(log, particles=50)
    for state in slam:
        if state.step == 20:
            break
    # a loop that was interrupted continues at the next step
    rest = [state.step for state in slam]
    assert rest == list(range(21, log.num_poses))
    np.testing.assert_array_equal(slam.result().poses, whole.poses)


def test_by_hand_is_the_same_as_over_the_log() -> None:
    log = simulate(seed=5).without_orientation()
    slam = FastSLAM1(particles=40, seed=2, start=log.initial_poses[0])
    for t in range(log.num_poses):
        if t > 0:
            slam.move(log.controls[t - 1], log.dt[t - 1])
        slam.observe(log.landmarks[log.steps == t], log.sightings[log.steps == t])
    whole = FastSLAM1(log, particles=40, seed=2).run()
    np.testing.assert_array_equal(slam.result().poses, whole.poses)
    np.testing.assert_array_equal(slam.result().log_weights, whole.log_weights)


def test_same_seed_same_result_and_other_seed_another() -> None:
    log = simulate()
    a, b, c = (FastSLAM1(log, particles=30, seed=seed).run().poses for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


@pytest.mark.parametrize("scheme", ["systematic", "stratified", "residual", "multinomial"])
def test_resampled_particles_share_no_map(scheme: str) -> None:
    """After resampling, copies of one particle see the landmark from different poses: their maps must differ."""
    slam = FastSLAM1(particles=50, seed=1, resampling=scheme, ess_threshold=1.0)
    sensor, landmark = SensorModel(), np.array([2.0, 1.0, 0.4])
    slam.observe([0], [sensor.h(np.zeros(3), landmark)])
    for _ in range(3):
        slam.move((0.5, 0.5), 1.0)
        slam.observe([0], [sensor.h(slam.state.mean_pose, landmark)])
        assert slam.state.resampled
    slam.move((0.5, 0.5), 1.0)
    before = [slam.state.map(i)[0].mean for i in range(50)]
    assert len(np.unique(np.round(before, 12), axis=0)) < 50
    slam.observe([0], [sensor.h(slam.state.mean_pose, landmark)])
    # the map of each particle was computed from its own pose, before it was resampled again
    poses, maps = slam.state.poses, np.array([slam.state.map(i)[0].mean for i in range(50)])
    same_pose = np.array([[np.array_equal(a, b) for b in poses] for a in poses])
    same_map = np.array([[np.array_equal(a, b) for b in maps] for a in maps])
    np.testing.assert_array_equal(same_pose, same_map)


def test_weights_are_the_likelihood_ratios() -> None:
    """Two particles on a known map: log w_1 - log w_2 = log N(z; h(x_1), Q) - log N(z; h(x_2), Q)."""
    start = np.array([[0.0, 0.0, 0.0], [0.3, -0.1, 0.05]])
    landmark, z = np.array([2.0, 1.0, 0.3]), np.array([2.1, 0.5, 0.2])
    mcl = MonteCarloLocalization(particles=2, start=start, map={4: landmark}, ess_threshold=0.0)
    mcl.observe([4], [z])
    Q = np.diag([(2.1 * 0.14) ** 2, 0.05**2, 0.05**2])

    def log_density(pose: np.ndarray) -> float:
        r = z - mcl.sensor.h(pose, landmark)
        r[1:] = wrap(r[1:])
        return float(-0.5 * r @ np.linalg.inv(Q) @ r)

    difference = mcl.state.log_weights[0] - mcl.state.log_weights[1]
    assert difference == pytest.approx(log_density(start[0]) - log_density(start[1]), rel=1e-10)


def test_weights_on_a_map_in_closed_form_with_the_determinant() -> None:
    """Particles that saw the landmark from different sides weigh a third sighting by N(z; h, H S H' + Q) each."""
    rng = np.random.default_rng(0)
    start = rng.normal(0.0, 0.2, (6, 3))
    slam = FastSLAM1(particles=6, start=start, ess_threshold=0.0, motion=MotionModel(epsilon=1e-300))
    slam.observe([0], [[2.0, 0.1, 0.3]])
    slam.move((0.5, 0.4), 1.0)
    poses, maps = slam.state.poses, [slam.state.map(i)[0] for i in range(6)]
    z = np.array([1.7, -0.3, 0.1])
    slam.observe([0], [z])
    expected = []
    for pose, landmark in zip(poses, maps, strict=True):
        H, r = slam.sensor.H(pose, landmark.mean), z - slam.sensor.h(pose, landmark.mean)
        r[1:] = wrap(r[1:])
        V = H @ landmark.covariance @ H.T + slam.sensor.Q(z)
        expected.append(-0.5 * (r @ np.linalg.inv(V) @ r + np.log(np.linalg.det(V))))
    weights = np.exp(np.array(expected) - np.max(expected))
    np.testing.assert_allclose(np.exp(slam.state.log_weights), weights / weights.sum(), rtol=1e-9)


def test_motion_has_the_covariance_of_the_graphs_edge() -> None:
    """Small noise: the particles' spread after one motion is A M A' + epsilon I, within sampling error."""
    slam = FastSLAM1(particles=200_000, seed=0, motion=QUIET["motion"], start=(1.0, 2.0, 0.7))
    control, dt = np.array([0.3, 0.2]), 2.0
    slam.move(control, dt)
    expected = QUIET["motion"].covariance([1.0, 2.0, 0.7], control, dt)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        slam.state.covariance() / np.outer(scale, scale), expected / np.outer(scale, scale),
        atol=bound(12) * np.sqrt(2 / 200_000),
    )  # fmt: skip
    off = (slam.state.mean_pose - QUIET["motion"].f([1.0, 2.0, 0.7], control, dt)) / scale
    # an error rate of 1e-6 for 12 moments of independent particles
    np.testing.assert_allclose(off, 0, atol=bound(12) / np.sqrt(200_000))


def test_mixture_map() -> None:
    log = simulate(seed=2)
    slam = FastSLAM1(log, particles=60)
    slam.run()
    state = slam.state
    weights, mixture = np.exp(state.log_weights), state.mixture_map()
    maps = [state.map(i) for i in range(60)]
    for j, estimate in mixture.items():
        means = np.array([m[j].mean for m in maps])
        np.testing.assert_allclose(estimate.mean[:2], weights @ means[:, :2], atol=1e-12)
        difference = means - estimate.mean
        difference[:, 2] = wrap(difference[:, 2])
        within = sum(w * m[j].covariance for w, m in zip(weights, maps, strict=True))
        np.testing.assert_allclose(
            estimate.covariance, within + difference.T @ np.diag(weights) @ difference, atol=1e-12
        )


def test_never_resampled_keeps_weights() -> None:
    """The weight is a product over steps: without resampling the last weights remember the first sightings."""
    log = simulate(seed=0)
    slam = FastSLAM1(log, particles=20, ess_threshold=0.0)
    previous = np.full(20, -np.log(20))
    changed = 0
    for state in slam:
        assert not state.resampled
        if log.landmarks[log.steps == state.step].size == 0:
            np.testing.assert_array_equal(state.log_weights, previous)
        changed += not np.array_equal(state.log_weights, previous)
        previous = state.log_weights
    assert changed > 40
    assert np.all(slam.result().ancestors == 20)


def test_threshold_one_resamples_after_every_weighed_step(clean_log: Log) -> None:
    result = FastSLAM1(clean_log, particles=20, ess_threshold=1.0).run()
    known: set[int] = set()
    for t in range(clean_log.num_poses):
        ids = set(clean_log.landmarks[clean_log.steps == t].tolist())
        assert result.resampled[t] == bool(ids & known)
        known |= ids
