"""The study over numbers of particles: rows, bands and JSON."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from comparisons.studies.particles import study_particles
from graphslam import LogError, OptionError, simulate


def test_rows_bands_and_json() -> None:
    log, runs = simulate(seed=1, steps=20), []
    filters = ("mcl", "fastslam1", "fastslam2")
    outcome = study_particles(log, filters=filters, particles=(10, 100), seeds=3, jobs=0, progress=runs.append)
    assert runs == list(outcome.runs)
    assert len(outcome.runs) == 3 * 2 * 3
    assert [(row.name, row.particles) for row in outcome.quartiles] == [
        (name, n) for name in ("mcl", "fastslam1", "fastslam2") for n in (10, 100)
    ]
    numbers, quartiles = outcome.bands("fastslam1", "ate_m")
    np.testing.assert_array_equal(numbers, [10, 100])
    values = [run.ate_m for run in outcome.runs if run.name == "fastslam1" and run.particles == 100]
    np.testing.assert_allclose(quartiles[:, 1], np.percentile(values, (25, 50, 75)))
    assert outcome.quartiles[3].ate_m[1] == pytest.approx(np.median(values))
    assert all(0 < run.ess_share <= 1 and 1 <= run.ancestors <= run.particles for run in outcome.runs)
    # localisation makes no map
    assert outcome.quartiles[0].landmark_rmse_m is None
    payload = json.loads(json.dumps(outcome.to_json(), allow_nan=False))
    assert payload["log"] == log.name
    assert payload["bands"][2]["ate_m"] == pytest.approx(outcome.bands("fastslam1", "ate_m")[1][:, 0])
    assert payload["bands"][0]["landmark_rmse_m"] is None


@pytest.mark.slow
def test_processes_change_nothing_but_the_time() -> None:
    log = simulate(seed=1, steps=10)
    alone, together = (study_particles(log, particles=(10, 20), seeds=2, jobs=jobs) for jobs in (0, 1))
    assert [replace(run, seconds=0.0) for run in alone.runs] == [replace(run, seconds=0.0) for run in together.runs]


def test_without_truth_and_without_names() -> None:
    log = simulate(seed=1, steps=10, clean=True)
    blind = study_particles(log.replace(true_poses=None, true_landmarks=None), particles=(10,), seeds=1, jobs=0)
    assert [row.ate_m for row in blind.quartiles] == [None, None]
    options = {"filters": ("fastslam2",), "particles": (10,), "association": "maximum-likelihood"}
    unnamed = study_particles(log, seeds=1, jobs=0, **options)
    assert unnamed.runs[0].ate_m is not None
    assert 0 < unnamed.runs[0].landmark_rmse_m < 3


def test_bad_input() -> None:
    log = simulate(seed=1, steps=5)
    with pytest.raises(OptionError, match="filters must be one of mcl"):
        study_particles(log, filters=("graph",))
    with pytest.raises(OptionError, match="seeds must be at least 1"):
        study_particles(log, seeds=0)
    with pytest.raises(OptionError, match="particles must be whole numbers, at least one"):
        study_particles(log, particles=())
    poses_only = log.replace(dt=None, controls=None)
    with pytest.raises(LogError, match="no controls"):
        study_particles(poses_only, jobs=0)


@pytest.mark.nightly
def test_the_time_limit_ends_one_run_and_no_other():
    # a billion moves of particles do not fit into a second
    log = simulate(seed=1, steps=5000)
    study = study_particles(log, filters=["fastslam1"], particles=[1, 300_000], seeds=1, jobs=1, time_limit=1.0)
    assert [run.particles for run in study.runs] == [1]
    assert study.notes == (
        "fastslam1 with 300000 particles and seed 0 has no result: it was stopped at the time limit of 1 s",
    )
    assert study.to_json()["notes"] == list(study.notes)
