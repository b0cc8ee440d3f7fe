"""The verbs import and show: what a new user of an own robot sees."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import comparisons
from comparisons.cli import app
from comparisons.cli.output import Output, in_flags
from comparisons.options import RunOptions
from comparisons.show.log_tables import bars, pictures, plan
from comparisons.show.recordings import write_mcap
from graphslam import OptionError, load, sample_log_path, simulate


@pytest.fixture
def call(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*arguments, code=0):
        result = CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "80"})
        assert result.exit_code == code, result.output
        return result.output

    return run


@pytest.fixture
def folder(tmp_path):
    log = load(sample_log_path())
    path = tmp_path / "drive"
    path.mkdir()
    t = np.concatenate([[0.0], np.cumsum(log.dt)])
    u = np.concatenate([log.controls, log.controls[-1:]])
    np.savetxt(path / "odometry.csv", np.column_stack([t, u]), delimiter=",", header="t,nu,omega", comments="")
    rows = np.column_stack([log.times[log.steps], log.landmarks, log.sightings])
    np.savetxt(path / "sightings.csv", rows, delimiter=",", header="t,id,range,bearing,psi", comments="")
    return path


def test_a_folder_is_listed_and_written(call, folder):
    output = call("import", folder)
    assert "odometry.csv" in output and "Nothing was written. Next:" in output and "import" in output
    assert "Columns of sightings: t [s], id, range [m], bearing [radians], orientation = psi [radians]." in output
    assert "WARNING" not in output
    output = call("import", folder, "drive.npz")
    assert "Wrote drive.npz." in output and "run drive.npz" in output
    assert load("drive.npz").equals(load(folder))
    assert max(len(line) for line in call("import", folder, "-q").splitlines() if "/" not in line) <= 100


def test_a_bag_that_makes_no_log_is_described_in_json(call, tmp_path):
    pytest.importorskip("mcap_ros2.writer")
    write_mcap(comparisons.run(estimators=["dead-reckoning"]), tmp_path / "poses.mcap")
    assert "no topic gives odometry" in call("import", "poses.mcap", "--json", "found.json", code=2)
    found = json.loads(Path("found.json").read_text())
    assert found["log"] is None and "no topic gives odometry" in found["reason"]
    assert "/truth/pose" in [topic["name"] for topic in found["topics"]]


def test_options_of_the_command_line(call, folder):
    table = np.loadtxt(folder / "sightings.csv", delimiter=",", skiprows=1)
    table[:, 3:] = np.rad2deg(-table[:, 3:])
    np.savetxt("tags.csv", table, delimiter=",")
    call(
        "import", "--odometry", folder / "odometry.csv", "--sightings", "tags.csv", "--angles", "sightings=degrees",
        "--bearings", "clockwise", "drive.npz",
    )  # fmt: skip
    np.testing.assert_allclose(load("drive.npz").sightings, load(folder).sightings, atol=1e-12)
    Path("recipe.toml").write_text('bearings = "clockwise"\n[sightings]\nangles = "degrees"\nfile = "../tags.csv"\n')
    call("import", folder, "other.npz", "--recipe", "recipe.toml")
    assert load("other.npz").equals(load("drive.npz"))


def test_a_flipped_bearing_is_announced_by_import_show_and_run(call, folder):
    (folder / "import.toml").write_text('bearings = "clockwise"\n')
    warning = "WARNING: the bearings, or else the turn rates, have the wrong sign"
    advice = "slam-compare import has --bearings; other verbs read such options from import.toml"
    output = call("import", folder)
    assert f"{warning} (--bearings clockwise)" in output and advice not in output
    for verb in (["show", folder], ["run", folder, "--estimators", "dead-reckoning", "--out", "out", "--figures", ""]):
        output = call(*verb)
        assert f'{warning} (bearings = "clockwise")' in output and advice in output
    assert "wrong sign (bearings='clockwise')" in json.loads(Path("out/comparison.json").read_text())["warnings"][0]


def test_options_are_spelled_as_the_command_line_has_them():
    text = "add axes='optical', clocks='sightings=-0.5', sensor_yaw=-1.5, kernel='cauchy' or noise=FILE"
    known = ("axes", "clocks", "sensor_yaw", "sensor_offset")
    flags = "add --axes optical, --clocks sightings=-0.5, --sensor-yaw -1.5, --kernel cauchy or --noise FILE"
    assert in_flags(text, known) == flags
    # a command stays as it is, and so do a verb's own words
    assert in_flags(flags, known) == flags
    assert in_flags("leave psi out: dimensions=2, or", ()) == "leave psi out: --dimensions 2, or"
    assert in_flags("see Graph.from_log(log, kernel='cauchy')", ()) == "see Graph.from_log(log, kernel='cauchy')"
    assert in_flags("fastslam1 particles=100 kernel=huber", ("particles",)) == "fastslam1 particles=100 kernel=huber"
    assert in_flags("import FOLDER --columns odometry.t=T,odometry.nu=V", ("odometry", "t")).endswith(
        "=T,odometry.nu=V"
    )
    assert in_flags("sensor_offset=[FORWARD, LEFT]、columns='odometry.nu=a b'", ("sensor_offset", "columns")) == (
        "--sensor-offset FORWARD,LEFT、--columns 'odometry.nu=a b'"
    )
    lines = in_flags(text, ()).removeprefix("add ").split(", ")
    assert lines[:2] == ['axes = "optical"', 'clocks = "sightings=-0.5"'] and lines[2] == "sensor_yaw = -1.5"


def test_mistakes_end_with_one_sentence(call, folder):
    assert call("import", code=2) == (
        "error: name the folder or bag, or the file of each table: --odometry FILE is missing\n"
    )
    assert "give at most a folder or bag" in call("import", "a", "b", "c", code=2)
    assert "this is no bag; give the folder of tables" in call("import", folder / "odometry.csv", code=2)
    (folder / "sightings.csv").write_text("t,id,range,way\n1,2,3,4\n")
    output = call("run", folder, code=2)
    assert output.count("\n") == 1 and "sightings.csv: no column for bearing" in output


def test_sightings_without_ids_name_the_column(call, folder):
    table = (folder / "sightings.csv").read_text().replace("t,id,", "t,serial,")
    (folder / "sightings.csv").write_text(table)
    output = call("import", folder)
    assert "no column for id (named id or landmark or" in output and "it has t, serial, range, bearing, psi" in output


def test_show(call, folder):
    output = call("show", folder, "--figure", "show.png", "--json", "show.json")
    assert "Nothing is suspicious" in output and "· dead reckoning" in output and "landmark 6" in output
    assert Path("show.png").read_bytes().startswith(b"\x89PNG")
    found, log = json.loads(Path("show.json").read_text()), load(folder)
    assert found["distance"] == pytest.approx(np.sum(np.abs(log.controls[:, 0]) * log.dt))
    assert found["seconds"] == pytest.approx(np.sum(log.dt))
    ids, counts = np.unique(log.landmarks, return_counts=True)
    assert {each["id"]: each["count"] for each in found["landmarks"]} == dict(zip(ids.tolist(), counts.tolist()))
    assert sum(found["ranges"]["counts"]) == sum(found["bearings"]["counts"]) == len(log.steps)
    assert {each["name"] for each in found["rates"]} == {"poses", "controls", "sightings"}


def test_show_without_controls_or_landmarks():
    log = load(sample_log_path()).replace(dt=None, controls=None, true_poses=None, true_landmarks=None)
    found = comparisons.inspect_log(log)
    assert found.seconds is None and found.distance is None and found.rates[0].rate is None
    assert "poses" in str(found)
    found.figure()
    assert comparisons.inspect_log(log.replace(steps=[], landmarks=[], sightings=[])).landmarks == ()
    with pytest.raises(OptionError):
        comparisons.inspect_log(log, robot=3)


def test_plots_of_characters():
    lines = bars(np.array([0.0, 1.0, 2.0]), np.array([1, 4]), "m", width=8)
    assert lines == ["[0.00, 1.00) m  ██ 1", "[1.00, 2.00) m  ████████ 4"]
    path = np.column_stack([np.linspace(0, 10, 200), np.zeros(200)])
    lines = plan(path, np.array([[5.0, 3.0]]), width=21, height=9)
    assert lines[-2].startswith("S····") and "+" in lines[0] and lines[0].index("+") == 10


def test_the_map_is_drawn_while_it_grows():
    log = simulate(steps=12, seed=1)
    *_, last = pictures(log, RunOptions.of(motion=log.motion, sensor=log.sensor), width=40, height=12)
    assert last[-1].startswith(f"step 12 of 12, {len(np.unique(log.landmarks))} landmarks")
    assert any("+" in line for line in last) and any("·" in line for line in last)
    assert "· estimated path, + landmark" in last[-2]


def test_only_the_last_picture_without_a_terminal(capsys):
    with Output(None).picture() as (draw, (width, height)):
        assert width > 20 and height >= 5
        draw(["one"])
        draw(["two", "three"])
    assert capsys.readouterr().err.split() == ["two", "three"]
