"""`slam-compare run LOG --map FILE`: the map of one log serves another one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

import comparisons
from comparisons.options import reading
from graphslam import (
    AbsolutePositions,
    Drive,
    Graph,
    LandmarkMap,
    Log,
    LogError,
    MotionModel,
    PartialSightings,
    SensorModel,
    load,
    save,
    simulate,
    solve,
)
from graphslam.se2 import between, transform, wrap
from graphslam.solvers.uncertainty import Uncertainty

Invoke = Callable[..., Result]
IN_MAP = ["graph", "gtsam", "mcl", "fastslam1", "fastslam2", "dead-reckoning"]


def log_of(seed: int, start: tuple[float, float, float], **options: object) -> Log:
    return simulate(seed=seed, steps=30, clean=True, start=start, name=f"log{seed}", **options)  # type: ignore[arg-type]


@pytest.fixture
def logs(tmp_path: Path) -> tuple[Path, Path]:
    """Two logs of the book's world, the second one from another place, with its first pose at the origin."""
    first, second = log_of(1, (0.0, -3.0, 0.0)), log_of(2, (-2.0, 0.0, 1.0))
    save(first, tmp_path / "first.npz")
    save(second.replace(initial_poses=second.initial_poses - second.initial_poses[0]), tmp_path / "second.npz")
    return tmp_path / "first.npz", tmp_path / "second.npz"


