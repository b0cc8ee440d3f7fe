"""Several robots that see each other, as one log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from graphslam import (
    Drive,
    Graph,
    GraphError,
    Log,
    LogError,
    MotionModel,
    OptionError,
    SensorModel,
    estimate_robot,
    load,
    save,
    simulate,
    solve,
    solve_with_gtsam,
)
from graphslam.io.formats import load_robots, robots_in
from graphslam.log import UNIDENTIFIED
from graphslam.log.continuous_time import with_poses_at
from graphslam.maps.localization import first_fix
from graphslam.metrics import ate
from graphslam.se2 import between
from graphslam.sessions import join_robots, relations_of

QUIET = MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05, epsilon=1e-9)
SENSOR = SensorModel(range_rate=0.03, bearing_std=0.02)


def with_robot(log: Log, steps: np.ndarray, number: int, sightings: np.ndarray) -> Log:
    """The log with sightings of a robot among those of landmarks."""
    every = np.concatenate([log.steps, steps])
    order = np.argsort(every, kind="stable")
    classes = [""] * len(log.steps) + [f"robot {number}"] * len(steps)
    ids = np.concatenate([log.landmarks, np.full(len(steps), UNIDENTIFIED)])
    rows = np.concatenate([log.sightings, sightings])
    return log.replace(
        steps=every[order], landmarks=ids[order], sightings=rows[order], classes=np.array(classes)[order]
    )


def team(seed: int, *, noise: float = 1.0, orientation: bool = False) -> dict[int, Log]:
    """Two robots with one clock in the book's world; each sees the other at every third step."""
    logs = {
        number: simulate(
            seed=10 * seed + number, steps=60, clean=True, orientation=orientation, motion=QUIET, sensor=SENSOR, start=start,
            name=f"robot{number}",
        )
        for number, start in ((1, (0.0, -3.0, 0.0)), (2, (0.0, 3.0, 2.0)))
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    true = {number: log.true_poses for number, log in logs.items()}
    seeing = {}
    for number, other in ((1, 2), (2, 1)):
        steps = np.arange(number, 60, 3)
        z = SENSOR.h(true[number][steps], true[other][steps] if orientation else true[other][steps, :2])
        z = z + noise * rng.standard_normal(z.shape) * np.sqrt(np.diagonal(SENSOR.Q(z), axis1=-2, axis2=-1))
        seeing[number] = with_robot(logs[number], steps, other, z)
    # the second one knows nothing of the frame of the first
    two = seeing[2]
    return {1: seeing[1], 2: two.replace(initial_poses=between(two.initial_poses[0], two.initial_poses))}


def solved(log: Log) -> np.ndarray:
    return solve(Graph.from_log(log, edges="landmark+motion", kernel="none")).poses


@cache
def errors() -> np.ndarray:
    """The mean ATE of two robots, alone, joined by their landmarks, and with their sightings of each other, of 20 teams."""
    rows = []
    for seed in range(20):
        robots = team(seed)
        alone = [
            ate(log.true_poses, solved(log.with_sightings(log.landmarks != UNIDENTIFIED))) for log in robots.values()
        ]
        together = []
        joined = join_robots(robots)
        for log in (joined.log.replace(relations=None), joined.log):
            found = solved(log)
            together.append(np.mean([ate(log.true_poses[drive], found[drive]) for drive in log.drives]))
        rows.append([np.mean(alone), *together])
    return np.mean(rows, axis=0)


@pytest.mark.nightly
def test_robots_that_see_each_other_are_located_better_than_alone() -> None:
    alone, by_landmarks, together = errors()
    assert together < by_landmarks < alone


def test_exact_sightings_of_each_other_fit_the_truth_exactly() -> None:
    for orientation in (False, True):
        joined = join_robots(team(3, noise=0.0, orientation=orientation)).log
        relations, truth = joined.relations, joined.true_poses
        assert relations is not None and truth is not None and len(relations) == 40
        off = between(truth[relations.first], truth[relations.second])[:, : 3 if orientation else 2]
        assert np.allclose(relations.motions[:, : off.shape[1]], off, atol=1e-9)
        assert joined.times is not None
        drives = joined.drives
        late = joined.times[drives[1].start]
        assert np.allclose(np.abs(joined.times[relations.first] - joined.times[relations.second]), late, atol=1e-6)


def test_the_cost_is_that_of_a_place_and_gtsam_finds_the_same_minimum() -> None:
    joined = join_robots(team(5)).log
    graph = Graph.from_log(joined, edges="landmark+motion", kernel="none")
    found, reference = solve(graph, tolerance=1e-11), solve_with_gtsam(graph)
    assert reference.cost == pytest.approx(found.cost, rel=1e-9)
    assert np.allclose(reference.poses, found.poses, atol=1e-5)
    assert found.certificate.status == "global"
    # the residual of the docstring, by hand
    relations = joined.relations
    assert relations is not None
    e = between(found.poses[relations.first], found.poses[relations.second])[:, :2] - relations.motions[:, :2]
    by_hand = np.einsum("ei,eij,ej->", e, np.linalg.inv(relations.covariances[:, :2, :2]), e)
    without = Graph.from_log(joined.replace(relations=None), edges="landmark+motion", kernel="none")
    assert found.cost - without.cost(found.state) == pytest.approx(by_hand, abs=1e-5 * len(relations))


def test_a_robot_gets_a_pose_when_another_one_sees_it() -> None:
    robots = team(2)
    late = robots[2].replace(start_time=1.25)
    joined = join_robots({1: robots[1], 2: late})
    second = joined.log.drives[1]
    seen = np.flatnonzero(robots[1].classes == "robot 2")
    # robot 1 sees it every 9 s, and it moves from 1.25 s on in steps of 3 s
    assert second.stop - second.start == late.num_poses + len(seen)
    # what moves between poses that were there before stays the same, but for epsilon
    finer = with_poses_at(late, np.array([2.0, 7.5, 7.5]))
    kept = np.searchsorted(finer.times, late.times)
    assert finer.num_poses == late.num_poses + 2
    assert np.allclose(finer.dead_reckoning()[kept], late.dead_reckoning())
    assert np.array_equal(kept[late.steps], finer.steps)


def test_a_robot_may_be_seen_at_its_last_pose_whatever_rounding_makes_of_its_time() -> None:
    """300 durations of 0.1 s and 600 of 0.05 s do not add up to the same time."""
    log = simulate(seed=1, steps=20, clean=True)
    for end in log.times[-1] + np.array([-4e-15, 0.0, 4e-15, 9e-7]):
        assert with_poses_at(log, np.array([end])).num_poses == log.num_poses
    # robot 1 sees the other one at its 59th pose
    one, two = (log.at_steps(np.arange(59)) for log in team(3).values())
    one = one.replace(start_time=float(np.spacing(two.times[-1])))
    assert one.times[-1] > two.times[-1] and one.classes[-1] == "robot 2"
    assert 2 * 59 - 1 in join_robots({1: one, 2: two}).log.relations.second


def test_the_robots_of_a_team_need_one_clock_and_their_classes() -> None:
    robots = team(1)
    with pytest.raises(LogError, match=r"clocks of the robots do not overlap .*robot 2 from 90000.0 to"):
        join_robots({1: robots[1], 2: robots[2].replace(start_time=90_000.0)})
    with pytest.raises(LogError, match="no sighting has the class of another robot"):
        join_robots({n: log.with_sightings(log.landmarks != UNIDENTIFIED) for n, log in robots.items()})
    stray = {n: log.replace(classes=["robot 7" if each else "" for each in log.classes]) for n, log in robots.items()}
    with pytest.raises(LogError, match="the robots saw 'robot 7' only, and the logs are of robots 1, 2"):
        join_robots(stray)
    with pytest.raises(OptionError, match="join_robots takes logs by the numbers"):
        join_robots(list(robots.values()))  # type: ignore[arg-type]
    with pytest.raises(LogError, match=r"no pose at 1e\+06 s|no pose at 1000000.000 s"):
        with_poses_at(robots[1], np.array([1e6]))


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "factor"), [("millimetres", 1000.0), ("centimetres", 100.0), ("feet", 1 / 0.3048)])
def test_the_unit_of_a_map_is_named_to_several_robots(unit: str, factor: float) -> None:
    """A wrong unit may fit some drives of a joined log; the one that is named fits most sightings."""
    robots = team(1)
    assert robots[1].true_landmarks is not None
    wrong = {j: place * factor for j, place in robots[1].true_landmarks.items()}
    with pytest.raises(GraphError, match=f"they would with the map in {unit}"):
        first_fix(join_robots(robots).log, wrong)


