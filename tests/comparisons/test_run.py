from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.special import chdtri

from comparisons import estimators
from comparisons.comparison import Comparison, run
from comparisons.estimators import Estimator
from comparisons.estimators.attempt import Skipped
from comparisons.estimators.config import read_config
from comparisons.options import RunOptions
from comparisons.results import EstimatorResult
from comparisons.results.results import CHI_SQUARE_MEDIANS
from comparisons.show.report import page_of
from comparisons.show.tables import as_text
from graphslam import FormatError, GraphError, Log, OptionError, SensorModel, SlamError, simulate
from graphslam.metrics import ate
from graphslam.se2 import wrap

# the keys of an estimator's entry that DESIGN section 4 promises
PROMISED = {"name", "converged", "iterations", "step_norms", "cost", "seconds", "ate_m", "rpe_m", "rpe_rad"}
PROMISED |= {"landmark_rmse_m", "poses", "landmarks"}


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


@pytest.fixture(scope="module")
def comparison(log: Log) -> Comparison:
    return run(log, particles=50)


def made_up(name: str, poses: np.ndarray, **rest: object) -> EstimatorResult:
    return EstimatorResult(name=name, poses=poses, estimated=np.ones(len(poses), bool), seconds=0.1, **rest)  # type: ignore[arg-type]


def registered(monkeypatch: pytest.MonkeyPatch, name: str, function: object, **rest: object) -> None:
    monkeypatch.setitem(estimators.ESTIMATORS, name, Estimator(function, **rest))  # type: ignore[arg-type]


def test_all_estimators_run_on_a_full_log(comparison: Comparison, log: Log) -> None:
    assert [r.name for r in comparison.results] == list(estimators.default_estimators())
    assert comparison.skipped == ()
    rows = {row.name: row for row in comparison.table}
    assert rows["graph"].ate_m == ate(log.true_poses, comparison["graph"].poses)  # type: ignore[arg-type]
    assert rows["mcl"].landmark_rmse_m is None
    assert rows["graph"].landmark_rmse_m is not None
    assert comparison.difference() < 1e-6  # type: ignore[operator]


