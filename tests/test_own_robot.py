"""The example of an own robot: its files are those that its script makes, and three commands lead to the report."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from comparisons.cli import app
from graphslam import load
from graphslam.log_checks import check_log

FOLDER = Path(__file__).parents[1] / "examples" / "own_robot"
FILES = ("odometry.csv", "sightings.csv", "truth.csv", "map.csv", "import.toml", "drive.mcap")


def test_the_files_are_small():
    assert sum(path.stat().st_size for path in FOLDER.iterdir() if path.is_file()) < 200_000


def test_the_script_makes_the_files(tmp_path):
    pytest.importorskip("rosbags")
    spec = importlib.util.spec_from_file_location("make_example", FOLDER / "make_example.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.main(tmp_path)
    for name in FILES[:-1]:
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name
    # compressed by another version of zstd a bag has other bytes
    assert load(tmp_path / "drive.mcap").equals(load(FOLDER / "drive.mcap"))


def test_tables_and_bag_are_the_same_drive():
    pytest.importorskip("rosbags")
    tables, bag = load(FOLDER), load(FOLDER / "drive.mcap")
    assert bag.landmarks.tolist() == tables.landmarks.tolist()
    assert bag.sensor.offset == tables.sensor.offset == (0.18, 0.0)
    np.testing.assert_allclose(bag.sightings, tables.sightings, atol=1e-5)
    np.testing.assert_allclose(bag.dt, tables.dt, atol=1e-9)
    np.testing.assert_array_equal(bag.controls, tables.controls)
    np.testing.assert_allclose(bag.true_poses, tables.true_poses, atol=1e-4)
    assert not tables.notes and not check_log(tables) and not check_log(bag)


@pytest.mark.slow
def test_three_commands_lead_to_the_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    few = ["--estimators", "dead-reckoning,graph"]
    commands = (
        ["show", FOLDER],
        ["run", FOLDER, "--out", "out", "--figures", "png", *few],
        ["report", FOLDER, "report.html", *few],
    )
    for words in commands:
        result = CliRunner().invoke(app, list(map(str, words)))
        assert result.exit_code == 0, result.output
        assert "WARNING" not in result.output
    found = json.loads(Path("out/comparison.json").read_text())
    errors = {each["name"]: each["ate_m"] for each in found["estimators"]}
    assert errors["graph"] < 0.05 < errors["dead-reckoning"]
    assert Path("report.html").stat().st_size > 100_000
