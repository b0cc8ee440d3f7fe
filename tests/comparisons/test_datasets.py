"""The survey of data sets, and runs on logs of data sets with their reading options."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import comparisons
from comparisons.datasets import DATA_SETS, survey
from graphslam import LogError, OptionError
from graphslam.metrics import evaluate

#: the noise of the folder of the fixture `data`
NOISE = {"sigma_v": 0.1, "sigma_omega": 0.2, "range_std": 0.1}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder of MR.CLAM with two robots, one of Huang's, a pose graph, and a text file of another kind."""
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
    (folder / "notes.txt").write_text("an ordinary text\n")
    return folder


def test_a_survey_counts_what_it_finds(data: Path) -> None:
    paths: list[Path] = []
    outcome = survey(str(data), progress=paths.append)
    assert [path.name for path in paths] == ["arena", "graph.g2o", "huang"]
    one, three = outcome.found["mrclam"]
    assert (one.robot, three.robot) == (1, 3)
    assert (one.poses, one.sightings, one.landmarks) == (14, 28, 2)
    assert one.poses_covered == 7
    assert one.seconds == pytest.approx(9.1)
    (graph,) = outcome.found["pose-graphs"]
    assert (graph.poses, graph.sightings) == (2, 1)
    assert outcome.found["lost-in-the-woods"] == ()
    # of a folder that cannot be read the message names what is missing
    (problem,) = outcome.problems
    assert "store_turnrate.mat: this file of the data set is missing" in problem


def test_the_survey_as_json(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAM_DATA", str(data))
    written = json.loads(json.dumps(survey().to_json(), allow_nan=False))
    assert (written["folder"], written["exists"]) == (str(data), True)
    assert [entry["name"] for entry in written["sets"]] == [known.name for known in DATA_SETS]
    assert [entry["robot"] for entry in written["sets"][0]["found"]] == [1, 3]
    (data / "huang" / "store_speed.mat").unlink()
    assert survey().problems == ()
    assert survey(tmp_path / "nowhere").to_json()["exists"] is False


def run(data: Path, **options: Any) -> comparisons.Comparison:
    return comparisons.run(data / "deep" / "arena", **{"estimators": ["graph"], **NOISE, **options})


def test_a_robot_of_a_folder_is_run(data: Path) -> None:
    with pytest.raises((LogError, OptionError), match="robot"):
        run(data)
    outcome = run(data, robot=3, estimators=["dead-reckoning", "graph"])
    written = json.loads(json.dumps(outcome.to_json(), allow_nan=False))
    assert (written["log"]["poses"], written["log"]["controls"], written["log"]["poses_covered"]) == (14, 91, 7)
    # figures count the poses that the ground truth covers; where it does not, it is null
    assert written["estimators"][0]["poses_counted"] == 7
    assert written["log"]["true_poses"][13] == [None, None, None]


def test_reading_options_select_poses_and_sightings(data: Path) -> None:
    assert run(data, robot=1, stride=2).log.num_poses == 7
    assert run(data, robot=1, keep_every=0.35).log.num_poses == 27
    assert len(run(data, robot=1, max_range=2.05).log.steps) == 14
    assert run(data, robot=1, sensor_offset=(0.1, 0.0)).options.sensor.offset == (0.1, 0.0)


def test_truth_of_positions_only_gives_no_rpe() -> None:
    truth = np.column_stack([np.arange(5.0), np.arange(5.0) ** 2, np.full(5, np.nan)])
    truth[2] = np.nan
    figures = evaluate(truth, None, np.nan_to_num(truth), {})
    assert (figures.rpe_m, figures.poses_counted) == (None, 4)
    assert figures.ate_m == pytest.approx(0.0, abs=1e-12)
