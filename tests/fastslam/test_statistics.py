"""The posterior against closed forms and against Gauss-Newton on the full problem."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound, check_normal, mean_error
from exact_posterior import exact_posterior

from fastslam import FastSLAM1, FastSLAM2, ParticleFilter
from fastslam.options import PROPOSAL_WEIGHTS
from graphslam import Log, MotionModel, OptionError, SensorModel, simulate
from graphslam.se2 import wrap

# A linear-Gaussian world made of the ordinary models. The wheels never slip round, so headings are known. The
# landmarks are so far away (10 km) that a sighting is a position with a round covariance and that h is straight to
# one part in 100,000 over all that matters. Farther away, the smallest epsilon of FastSLAM 2.0 would matter.
FAR, SPREAD, MARKS, STEPS = 1e4, 0.3, 3, 8
LINEAR = {
    "motion": MotionModel(nn=0.2, no=0, on=0, oo=0, epsilon=1e-30),
    "sensor": SensorModel(range_rate=SPREAD / FAR, bearing_std=SPREAD / FAR),
}
CONTROL = np.array([0.5, 0.4])
LANDMARKS = FAR * np.array([[np.cos(a), np.sin(a)] for a in 2.2 * np.arange(MARKS)])


def linear_log(seed: int) -> Log:
    rng, motion, sensor = np.random.default_rng(seed), LINEAR["motion"], LINEAR["sensor"]
    nu = CONTROL[0] + np.sqrt(motion.M(CONTROL, 1.0)[0, 0]) * rng.standard_normal(STEPS)
    poses = motion.dead_reckoning(np.zeros(3), np.column_stack([nu, np.full(STEPS, CONTROL[1])]), 1.0)
    steps, ids = np.repeat(np.arange(STEPS + 1), MARKS), np.tile(np.arange(MARKS), STEPS + 1)
    exact = sensor.h(poses[steps], LANDMARKS[ids])
    noise = np.sqrt(np.diagonal(sensor.Q(exact), axis1=-2, axis2=-1)) * rng.standard_normal(exact.shape)
    return Log(
        dt=np.ones(STEPS), controls=np.tile(CONTROL, (STEPS, 1)), steps=steps, landmarks=ids, sightings=exact + noise
    )


def linear_posterior(log: Log) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mean and covariance of the last position and of each landmark, in closed form: linear least squares.

    The unknowns are the noise of each nu (standard normal a priori) and the landmarks.
    """
    motion, sensor = LINEAR["motion"], LINEAR["sensor"]
    reckoned = motion.dead_reckoning(np.zeros(3), log.controls, log.dt)
    by_noise = motion.A(reckoned[:-1], log.controls, log.dt)[:, :2, 0] * np.sqrt(motion.M(CONTROL, 1.0)[0, 0])
    size = STEPS + 2 * MARKS
    Omega, xi = np.diag([1.0] * STEPS + [0.0] * 2 * MARKS), np.zeros(size)
    for t, j, z in zip(log.steps, log.landmarks, log.sightings, strict=True):
        J = np.zeros((2, size))
        J[:, :t] = -by_noise[:t].T
        J[:, STEPS + 2 * j : STEPS + 2 * j + 2] = np.eye(2)
        Omega += J.T @ J / SPREAD**2
        xi += J.T @ (sensor.h_inverse(reckoned[t], z) - LANDMARKS[j]) / SPREAD**2
    covariance = np.linalg.inv(Omega)
    mean = covariance @ xi
    moved = np.hstack([by_noise.T, np.zeros((2, 2 * MARKS))])
    posterior = [(reckoned[-1, :2] + moved @ mean, moved @ covariance @ moved.T)]
    for j in range(MARKS):
        at = slice(STEPS + 2 * j, STEPS + 2 * j + 2)
        posterior.append((LANDMARKS[j] + mean[at], covariance[at, at]))
    return posterior


