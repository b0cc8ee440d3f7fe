"""The study over numbers of particles: rows, bands and JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

from comparisons.show.tables import tables_of
from comparisons.studies.execute import DONE, TIMEOUT
from comparisons.studies.sweep import study_particles
from fastslam import FastSLAM1
from graphslam import MotionModel, OptionError, SensorModel, SlamError, simulate
from graphslam.metrics import ate


def test_rows_summary_figure_and_json() -> None:
    log, calls = simulate(seed=1, steps=20), []
    filters = ("mcl", "fastslam1", "fastslam2")
    outcome = study_particles(
        log, filters=filters, particles=(10, 100), seeds=3, jobs=0,
        progress=lambda done, planned, run, _: calls.append((done, planned, run.key)),
    )  # fmt: skip
    assert calls == [(k, 18, run["key"]) for k, run in enumerate(outcome.runs, start=1)]
    assert {name: list(lines) for name, lines in outcome.methods.items()} == {name: [10, 100] for name in filters}
    runs = [run for run in outcome.runs if run["method"] == "fastslam1 particles=100"]
    values = [run["ate_m"] for run in runs]
    found = outcome.methods["fastslam1"][100].figures["ate_m"]
    low, high = found.quartiles
    np.testing.assert_allclose([low, found.median, high], np.percentile(values, (25, 50, 75)))
    # one run by hand
    by_hand = FastSLAM1(log, particles=100, seed=2, motion=MotionModel(), sensor=SensorModel()).run()
    last, sighted = runs[2], np.unique(log.steps)
    assert last["ate_m"] == pytest.approx(ate(log.true_poses, by_hand.poses))
    assert last["mean_ate_m"] == pytest.approx(ate(log.true_poses, by_hand.mean_poses))
    assert last["ess_share"] == pytest.approx(by_hand.ess[sighted].mean() / 100)
    assert last["ancestors"] == by_hand.ancestors[10]
    # localisation makes no map
    assert outcome.methods["mcl"][10].figures["landmark_rmse_m"] is None
    payload = json.loads(json.dumps(outcome.to_json(), allow_nan=False))
    assert payload["log"] == log.name
    shown = payload["summary"]["methods"][3]
    assert (shown["method"], shown["figures"]["ate_m"]["median"]) == ("fastslam1 particles=100", found.median)
    assert shown["figures"]["ate_m"]["quartiles"] == [low, high]
    # the figure has a line of each filter between bands of quartiles
    first, _, of_maps = outcome.figure().axes[:3]
    lines = {line.get_label(): line for line in first.lines}
    np.testing.assert_array_equal(lines["fastslam1"].get_xdata(), [10, 100])
    assert lines["fastslam1"].get_ydata()[1] == found.median
    edges = first.collections[filters.index("fastslam1")].get_paths()[0].vertices
    assert {low, high} <= set(edges[edges[:, 0] == 100, 1])
    assert [line.get_label() for line in of_maps.lines] == ["fastslam1", "fastslam2"]


@pytest.mark.slow
def test_processes_change_nothing_but_the_time() -> None:
    log = simulate(seed=1, steps=10)
    alone, together = (study_particles(log, particles=(10, 20), seeds=2, jobs=jobs) for jobs in (0, 1))
    moment = dict.fromkeys(("seconds", "total_seconds", "process", "ended"))
    assert [run | moment for run in alone.runs] == [run | moment for run in together.runs]


def test_without_truth_and_without_names() -> None:
    log = simulate(seed=1, steps=10, clean=True)
    blind = study_particles(log.replace(true_poses=None, true_landmarks=None), particles=(10,), seeds=1, jobs=0)
    assert [(run["ate_m"], run["mean_ate_m"]) for run in blind.runs] == [(None, None)] * 2
    options = {"filters": ("fastslam2",), "particles": (10,), "association": "maximum-likelihood"}
    unnamed = study_particles(log, seeds=1, jobs=0, **options)
    assert unnamed.runs[0]["ate_m"] is not None
    assert 0 < unnamed.runs[0]["landmark_rmse_m"] < 3


def test_bad_input() -> None:
    log = simulate(seed=1, steps=5)
    with pytest.raises(OptionError, match="filters must be one of mcl"):
        study_particles(log, filters=("graph",))
    with pytest.raises(OptionError, match="seeds must be at least 1"):
        study_particles(log, seeds=0)
    with pytest.raises(OptionError, match="particles must be whole numbers, at least one"):
        study_particles(log, particles=())
    poses_only = log.replace(dt=None, controls=None)
    with pytest.raises(SlamError, match="no run has a result: .*no controls"):
        study_particles(poses_only, jobs=0)


@pytest.mark.nightly
def test_the_time_limit_ends_one_run_and_no_other():
    # a billion moves of particles do not fit into six seconds, and five thousand do on a busy machine, too
    log = simulate(seed=1, steps=5000)
    study = study_particles(log, filters=["fastslam1"], particles=[1, 300_000], seeds=1, jobs=1, time_limit=6.0)
    assert [(run["options"]["particles"], run["status"]) for run in study.runs] == [(1, DONE), (300_000, TIMEOUT)]
    late = "fastslam1 particles=300000 with the random seed 0 has no result: it was stopped at the time limit of 6 s."
    assert tables_of(study)[1] == [late]
    assert study.to_json()["summary"]["errors"] == {"it was stopped at the time limit of 6 s": 1}
