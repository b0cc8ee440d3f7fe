"""Backward simulation of a filter run: against exact posteriors, and what it says of itself."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound, check_mean, mean_error
from exact_posterior import exact_posterior

import comparisons
from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from graphslam import MotionModel, OptionError, SensorModel, simulate
from graphslam.se2 import wrap

FIFTH: dict = {
    "motion": MotionModel(nn=0.038, no=0.0002, on=0.026, oo=0.04, epsilon=4e-6),
    "sensor": SensorModel(range_rate=0.028, bearing_std=0.01),
}


@pytest.mark.nightly
def test_it_repairs_the_early_steps_of_fastslam_1() -> None:
    """Histories have few ancestors in early steps; drawn backwards they are nearer to the posterior.

    The limits are at least `bound(1, 23)`, 6.6, standard errors away from the means of these 24 independent runs.
    """
    ratios, errors, spreads, worst = [], [], [], []
    for seed in range(24):
        log = simulate(seed=seed, steps=25, clean=True, orientation=False, **FIFTH)
        exact = exact_posterior(log, 25, FIFTH["motion"], FIFTH["sensor"])
        std = np.sqrt([np.diag(exact.pose_covariance(t)) for t in range(1, 26)])
        result = FastSLAM1(log, particles=300, seed=seed, smoothing=50, **FIFTH).run()
        rms = []
        for poses in (result.mean_poses, result.smoothed.poses):
            off = poses[1:] - exact.poses[1:]
            off[:, 2] = wrap(off[:, 2])
            rms.append(np.sqrt(np.mean((off / std) ** 2)))
        ratios.append(np.log(rms[0] / rms[1]))
        errors.append(rms[1])
        found = np.sqrt(np.diagonal(result.smoothed.covariance()[1:], axis1=1, axis2=2))
        spreads.append(np.median(found / std))
        offs = {j: result.smoothed.landmarks[j] - mean for j, mean in exact.landmarks.items()}
        worst.append(max(off @ np.linalg.solve(exact.landmark_covariance(j), off) for j, off in offs.items()))
    # the factor is 2.3 in the mean
    assert np.mean(ratios) > 0
    assert np.mean(errors) < 0.5
    assert np.mean(worst) < 1.5
    # 300 particles are too sure by 5 %
    assert np.mean(spreads) == pytest.approx(0.95, abs=bound(1, 23) * mean_error(spreads))


@pytest.mark.slow
@pytest.mark.parametrize("offset", [pytest.param((0.0, 0.0), marks=pytest.mark.nightly), (0.3, 0.1)])
@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_without_common_landmarks_it_draws_the_motions(kind: type, offset: tuple[float, float]) -> None:
    """A landmark seen once ties nothing together: the trajectories are those of the motion model, with or without psi."""
    log = simulate(seed=0, steps=3, clean=True).replace(sensor=SensorModel(offset=offset))
    log = log.replace(steps=[2], landmarks=[0], sightings=[[1.0, 0.0, 0.0]])
    motions, covariances = log.motions(MotionModel())
    runs = []
    # the time is that of particles times trajectories, so that more runs of fewer are cheaper
    for seed in range(40):
        smoothed = kind(log, particles=300, seed=seed, smoothing=200).run().smoothed
        off = (smoothed.poses[1] - smoothed.poses[0] - motions[0]) / np.sqrt(np.diag(covariances[0]))
        runs.append([*off, *(np.diag(smoothed.covariance()[1]) / np.diag(covariances[0]))])
    check_mean(runs, [0, 0, 0, 1, 1, 1])
    assert smoothed.trajectories.shape == (1, 200, 4, 3)
    assert smoothed.maps.shape == (1, 200, 1, 3)


def test_seed_threads_and_measurements_by_hand() -> None:
    log = simulate(seed=1, steps=12)
    runs = [FastSLAM2(log, particles=300, seed=2, smoothing=20, threads=threads).run() for threads in (1, 2)]
    np.testing.assert_array_equal(runs[0].smoothed.trajectories, runs[1].smoothed.trajectories)
    np.testing.assert_array_equal(runs[0].smoothed.maps, runs[1].smoothed.maps)
    # the filter itself is not changed
    plain = FastSLAM2(log, particles=300, seed=2).run()
    np.testing.assert_array_equal(runs[0].poses, plain.poses)
    assert plain.smoothed is None
    by_hand = FastSLAM2(particles=300, seed=2, smoothing=20, start=log.initial_poses[0])
    assert by_hand.result().smoothed is None
    for t in range(log.num_poses):
        if t:
            by_hand.move(log.controls[t - 1], log.dt[t - 1])
        seen = log.steps == t
        by_hand.observe(log.landmarks[seen], log.sightings[seen])
    for result in (by_hand.result(), by_hand.result()):
        np.testing.assert_allclose(result.smoothed.trajectories, runs[0].smoothed.trajectories, atol=1e-9)


@pytest.mark.slow
def test_several_observations_of_one_step() -> None:
    """Each may resample: the histories must still be connected.

    The limit is 12 standard errors away from the mean of 12 runs, 0.10, and `bound(1, 11)` is 9.
    """
    differences = []
    for seed in range(12):
        log = simulate(seed=seed, steps=12, clean=True, orientation=False, **FIFTH)
        results = []
        for split in (False, True):
            slam = FastSLAM1(
                particles=1000, seed=seed, smoothing=100, start=log.initial_poses[0], ess_threshold=1.0, **FIFTH
            )
            for t in range(log.num_poses):
                if t:
                    slam.move(log.controls[t - 1], log.dt[t - 1])
                seen = np.flatnonzero(log.steps == t)
                for part in np.array_split(seen, 2) if split else (seen,):
                    slam.observe(log.landmarks[part], log.sightings[part])
            results.append(slam.result().smoothed)
        off = results[0].poses[1:] - results[1].poses[1:]
        off[:, 2] = wrap(off[:, 2])
        scale = np.sqrt(np.diagonal(results[0].covariance()[1:], axis1=1, axis2=2))
        differences.append(np.sqrt(np.mean((off / scale) ** 2)))
    assert np.mean(differences) < 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"smoothing": 3}, "smoothing must be 0 .off. or at least 10 trajectories, not 3"),
        ({"smoothing": -1}, "smoothing must be 0"),
        ({"smoothing": 10.5}, "smoothing must be a whole number"),
        ({"smoothing": 20, "association": "maximum-likelihood"}, "smoothing 20 needs the association known"),
        ({"smoothing": 20, "stage": "motion"}, "smoothing needs weighted particles"),
    ],
)
def test_bad_options(options: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        FastSLAM1(**options)


def test_it_needs_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    log = simulate(seed=1, steps=5)
    slam = FastSLAM1(log, particles=100, smoothing=10)
    monkeypatch.setattr("fastslam.motions.available_memory", lambda: 1e4)
    with pytest.raises(
        OptionError, match=r"smoothing 100 particles over 5 steps by 10 trajectories needs .* take fewer"
    ):
        slam.run()


def test_what_cannot_fit_is_refused_before_the_run() -> None:
    log = simulate(seed=1, steps=5)
    with pytest.raises(OptionError, match=r"take at most [\d,]+ particles or a smaller smoothing"):
        FastSLAM1(log, particles=100, smoothing=10**9)
    with pytest.raises(OptionError, match=r"take at most [\d,]+ particles or a smaller smoothing"):
        FastSLAM1(log.replace(name="long"), particles=49_000_000, smoothing=10)


def test_the_estimator_reports_the_smoothed_trajectory() -> None:
    log = simulate(seed=1, steps=12)
    comparison = comparisons.run(log, estimators=["mcl", "fastslam2"], particles=200, smoothing=20)
    result = comparison.results[1]
    np.testing.assert_array_equal(result.poses, result.origin.smoothed.poses)
    assert result.landmarks.keys() == result.origin.smoothed.landmarks.keys()
    assert result.pose_covariances.shape == (13, 3, 3)
    assert result.reason.endswith("and drew 20 trajectories backwards")
    # localisation ignores it
    assert comparison.results[0].origin.smoothed is None
    assert repr(result.origin).endswith("20 trajectories drawn backwards)")
    assert repr(result.origin.smoothed) == f"Samples(20 trajectories of 13 poses, {len(result.landmarks)} landmarks)"
    assert MonteCarloLocalization(log, particles=20, smoothing=20).run().smoothed is None


def test_the_map_of_a_smoothed_result_is_that_of_its_trajectories() -> None:
    """The map of one path has a mean squared Mahalanobis distance of the landmarks over 2 of 6, drawn backwards 1."""
    log = simulate(seed=3, steps=60, clean=True)
    found = FastSLAM1(log, particles=100, seed=1, smoothing=30).run()
    assert found.smoothed is not None
    for j, mean in found.smoothed.landmarks.items():
        np.testing.assert_array_equal(found.map[j], mean)
        np.testing.assert_allclose(found.map.covariances[j], found.smoothed.landmark_covariances[j])
    assert set(found.map) == set(found.smoothed.landmarks)