@pytest.mark.nightly
@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_convergence_to_the_closed_form_as_one_over_root_n(kind: type[ParticleFilter]) -> None:
    """Mean and covariance of pose and map: the slope of the errors over the number of particles is -1/2 in logarithms.

    The error of the slope follows from the spread of the squared errors over the logs.
    """
    numbers, logs = np.array([100, 316, 1000, 3162, 10_000]), 100
    squares = np.empty((len(numbers), logs, 4))
    for n, particles in enumerate(numbers):
        for seed in range(logs):
            log = linear_log(seed)
            slam = kind(log, particles=int(particles), seed=logs * n + seed, **LINEAR)
            slam.run()
            state = slam.state
            estimates = [(state.mean_pose[:2], state.covariance()[:2, :2])]
            estimates += [(e.mean, e.covariance) for e in state.mixture_map().values()]
            off = []
            for (mean, covariance), (m, C) in zip(estimates, linear_posterior(log), strict=True):
                scale = np.sqrt(np.diag(C))
                off.append(
                    [np.mean(((mean - m) / scale) ** 2), np.mean(((covariance - C) / np.outer(scale, scale)) ** 2)]
                )
            squares[n, seed] = [*off[0], *np.mean(off[1:], axis=0)]
    means = squares.mean(axis=1)
    log_errors = mean_error(np.swapaxes(squares, 0, 1)) / (2 * means)
    x = np.log(numbers) - np.log(numbers).mean()
    slopes, slope_errors = x @ np.log(means) / 2 / (x @ x), np.sqrt(x**2 @ log_errors**2) / (x @ x)
    check_normal(slopes + 0.5, slope_errors, len(numbers) * (logs - 1))
    # independent samples of the posterior would have 1; resampling costs some of them
    inflation = np.sqrt(numbers[-1] * means[-1])
    assert np.all(inflation < 2.5 * np.exp(bound(4, logs - 1) * log_errors[-1])), inflation


def test_exact_weights_stay_equal_in_a_linear_world_without_epsilon() -> None:
    """The draw and its weight take the same epsilon, else the weights of a noise-free heading differ without bound."""
    log = linear_log(0)
    ess = {w: FastSLAM2(log, particles=1000, seed=1, proposal_weight=w, **LINEAR).run().ess for w in PROPOSAL_WEIGHTS}
    assert np.all(ess["exact"] > 0.9 * ess["linearised"])


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "seed", "last", "particles"), [(FastSLAM2, 0, 60, 4000), (FastSLAM1, 1, 30, 8000)])
def test_the_grown_graphs_posterior(kind: type[ParticleFilter], seed: int, last: int, particles: int) -> None:
    """A fifth of the book's noise: means and standard deviations at every tenth step, as a mean over 40 runs.

    Linearised landmarks and so many particles are off by up to 0.1 standard deviations; the rest is the spread of runs.
    The bootstrap proposal of 1.0 meets this for half of the log only: resampled sixty times, by whatever scheme, its
    histories are of few families, and its worst landmark is 0.2 to 0.7 off (`benchmarks/fastslam_depletion.py`).
    """
    models = {
        "motion": MotionModel(nn=0.038, no=0.0002, on=0.026, oo=0.04, epsilon=4e-6),
        "sensor": SensorModel(range_rate=0.028, bearing_std=0.01),
    }
    log = simulate(seed=seed, steps=last, clean=True, orientation=False, **models)
    posteriors, runs = {t: exact_posterior(log, t, **models) for t in range(10, last + 1, 10)}, []
    for run in range(40):
        numbers = []
        for state in kind(log, particles=particles, seed=run, **models):
            if state.step not in posteriors:
                continue
            exact, mixture = posteriors[state.step], state.mixture_map()
            assert mixture.keys() == exact.landmarks.keys()
            off, P = state.mean_pose - exact.poses[-1], exact.pose_covariance(state.step)
            off[2] = wrap(off[2])
            both = [(off, state.covariance(), P)]
            for j, mean in exact.landmarks.items():
                both.append((mixture[j].mean - mean, mixture[j].covariance, exact.landmark_covariance(j)))
            for off, found, expected in both:
                numbers += [*(off / np.sqrt(np.diag(expected))), *np.log(np.diag(found) / np.diag(expected)) / 2]
        runs.append(numbers)
    errors = np.abs(np.mean(runs, axis=0))
    assert np.all(errors < 0.1 + bound(errors.size, 39) * mean_error(runs))


