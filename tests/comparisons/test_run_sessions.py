"""`slam-compare run A B C`: several logs of one place, solved together."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

import comparisons
from graphslam import (
    Graph,
    Log,
    MotionModel,
    OptionError,
    PartialSightings,
    SensorModel,
    join_logs,
    load,
    save,
    simulate,
    solve,
)
from graphslam.log.continuous_time import with_poses_every
from graphslam.metrics import ate
from graphslam.se2 import between
from graphslam.sessions import with_common_noise

Invoke = Callable[..., Result]
QUIET = MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05)


def drives(count: int = 3) -> list[Log]:
    """Parts of one drive without the motions between them, each in a frame of its own and with its own clock."""
    log = simulate(seed=11, steps=90, clean=True, motion=QUIET)
    ends = np.linspace(0, log.num_poses, count + 1).astype(int)
    parts = [log.at_steps(np.arange(*pair)) for pair in zip(ends[:-1], ends[1:])]
    return [
        part.replace(
            initial_poses=between(part.initial_poses[0], part.initial_poses), start_time=1000.0 * k, name=f"day{k}"
        )
        for k, part in enumerate(parts, start=1)
    ]


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    for part in drives():
        save(part, tmp_path / f"{part.name}.npz")
    return [tmp_path / f"day{k}.npz" for k in (1, 2, 3)]


@pytest.mark.slow
def test_three_logs_are_one_graph_one_map_and_a_table_each(invoke: Invoke, files: list[Path], tmp_path: Path) -> None:
    result = invoke(
        "run",
        *files,
        "--estimators",
        "dead-reckoning,graph,gtsam",
        "--out",
        "out",
        "--json",
        "o.json",
        "--figures",
        "png",
    )
    assert result.exit_code == 0, result.output
    for k in (1, 2, 3):
        assert re.search(rf"^day{k} +dead-reckoning +0", result.output, re.MULTILINE), result.output
        assert (tmp_path / f"out/graph-{k}.tum").exists() and (tmp_path / f"out/truth-{k}.tum").exists()
    # however many other notes there are
    assert (
        len(re.findall(r"^Compared with the logs before day[23], \d+ landmarks agree", result.stdout, re.MULTILINE))
        == 2
    )
    document = json.loads((tmp_path / "o.json").read_text())
    expected = solve(Graph.from_log(join_logs(drives()).log, weight="pairs"))
    rows = {row["name"]: row for row in document["estimators"]}
    assert np.allclose(rows["graph"]["poses"], expected.poses, atol=1e-9)
    for session, part, own in zip(document["sessions"], drives(), join_logs(drives()).split(expected.poses)):
        assert session["file"] == str(tmp_path / f"{part.name}.npz") and session["start_time"] == part.start_time
        assert part.true_poses is not None
        assert session["estimators"]["graph"]["ate_m"] == pytest.approx(ate(part.true_poses, own))
        alone = solve(Graph.from_log(part, weight="pairs")).poses
        assert session["estimators"]["graph"]["alone_m"] == pytest.approx(ate(part.true_poses, alone), rel=1e-6)
        assert session["estimators"]["gtsam"]["alone_m"] is None
    # all poses together have the common alignment
    squares = [s["poses"] * s["estimators"]["graph"]["together_m"] ** 2 for s in document["sessions"]]
    assert np.sqrt(sum(squares) / document["log"]["poses"]) == pytest.approx(rows["graph"]["ate_m"])
    # a trajectory has the clock of its own log
    times = np.loadtxt(tmp_path / "out/graph-2.tum")[:, 0]
    assert times[0] == 2000.0 and len(times) == drives()[1].num_poses
    again = invoke("run", "--config", "out/config.toml", "--out", "again", "--json", "-")
    repeated = {row["name"]: row for row in json.loads(again.stdout)["estimators"]}
    assert repeated["graph"]["poses"] == rows["graph"]["poses"]


def test_the_relative_pose_error_has_no_motion_between_two_logs() -> None:
    joined = join_logs(drives()).log
    outcome = comparisons.run(drives(), estimators=["dead-reckoning"])
    assert outcome.log.equals(joined)
    each = [comparisons.run(part, estimators=["dead-reckoning"]) for part in drives()]
    squares = [
        (run.log.num_poses - 1) * (run.metrics["dead-reckoning"].rpe_m or np.nan) ** 2 for run in each
    ]  # fmt: skip
    expected = np.sqrt(sum(squares) / (joined.num_poses - len(each)))
    assert outcome.metrics["dead-reckoning"].rpe_m == pytest.approx(expected)


def test_what_follows_one_robot_is_left_out() -> None:
    outcome = comparisons.run(drives(2), estimators=["graph", "mcl", "fastslam1", "textbook", "particle-gibbs"])
    assert [each.name for each in outcome.skipped] == ["mcl", "fastslam1", "textbook", "particle-gibbs"]
    assert all("follows one robot" in each.reason and "2 logs" in each.reason for each in outcome.skipped)


def test_no_log_is_refused_in_one_sentence() -> None:
    with pytest.raises(OptionError, match="needs at least one log"):
        comparisons.run([])


def test_logs_that_share_nothing_are_refused_in_one_sentence(invoke: Invoke, files: list[Path], tmp_path: Path) -> None:
    far = load(files[1])
    save(far.replace(landmarks=far.landmarks + 100), tmp_path / "far.npz")
    result = invoke("run", files[0], "far.npz")
    assert result.exit_code == 2
    assert result.stderr == "error: far and day1 share no landmark: do the ids mean the same ones in all of them?\n"
    twice = invoke("run", files[0], files[1], files[0])
    assert twice.exit_code == 2 and twice.stderr.startswith(
        "error: day1.npz is named twice; its sightings would count twice"
    )


@pytest.mark.slow
def test_the_robots_of_a_data_set_are_solved_together_unless_one_is_named(invoke: Invoke, tmp_path: Path) -> None:
    starts = {1: (0.0, -3.0, 0.0), 2: (0.0, 3.0, 2.0)}
    logs = {
        n: simulate(seed=n, steps=40, clean=True, motion=QUIET, orientation=False, start=start)
        for n, start in starts.items()
    }
    barcodes = {j: 50 + j for j in (logs[1].true_landmarks or {})}
    (tmp_path / "set").mkdir()
    rows = [(1, 5), (2, 14), *((6 + j, code) for j, code in barcodes.items())]
    (tmp_path / "set/Barcodes.dat").write_text("".join(f"{subject} {code}\n" for subject, code in rows))
    for robot, other in ((1, 14), (2, 5)):
        log, seen_robot = logs[robot], logs[3 - robot]
        assert log.times is not None and log.controls is not None
        assert log.true_poses is not None and seen_robot.true_poses is not None
        drive = np.column_stack([log.times, np.append(log.controls, [[0, 0]], axis=0)])
        np.savetxt(tmp_path / f"set/Robot{robot}_Odometry.dat", drive)
        codes = [barcodes[j] for j in log.landmarks.tolist()]
        seen = np.column_stack([log.times[log.steps], codes, log.sightings])
        at = np.arange(3, 36, 4)[:9]
        z = SensorModel().h(log.true_poses[at], seen_robot.true_poses[at][:, :2])
        met = np.column_stack([log.times[at], np.full(9, other), z])
        np.savetxt(
            tmp_path / f"set/Robot{robot}_Measurement.dat",
            np.concatenate([seen, met])[np.argsort([*seen[:, 0], *(m[0] for m in met)], kind="stable")],
        )
    result = invoke("run", "set", "--noise", "book", "--estimators", "graph", "--json", "all.json", "--out", "all")
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "all.json").read_text())
    assert [each["name"] for each in document["sessions"]] == ["set-robot1", "set-robot2"]
    assert "18 sightings of other robots are relations between two poses of one instant" in document["log"]["notes"]
    again = invoke("run", "--config", "all/config.toml", "--json", "-", "--out", "again")
    assert np.allclose(
        json.loads(again.stdout)["estimators"][0]["poses"], document["estimators"][0]["poses"], atol=1e-9
    )
    one = invoke("run", "set", "--robot", "1", "--noise", "book", "--estimators", "graph", "--json", "-")
    assert json.loads(one.stdout)["sessions"] is None
    # verbs that follow one robot still ask which
    which = invoke("particles", "set")
    assert which.exit_code == 2 and "say which (--robot N)" in which.stderr


def test_a_changed_log_is_not_repeated(invoke: Invoke, files: list[Path]) -> None:
    assert invoke("run", *files[:2], "--estimators", "graph", "--out", "out").exit_code == 0
    save(load(files[1]).at_steps(np.arange(20)), files[1])
    result = invoke("run", "--config", "out/config.toml")
    assert result.exit_code == 2 and "has changed since" in result.stderr


def test_a_joined_log_keeps_its_sessions(tmp_path: Path) -> None:
    joined = join_logs(drives()).log
    save(joined, tmp_path / "all.npz")
    assert load(tmp_path / "all.npz").sessions == joined.sessions
    starts = [drive.start for drive in joined.drives]
    assert np.array_equal(joined.dead_reckoning()[starts], joined.initial_poses[starts])
    # the second log loses all its poses, the third one its first five
    fewer = joined.at_steps(np.concatenate([np.arange(starts[1]), np.arange(starts[2] + 5, joined.num_poses)]))
    assert [(each.name, each.start) for each in fewer.sessions] == [("day1", 0), ("day3", starts[1])]
    finer = with_poses_every(joined, 1.0)
    assert [len(finer.initial_poses[drive]) for drive in finer.drives] == [
        with_poses_every(part, 1.0).num_poses for part in drives()
    ]


def test_the_noise_of_several_logs_is_the_mean_of_theirs_where_the_sensor_is() -> None:
    near, ahead = SensorModel(bearing_std=0.03), SensorModel(bearing_std=0.04, offset=(0.4, 0.0))
    logs = [drives()[0].replace(sensor=near), drives()[1].replace(sensor=ahead)]
    common = with_common_noise(logs)
    sensor = common[0].sensor
    assert sensor is not None and common[1].sensor == sensor and sensor.offset == (0.2, 0.0)
    assert sensor.bearing_std == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2))
    for before, after, own in zip(logs, common, (near, ahead)):
        origin = np.zeros((len(before.steps), 3))
        places = own.h_inverse(origin, before.sightings), sensor.h_inverse(origin, after.sightings)
        assert np.allclose(*places)


@pytest.mark.parametrize(("alone", "offset"), [((0,), 0.0), ((1,), 0.4)])
def test_the_place_of_the_sensor_is_that_of_the_logs_with_single_numbers(alone: tuple[int, ...], offset: float) -> None:
    """A range cannot be carried to another place of the sensor, as whole sightings are."""
    partial = PartialSightings(steps=[0], landmarks=[3], ranges=[2.0], bearings=[np.nan])
    logs = [
        log.replace(
            sensor=SensorModel(offset=(0.4 * k, 0.0)), partial_sightings=partial if k in alone else None
        ).without_orientation()
        for k, log in enumerate(drives(2))
    ]
    common = with_common_noise(logs)
    assert [log.sensor and log.sensor.offset for log in common] == [(offset, 0.0)] * 2


def test_biases_taken_out_of_several_logs_are_as_uncertain_as_the_mean_of_theirs_in_any_order() -> None:
    """The joined log had those of the first log alone, so that its covariances depended on the order of the logs."""
    logs = [
        each.replace(uncertain=of_it)
        for each, of_it in zip(drives(), ({"wheel_scale": 0.03}, None, {"range_bias": 0.1}))
    ]
    wanted = {"wheel_scale": 0.03 / 3**0.5, "range_bias": 0.1 / 3**0.5}
    for order in ([0, 1, 2], [2, 1, 0]):
        joined = join_logs(with_common_noise([logs[k] for k in order])).log
        assert joined.uncertain == pytest.approx(wanted)
    alike = [each.replace(uncertain={"wheel_scale": 0.03}) for each in drives()]
    assert join_logs(with_common_noise(alike)).log.uncertain == {"wheel_scale": 0.03}
