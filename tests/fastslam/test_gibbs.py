"""Particle Gibbs against posteriors that are known otherwise, and what it says of itself."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import batch_errors, bound, check_normal
from importance_sampling import Moments, importance

import comparisons
from fastslam import GibbsOptions, GibbsResult, ParticleGibbs
from fastslam.filters import particle_filter
from fastslam.gibbs import LowRank, Target, judge
from fastslam.motions import Problem
from graphslam import Graph, Log, LogError, MotionModel, OptionError, PoseRelations, SensorModel, simulate, solve
from graphslam.association import known_noise
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import wrap

MOTION = MotionModel(nn=0.19, no=0.001, on=0.13, oo=0.2)
FIFTH: dict = {
    "motion": MotionModel(nn=0.038, no=0.0002, on=0.026, oo=0.04, epsilon=4e-6),
    "sensor": SensorModel(range_rate=0.028, bearing_std=0.01, orientation_std=0.01),
}


def small(
    seed: int, columns: int, offset: tuple[float, float] = (0.0, 0.0), composite: bool = False, landmarks: int = 2
) -> Log:
    """Landmarks, seen from all of four poses, with the book's noise."""
    rng, sensor = np.random.default_rng(seed), SensorModel(offset=offset)
    J = landmarks
    marks = np.column_stack([rng.uniform(1, 4, J), rng.uniform(-2, 3, J), rng.uniform(-3, 3, J)])[:, :columns]
    pieces = 3 if composite else 1
    controls, dt = np.tile([0.3, 0.25], (3 * pieces, 1)), np.full(3 * pieces, 3.0 / pieces)
    pose, steps, ids, sightings = np.zeros(3), [], [], []
    for t in range(4):
        for k in range(pieces if t else 0):
            std = np.sqrt(np.diag(MOTION.M(controls[0], dt[k])))
            pose = MOTION.f(pose, controls[0] + std * rng.standard_normal(2), dt[k])
        pose = pose + 0.01 * rng.standard_normal(3) * (t > 0)
        for j in range(J):
            z = sensor.h(pose, marks[j])
            z = z + np.sqrt(np.diag(sensor.Q(z))) * rng.standard_normal(columns)
            steps, ids, sightings = [*steps, t], [*ids, j], [*sightings, z]
    return Log(
        dt=dt,
        controls=controls,
        control_starts=np.arange(0, 3 * pieces + 1, pieces),
        initial_poses=np.zeros((4, 3)),
        steps=steps,
        landmarks=ids,
        sightings=sightings,
    )


def check_moments(result: GibbsResult, reference: Moments) -> None:
    """Means and standard deviations of poses and positions of landmarks against those of importance sampling.

    The tolerance of each is the number of standard errors that all differences together exceed with a probability of 1e-6.
    The errors are those of the chains, from 60 batches of each two chains, and those of the importance samples.
    """
    deviations = result.deviations
    T, n = result.trajectories.shape[2] - 1, result.maps.shape[3]
    kept = np.arange(deviations.shape[2])
    kept = kept[(kept < 3 * T) | ((kept - 3 * T) % n < 2)]
    mean_errors, std_errors = batch_errors(deviations[..., kept])
    found = np.concatenate([result.poses[1:].ravel(), *(mark[:2] for mark in result.landmarks.values())])
    off = found - reference.mean
    off[2 : 3 * T : 3] = wrap(off[2 : 3 * T : 3])
    degrees = 2 * 30 - 1
    check_normal(off, np.hypot(mean_errors, reference.mean_errors), degrees)
    std = np.sqrt(np.mean(deviations[..., kept] ** 2, axis=(0, 1)))
    check_normal(np.log(std / reference.std), np.hypot(std_errors, reference.std_errors), degrees)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "offset", "composite", "degrees"),
    [
        (2, (0.0, 0.0), False, None),
        pytest.param(3, (0.0, 0.0), False, None, marks=pytest.mark.nightly),
        pytest.param(2, (0.3, 0.1), True, None, marks=pytest.mark.nightly),
        (2, (0.0, 0.0), False, 4.0),
    ],
)
def test_the_exact_density_against_importance_sampling(
    columns: int, offset: tuple, composite: bool, degrees: float | None
) -> None:
    """The book's noise, where the linearised landmarks of FastSLAM are off by up to 0.6 standard deviations."""
    log, sensor = small(1, columns, offset, composite), SensorModel(offset=offset)
    gibbs = ParticleGibbs(
        log, seed=1, motion=MOTION, sensor=sensor, density="exact", particles=8, iterations=2000, warm_up=60, chains=2,
        degrees_of_freedom=degrees,
    )  # fmt: skip
    result = gibbs.run()
    about = result.trajectories[:, ::4].reshape(-1, 4, 3)
    check_moments(result, importance(log, sensor, MOTION, about, degrees=degrees))
    assert 0.3 < result.accepted < 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("density", "degrees", "columns"),
    [
        ("linearised", None, 2),
        ("exact", 4.0, 3),
        *(pytest.param(*case, marks=pytest.mark.nightly) for case in (
            ("linearised", None, 3), ("exact", None, 2), ("exact", None, 3), ("exact", 4.0, 2),
        )),
    ],
)  # fmt: skip
def test_many_landmarks_against_importance_sampling(columns: int, density: str, degrees: float | None) -> None:
    """Ten landmarks. Their headings, which nothing depends on without psi, once made everything else too narrow.

    Without a warm-up, the linearised density is that of the sightings as measured.
    """
    log, warm_up = small(3, columns, landmarks=10), 60 * (density == "exact")
    result = ParticleGibbs(
        log, seed=1, motion=MOTION, sensor=SensorModel(), density=density, particles=8, iterations=2000, warm_up=warm_up,
        chains=2, degrees_of_freedom=degrees,
    ).run()  # fmt: skip
    about = result.trajectories[:, ::4].reshape(-1, 4, 3)
    reference = importance(log, SensorModel(), MOTION, about, size=20_000, degrees=degrees, exact=density == "exact")
    check_moments(result, reference)


