"""The array versions against the textbook, particle by particle, with the same random numbers: 1e-10."""

from __future__ import annotations

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, ParticleFilter, textbook
from graphslam import Log, OptionError, simulate

TOLERANCE = {"rtol": 1e-10, "atol": 1e-10}

LOGS = {
    "sample": lambda: simulate(seed=0, steps=40),
    "clean": lambda: simulate(seed=4, clean=True, steps=40),
    "way points": lambda: simulate(
        seed=2,
        steps=30,
        dt=1.0,
        speed=0.5,
        turn_rate=0.6,
        way_points=[(3, 3), (-3, 3), (-3, -3), (3, -3)],
        landmarks=15,
    ),
}


@pytest.fixture(params=[(name, psi) for name in LOGS for psi in (True, False)], ids=lambda p: f"{p[0]}, psi {p[1]}")
def log(request: pytest.FixtureRequest) -> Log:
    name, psi = request.param
    return LOGS[name]() if psi else LOGS[name]().without_orientation()


def assert_same(fast: ParticleFilter, slow: list[textbook.Particle], maps: bool = True) -> None:
    state = fast.state
    np.testing.assert_allclose(state.poses, [particle.pose for particle in slow], **TOLERANCE)
    np.testing.assert_allclose(state.log_weights, [particle.log_weight for particle in slow], **TOLERANCE)
    if not maps:
        return
    found = [state.map(i) for i in range(len(slow))]
    assert [each.keys() for each in found] == [particle.map.keys() for particle in slow]
    # all at once, because a comparison takes longer than a landmark
    pairs = [(each[j], landmark) for each, particle in zip(found, slow) for j, landmark in particle.map.items()]
    for part in ("mean", "covariance"):
        ours, theirs = ([getattr(landmark, part) for landmark in side] for side in zip(*pairs)) if pairs else ([], [])
        np.testing.assert_allclose(ours, theirs, **TOLERANCE)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("ess_threshold", [1.0, 0.5])
def test_step_by_step(log: Log, ess_threshold: float, version: int) -> None:
    filters = {1: (FastSLAM1, textbook.fastslam1), 2: (FastSLAM2, textbook.fastslam2)}
    fast = filters[version][0](log, particles=6, seed=np.random.default_rng(3), ess_threshold=ess_threshold)
    slow = filters[version][1](log, particles=6, rng=3, ess_threshold=ess_threshold)
    steps = 0
    for _, particles in zip(fast, slow, strict=True):
        assert_same(fast, particles)
        steps += 1
    assert steps == log.num_poses
    # the genealogy stores the histories once, the textbook copies them
    for i, particle in enumerate(particles):
        np.testing.assert_allclose(fast.trajectory(i), particle.path, **TOLERANCE)


@pytest.mark.slow
def test_sighting_by_sighting(log: Log) -> None:
    """Every sighting is weighed and resampled by itself."""
    rng_fast, rng_slow = np.random.default_rng(5), np.random.default_rng(5)
    fast = FastSLAM1(particles=8, seed=rng_fast, start=log.initial_poses[0], ess_threshold=0.8)
    slow = textbook.start(8, log.initial_poses[0])
    for t in range(30):
        if t > 0:
            fast.move(log.controls[t - 1], log.dt[t - 1])
            textbook.motion_update(slow, log.controls[t - 1], log.dt[t - 1], fast.motion, rng_slow)
        for k in np.flatnonzero(log.steps == t):
            fast.observe(log.landmarks[[k]], log.sightings[[k]])
            weighed = textbook.observation_update(slow, log.landmarks[[k]].tolist(), log.sightings[[k]], fast.sensor)
            if weighed and textbook.effective_sample_size(slow) <= 0.8 * 8:
                slow = textbook.resample(slow, rng_slow)
            assert_same(fast, slow)


@pytest.mark.slow
def test_localization(log: Log) -> None:
    rng = np.random.default_rng(6)
    fast = MonteCarloLocalization(log, particles=20, seed=np.random.default_rng(6), ess_threshold=1.0)
    slow = textbook.start(20, log.initial_poses[0])
    for t, _ in enumerate(fast):
        if t > 0:
            textbook.motion_update(slow, log.controls[t - 1], log.dt[t - 1], fast.motion, rng)
        now = log.steps == t
        if np.any(now):
            textbook.localization_update(
                slow, log.landmarks[now].tolist(), log.sightings[now], log.true_landmarks, fast.sensor
            )
            slow = textbook.resample(slow, rng)
        assert_same(fast, slow, maps=False)


def test_the_textbook_with_one_particle() -> None:
    """Without motion noise a map is a product of Gaussians: K equal sightings divide the covariance by K."""
    particles = textbook.start(1, (0.0, 0.0, 0.0))
    sensor = FastSLAM1().sensor
    z = np.array([2.0, 0.3])
    first = textbook.initialize_landmark(particles[0].pose, z, sensor)
    np.testing.assert_allclose(first.covariance, sensor.landmark_covariance(particles[0].pose, z), rtol=1e-12)
    for _ in range(10):
        textbook.observation_update(particles, [7], [z], sensor)
    np.testing.assert_allclose(particles[0].map[7].mean, sensor.h_inverse(particles[0].pose, z), rtol=1e-12)
    np.testing.assert_allclose(particles[0].map[7].covariance, first.covariance / 10, rtol=1e-9)
    # N(z; h(m), 2 Q) at its mode
    expected = -0.5 * np.log(np.linalg.det(2 * np.pi * 2 * sensor.Q(z)))
    assert textbook.log_likelihood(particles[0].pose, first, z, sensor) == pytest.approx(expected, rel=1e-12)


def test_the_textbook_refuses_an_unknown_weight() -> None:
    log = simulate(seed=1, steps=2)
    with pytest.raises(OptionError, match="proposal_weight must be one of exact, linearised, not 'linear'"):
        next(textbook.fastslam2(log, rng=np.random.default_rng(0), proposal_weight="linear"))


def test_textbook_restores_vanished_weights() -> None:
    particles = textbook.start(3, (1.0, 2.0, 0.0))
    for particle in particles:
        particle.map[0] = textbook.Gaussian(np.array([1.0, 2.0]), np.eye(2))
    assert textbook.observation_update(particles, [0], [np.array([1.0, 0.0])], FastSLAM1().sensor)
    np.testing.assert_allclose([particle.log_weight for particle in particles], -np.log(3))
    np.testing.assert_array_equal(particles[0].map[0].mean, [1.0, 2.0])