def test_relations_without_a_heading() -> None:
    z = np.array([[2.0, 0.5]])
    sensor = replace(SENSOR, offset=(0.3, 0.0))
    found = relations_of(np.array([0]), np.array([1]), z, sensor)
    place = np.array([0.3 + 2 * np.cos(0.5), 2 * np.sin(0.5)])
    assert np.allclose(found.motions[0, :2], place)
    # R Q R' of a sighting
    R = np.array([[np.cos(0.5), -2 * np.sin(0.5)], [np.sin(0.5), 2 * np.cos(0.5)]])
    assert np.allclose(found.covariances[0, :2, :2], R @ np.diag([(2 * 0.03) ** 2, 0.02**2]) @ R.T)
    assert found.covariances[0, 2].tolist() == [0.0, 0.0, 1e6]


def test_mrclam_folders_have_several_robots(tmp_path: Path) -> None:
    head, unix = "# Time [s]\n", 1248444175.0
    times = unix + np.arange(0, 4.001, 0.02)
    (tmp_path / "Barcodes.dat").write_text("1 5\n2 14  # a robot\n6 63\n")
    for robot, other in ((1, 14), (2, 5)):
        rows = "".join(f"{t:.3f} 1.0 0.5\n" for t in times)
        (tmp_path / f"Robot{robot}_Odometry.dat").write_text(head + rows)
        seen = [(0.51, 63), (1.0 + 0.11 * robot, other), (2.5, 63), (3.5, 63)]
        text = "".join(f"{unix + t:.3f} {code} 2.0 {np.pi / 2:.6f}\n" for t, code in seen)
        (tmp_path / f"Robot{robot}_Measurement.dat").write_text(head + text)
    assert robots_in(tmp_path) == [1, 2]
    robots = load_robots(tmp_path)
    assert robots[1].classes is not None and robots[1].classes.tolist() == ["", "robot 2", "", ""]
    assert robots[1].landmarks.tolist() == [6, UNIDENTIFIED, 6, 6]
    assert load(tmp_path, robot=1).landmarks.tolist() == [6, 6, 6]
    save(simulate(seed=1, steps=5), tmp_path / "one.npz")
    with pytest.raises(OptionError, match="are of one robot"):
        load_robots(tmp_path / "one.npz")


@pytest.mark.parametrize("odometry_rate", [1.0, 20.0])
def test_poses_without_landmarks_do_not_change_the_estimate(odometry_rate) -> None:
    """Sightings of other robots cut controls. On MR.CLAM 6 robot 3 this moved the sensor by 8 cm and its delay by 0.09 s."""
    log, _ = Drive(seed=7, duration=100.0, odometry_rate=odometry_rate, sensor_rate=5.0).simulate()
    assert log.times is not None
    finer = with_poses_at(log, np.linspace(*log.times[[0, -1]], 301)[1:-1])
    plain, cut = (estimate_robot(each) for each in (log, finer))
    np.testing.assert_allclose(cut.parameters.values, plain.parameters.values, rtol=1e-5, atol=1e-8)
    assert [cut.sensor.range_rate, cut.motion.oo] == pytest.approx([plain.sensor.range_rate, plain.motion.oo], rel=1e-5)
