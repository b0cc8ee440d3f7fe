"""Bands and NEES on known Gaussians, and the consistency of each weight."""

import json

import numpy as np
import pytest
from error_rates import bound, chi_square_bounds
from scipy.stats import chi2

from comparisons.studies.consistency import Consistency, band, models, study_consistency
from graphslam import Graph, MotionModel, OptionError, SensorModel, simulate, solve
from graphslam.metrics import pose_nees
from graphslam.se2 import wrap


@pytest.fixture(scope="module")
def outcome():
    return study_consistency(logs=30, steps=40, seed=3, jobs=0)


def test_the_band_holds_95_of_100_studies():
    rng = np.random.default_rng(0)
    low, high = band(3 * 40)
    inside = [low <= np.mean(rng.chisquare(3, 40)) / 3 <= high for _ in range(4000)]
    assert np.mean(inside) == pytest.approx(0.95, abs=bound() * np.sqrt(0.95 * 0.05 / 4000))
    assert chi2.cdf(low * 120, 120) == pytest.approx(0.025)


def test_nees_of_gaussians_is_one_and_shows_a_wrong_covariance():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(5, 3, 3))
    covariance = root @ np.swapaxes(root, 1, 2)
    errors = np.einsum("tij,ntj->nti", root, rng.normal(size=(4000, 5, 3)))
    nees = np.array([pose_nees(e, covariance) for e in errors])
    # chi-square with 60,000 degrees of freedom
    error = bound() * np.sqrt(2 / 60_000)
    assert nees.mean() == pytest.approx(1.0, rel=error)
    assert np.mean([pose_nees(e, covariance / 4) for e in errors]) == pytest.approx(4.0, rel=error)


def test_joint_nees_is_that_of_the_dense_covariance():
    """With the whole covariance of the poses, landmarks marginalised out by inverting everything."""
    motion, sensor = models(0.1)
    log = simulate(seed=5, steps=15, clean=True, motion=motion, sensor=sensor)
    for options in ({"edges": "landmark+motion"}, {"weight": "marginal"}):
        graph = Graph.from_log(log, motion=motion, sensor=sensor, **options)
        solution = solve(graph, initialize="auto")
        omega = graph.linearize(solution.state)[0].to_sparse().toarray()
        # the first pose is known: its rows and columns go, and then the others' covariance is a block of the inverse
        covariance = np.linalg.inv(omega[3:, 3:])[:45, :45]
        e = solution.poses - log.true_poses
        e[:, 2] = wrap(e[:, 2])
        expected = e[1:].ravel() @ np.linalg.solve(covariance, e[1:].ravel()) / 45
        assert solution.joint_nees(log.true_poses) == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
def test_exact_variants_are_consistent_and_pairs_are_not(outcome):
    of = {r.name: r for r in outcome.results}
    for name in ("landmark nodes", "marginal"):
        # J of 30 logs of 40 poses is a chi-square of 3,600 degrees of freedom; the noise is a tenth, so that all is linear
        low, high = chi_square_bounds(3600, 2)
        assert low < 3600 * of[name].anees < high, (of[name].anees, of[name].joint_band)
        # 95 % are expected; errors of steps are correlated, but the solver gives the same numbers on every machine
        assert of[name].steps_inside > 0.8
    # an approximation, which is 10 % off at most on these logs
    assert of["tempered"].anees == pytest.approx(1, abs=0.1)
    assert of["pairs"].anees > 3 and not of["pairs"].consistent
    assert all(r.failed == 0 for r in outcome.results)


def test_without_psi_the_weights_are_those_of_pairs_of_sightings() -> None:
    marginal, pairs = study_consistency(logs=2, dimensions=2, estimators=["marginal", "pairs"], jobs=0).results
    # J of 2 logs of 62 poses; a pair of sightings counts about 10 times
    low, high = chi_square_bounds(3 * 62 * 2, 2)
    assert low < 3 * 62 * 2 * marginal.anees < high
    assert pairs.anees > 3


def test_noise_scales_all_standard_deviations():
    motion, sensor = models(0.5)
    u, z = np.array([0.3, 0.2]), np.array([2.0, 0.1, 0.2])
    full = MotionModel().covariance(np.zeros(3), u, 2.0)
    np.testing.assert_allclose(motion.covariance(np.zeros(3), u, 2.0), full / 4)
    np.testing.assert_allclose(sensor.Q(z), SensorModel().Q(z) / 4)
    # the place of the sensor and its limits of sight are no noise
    assert [getattr(sensor, n) for n in SensorModel.GEOMETRY] == [
        getattr(SensorModel(), n) for n in SensorModel.GEOMETRY
    ]


def test_json(outcome):
    data = json.loads(json.dumps(outcome.to_json()))
    assert [row["name"] for row in data["estimators"]] == ["landmark nodes", "marginal", "tempered", "pairs"]
    assert len(data["estimators"][0]["anees_per_step"]) == 40
    expected = {"logs", "noise", "steps", "dimensions", "seed", "sightings_per_landmark", "estimators"}
    assert set(data) == expected


@pytest.mark.slow
def test_a_filter_and_another_process():
    alone, together = (
        study_consistency(logs=4, steps=12, estimators=["landmark nodes", "fastslam2"], jobs=jobs) for jobs in (0, 1)
    )
    for a, b in zip(alone.results, together.results):
        np.testing.assert_array_equal(a.per_step, b.per_step)
    assert alone.results[1].anees is None and alone.results[1].consistent is None


def test_failures_are_counted_and_left_out():
    per_step = np.ones((3, 5))
    per_step[1] = np.nan
    result = Consistency("x", per_step, np.array([1.0, np.nan, 1.2]))
    assert (result.logs, result.failed) == (2, 1)
    assert result.anees == pytest.approx(1.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"logs": 0}, "logs must be at least 1"),
        ({"noise": -1.0}, "noise must be at least"),
        ({"noise": float("nan")}, "noise must be a finite"),
        ({"noise": 1e-6}, "noise must be at least"),
        ({"noise": 1e300}, "noise must be at most"),
        ({"dimensions": 4}, "dimensions must be at most 3"),
        ({"estimators": ["kalman"]}, "estimators must be one of"),
        ({"estimators": []}, "estimators must be names, at least one"),
        ({"jobs": -1}, "jobs must be at least 0"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(OptionError, match=message):
        study_consistency(**options)


def test_the_smoother_has_its_options_and_counts_where_its_chains_mix():
    given = {
        "estimators": ["particle-gibbs"],
        "logs": 1,
        "steps": 8,
        "jobs": 0,
        "gibbs_chains": 2,
        "gibbs_particles": 10,
    }
    mixed = study_consistency(**given, gibbs_iterations=300, gibbs_warm_up=50).results[0]
    assert (mixed.logs, mixed.failed) == (1, 0) and np.isfinite(mixed.steps).all()
    study = study_consistency(**given, gibbs_iterations=4, gibbs_warm_up=0)
    (stuck,) = study.results
    assert (stuck.logs, stuck.failed, stuck.steps_inside) == (0, 1, None)
    assert "did not mix on 1 of 1 logs" in str(study) and "--gibbs-warm-up" in str(study)
    assert study.to_json()["estimators"][0]["step_band"] == [None, None]
    with pytest.raises(OptionError, match="gibbs_chains must be at least 1"):
        study_consistency(gibbs_chains=0)
