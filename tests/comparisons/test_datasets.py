"""The verb ``datasets``, and logs of data sets on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner, Result

from comparisons.cli import app
from comparisons.datasets import DATA_SETS, survey

Invoke = Callable[..., Result]


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Invoke:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAM_DATA", str(tmp_path / "data"))
    return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """One of MR.CLAM's folders with two robots, one of Huang's, a pose graph, and things that are nothing."""
    folder = tmp_path / "data"
    park = folder / "deep" / "arena"
    park.mkdir(parents=True)
    (park / "Barcodes.dat").write_text("6 63\n7 25\n")
    times = np.arange(0, 10, 0.1)
    for robot in (1, 3):
        (park / f"Robot{robot}_Odometry.dat").write_text("".join(f"{t:.3f} 0.5 0.1\n" for t in times))
        (park / f"Robot{robot}_Measurement.dat").write_text(
            "".join(
                f"{t:.3f} {code} {2 + 0.01 * t:.3f} {b:.3f}\n" for t in times[3::7] for code, b in ((63, 0.3), (25, 1))
            )
        )
        (park / f"Robot{robot}_Groundtruth.dat").write_text("".join(f"{t:.3f} {t} 0 0\n" for t in times[:50]))
    huang = folder / "huang"
    huang.mkdir()
    savemat(huang / "store_speed.mat", {"store_speed": np.ones((1, 2))})
    (folder / "graph.g2o").write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    (folder / "notes.txt").write_text("nothing of the kind\n")
    return folder


def test_a_survey_counts_what_it_finds(data: Path) -> None:
    outcome = survey(data)
    one, three = outcome.found["mrclam"]
    assert (one.robot, three.robot) == (1, 3)
    assert (one.poses, one.sightings, one.landmarks) == (14, 28, 2)
    assert one.poses_covered == 7
    assert one.seconds == pytest.approx(9.1)
    (graph,) = outcome.found["pose-graphs"]
    assert (graph.poses, graph.sightings) == (2, 1)
    assert outcome.found["lost-in-the-woods"] == ()
    # a folder that cannot be read is said to be so, with what is missing
    (problem,) = outcome.problems
    assert "store_turnrate.mat: this file of the data set is missing" in problem


def test_the_verb_lists_checks_and_exits_with_one_where_something_is_broken(invoke: Invoke, data: Path) -> None:
    result = invoke("datasets", "--json", "sets.json")
    assert result.exit_code == 1
    for known in DATA_SETS:
        assert known.name in result.output and known.source in result.output and known.terms in result.output
    assert "CANNOT BE READ" in result.output
    written = json.loads(Path("sets.json").read_text())
    assert {entry["name"] for entry in written["sets"]} == {known.name for known in DATA_SETS}
    assert written["exists"] is True
    (data / "huang" / "store_speed.mat").unlink()
    assert invoke("datasets").exit_code == 0


def test_nothing_at_hand_is_no_error(invoke: Invoke) -> None:
    result = invoke("datasets", "--json", "-")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["exists"] is False
    assert invoke("datasets", "--folder", "nowhere").exit_code == 2


NOISE = ["--sigma-v", "0.1", "--sigma-omega", "0.2", "--range-std", "0.1"]


def test_a_robot_of_a_folder_is_run(invoke: Invoke, data: Path) -> None:
    arguments = ["run", data / "deep" / "arena", "--estimators", "dead-reckoning,graph", *NOISE, "--json", "-"]
    assert "say which" in invoke(*arguments).stderr
    result = invoke(*arguments, "--robot", 3)
    assert result.exit_code == 0, result.output
    written = json.loads(result.stdout)
    assert (written["log"]["poses"], written["log"]["controls"], written["log"]["poses_covered"]) == (14, 91, 7)
    # figures are of the poses that the truth covers, and say so; the truth is null where it does not
    assert written["estimators"][0]["poses_counted"] == 7
    assert written["log"]["true_poses"][13] == [None, None, None]
    assert "7 of 14 poses that the truth covers" in result.stderr


def test_logs_are_thinned_and_cut_by_options(invoke: Invoke, data: Path) -> None:
    arguments = ["run", data / "deep" / "arena", "--robot", 1, "--estimators", "graph", *NOISE, "--json", "-"]

    def log(*more: object) -> dict:
        result = invoke(*arguments, *more)
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)["log"]

    assert log("--stride", 2)["poses"] == 7
    assert log("--keep-every", 0.35)["poses"] == 27
    assert log("--max-range", 2.05)["sightings"] == 14
    assert log("--sensor-offset", "0.1,0")["poses"] == 14
    assert "--sensor-offset" in invoke(*arguments, "--sensor-offset", "0.1").stderr


def test_truth_that_tells_positions_only_gives_no_rpe() -> None:
    from graphslam.metrics import evaluate

    truth = np.column_stack([np.arange(5.0), np.arange(5.0) ** 2, np.full(5, np.nan)])
    truth[2] = np.nan
    poses = np.nan_to_num(truth)
    figures = evaluate(truth, None, poses, {})
    assert (figures.rpe_m, figures.poses_counted) == (None, 4)
    assert figures.ate_m == pytest.approx(0.0, abs=1e-12)