@pytest.mark.nightly
def test_the_exact_weight_makes_1_and_2_agree() -> None:
    """Two landmarks, three motions at the book's noise: the same means; linearised they are not."""
    motion, sensor, rng = MotionModel(), SensorModel(), np.random.default_rng(0)
    marks, u, dt = np.array([[2.9, 1.2], [1.8, -1.9]]), np.array([0.3, 0.25]), 3.0
    poses = motion.dead_reckoning(np.zeros(3), np.tile(u, (3, 1)), dt)
    steps, ids = np.repeat(np.arange(4), 2), np.tile([0, 1], 4)
    exact = sensor.h(poses[steps], marks[ids])
    sightings = exact + np.sqrt(np.diagonal(sensor.Q(exact), axis1=1, axis2=2)) * rng.standard_normal(exact.shape)
    log = Log(dt=np.full(3, dt), controls=np.tile(u, (3, 1)), steps=steps, landmarks=ids, sightings=sightings)

    def run(kind: type[ParticleFilter], **options: str) -> np.ndarray:
        means = []
        for seed in range(24):
            slam = kind(log, particles=15_000, seed=seed, **options)
            slam.run()
            mixture = slam.state.mixture_map()
            means.append(np.concatenate([slam.state.mean_pose, mixture[0].mean, mixture[1].mean]))
        return np.array(means)

    reference, second = run(FastSLAM1), run(FastSLAM2)
    off = second.mean(axis=0) - reference.mean(axis=0)
    check_normal(off, np.hypot(mean_error(second), mean_error(reference)), 23)
    linearised = run(FastSLAM2, proposal_weight="linearised")
    off = np.abs(linearised.mean(axis=0) - reference.mean(axis=0))
    # the farthest is 9 standard errors off, and `bound(1, 23)` is 6.6
    assert np.any(off > 2 * np.hypot(mean_error(linearised), mean_error(reference)))


@pytest.mark.parametrize("cls", [FastSLAM1, FastSLAM2])
def test_filters_have_the_methods_of_the_online_solver(cls: type) -> None:
    """The joint covariance of pose and landmarks is that of the particles, with the Gaussians inside each of them."""
    slam, other = cls(particles=400, seed=1), cls(particles=400, seed=1)
    seen = ([3, -2], [[2.0, 0.3], [1.5, -0.4]])
    z, P = np.array([1.0, 0.0, 0.1]), np.diag([0.05, 0.05, 0.02]) ** 2
    for one in (slam, other):
        one.observe(*seen)
        one.move(motion=z, covariance=P)
        one.observe([3], [[1.1, 0.4]])
    np.testing.assert_array_equal(slam.pose, other.state.mean_pose)
    assert list(slam.landmarks) == [-2, 3]
    joint = slam.covariance(poses=1, landmarks=[3, -2], joint=True)
    pose, landmarks = slam.covariance(poses=1, landmarks=[3, -2])
    np.testing.assert_allclose(joint[:3, :3], pose)
    np.testing.assert_allclose(joint[3:5, 3:5], landmarks[0])
    np.testing.assert_allclose(joint[5:, 5:], landmarks[1])
    np.testing.assert_array_equal(slam.covariance(), pose)
    assert [block.shape for block in slam.covariance(poses=[], landmarks=[])] == [(0, 3, 3), (0, 2, 2)]
    assert slam.covariance(poses=[], landmarks=[], joint=True).shape == (0, 0)
    assert np.linalg.eigvalsh(joint).min() > 0
    weights, mean = np.exp(slam.state.log_weights), slam.landmarks[3]
    means = np.array([slam.state.map(k)[3].mean for k in range(400)])
    crossed = (slam.state.poses - slam.pose).T @ (weights[:, None] * (means - mean))
    np.testing.assert_allclose(joint[:3, 3:5], crossed, atol=1e-12)
    for arguments in ({"poses": 0}, {"landmarks": [7]}, {"poses": 0.5}):
        with pytest.raises(OptionError):
            slam.covariance(**arguments)
    for motion in ({}, {"motion": z, "covariance": -P}, {"control": (1, 0), "dt": 1.0, "motion": z, "covariance": P}):
        with pytest.raises(OptionError):
            slam.move(**motion)