def test_without_sightings_that_matter_it_samples_the_motions() -> None:
    """A landmark seen once says nothing of the poses: their samples are those of the motion model."""
    log = small(0, 2)
    once = log.replace(steps=[3], landmarks=[0], sightings=log.sightings[:1])
    result = ParticleGibbs(once, motion=MOTION, particles=3, iterations=1500, warm_up=0, chains=2, block=2).run()
    motions, covariances = log.motions(MOTION)
    samples = result.trajectories.reshape(-1, 4, 3)
    d = samples[:, 1]
    np.testing.assert_allclose(samples[:, 0], 0)
    # each sweep draws the motions anew: 3,000 independent samples, and 3 + 9 moments
    scale, many = np.sqrt(np.diag(covariances[0])), bound(12) / np.sqrt(len(samples))
    np.testing.assert_allclose((d.mean(axis=0) - motions[0]) / scale, 0, atol=many)
    correlations = np.outer(scale, scale)
    np.testing.assert_allclose(np.cov(d.T) / correlations, covariances[0] / correlations, atol=np.sqrt(2) * many)


def test_both_kernels_agree() -> None:
    """Motion moves alone and block moves alone agree; so do short and long blocks, few and many particles."""
    log = simulate(seed=2, steps=8, clean=True, **FIFTH)
    results = [
        ParticleGibbs(
            log, seed=s, iterations=400, warm_up=20, chains=2, block=block, particles=particles, **FIFTH
        ).run()
        for s, (block, particles) in enumerate([(1, 40), (8, 40), (3, 4)])
    ]
    poses, landmarks = results[0].covariance(poses=[], landmarks=[])
    assert poses.shape == (0, 3, 3) and landmarks.shape[0] == 0
    scale = np.sqrt(np.diagonal(results[0].covariance()[1:], axis1=1, axis2=2))
    for other in results[1:]:
        difference = (other.poses - results[0].poses)[1:] / scale
        # an error rate of 1e-6 for the coordinates of both comparisons, with the effective sample size of the worst one
        error = np.sqrt(2 / min(np.nanmin(r.mixing.ess) for r in results))
        assert np.abs(difference).max() < bound(2 * difference.size) * error


@pytest.mark.parametrize("orientation", [True, False])
def test_the_mode_is_that_of_the_graph(orientation: bool) -> None:
    """Landmarks as nodes, residuals in the axes of the robot, motion edges: another program, the same density."""
    log = simulate(seed=2, steps=20, clean=True, orientation=orientation, **FIFTH)
    problem = Problem.of(log, FIFTH["motion"], FIFTH["sensor"])
    solution = solve(Graph.from_log(log, edges="landmark+motion", residual="cartesian", **FIFTH))
    marks = np.array([[*log.true_landmarks[j], 0.0][:3] for j in problem.ids.tolist()])
    target = Target.of(problem, GibbsOptions())
    poses, found = LowRank(target, log.initial_poses, marks).mode
    assert target.in_engine.cost(poses, found, False)[0] == pytest.approx(0.5 * solution.cost, rel=1e-9)
    np.testing.assert_allclose(wrap(poses - solution.poses), 0, atol=1e-6)