@pytest.mark.slow
def test_the_map_of_one_run_is_the_prior_of_the_next(invoke: Invoke, logs: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = logs
    made = invoke("run", first, "--estimators", "graph,gtsam", "--out", "one")
    assert made.exit_code == 0, made.output
    assert "Localise in this map: slam-compare run OTHER_LOG --map one/graph-map.npz" in " ".join(made.output.split())
    result = invoke(
        "run",
        second,
        "--map",
        "one/graph-map.npz",
        "--out",
        "two",
        "--particles",
        100,
        "--json",
        "-",
        "--figures",
        "png",
    )
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    rows = {each["name"]: each for each in document["estimators"]}
    # in the frame of the map: that of the first log, whose first pose is the true one
    truth = log_of(2, (-2.0, 0.0, 1.0)).true_poses
    assert truth is not None
    for name in IN_MAP:
        error = np.array(rows[name]["poses"])[0] - truth[0]
        assert np.hypot(*error[:2]) < 1.0 and abs(wrap(error[2])) < 0.5, name
    assert np.allclose(rows["graph"]["poses"], rows["gtsam"]["poses"], atol=1e-7)
    assert rows["textbook"]["reason"].startswith("textbook does not use a map")
    assert any("first pose was found in the map" in note for note in document["log"]["notes"])
    # the map that is written is that of both
    one, two = (LandmarkMap.load(tmp_path / run / "graph-map.npz") for run in ("one", "two"))
    assert list(one) == list(two) and np.trace(two.joint) < np.trace(one.joint)
    again = invoke("run", "--config", "two/config.toml", "--json", "-", "--out", "three")
    poses = {each["name"]: each["poses"] for each in json.loads(again.stdout)["estimators"]}
    assert poses == {name: row["poses"] for name, row in rows.items()}


def test_python_and_the_command_line_do_the_same(invoke: Invoke, logs: tuple[Path, Path], tmp_path: Path) -> None:
    _, second = logs
    known = solve(Graph.from_log(log_of(1, (0.0, -3.0, 0.0)))).map
    known.save(tmp_path / "map.npz")
    here = comparisons.run(second, estimators=["graph"], map=tmp_path / "map.npz", map_use="own")["graph"]
    there = comparisons.run(second, estimators=["graph"], landmark_map=known.used_as("own"))["graph"]
    result = invoke("run", second, "--map", "map.npz", "--map-use", "own", "--estimators", "graph", "--json", "-")
    told = json.loads(result.stdout)["estimators"][0]
    assert np.array_equal(here.poses, there.poses) and np.array_equal(here.poses, told["poses"])
    assert here.cost == told["cost"]
    fixed = comparisons.run(second, estimators=["graph"], map=tmp_path / "map.npz", map_use="fixed")["graph"]
    assert all(np.array_equal(fixed.landmarks[j], known[j]) for j in known)


def test_sightings_of_landmarks_that_localisation_does_not_know_are_left_out(logs: tuple[Path, Path]) -> None:
    true = log_of(1, (0.0, -3.0, 0.0)).true_landmarks
    assert true is not None
    some = LandmarkMap({j: m for j, m in true.items() if j != 0})
    result = comparisons.run(logs[1], estimators=["mcl", "graph"], landmark_map=some, particles=100)
    assert any("not on the map, and left out" in note for note in result["mcl"].notes)
    assert 0 in result["graph"].landmarks
    # a range alone of an unknown landmark keeps localisation from nothing, either
    log = load(logs[1]).without_orientation()
    alone = PartialSightings(steps=[3, 4], landmarks=[0, 1], ranges=[2.0, 2.0], bearings=[np.nan, np.nan])
    known = LandmarkMap({j: m[:2] for j, m in some.items()})
    every = log.with_sightings(log.landmarks != 0, partial_sightings=alone)
    result = comparisons.run(every, estimators=["mcl"], landmark_map=known, particles=100)
    left_out = f"1 of {len(every.steps) + 2} sightings are of landmarks that are not on the map, and left out"
    assert left_out in result["mcl"].notes


@pytest.mark.slow
def test_positions_in_another_frame_than_the_map_are_said() -> None:
    log = log_of(2, (-2.0, 0.0, 1.0))
    known = LandmarkMap({j: place[:2] for j, place in log.true_landmarks.items()})
    steps, rng = np.arange(3, 31, 3), np.random.default_rng(0)

    def warned(motion: tuple[float, float, float], **options: object) -> list[str]:
        """The warnings of a run with positions that are moved by a motion."""
        places = transform(motion, log.true_poses[steps, :2]) + rng.normal(scale=0.1, size=(len(steps), 2))
        positions = AbsolutePositions(steps=steps, places=places, covariances=0.01 * np.eye(2))
        found = comparisons.run(log.replace(positions=positions), estimators=["graph"], **options)
        return [each.message for each in found.findings]

    (said,) = warned((0.0, 0.0, 1.5), landmark_map=known)
    assert said.startswith("half of the positions contradict the map: in the median, their squared errors are")
    # without a map positions are the frame
    assert warned((0.0, 0.0, 0.0), landmark_map=known) == [] == warned((3.0, 1.0, 1.5))


@pytest.mark.slow
def test_nees_in_a_map_is_that_of_errors_against_the_first_pose() -> None:
    """The first pose is not held in a map: the covariances against it come from the joint one of both poses."""
    values = []
    for seed in range(2, 8):
        log = simulate(seed=seed, clean=True)
        truth, true = log.true_poses, log.true_landmarks
        assert truth is not None and true is not None
        known = LandmarkMap({j: m[:2] for j, m in true.items()})
        results = comparisons.run(log, estimators=["graph", "gtsam"], landmark_map=known)
        own = results["graph"]
        assert own.nees(truth) == pytest.approx(results["gtsam"].nees(truth), rel=1e-4)
        values.append(own.nees(truth))
        if seed > 2:
            continue
        assert own.graph is not None and own.state is not None
        each, uncertainty = [], Uncertainty(own.graph, own.state)
        for k in range(1, len(truth)):
            joint = uncertainty.joint(np.array([0, k]))
            # the pose k in the frame of pose 0, and the derivative of it by both poses
            found, right = between(own.poses[0], own.poses[k]), between(truth[0], truth[k])
            c, s = np.cos(own.poses[0, 2]), np.sin(own.poses[0, 2])
            turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            by_first = -turn.copy()
            by_first[:2, 2] = found[1], -found[0]
            derivative = np.hstack([by_first, turn])
            error = found - right
            error[2] = wrap(error[2])
            each.append(error @ np.linalg.solve(derivative @ joint @ derivative.T, error) / 3)
        assert own.nees(truth) == pytest.approx(np.mean(each), rel=1e-6)
    # 27 with the covariances in the axes of the map
    assert 0.4 < np.mean(values) < 2.0


@pytest.mark.parametrize("start", [(0.0, -3.0, 0.0), (0.1, -3.3, 0.7)])
def test_nees_of_samples_does_not_depend_on_the_start(start: tuple[float, float, float]) -> None:
    """Their first pose is the same up to rounding, which is no covariance."""
    log = log_of(2, start)
    assert comparisons.run(log, estimators=["fastslam2"], smoothing=20)["fastslam2"].nees(log.true_poses) is not None


@pytest.mark.slow
def test_estimated_biases_in_an_exact_map_have_covariances() -> None:
    """Landmarks that are held do not follow the parameters."""
    log = Drive(seed=2001, duration=60.0, misread=0.0).simulate()[0]
    assert log.true_landmarks is not None
    known = LandmarkMap({j: m[:2] for j, m in log.true_landmarks.items()})
    result = comparisons.run(log, estimators=["graph"], landmark_map=known)["graph"]
    assert result.covariance_failure is None
    value = result.nees(log.robot_truth)
    assert value is not None and value < 10


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("id,x,y\n1,0,0\n1,1,1\n", "map.csv:3: landmark 1 is in the map twice"),
        ("id,x,y\n101,0,0\n102,1,1\n", "sees no landmark of the map"),
        ("id,x,y\n1,2000,-3000\n2,3000,3000\n3,0,4000\n0,-4000,2000\n4,1000,1000\n5,-3000,-1000\n", "in millimetres"),
        ("id,x,y\n1,2,3\n2,3,-3\n3,0,-4\n0,-4,-2\n4,1,-1\n5,-3,1\n", "mirrored"),
    ],
)
def test_a_map_that_does_not_fit_is_one_sentence(content: str, message: str, invoke: Invoke, tmp_path: Path) -> None:
    models = {
        "sensor": SensorModel(range_rate=0.02, bearing_std=0.02),
        "motion": MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05, epsilon=1e-6),
    }
    log = log_of(1, (0.0, -3.0, 0.0), orientation=False, max_range=10.0, **models)
    save(log.replace(**models), tmp_path / "log.npz")
    (tmp_path / "map.csv").write_text(content)
    result = invoke("run", "log.npz", "--map", "map.csv", "--estimators", "graph")
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert "Traceback" not in result.output


