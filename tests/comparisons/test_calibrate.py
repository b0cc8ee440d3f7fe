"""The verb ``calibrate`` and noise files: round trip, what beats what, and bad files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import Result

from comparisons import run
from comparisons.cli.run import _noise_advice
from comparisons.estimators.config import config_text, read_config
from comparisons.options import NoiseOptions, RunOptions, options_of
from comparisons.options.reading import _compared_with_estimate, prepare
from comparisons.options.toml_files import read_noise, write_noise
from comparisons.show.language import translated
from fastslam import FastSLAM2
from graphslam import (
    Drive,
    FormatError,
    Log,
    LogError,
    MotionModel,
    OptionError,
    PartialSightings,
    SensorModel,
    estimate_robot,
    load,
    sample_log_path,
    save,
    simulate,
)
from graphslam.association import known_noise
from graphslam.calibration import Calibration, calibrate
from graphslam.identification.corrections import without_biases
from graphslam.identification.declared import CORRECTIONS
from graphslam.log import UNIDENTIFIED
from graphslam.simulation.worlds import simulate_single_numbers

Invoke = Callable[..., Result]
#: a drive, and what `estimate_robot` finds
Robot = tuple[Log, Any]


@pytest.fixture
def log_file(tmp_path: Path) -> Path:
    """A log whose ranges are measured 5 % and 0.1 m too long."""
    log = simulate(seed=2, steps=60, clean=True, orientation=False, sensor=SensorModel(range_rate=0.02))
    sightings = log.sightings.copy()
    sightings[:, 0] = 1.05 * sightings[:, 0] + 0.1
    save(log.replace(sightings=sightings), tmp_path / "log.npz")
    return tmp_path / "log.npz"


def test_what_is_written_is_read(tmp_path: Path) -> None:
    found = calibrate(simulate(seed=3, steps=80, clean=True))
    odd = dict(zip(CORRECTIONS, (1.1, 0.9, 0.01, 0.02, 1.2, 0.3, 0.04, 0.05)))
    found = replace(found, **odd)
    write_noise(found, tmp_path / "noise.toml", "a log")
    known = read_noise(tmp_path / "noise.toml")
    assert NoiseOptions.of(**known).models() == (found.motion, found.sensor)
    assert {name: known[name] for name in CORRECTIONS} == found.corrections == odd


@pytest.mark.slow
def test_from_log_to_run(invoke: Invoke, log_file: Path) -> None:
    result = invoke("calibrate", "log.npz", "--out", "noise.toml", "--json", "c.json")
    assert result.exit_code == 0, result.output
    assert "slam-compare run log.npz --noise noise.toml" in result.stdout
    found = json.loads(Path("c.json").read_text())
    assert found["source"] == "truth"
    assert found["range_scale"] == pytest.approx(1.05, abs=4 * found["errors"]["range_scale"])
    assert read_noise(Path("noise.toml"))["bearing_std"] == found["sensor"]["bearing_std"]
    check_bounds(found, result.stdout)

    options = ["--estimators", "graph", "--json", "-", "--figures", ""]
    (plain,) = json.loads(invoke("run", "log.npz", "--out", "a", *options).stdout)["estimators"]
    (right,) = json.loads(invoke("run", "log.npz", "--noise", "noise.toml", "--out", "b", *options).stdout)[
        "estimators"
    ]
    # ranges that are 5 % too long stretch the map; the line takes that back
    assert right["landmark_rmse_m"] < 0.5 * plain["landmark_rmse_m"]

    # a saved configuration needs the noise file no longer
    Path("noise.toml").unlink()
    assert read_config(Path("b/config.toml"))["noise"] == Path("b/noise.toml")
    again = invoke("run", "--config", "b/config.toml", "--out", "c", "--json", "-")
    assert json.loads(again.stdout)["estimators"][0]["poses"] == right["poses"]


@pytest.mark.slow
def test_what_beats_what(invoke: Invoke, log_file: Path) -> None:
    Path("noise.toml").write_text("[motion]\nnn = 0.3\noo = 0.4\n[sensor]\nbearing_std = 0.2\n[ranges]\nscale = 1.1\n")
    Path("c.toml").write_text('log = "log.npz"\nnoise = "noise.toml"\nestimators = ["graph"]\n[motion]\noo = 0.5\n')
    options = ["--range-bias", 0.05, "--out", "a", "--json", "a.json"]
    assert invoke("run", "--config", "c.toml", *options).exit_code == 0
    motion, sensor = (json.loads(Path("a.json").read_text())["noise"][name]["model"] for name in ("motion", "sensor"))
    assert (motion["nn"], motion["oo"], motion["on"]) == (0.3, 0.5, 0.13)
    assert sensor["bearing_std"] == 0.2
    flat = read_config(Path("a/config.toml"))
    assert (flat["noise"], flat["oo"], flat["range_bias"]) == (Path("a/noise.toml"), 0.5, 0.05)
    # a noise file on the command line beats the noise that the configuration has, but not the place of the sensor
    Path("other.toml").write_text("[sensor]\nbearing_std = 0.25\n")
    with Path("a/config.toml").open("a") as file:
        file.write("[sensor]\noffset = [0.2, 0.1]\n")
    options = ["--noise", "other.toml", "--nn", 0.1, "--out", "b", "--json", "b.json"]
    assert invoke("run", "--config", "a/config.toml", *options).exit_code == 0
    motion, sensor = (json.loads(Path("b.json").read_text())["noise"][name]["model"] for name in ("motion", "sensor"))
    assert (sensor["bearing_std"], sensor["offset"], motion["nn"], motion["oo"]) == (0.25, [0.2, 0.1], 0.1, 0.2)
    assert "range_bias" not in read_config(Path("b/config.toml"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[sensor]\n\nbearing = 1\n", [":3:", "[sensor]", "'bearing_std'"]),
        ("[sensor]\nbearing_std = -0.1\n", [":2:", "bearing_std", "positive"]),
        ("[motion]\nsigma_v = -1\n", [":2:", "sigma_v"]),
        ("[motion]\nepsilon = 0\n", [":2:", "epsilon"]),
        ("[motion]\nnn = 'much'\n", [":2:", "a number"]),
        ("[ranges]\nscale = 0\n", [":2:", "scale"]),
        ("[ranges]\nbias = inf\n", [":2:", "bias"]),
        ("[ranges]\noffset = 0\n", [":2:", "[ranges]"]),
        ("[movement]\nnn = 1\n", ["'movement'", "motion, sensor, ranges"]),
        ("motion = 3\n", [":1:", "a table"]),
        ("", ["no noise"]),
        ("[sensor\n", [":1:", "TOML"]),
    ],
)
def test_wrong_files_are_told_in_a_sentence(invoke: Invoke, log_file: Path, content: str, words: list[str]) -> None:
    Path("n.toml").write_text(content)
    with pytest.raises(FormatError):
        read_noise(Path("n.toml"))
    result = invoke("run", "log.npz", "--noise", "n.toml")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: n.toml")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr
    assert not Path("results").exists()


def test_wrong_use(invoke: Invoke, log_file: Path) -> None:
    assert "no such file" in invoke("run", "log.npz", "--noise", "nowhere.toml").stderr
    result = invoke("run", "log.npz", "--range-bias", 30)
    assert result.exit_code == 2
    assert "below zero" in result.stderr
    result = invoke("calibrate", "log.npz", "--out", "no/such/folder.toml")
    assert result.exit_code == 2
    assert "no such folder" in result.stderr
    assert "source must be one of" in invoke("calibrate", "log.npz", "--source", "guess").stderr
    blind = simulate(seed=2, steps=9, clean=True)
    save(blind.replace(steps=[], landmarks=[], sightings=np.zeros((0, 2))), Path("blind.npz"))
    result = invoke("calibrate", "blind.npz", "--out", "n.toml")
    assert result.exit_code == 2
    assert "no sightings" in result.stderr
    assert not Path("n.toml").exists()


def check_bounds(found: dict[str, Any], table: str) -> None:
    """Numbers near zero have a bound in place of an error."""
    near_zero = [name for name, error in found["errors"].items() if error is None and found["bounds"].get(name)]
    assert near_zero
    for name in near_zero:
        row = next(line for line in table.splitlines() if line.startswith(f"{name} "))
        assert f"< {found['bounds'][name]:.2g}" in row
    # a number has an error or a bound, not both
    assert all(found["errors"][name] is None for name in found["bounds"])


@pytest.mark.slow
def test_several_logs_and_several_robots(invoke: Invoke, tmp_path: Path) -> None:
    for seed in (1, 2):
        save(simulate(seed=seed, steps=60, clean=True), tmp_path / f"{seed}.npz")
    result = invoke("calibrate", "1.npz", "2.npz", "--out", "noise.toml", "--json", "c.json")
    assert result.exit_code == 0, result.output
    found = json.loads(Path("c.json").read_text())
    assert (found["logs"], found["counts"]["motion"], found["doubts"]) == (["1", "2"], 120, [])
    assert Path("noise.toml").read_text().startswith("# The noise of 1, 2, from truth")
    assert "slam-compare run 1.npz --noise noise.toml" in result.stdout
    both = invoke("calibrate", "1.npz", "--robot", "1", "--robots", "1,3")
    assert both.exit_code != 0 and "robots" in both.stderr


@pytest.mark.slow
def test_corrections_go_from_the_file_to_the_log(invoke: Invoke, log_file: Path) -> None:
    """Ranges 5 % and speeds 10 % too long, a gyroscope off by 0.05 rad/s: the noise file takes all of it back."""
    log = load(log_file)
    controls = log.controls * [1.1, 1.0] + [0.0, 0.05]
    save(log.replace(controls=controls), log_file)
    Path("noise.toml").write_text(
        "[ranges]\nscale = 1.05\nbias = 0.1\n[odometry]\nwheel_scale = 1.1\nturn_rate_bias = 0.05\n"
    )
    data, _, options = prepare(log_file, RunOptions.of(noise="noise.toml"))
    np.testing.assert_allclose(data.controls, log.controls, atol=1e-12)
    np.testing.assert_array_equal(data.initial_poses, data.dead_reckoning())
    assert (options.wheel_scale, options.turn_rate_bias, options.range_scale) == (1.1, 0.05, 1.05)
    # an option takes precedence over the file, and a log without odometry has nothing to correct
    assert prepare(log_file, RunOptions.of(noise="noise.toml", wheel_scale=1.0))[2].wheel_scale is None
    still = log.replace(dt=None, controls=None)
    prepare(still, RunOptions.of(noise="noise.toml"))
    with pytest.raises(LogError, match="no controls"):
        prepare(still, RunOptions.of(wheel_scale=1.1))


@pytest.fixture(scope="module")
def robot() -> Robot:
    """A drive of two minutes, and what it tells of its robot: the estimate takes a second."""
    log, _ = Drive(seed=6, duration=120.0, landmarks=20).simulate()
    return log, estimate_robot(log)


@pytest.mark.slow
def test_the_noise_of_a_robot_is_estimated_and_told(invoke: Invoke, tmp_path: Path, robot: Robot) -> None:
    log, found = robot
    save(log, tmp_path / "own.npz")
    result = invoke("run", "own.npz", "--estimators", "graph", "--out", "a", "--json", "a.json", "--figures", "")
    assert result.exit_code == 0, result.output
    assert "Noise models: estimated from this log." in result.stdout
    run = json.loads(Path("a.json").read_text())
    assert run["noise"]["sensor"] == {"source": "estimated", "model": run["noise"]["sensor"]["model"]}
    assert run["noise"]["sensor"]["model"]["bearing_std"] == found.sensor.bearing_std
    assert [note for note in run["log"]["notes"] if note.startswith("biases estimated from this log: wheel_scale")]
    # the saved configuration repeats it
    again = invoke("run", "--config", "a/config.toml", "--out", "b", "--json", "b.json")
    assert again.exit_code == 0, again.output
    assert json.loads(Path("b.json").read_text())["estimators"][0]["cost"] == run["estimators"][0]["cost"]
    # noise.toml takes noise and biases, but no ids, to the very same graph
    assert run["files"]["noise.toml"] == "a/noise.toml"
    named = found.ids.correct(log)
    data, _, options = prepare(named, RunOptions.of(noise="a/noise.toml"))
    np.testing.assert_array_equal(data.sightings, found.log.sightings)
    np.testing.assert_array_equal(data.controls, found.log.controls)
    np.testing.assert_array_equal(data.initial_poses, found.log.initial_poses)
    assert (options.motion, options.sensor) == (found.motion, found.sensor)
    assert options.sensor_delay == found.parameters["sensor_delay"]


@pytest.mark.slow
def test_the_noise_of_the_book_is_taken_where_it_is_asked_for(invoke: Invoke, tmp_path: Path, robot: Robot) -> None:
    save(robot[0], tmp_path / "own.npz")
    plain = ["--estimators", "graph", "--kernel", "none", "--figures", "", "--json", "-"]
    result = invoke("run", "own.npz", "--noise", "book", "--out", "a", *plain)
    noise = json.loads(result.stdout)["noise"]
    assert noise["sensor"]["source"] == "book" and noise["sensor"]["model"]["range_rate"] == 0.14
    # numbers that are given are used, and nothing else is estimated
    given = invoke("run", "own.npz", "--range-std", "0.1", "--out", "b", *plain)
    assert json.loads(given.stdout)["noise"]["sensor"]["model"]["range_std"] == 0.1


def test_better_noise_is_offered_where_that_of_the_book_does_not_fit(invoke: Invoke, tmp_path: Path) -> None:
    log = simulate(seed=2, steps=80, clean=True, orientation=False)
    precise = simulate(
        seed=2, steps=80, clean=True, orientation=False, motion=MotionModel(nn=0.02, no=0.001, on=0.01, oo=0.02),
        sensor=SensorModel(range_rate=0.02, bearing_std=0.01),
    )  # fmt: skip
    fits, calibrate_it, auto = "fits.npz", "calibrate.npz", "auto.npz"
    alone = precise.replace(true_poses=None)
    for name, each in ((fits, log), (calibrate_it, precise), (auto, alone)):
        save(each, tmp_path / name)
    outputs = {
        name: invoke("run", name, "--estimators", "graph", "--out", "a", "--figures", "").output
        for name in (fits, calibrate_it, auto)
    }
    assert "Noise of this robot" not in outputs[fits]
    assert "Noise of this robot: slam-compare calibrate calibrate.npz --out noise.toml" in outputs[calibrate_it]
    assert "Noise of this robot: slam-compare run auto.npz --noise auto" in outputs[auto]


def test_the_command_for_the_noise_names_the_robot_of_a_data_set() -> None:
    """Without it, `calibrate` ends in "has robots 1, 2, 3: say which"."""
    log = simulate(seed=2, steps=10, clean=True)
    outcome: Any = SimpleNamespace(log=log, noise_ratio=(1.0, 0.01), findings=(), noise_source={"motion": "book"})
    advice = _noise_advice(outcome, Path("mrclam6"), RunOptions.of(robot=3, keep_every=0.5, particles=7))
    assert advice is not None and advice.startswith(
        "Noise of this robot: slam-compare calibrate mrclam6 --out noise.toml"
    )
    assert "--robot 3" in advice and "--keep-every 0.5" in advice and "particles" not in advice


def test_no_command_that_fails_is_named_for_single_numbers() -> None:
    log = simulate_single_numbers("range")
    assert log.partial_sightings is not None and len(log.partial_sightings) == 150
    few = log.replace(partial_sightings=log.partial_sightings.among(np.arange(59)))
    for each, begin in (
        (few, "The noise of so few ranges or bearings alone is not estimated"),
        (log, "Noise of this robot: slam-compare run beacons.npz --noise auto"),
    ):
        outcome: Any = SimpleNamespace(log=each, noise_ratio=(1.0, 0.01), findings=(), noise_source={"motion": "book"})
        advice = _noise_advice(outcome, Path("beacons.npz"), RunOptions())
        assert advice is not None and advice.startswith(begin)


@pytest.mark.nightly
def test_ranges_alone_do_not_doubt_a_file_and_their_ids_are_not_checked() -> None:
    """Nothing of them is left out, so that the noise of the motion is not known to be better than that of the file."""
    drive = replace(Drive.random(6000), duration=60.0, misread=0.0, clutter=0.0, parameters={})
    log, truth = drive.simulate()
    alone = PartialSightings(
        steps=log.steps, landmarks=truth.landmarks, ranges=log.sightings[:, 0], bearings=np.full(len(log.steps), np.nan)
    )
    log = log.with_sightings(np.zeros(len(log.steps), dtype=bool)).replace(partial_sightings=alone)
    assert prepare(log, RunOptions.of(check_ids=False))[2].calibration is not None
    # the estimate has 19 times the noise of the true model in the heading
    assert not _compared_with_estimate(log, truth.motion, truth.sensor).doubts


@pytest.mark.slow
@pytest.mark.parametrize(
    "scales",
    [(1.02, 0.97), pytest.param((1.0, 1.04), marks=pytest.mark.nightly)],
    ids=["both biased", "one holds the ideal value"],
)
def test_robots_that_disagree_are_not_one(invoke: Invoke, tmp_path: Path, scales: tuple[float, float]) -> None:
    for seed, scale in zip((1001, 1003), scales):
        drive = Drive(seed=seed, duration=100.0, landmarks=16, parameters={"wheel_scale": scale})
        save(drive.simulate()[0], tmp_path / f"{seed}.npz")
    result = invoke("calibrate", "1001.npz", "1003.npz", "--source", "residuals", "--out", "noise.toml")
    assert result.exit_code == 0, result.output
    assert "Not recommended: the logs disagree beyond chance on wheel_scale" in " ".join(result.stdout.split())
    assert "slam-compare run" not in result.stdout and "ground truth of other robots" in result.stdout
    assert "# Not recommended" in Path("noise.toml").read_text()


def without_ids() -> Log:
    log = load(sample_log_path())
    return log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))


@pytest.mark.nightly
def test_noise_of_a_log_without_ids_is_that_with_ids() -> None:
    """Ids and noise in turn: the noise is that of the log with ids, but for the start of the search."""
    log, unknown = load(sample_log_path()), without_ids()
    data, _, options = prepare(unknown, RunOptions.of(noise="auto"))
    assert options.noise == Path("auto") and options.calibration.sensor == options.sensor == data.sensor
    assert options.sensor.bearing_std == pytest.approx(estimate_robot(log).sensor.bearing_std, rel=1e-3)
    assert [note for note in data.notes if "with 13 landmarks that were found" in note]
    unnamed = unknown.replace(simulated=False)
    assert FastSLAM2(unnamed, particles=2, seed=0).sensor == options.sensor
    # there are no ids that could be checked
    assert prepare(unnamed, RunOptions.of(check_ids=False))[2].sensor == options.sensor


@pytest.mark.slow
def test_logs_without_ids() -> None:
    """Where nothing is known of the noise of a log, that is estimated by default."""
    unknown = without_ids()
    half = unknown.at_steps(np.arange(unknown.num_poses // 2))
    data, _, options = prepare(half, RunOptions.of(noise="auto"))
    assert options.noise == Path("auto") and options.calibration.sensor == options.sensor == data.sensor
    assert [note for note in data.notes if note.startswith("noise estimated from this log")]
    unnamed = half.replace(simulated=False)
    by_default, _, chosen = prepare(unnamed, RunOptions())
    assert (chosen.sensor, chosen.motion) == (options.sensor, options.motion) and by_default.notes == data.notes
    with pytest.raises(OptionError, match="noise must be one of auto, book, not 'bok'"):
        known_noise(unnamed, "bok")
    # what cannot tell its noise keeps the book's, and says why
    few, _, options = prepare(unknown.at_steps(np.arange(15)), RunOptions.of(noise="auto"))
    assert options.calibration is None and options.sensor == SensorModel()
    assert [note for note in few.notes if note.startswith("noise auto kept the book's noise models")]
    few, _, options = prepare(unnamed.at_steps(np.arange(15)), RunOptions())
    assert options.calibration is None and options.sensor == SensorModel()
    assert [note for note in few.notes if note.startswith("the noise models are the book's, because")]


@pytest.mark.nightly
def test_noise_of_another_robot_is_noticed(tmp_path: Path, robot: Robot) -> None:
    log, found = robot
    noise, named = Calibration.of(found), found.ids.correct(log)
    for factor in (1.0, 3.0):
        smaller = {name: getattr(found.sensor, name) / factor for name in ("range_rate", "range_std", "bearing_std")}
        write_noise(replace(noise, sensor=replace(found.sensor, **smaller)), tmp_path / "noise.toml", "a robot")
        outcome = run(named, estimators=["graph"], noise=tmp_path / "noise.toml")
        said = [finding.message for finding in outcome.findings if "less noise than this log shows" in finding.message]
        assert len(said) == (factor > 1)


@pytest.fixture(scope="module")
def misread() -> Robot:
    """A drive with misread ids, and what it tells of its robot."""
    log, _ = Drive(seed=5, duration=150.0, landmarks=20, misread=0.08).simulate()
    return log, estimate_robot(log)


@pytest.mark.nightly
def test_a_noise_file_of_the_robot_corrects_misread_ids(tmp_path: Path, misread: Robot) -> None:
    """The noise of one drive is used for another one, whose ids are misread as often."""
    write_noise(Calibration.of(misread[1]), tmp_path / "noise.toml", "first")
    log, truth = Drive(seed=6, duration=150.0, landmarks=20, misread=0.08).simulate()
    with_file = run(log, estimators=["graph"], noise=tmp_path / "noise.toml")
    assert with_file.noise_source == {"motion": "file", "sensor": "file"}
    assert any("contradict their id" in note for note in with_file.log.notes)
    assert not with_file.findings
    oracle = log.with_sightings(~truth.clutter, landmarks=truth.landmarks[~truth.clutter])
    right = run(oracle, estimators=["graph"], noise=tmp_path / "noise.toml")
    errors = [each.metrics["graph"].ate_m or np.inf for each in (with_file, right)]
    assert errors[0] < 1.3 * errors[1]
    # the configuration repeats the run
    files = with_file.save(tmp_path / "results", figures=())
    options = {n: v for n, v in read_config(files["config"]).items() if n not in ("log", "estimators")}
    again = run(log, estimators=["graph"], **options)
    np.testing.assert_array_equal(again["graph"].poses, with_file["graph"].poses)


@pytest.mark.nightly
def test_a_noise_file_of_another_robot_is_doubted(tmp_path: Path, robot: Robot) -> None:
    log, right = robot[0], Calibration.of(robot[1])
    assert right.motion is not None
    slight = MotionModel(**{name: value / 10 for name, value in vars(right.motion).items()})
    for file, doubt in (
        (right, None),
        (replace(right, wheel_scale=1.03 * right.wheel_scale), "wheel_scale"),
        (replace(right, motion=slight), "noise of the motion that is"),
    ):
        write_noise(file, tmp_path / "noise.toml", "drive")
        found = run(log, estimators=["graph"], noise=tmp_path / "noise.toml")
        doubts = [each.message for each in found.findings if "does not fit this log" in each.message]
        assert [doubt is not None and doubt in each for each in doubts] == ([] if doubt is None else [True])
        assert any("mean log density" in note and "the noise that was given" in note for note in found.log.notes)


@pytest.mark.nightly
def test_what_a_noise_file_does_not_correct_is_doubted(tmp_path: Path) -> None:
    """Errors that files do not contain were found beside the file, and not said."""
    log, _ = replace(Drive.random(1001), duration=200.0).simulate()
    write_noise(Calibration.of(estimate_robot(log)), tmp_path / "noise.toml", "drive")
    lens = log.sightings * np.array([1.0, 1.04, 1.0])[: log.sightings.shape[1]]
    for each, count in ((log, 0), (log.replace(sightings=lens), 1)):
        findings = run(each, estimators=["graph"], noise=tmp_path / "noise.toml").findings
        said = [each.message for each in findings if "bearings that are off by a part of their size" in each.message]
        assert len(said) == count
    assert "方角の誤差" in translated(said[0], "ja")


@pytest.mark.nightly
def test_ids_that_are_not_checked(invoke: Invoke, tmp_path: Path, misread: Robot) -> None:
    log, found = misread
    write_noise(Calibration.of(found), tmp_path / "noise.toml", "drive")
    save(log, tmp_path / "log.npz")
    plain = invoke("run", str(tmp_path / "log.npz"), "--estimators", "graph", "--noise", str(tmp_path / "noise.toml"),
                   "--no-check-ids", "--out", str(tmp_path / "a"))  # fmt: skip
    assert plain.exit_code == 0, plain.output
    assert "contradict their id" not in plain.output
    few = prepare(log.with_sightings(np.arange(40)), RunOptions.of(noise=tmp_path / "noise.toml"))[0]
    assert any("the ids were not checked" in note for note in few.notes)
    wrong = log.replace(landmarks=np.random.default_rng(0).permutation(log.landmarks))
    assert any(
        "more than sensors misread" in note
        for note in prepare(wrong, RunOptions.of(noise=tmp_path / "noise.toml"))[0].notes
    )
    with pytest.raises(OptionError, match="always checks ids"):
        run(log, estimators=["graph"], check_ids=False)


@pytest.mark.slow
def test_options_beside_the_estimate_are_given_and_alone_switch_it_off() -> None:
    log = Drive(seed=5, duration=70.0, landmarks=20).simulate()[0]
    beside = run(log, estimators=["dead-reckoning"], noise="auto", nn=0.01)
    assert beside.noise_source == {"motion": "given", "sensor": "estimated"}
    assert beside.models["motion"].nn == 0.01
    alone = run(log, estimators=["dead-reckoning"], nn=0.01)
    assert alone.noise_source == {"motion": "given", "sensor": "book"}
    assert any("--noise auto estimates the rest" in note for note in alone.log.notes)


@pytest.mark.slow
def test_what_is_given_beside_the_estimate_comes_first_and_is_repeated(tmp_path: Path) -> None:
    """A bias of 0.1 m that is given is taken out once, and numbers beside --noise auto are in the configuration."""
    drive = Drive(seed=5, duration=70.0, landmarks=20, parameters={"range_bias": 0.1, "range_scale": 1.0})
    save(log := drive.simulate()[0], tmp_path / "a.npz")
    first, *_, of_first = prepare(without_biases(log, range_bias=0.1), RunOptions.of(noise="auto"))
    given = RunOptions.of(noise="auto", range_bias=0.1, oo=0.3)
    beside, source, options = prepare(tmp_path / "a.npz", given)
    assert np.array_equal(beside.sightings, first.sightings)
    assert options.calibration.range_bias == 0.1 + of_first.calibration.range_bias
    (tmp_path / "config.toml").write_text(config_text(source, ("graph",), given, copies={}))
    values = {n: v for n, v in read_config(tmp_path / "config.toml").items() if n in options_of(RunOptions)}
    again, *_, repeated = prepare(tmp_path / "a.npz", RunOptions.of(**values))
    assert np.array_equal(again.sightings, beside.sightings)
    assert repeated.models() == options.models() and repeated.motion.oo == 0.3