def test_the_table_says_whether_the_noise_fits(log: Log) -> None:
    few = ["dead-reckoning", "graph"]
    plain = run(log, estimators=few)
    assert plain.noise_source == {"motion": "book", "sensor": "book"}
    text = as_text(plain)
    assert "Noise models: the book's." in text
    assert "J per dof (degree of freedom): about 1 means that the noise models fit.\n" in text
    expected = plain["graph"].expected_ate_m
    assert (
        expected is not None
        and f"Expected ATE, from the covariances, if the noise models are right: graph {expected:.3f} m.\n" in text
    )
    assert [each["expected_ate_m"] for each in plain.to_json()["estimators"]] == [None, expected]
    # a tenth of the true noise of the sensor
    small = run(log, estimators=few, range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
    ratio = small.table["graph"].cost_per_dof
    assert ratio is not None and ratio > 10
    assert small.table["dead-reckoning"].cost_per_dof is None
    text = as_text(small)
    assert "Noise models: motion the book's, sensor as given." in text
    assert f"graph has {ratio:.1f}: the noise models assume less noise than there is, or sightings are wrong." in text
    large = run(log.replace(sensor=SensorModel(range_rate=1.4, bearing_std=0.5, orientation_std=0.5)), estimators=few)
    assert large.noise_source["sensor"] == "log"
    assert "the noise models assume more noise than there is" in as_text(large)
    payload = small.to_json()
    assert payload["noise"]["motion"]["source"] == "book"
    assert payload["noise"]["sensor"]["model"]["range_rate"] == 0.014
    assert payload["estimators"][1]["cost_per_dof"] == ratio


def test_medians_of_chi_square() -> None:
    assert {d: chdtri(d, 0.5) for d in CHI_SQUARE_MEDIANS} == pytest.approx(CHI_SQUARE_MEDIANS, rel=1e-14)


def test_json_is_what_the_design_says(comparison: Comparison, log: Log) -> None:
    payload = json.loads(json.dumps(comparison.to_json({"figure": Path("f.png")}), allow_nan=False))
    assert set(payload) == {
        "log",
        "noise",
        "robot",
        "sessions",
        "map_states",
        "estimators",
        "files",
        "notes",
        "warnings",
    }
    assert payload["files"] == {"figure": "f.png"}
    assert payload["log"]["poses"] == log.num_poses
    for entry, result in zip(payload["estimators"], comparison.results):
        assert entry.keys() >= PROMISED
        np.testing.assert_array_equal(entry["poses"], result.poses)
        assert {int(j) for j in entry["landmarks"]} == set(result.landmarks)
        assert isinstance(entry["ate_m"], float)


def test_without_truth_the_errors_are_null(log: Log) -> None:
    bare = run(log.replace(true_poses=None, true_landmarks=None), estimators=["graph"])
    (entry,) = bare.to_json()["estimators"]
    assert [entry[k] for k in ("ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m", "landmark_errors_m")] == [None] * 5
    assert entry["converged"] is True


def test_without_true_poses_the_map_still_has_its_errors(log: Log) -> None:
    bare = run(log.replace(true_poses=None), estimators=["graph"])
    (entry,) = bare.to_json()["estimators"]
    assert entry["ate_m"] is None and entry["aligned_by"] == "landmarks"
    errors = np.array(list(entry["landmark_errors_m"].values()))
    assert set(entry["landmark_errors_m"]) == set(entry["landmarks"])
    assert entry["landmark_rmse_m"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert "aligned to the true landmarks" in str(bare)
    assert bare.figure().axes[0].get_title(loc="left").endswith("aligned to the true landmarks")
    assert "aligned to the true landmarks" in page_of(bare)
    assert "Error of each landmark" in page_of(bare)


def test_poses_outside_the_graph_do_not_count(log: Log) -> None:
    outcome = run(log, estimators=["graph"], edges="virtual")
    estimated = outcome["graph"].estimated
    assert not estimated.all()
    assert outcome.metrics["graph"].ate_m == ate(log.true_poses, outcome["graph"].poses, mask=estimated)  # type: ignore[arg-type]


def test_those_that_cannot_run_are_rows_with_their_reason(log: Log) -> None:
    outcome = run(log.replace(true_landmarks=None), particles=50)
    assert [entry.name for entry in outcome.skipped] == ["mcl"]
    row = next(row for row in outcome.table if row.name == "mcl")
    assert "map" in str(row.skipped)
    assert [row.name for row in outcome.table] == list(estimators.default_estimators())
    entry = next(e for e in outcome.to_json()["estimators"] if e["name"] == "mcl")
    assert entry.keys() >= PROMISED
    assert entry["poses"] is None
    assert "map" in entry["reason"]


def test_those_that_were_named_and_cannot_run_are_rows(log: Log) -> None:
    outcome = run(log.replace(true_landmarks=None), estimators=["graph", "mcl"])
    assert "graph" in outcome and "map" in {entry.name: entry.reason for entry in outcome.skipped}["mcl"]
    with pytest.raises(OptionError, match="map"):
        run(log.replace(true_landmarks=None), estimators=["mcl"])


def test_without_the_graph_there_is_no_comparison(log: Log) -> None:
    with pytest.raises(GraphError, match="one landmark"):
        run(log.without_orientation(), edges="virtual", estimators=["graph"])
    nothing = log.replace(steps=[], landmarks=[], sightings=np.empty((0, 3)))
    with pytest.raises(GraphError, match="no sightings"):
        run(nothing, estimators=["dead-reckoning"])


def test_slow_ones_run_only_when_named(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    registered(
        monkeypatch, "slow", lambda log, _: made_up("slow", log.initial_poses), seconds_per_iteration=lambda *_: 9.0
    )
    outcome = run(log, particles=50)
    assert outcome.skipped == (Skipped("slow", outcome.skipped[0].reason),)
    assert "9 s" in outcome.skipped[0].reason
    assert "slow" in run(log, estimators=["slow"])


def test_names_are_checked(log: Log) -> None:
    with pytest.raises(OptionError, match="no estimator 'graf'.*graph"):
        run(log, estimators=["graph", "graf"])
    with pytest.raises(OptionError, match="at least one"):
        run(log, estimators=[])
    assert [r.name for r in run(log, estimators=["graph", "dead-reckoning", "graph"]).results] == [
        "graph",
        "dead-reckoning",
    ]


def test_warnings_become_notes(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def loud(log: Log, _: RunOptions) -> EstimatorResult:
        warnings.warn("step 3: impossible", RuntimeWarning, stacklevel=1)
        warnings.warn("step 3: impossible", RuntimeWarning, stacklevel=1)
        return made_up("loud", log.initial_poses, notes=("mine",))

    registered(monkeypatch, "loud", loud)
    assert run(log, estimators=["loud"])["loud"].notes == ("mine", "step 3: impossible")


def test_warnings_for_programmers_stay_warnings(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def old(log: Log, _: RunOptions) -> EstimatorResult:
        warnings.warn("this will go away", DeprecationWarning, stacklevel=1)
        return made_up("old", log.initial_poses)

    registered(monkeypatch, "old", old)
    with pytest.warns(DeprecationWarning, match="go away"):
        assert run(log, estimators=["old"])["old"].notes == ()


def test_an_estimator_that_fails_is_a_row_and_the_others_go_on(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(log: Log, _: RunOptions) -> EstimatorResult:
        raise np.linalg.LinAlgError("Singular matrix")

    registered(monkeypatch, "broken", broken)
    outcome = run(log, estimators=["broken", "graph"])
    assert outcome.table["broken"].skipped == "LinAlgError: Singular matrix"
    assert "broken failed: LinAlgError: Singular matrix." in as_text(outcome)
    entry = next(entry for entry in outcome.to_json()["estimators"] if entry["name"] == "broken")
    assert entry["reason"] == "LinAlgError: Singular matrix"
    with pytest.raises(SlamError, match="broken failed: LinAlgError: Singular matrix") as caught:
        run(log, estimators=["broken"])
    assert isinstance(caught.value.__cause__, np.linalg.LinAlgError)


def test_a_graph_that_fails_is_a_row_where_others_have_results(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("comparisons.estimators.make_graph", singular)
    outcome = run(log, estimators=["dead-reckoning", "graph"])
    assert outcome.table["graph"].skipped == "LinAlgError: Singular matrix"


@pytest.mark.slow
def test_the_time_limit_ends_one_estimator_and_no_other(tmp_path: Path) -> None:
    # a billion moves of particles do not fit into a second
    limited = run(
        simulate(seed=1, steps=5000), estimators=["fastslam1", "dead-reckoning"], particles=300_000, time_limit=1.0
    )
    reason = "it was stopped at the time limit of 1 s"
    assert limited.table["fastslam1"].skipped == reason
    assert f"fastslam1 left out: {reason}." in as_text(limited)
    assert limited.table["dead-reckoning"].ate_m is not None
    (entry,) = [entry for entry in limited.to_json()["estimators"] if entry["name"] == "fastslam1"]
    assert entry["reason"] == reason
    # a repeated run has the same limit
    assert read_config(limited.save(tmp_path, figures=())["config"])["time_limit"] == 1.0


@pytest.mark.nightly
def test_with_a_time_limit_the_numbers_are_the_same(log: Log) -> None:
    names = ["textbook", "graph", "isam2", "fastslam2"]
    limited, here = (run(log, estimators=names, particles=50, time_limit=limit) for limit in (600.0, None))
    for name in names:
        np.testing.assert_array_equal(limited[name].poses, here[name].poses)
        np.testing.assert_array_equal(limited[name].landmarks[0], here[name].landmarks[0])
    assert limited.nees == here.nees
    assert [row.cost_per_dof for row in limited.table] == [row.cost_per_dof for row in here.table]
    with pytest.raises(OptionError, match="time_limit must be a positive number"):
        run(log, time_limit=0.0)


@pytest.mark.slow
def test_errors_come_back_from_the_process_of_a_time_limit(log: Log) -> None:
    with pytest.raises(OptionError, match="true map"):
        run(log.replace(true_landmarks=None), estimators=["mcl"], time_limit=60.0)


def test_covariances_that_fail_are_a_note(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("graphslam.solvers.solution.Uncertainty", singular)
    outcome = run(log, estimators=["dead-reckoning", "graph"], edges="landmark+motion")
    assert outcome.metrics["graph"].ate_m is not None
    assert outcome["graph"].landmark_covariances == {}
    assert outcome.nees["graph"] is None
    entry = outcome.to_json()["estimators"][1]
    assert [note for note in entry["notes"] if "covariances" in note] == [
        "the covariances of the map are not known: LinAlgError: Singular matrix",
        "the covariances are not known: LinAlgError: Singular matrix",
    ]


def test_a_map_that_fails_is_a_note(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("graphslam.estimate_map", fails)
    outcome = run(log, estimators=["dead-reckoning"])
    assert outcome["dead-reckoning"].landmarks == {}
    assert outcome["dead-reckoning"].notes == ("the map is not known: LinAlgError: Singular matrix",)


def test_progress_tells_of_begin_and_end(log: Log) -> None:
    calls: list[tuple[str, bool]] = []
    run(
        log,
        estimators=["dead-reckoning", "graph"],
        progress=lambda name, outcome: calls.append((name, outcome is None)),
    )
    assert calls == [("dead-reckoning", True), ("dead-reckoning", False), ("graph", True), ("graph", False)]


def test_difference_is_wrapped_and_masked(log: Log) -> None:
    a = np.zeros((3, 3))
    b = np.array([[0.0, 0, 0], [0.25, 0, 2 * np.pi - 0.5], [99, 0, 0]])
    both = np.array([True, True, False])
    first = EstimatorResult(name="graph", poses=a, estimated=np.ones(3, bool), seconds=0)
    second = EstimatorResult(name="gtsam", poses=b, estimated=both, seconds=0)
    outcome = Comparison(log, (first, second))
    assert outcome.difference() == pytest.approx(abs(float(wrap(0.5))))
    assert outcome.difference("graph", "mcl") is None
    with pytest.raises(KeyError):
        outcome["mcl"]


@pytest.mark.slow
def test_save_writes_figure_and_json(comparison: Comparison, tmp_path: Path) -> None:
    files = comparison.save(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(p.name for p in files.values())
    assert files["figure"].read_bytes().startswith(b"\x89PNG")
    assert files["figure_pdf"].read_bytes().startswith(b"%PDF")
    assert json.loads(files["json"].read_text())["files"]["figure"] == str(files["figure"])


def test_save_makes_a_folder_of_its_own(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = comparison.save(figures=())["json"].parent
    assert folder.parent == Path("results")
    assert Path("results/latest").resolve() == folder.resolve()


def test_a_figure_that_fails_is_a_note(comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ValueError("an axis is infinite")

    monkeypatch.setattr("comparisons.comparison.Comparison.save_figure", fails)
    files = comparison.save(tmp_path / "out")
    assert "figure" not in files
    assert {"json", "config", "graph.tum", "graph.g2o"} <= files.keys()
    expected = ["there is no figure: ValueError: an axis is infinite"]
    assert json.loads(files["json"].read_text())["notes"] == files.notes == expected


def test_an_export_that_fails_is_a_note(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> str:
        raise ValueError("too large")

    monkeypatch.setattr("comparisons.results.files.relative_graph", fails)
    monkeypatch.setattr("comparisons.results.files.map_text", fails)
    files = comparison.save(tmp_path / "out", figures=())
    assert "graph.tum" in files
    assert "there is no graph.g2o: ValueError: too large" in files.notes
    assert "there is no graph-map.csv: ValueError: too large" in files.notes
    assert {path.name for path in (tmp_path / "out").iterdir()} == {path.name for path in files.values()}


def test_nothing_is_left_where_the_folder_cannot_be_written(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise FormatError("comparison.png", None, "cannot be written: disk full")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("comparisons.comparison.Comparison.save_figure", fails)
    for directory in (None, tmp_path / "out"):
        with pytest.raises(FormatError):
            comparison.save(directory)
    assert [p.name for p in tmp_path.iterdir()] == ["results"]
    assert list((tmp_path / "results").iterdir()) == []