@pytest.mark.slow
def test_long_logs_mix_by_low_rank_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """The smallest effective sample size without them is a fraction, the posterior the same."""
    log = simulate(seed=0, steps=40, clean=True, orientation=False, **FIFTH)
    options = {"seed": 1, "particles": 5, "iterations": 150, "warm_up": 40, "chains": 2, **FIFTH}
    whole = ParticleGibbs(log, **options).run()
    monkeypatch.setattr("fastslam.gibbs.MOVES", 0)
    without = ParticleGibbs(log, **options).run()
    assert np.nanmin(whole.mixing.ess) > 2 * np.nanmin(without.mixing.ess)
    off = (whole.poses - without.poses)[1:] / np.sqrt(np.diagonal(whole.covariance()[1:], axis1=1, axis2=2))
    # an error rate of 1e-6 for all coordinates, with the effective sample size of the worst one
    error = np.sqrt(1 / np.nanmin(whole.mixing.ess) + 1 / np.nanmin(without.mixing.ess))
    assert np.abs(off).max() < bound(off.size) * error


@pytest.mark.slow
def test_wrong_sightings_bend_the_trajectory_little_with_student_s_density() -> None:
    log = simulate(seed=4, steps=25, clean=True, orientation=False, **FIFTH)
    sightings = log.sightings.copy()
    sightings[5::12, 1] += 0.5
    wrong = log.replace(sightings=sightings)
    options = {"seed": 1, "particles": 5, "iterations": 60, "warm_up": 40, "chains": 2, **FIFTH}
    gaussian, student = (ParticleGibbs(wrong, degrees_of_freedom=degrees, **options).run() for degrees in (None, 3.0))
    errors = [np.abs(wrap(result.poses - log.true_poses))[:, :2].max() for result in (gaussian, student)]
    assert errors[1] < 0.3 * errors[0]


def test_seed_and_threads() -> None:
    log = simulate(seed=2, steps=5, clean=True)
    options = {"iterations": 4, "warm_up": 4, "chains": 2, "particles": 5}
    first, second = (ParticleGibbs(log, seed=3, threads=threads, **options).run() for threads in (1, 2))
    np.testing.assert_array_equal(first.trajectories, second.trajectories)
    np.testing.assert_array_equal(first.maps, second.maps)
    assert first.trajectories.shape == (2, 4, 6, 3)
    assert np.abs(first.trajectories - ParticleGibbs(log, seed=4, **options).run().trajectories).max() > 0
    assert "not mixed" in repr(first)


def test_mixing_of_known_chains() -> None:
    """Of independent samples all count; of a first-order autoregression (1 - rho) / (1 + rho); chains apart do not mix."""
    rng, rho = np.random.default_rng(0), 0.8
    noise = rng.standard_normal((4, 4000, 3))
    chains = noise.copy()
    for t in range(1, 4000):
        chains[:, t, 1] = rho * chains[:, t - 1, 1] + np.sqrt(1 - rho**2) * noise[:, t, 1]
    chains[:, :, 2] += np.arange(4)[:, None]
    mixing = judge(chains, ["a", "b", "c"])
    # fixed random numbers without a sampler: the same on every machine, and within the error of an estimated spectrum
    np.testing.assert_allclose(mixing.ess[:2], [16000, 16000 * (1 - rho) / (1 + rho)], rtol=0.15)
    np.testing.assert_allclose(mixing.rhat[:2], 1, atol=5e-3)
    # B / n = 5/3 of the means, W = 1
    assert mixing.rhat[2] == pytest.approx(np.sqrt(1 + 1.25 * 8 / 7), rel=0.02)
    assert not mixing.mixed and mixing.statement.startswith("not mixed: R-hat at most 1.5")
    assert "(c)" in mixing.statement and "raise iterations and warm_up" in mixing.statement
    assert judge(chains[:, :, :2], ["a", "b"]).mixed
    # more samples or particles do not bring chains together that have not yet met
    chains[:, :, 2] += 10 * np.arange(4)[:, None]
    assert "the chains are still far apart: raise warm_up" in judge(chains, ["a", "b", "c"]).statement


@pytest.mark.parametrize("shape", [(1, 1, 2), (4, 3, 2), (1, 50, 2)])
def test_chains_that_say_nothing_have_not_mixed(shape: tuple[int, int, int]) -> None:
    """Too few sweeps, or a chain that has never moved."""
    mixing = judge(np.ones(shape), ["a", "b"])
    assert not mixing.mixed
    assert mixing.statement.startswith("not mixed: R-hat at most inf (a), effective sample size at least 0 (a)")


