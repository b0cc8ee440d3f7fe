"""The command line from outside: results, notes, and what is left on disk."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import graphslam.log
from comparisons.cli import app
from comparisons.studies import solvers
from graphslam import Log, load, save, simulate

QUICK = ["--estimators", "dead-reckoning,graph"]

Invoke = Callable[..., Result]


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


@pytest.mark.slow
def test_run_leaves_a_figure_and_json(log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["run", str(log_file), "--particles", "50"])
    assert result.exit_code == 0, result.output
    (folder,) = (p for p in (tmp_path / "results").iterdir() if not p.is_symlink())
    names = ["comparison.json", "comparison.pdf", "comparison.png", "config.toml"]
    written = sorted(p.name for p in folder.iterdir())
    assert [name for name in written if not name.endswith((".tum", ".csv", ".npz"))] == [*names, "graph.g2o"]
    assert {"truth.tum", "graph.tum", "graph-map.csv", "graph-map.npz", "gtsam.tum"} < set(written)
    assert (tmp_path / "results" / "latest").resolve() == folder.resolve()
    for word in (
        *names,
        folder.name,
        "slam-compare report",
        "ATE",
        "[rad]",
        "graph and gtsam differ by at most",
    ):
        assert word in result.stdout
    payload = json.loads((folder / "comparison.json").read_text())
    assert [entry["name"] for entry in payload["estimators"]][2] == "graph"
    assert (tmp_path / payload["files"]["figure"]).exists()


def test_json_on_standard_output_stands_alone(invoke: Invoke, log_file: Path) -> None:
    result = invoke("run", log_file, *QUICK, "--out", "here", "--json", "-")
    payload = json.loads(result.stdout)
    assert payload["files"]["json"] == str(Path("here/comparison.json"))
    assert "ATE" in result.stderr


def test_options_reach_the_estimators(invoke: Invoke, log_file: Path) -> None:
    options = (
        "--initialize given --frame world --weight tempered --motion-weight 3 --edges virtual+motion --kernel cauchy"
    )
    of_filter = "--estimators graph,fastslam1 --particles 20 --seed 5 --json -"
    result = invoke("run", log_file, *of_filter.split(), *options.split())
    graph, fastslam = json.loads(result.stdout)["estimators"]
    expected = {"edges": "virtual+motion", "frame": "world", "weight": "tempered", "motion_weight": 3.0}
    assert graph["options"] == expected | {
        "initialize": "given", "kernel": "cauchy", "residual": "cartesian", "estimate": None, "range_noise": "measured",
    }  # fmt: skip
    expected = {"particles": 20, "seed": 5, "resampling": "systematic", "association": "known"}
    assert fastslam["options"].items() >= expected.items()
    noisy = json.loads(invoke("run", log_file, *QUICK, "--range-rate", "0.5", "--json", "-").stdout)["estimators"][1]
    assert noisy["cost"] != pytest.approx(graph["cost"])


def test_one_that_cannot_run_is_a_row(invoke: Invoke, log: Log, tmp_path: Path) -> None:
    save(log.replace(true_landmarks=None), tmp_path / "log.npz")
    result = invoke("run", "log.npz", "--particles", 20, "--out", "here")
    assert result.exit_code == 0
    assert "mcl left out" in result.stdout
    named = invoke("run", "log.npz", "--estimators", "graph,mcl", "--json", "-", "--out", "there")
    assert named.exit_code == 0
    graph, mcl = json.loads(named.stdout)["estimators"]
    assert graph["converged"]
    assert "below the tolerance" in graph["reason"]
    assert "map" in mcl["reason"]
    alone = invoke("run", "log.npz", "--estimators", "mcl")
    assert alone.exit_code == 2
    assert "map" in alone.stderr
    # without ids, too
    unnamed = np.full(len(log.steps), graphslam.log.UNIDENTIFIED)
    save(log.replace(landmarks=unnamed), tmp_path / "unnamed.npz")
    result = invoke("run", "unnamed.npz", "--estimators", "dead-reckoning,mcl")
    assert result.exit_code == 0
    assert "mcl left out" in result.stdout


def test_the_sample_log_is_the_default(invoke: Invoke) -> None:
    result = invoke("run", *QUICK)
    assert result.exit_code == 0
    assert "sample: " in result.stdout
    assert "slam-compare report report.html" in result.stdout


def test_a_figure_and_a_page_that_fail_are_notes(
    invoke: Invoke, log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("plotly", reason="needs the extra 'report'")

    def breaks(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("comparisons.comparison.Comparison.figure", breaks)
    monkeypatch.setattr("comparisons.show.report.page_of", breaks)
    result = invoke(
        "run", log_file, *QUICK, "--out", "here", "--html", "page.html", "--json", "out.json", "--figures", "png"
    )
    assert result.exit_code == 0
    assert "There is no figure: ZeroDivisionError." in result.stdout
    expected = ["there is no figure: ZeroDivisionError", "there is no interactive report: ZeroDivisionError"]
    assert json.loads((tmp_path / "out.json").read_text())["notes"] == expected
    assert not (tmp_path / "page.html").exists()


def test_nothing_is_left_behind_when_a_run_breaks(
    invoke: Invoke, log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("comparisons.comparison.write_json", breaks)
    result = invoke("run", log_file, *QUICK, "--out", "here", "--figures", "svg")
    assert isinstance(result.exception, ZeroDivisionError)
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def test_an_interrupted_run_says_so(invoke: Invoke, log_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("comparisons.comparison.compare", interrupted)
    result = invoke("run", log_file)
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


def test_an_interrupt_within_an_import_is_an_interrupt(
    invoke: Invoke, log_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half_imported(*_: object, **__: object) -> None:
        # so does a module of pybind11, such as gtsam, that is interrupted while it loads
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr("comparisons.comparison.compare", half_imported)
    result = invoke("run", log_file)
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


# -- solvers -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def short_file(log: Log, tmp_path: Path) -> Path:
    """The first half of the log: some 50 graphs are solved twice."""
    save(log.at_steps(np.arange(13)), tmp_path / "log.npz")
    return tmp_path / "log.npz"


@pytest.mark.slow
def test_solvers_agree(invoke: Invoke, short_file: Path) -> None:
    result = invoke("solvers", short_file, "--motion-weights", "1", "--jobs", 0, "--json", "a.json")
    assert result.exit_code == 0, result.output
    assert "agree in all" in result.stdout
    # each variant when it is done, with the times, of which GTSAM's is the longer one
    assert re.search(r"virtual\+motion body pairs 3-D lambda=1: graphslam \S+ s, gtsam \S+ s", result.stderr)
    assert {"variants", "skipped"} == set(json.loads(Path("a.json").read_text()))


@pytest.mark.slow
def test_only_the_graphs_that_are_named(invoke: Invoke, short_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = ["solvers", short_file, "--motion-weights", "2", "--jobs", 0]
    unknown = invoke(*command, "--edges", "virtual,some")
    assert unknown.exit_code == 2
    assert "some" in unknown.stderr and "virtual+motion" in unknown.stderr
    # solvers that differ exit with one
    sloppy = solvers.solve
    monkeypatch.setattr(solvers, "solve", lambda graph, **_: sloppy(graph, tolerance=1e-3))
    result = invoke(*command, "--edges", "virtual+motion", "--json", "-")
    assert result.exit_code == 1
    assert "DIFFERENT" in result.stderr
    variants = json.loads(result.stdout)["variants"]
    assert {entry["name"].split()[0] for entry in variants} == {"virtual+motion"}
    assert not all(entry["agree"] for entry in variants)


# -- what all verbs understand ---------------------------------------------------------------------------------------


def test_help_shows_examples_and_units(invoke: Invoke) -> None:
    assert all(verb in invoke("--help").stdout for verb in ("run", "solvers", "simulate"))
    for verb in ("run", "solvers", "simulate"):
        text = invoke(verb, "--help").stdout
        assert f"slam-compare {verb}" in text
        assert "Examples" in text
        assert "[rad]" in text


def test_version(invoke: Invoke) -> None:
    result = invoke("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("slam-compare")


def test_quiet_leaves_the_result_alone(invoke: Invoke, log_file: Path) -> None:
    said = invoke("run", log_file, *QUICK, "--out", "here")
    quiet = invoke("run", log_file, *QUICK, "--out", "here", "--quiet")
    assert "ATE" in quiet.stdout
    for hint in ("Repeat this run:", "Wrote", "Animation:"):
        assert hint in said.stdout
        assert hint not in quiet.stdout
    # nothing is left of it in the next run
    assert "Repeat this run:" in invoke("run", log_file, *QUICK, "--out", "here").stdout


def test_verbose_tells_each_step_and_where_errors_arise(invoke: Invoke, log_file: Path) -> None:
    assert "step norm" in invoke("run", log_file, "-v", "--estimators", "graph", "--out", "here").stderr
    assert "Traceback" in invoke("run", "nowhere", "-v").stderr
    assert "Traceback" not in invoke("run", "nowhere").stderr


@pytest.mark.slow
def test_every_verb_is_quiet_and_verbose_on_demand(invoke: Invoke) -> None:

    for command in app.registered_commands:
        assert command.callback is not None
        text = invoke(command.name or command.callback.__name__, "--help").stdout
        assert "--quiet" in text
        assert "--verbose" in text


def test_associate_writes_the_log_with_ids(invoke: Invoke, log_file: Path) -> None:
    refused = invoke("associate", log_file, "named.npz")
    assert refused.exit_code == 2 and "all sightings have ids" in refused.stderr
    result = invoke(
        "associate", log_file, "named.npz", "--association", "maximum-likelihood", "--front-end", "batch", "--json", "-"
    )
    found = json.loads(result.stdout)["estimators"][0]["association"]
    named = load("named.npz")
    assert named.identified and len(np.unique(named.landmarks)) == found["landmarks"]
    assert found["precision"] > 0.95 and "Next: slam-compare run named.npz" in result.stderr
