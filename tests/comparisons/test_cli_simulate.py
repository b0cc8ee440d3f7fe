"""The verb simulate: every option of the simulator arrives, and wrong ones are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from comparisons.cli import app
from graphslam import MotionModel, SensorModel, World, load, simulate
from graphslam.simulation.simulator import MotionFaults, SensorFaults
from graphslam.simulation.worlds import WORLDS

Invoke = Callable[..., Result]


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Invoke:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, ["simulate", *(str(a) for a in arguments)])


def test_the_default_is_the_simulators(invoke: Invoke) -> None:
    assert invoke("a.npz", "--seed", 4).exit_code == 0
    assert load("a.npz").equals(simulate(seed=4))


def test_the_sample_can_be_made_again(invoke: Invoke) -> None:
    assert invoke("a.npz", "--world", "garden", "--seed", 1).exit_code == 0
    # tests/graphslam/test_simulator.py compares it with the sample, up to what processors differ by
    assert load("a.npz").equals(simulate(WORLDS["garden"], seed=1))


def test_every_option_arrives(invoke: Invoke) -> None:
    drive = {"steps": 30, "dt": 0.5, "speed": 0.7, "turn_rate": 0.9, "min_range": 0.2, "max_range": 4.5, "arena": 8.0}
    drive |= {"field_of_view": 3.0}
    wheels = {"kicks_per_metre": 2.0, "kick_std": 0.2, "velocity_bias_std": 0.05, "stuck_interval": 9.0}
    wheels |= {"stuck_duration": 1.0, "kidnap_interval": 12.0}
    camera = {"range_noise_rate": 0.02, "bearing_noise": 0.01, "orientation_noise": 0.03, "range_bias_rate_std": 0.01}
    camera |= {
        "bearing_bias_std": 0.02,
        "orientation_bias_std": 0.05,
        "phantom": 0.1,
        "oversight": 0.2,
        "occlusion": 0.3,
    }
    options = [word for name, value in (drive | wheels | camera).items()
               for word in (f"--{name.replace('_', '-')}", value)]  # fmt: skip
    places = ["--way-points", "4,-3 4,3 -4,3", "--start", "1,-2,0.5", "--landmarks", "17", "--seed", 11]
    result = invoke("a.npz", *options, *places, "--no-orientation")
    assert result.exit_code == 0, result.output
    expected = simulate(
        **drive, way_points=[(4, -3), (4, 3), (-4, 3)], start=(1, -2, 0.5), landmarks=17, orientation=False,
        motion_faults=MotionFaults(**wheels), sensor_faults=SensorFaults(**camera), seed=11,
    )  # fmt: skip
    assert load("a.npz").equals(expected)
    assert load("a.npz").sightings.shape[1] == 2


def test_landmarks_can_be_placed(invoke: Invoke) -> None:
    assert invoke("a.npz", "--landmarks", "1,2 -3,4.5").exit_code == 0
    truth = load("a.npz").true_landmarks
    assert truth is not None
    np.testing.assert_array_equal([m[:2] for m in truth.values()], [[1, 2], [-3, 4.5]])


def test_clean_follows_the_models(invoke: Invoke) -> None:
    assert invoke("a.npz", "--clean", "--nn", 0.05, "--range-rate", 0.01, "--seed", 2).exit_code == 0
    models: dict[str, Any] = {"motion": MotionModel(nn=0.05), "sensor": SensorModel(range_rate=0.01)}
    expected = simulate(clean=True, **models, seed=2)
    # `run` takes the models from the log
    assert load("a.npz").equals(expected.replace(**models))
    result = invoke("a.txt", "--sensor-offset", "0.3,0.1", "--no-truth")
    assert "Next: slam-compare run a.txt --sensor-offset 0.3,0.1" in result.stdout


def test_without_truth_the_books_format_will_do(invoke: Invoke) -> None:
    assert invoke("a.txt", "--no-truth", "--seed", 4).exit_code == 0
    assert load("a.txt").true_poses is None
    np.testing.assert_array_equal(load("a.txt").sightings, simulate(seed=4).sightings)
    assert invoke("b.log", "--no-truth", "--format", "lnpr").exit_code == 0
    assert load("b.log").num_poses == 63


def test_it_says_what_it_wrote(invoke: Invoke) -> None:
    result = invoke("a.npz", "--json", "-")
    payload = json.loads(result.stdout)
    assert payload["file"] == "a.npz"
    assert payload["log"]["poses"] == 63
    assert "Next: slam-compare run a.npz" in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["a.npz", "--world", "mars"], "mars"),
        (["a.npz", "--steps", "0"], "steps"),
        (["a.npz", "--dt", "-1"], "dt"),
        (["a.npz", "--dt", "inf"], "dt"),
        (["a.npz", "--speed", "nan"], "speed"),
        (["a.npz", "--turn-rate", "nan"], "turn_rate"),
        (["a.npz", "--min-range", "9"], "min_range"),
        (["a.npz", "--field-of-view", "0"], "field_of_view"),
        (["a.npz", "--landmarks", "0"], "landmarks"),
        (["a.npz", "--landmarks", "many"], "landmarks"),
        (["a.npz", "--landmarks", "1,2,3,4"], "landmarks"),
        (["a.npz", "--way-points", "1,2 3"], "way_points"),
        (["a.npz", "--way-points", " "], "way_points"),
        (["a.npz", "--way-points", "1,nan"], "way_points"),
        (["a.npz", "--start", "1,2"], "start"),
        (["a.npz", "--phantom", "1.5"], "phantom"),
        (["a.npz", "--oversight", "-0.1"], "oversight"),
        (["a.npz", "--kick-std", "-1"], "kick"),
        (["a.npz", "--bearing-noise", "nan"], "bearing"),
        (["a.npz", "--velocity-bias-std", "inf"], "velocity"),
        (["a.npz", "--clean", "--phantom", "0.1"], "clean"),
        (["a.npz", "--clean", "--nn", "-1"], "nn"),
        (["a.npz", "--nn", "0.1"], "--clean"),
        (["a.txt"], "truth"),
        (["a.doc"], ".doc"),
        (["a.npz", "--format", "xml"], "xml"),
        (["nowhere/a.npz"], "nowhere"),
        (["."], "folder"),
        (["a.npz", "--json", "nowhere/a.json"], "nowhere"),
    ],
)
def test_refused(invoke: Invoke, tmp_path: Path, arguments: list[str], word: str) -> None:
    result = invoke(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert word in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_help_shows_the_defaults_of_the_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text = CliRunner().invoke(app, ["simulate", "--help"]).stdout
    for component in (World(), MotionFaults(), SensorFaults(), MotionModel(), SensorModel()):
        for each in fields(component):
            name = {"offset": "sensor_offset"}.get(each.name, each.name)
            assert f"--{name.replace('_', '-')}" in text
    (line,) = [line for line in text.splitlines() if "--steps " in line]
    assert "(62)" in line


def test_the_place_and_limits_of_the_sensor_hold_with_faults_too(invoke: Invoke) -> None:
    invoke("near.npz", "--sensor-max-range", "2", "--sensor-offset", "0.5,0", "--oversight", "0")
    invoke("far.npz", "--oversight", "0")
    assert 0 < len(load("near.npz").steps) < len(load("far.npz").steps)