def test_noise_that_leaves_floating_point_is_refused() -> None:
    log = simulate(seed=2, steps=6, clean=True)
    motion = MotionModel(nn=0.001, no=0, on=0.001, oo=0, epsilon=1e-14)
    with pytest.raises(OptionError, match="left floating point.*raise epsilon"):
        ParticleGibbs(log, motion=motion, particles=4, iterations=8, warm_up=8, chains=1).run()
    sightings = log.sightings.copy()
    sightings[5, 0] = 1e49
    # rounding decides which of the two is noticed first
    with pytest.raises(OptionError, match="longest is 1e\\+49 m|left floating point"):
        ParticleGibbs(log.replace(sightings=sightings), particles=4, iterations=8, warm_up=8, chains=1).run()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"particles": 1}, "particles must be at least 2, not 1"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"iterations": 2.5}, "iterations must be a whole number"),
        ({"warm_up": -1}, "warm_up must be at least 0"),
        ({"chains": 0}, "chains must be at least 1"),
        ({"block": 0}, "block must be at least 1"),
        ({"degrees_of_freedom": 0.0}, "degrees_of_freedom must be a positive number, not 0"),
        ({"degrees_of_freedom": "many"}, "degrees_of_freedom must be a number, not"),
        ({"density": "true"}, "density must be one of linearised, exact"),
        ({"iterations": 10**12}, "need .* of memory"),
        ({"chains": 10**9}, "1,000,000,000 chains .* need .* of memory"),
        ({"particles": 10**12}, "particles of particle Gibbs need .* of memory"),
        ({"seed": -1}, "seed must be a whole number, not below 0"),
        ({"seed": 0.5}, "seed must be a whole number"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"log": "sample.npz"}, "log must be a Log"),
        ({"log": None}, "log must be a Log"),
        ({"motion": 0.1}, "motion must be a MotionModel"),
        ({"sensor": 0.1}, "sensor must be a SensorModel"),
        ({"start": (0.0, np.nan, 0.0)}, "start must be 3 finite numbers"),
        ({"iteratons": 3}, "ParticleGibbs has no option 'iteratons'; did you mean 'iterations'"),
    ],
)
def test_bad_options(options: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        ParticleGibbs(**{"log": small(0, 2)} | options)


def test_what_is_not_used_is_said_once() -> None:
    rows = {"first": [0], "second": [2], "motions": np.zeros((1, 3)), "covariances": np.eye(3)[None]}
    with pytest.warns(UserWarning, match="does not use") as caught:
        ParticleGibbs(small(0, 3).replace(relations=PoseRelations(**rows)), chains=3)
    assert [str(each.message) for each in caught] == ["particle Gibbs does not use the relations of the log"]


def test_bad_logs() -> None:
    log = small(0, 2)
    with pytest.raises(LogError, match="no controls"):
        ParticleGibbs(Log(initial_poses=np.zeros((2, 3)), steps=[0], landmarks=[0], sightings=[[1.0, 0.0]]))
    with pytest.raises(OptionError, match="no sightings"):
        ParticleGibbs(log.replace(steps=[], landmarks=[], sightings=np.empty((0, 2))))
    with pytest.raises(OptionError, match="without ids"):
        ParticleGibbs(log.replace(landmarks=np.full(8, UNIDENTIFIED)))


def test_biases_that_are_estimated_are_taken_out_of_what_is_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    log = simulate(seed=3, steps=200, clean=True)
    turned = log.sightings + np.array([0.0, 0.15, 0.0])
    log = log.replace(sightings=turned, simulated=False, motion=None, sensor=None)
    known, _ = known_noise(log)
    estimates: list[Log] = []
    monkeypatch.setattr(particle_filter, "known_noise", lambda log: (estimates.append(log), known_noise(log))[1])
    problem = ParticleGibbs(log, chains=3)._problem
    # the filters of the other chains are given what the first one has found
    assert [each.motion is None for each in estimates] == [True]
    np.testing.assert_allclose(problem.z, known.sightings, atol=1e-12)
    assert np.abs(problem.z - log.sightings).max() > 0.01


def test_the_estimator_and_its_options() -> None:
    log = simulate(seed=2, steps=5, clean=True)
    comparison = comparisons.run(
        log, estimators=["graph", "particle-gibbs"], gibbs_iterations=20, gibbs_chains=2, gibbs_particles=10
    )
    result = comparison.results[1]
    assert result.origin.options == GibbsOptions(iterations=20, chains=2, particles=10)
    assert result.options["gibbs_iterations"] == 20
    assert result.reason.startswith("not mixed")
    assert (result.converged, result.iterations) == (False, 20)
    # the tables print the reason, and would print a note beside it
    assert result.notes == ()
    assert result.pose_covariances.shape == (6, 3, 3)
    assert comparison.metrics["particle-gibbs"].ate_m < 1
    with pytest.raises(OptionError, match="gibbs_chains must be a whole number"):
        comparisons.run(log, estimators=["particle-gibbs"], gibbs_chains=1.5)
    with pytest.raises(OptionError, match="^gibbs_particles must be at least 2, not 1"):
        comparisons.run(log, estimators=["particle-gibbs"], gibbs_particles=1)