def test_landmarks_that_have_moved_are_shown_and_written(
    invoke: Invoke, logs: tuple[Path, Path], tmp_path: Path
) -> None:
    true = log_of(1, (0.0, -3.0, 0.0)).true_landmarks
    assert true is not None
    places = {j: np.array(m) for j, m in true.items()}
    places[4] += (1.5, 0.0, 0.0)
    LandmarkMap({**places, 77: (900.0, 0.0, 0.0)}, dict.fromkeys([*places, 77], 1e-4 * np.eye(3))).save(
        tmp_path / "m.npz"
    )
    result = invoke("run", logs[1], "--map", "m.npz", "--estimators", "graph", "--json", "out.json")
    assert "landmark 4 has moved; landmarks 1 and 77 were not in view of the sensor" in " ".join(result.output.split())
    states = {each["id"]: each for each in json.loads((tmp_path / "out.json").read_text())["map_states"]}
    assert states[4]["state"] == "moved" and states[77]["state"] == "not in view" and states[0]["state"] == "agrees"
    # the map was shifted by 1.5 m along x; the noise of the book leaves some decimetres
    assert np.hypot(states[4]["shift"][0] + 1.5, states[4]["shift"][1]) < 0.5


def test_the_probability_of_being_off_is_shown_written_and_drawn_live(invoke: Invoke, logs: tuple[Path, Path]) -> None:
    known = solve(Graph.from_log(log_of(1, (0.0, -3.0, 0.0)))).map
    known.save("map.npz")
    arguments = ["run", logs[1], "--map", "map.npz", "--estimators", "graph,online", "--bound", "0.4,10"]
    result = invoke(*arguments, "--live", "--json", "out.json")
    shown = " ".join(result.output.split())
    assert "P(off): the probability that a pose is off by more than 0.4 m or 10 degrees in the map" in shown
    assert "degrees with probability" in " ".join((result.output + result.stderr).split())
    rows = {each["name"]: each for each in json.loads(Path("out.json").read_text())["estimators"]}
    assert rows["graph"]["options"]["bound"] == [0.4, 10]
    solution = solve(Graph.from_log(load(logs[1]), map=known))
    assert np.allclose(rows["graph"]["integrity_risk"], solution.integrity_risk(0.4, np.radians(10)), atol=1e-6)
    # later sightings tell more than was known when the robot was there
    assert (
        len(rows["online"]["integrity_risk"]) == 31
        and np.mean(rows["online"]["integrity_risk"]) > solution.integrity_risk(0.4, np.radians(10)).mean()
    )
    refused = invoke(*arguments[:-1], "0.4")
    assert refused.exit_code == 2 and "bound must be two numbers" in refused.stderr


@pytest.mark.parametrize("option", [("--map-use", "fixed"), ("--bound", "1,5")])
def test_options_about_a_map_need_one(option: tuple[str, str], invoke: Invoke) -> None:
    refused = invoke("run", *option)
    assert refused.exit_code == 2 and "a map to localise in; name it with map (--map FILE)" in refused.stderr


def test_a_noise_file_is_compared_with_the_log_in_its_map(
    logs: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bearings off by 0.015 rad were doubted on 4 of 6 drives; with the map, which was left out, they are on all."""
    used = []

    def estimate(log: Log, *, map: LandmarkMap | None, **options: object) -> None:
        used.append(map)
        raise LogError("too short")

    monkeypatch.setattr(reading, "estimate_robot", estimate)
    (tmp_path / "noise.toml").write_text("[sensor]\nbearing_std = 0.05\n")
    known = solve(Graph.from_log(load(logs[0]), edges="landmark+motion")).map
    for each in (known, None):
        comparisons.run(logs[1], estimators=["graph"], noise=tmp_path / "noise.toml", landmark_map=each)
    assert list(used[0]) == list(known) and used[1] is None
