"""Sightings with a range or a bearing alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from graphslam import (
    Graph,
    GraphError,
    Log,
    LogError,
    OnlineSolver,
    OptionError,
    PartialSightings,
    SensorModel,
    calibrate,
    load,
    save,
    simulate,
    solve,
    solve_online,
    solve_with_gtsam,
)
from graphslam.edges import BearingEdges, EdgeFamily, PartialEdges, RangeEdges
from graphslam.edges.robust import Cauchy
from graphslam.graph.transform import relative_graph
from graphslam.linear.information import BlockSystem
from graphslam.log.continuous_time import with_poses_every
from graphslam.online.replay import replay
from graphslam.se2 import transform, wrap
from graphslam.simulation.worlds import SENSOR, simulate_single_numbers
from graphslam.solvers.gtsam_factors import to_gtsam
from graphslam.solvers.initialize import doubtful_images


def from_truth(log: Log, graph: Graph) -> np.ndarray:
    """The state of a graph at the ground truth."""
    assert log.true_poses is not None and log.true_landmarks is not None
    places = [[*log.true_landmarks[j][:2], 0.0] for j in graph.landmark_ids.tolist()]
    return np.concatenate([log.true_poses, places])


def straight(seed: int = 0, *, number: str = "range") -> Log:
    """A straight drive past two beacons, one of which has been seen in whole once."""
    log = simulate_single_numbers(number, seed=seed, landmarks=1)
    rng, steps = np.random.default_rng(seed), np.arange(0, 40)
    poses = np.column_stack([0.5 * steps, np.zeros(40), np.zeros(40)])
    z = SENSOR.h(poses, np.array([10.0, 4.0])) + 0.05 * rng.standard_normal((40, 2))
    partial = PartialSightings(steps=steps, landmarks=np.full(40, 7), ranges=z[:, 0], bearings=np.full(40, np.nan))
    return Log(
        dt=1.0, controls=np.tile([0.5, 0.0], (39, 1)), steps=[], landmarks=[], sightings=np.zeros((0, 2)),
        true_poses=poses, true_landmarks={7: (10.0, 4.0)}, partial_sightings=partial, motion=log.motion, sensor=SENSOR,
        simulated=True,
    )  # fmt: skip


@pytest.mark.parametrize("kind", [RangeEdges, BearingEdges])
@pytest.mark.parametrize("kernel", [None, "cauchy"])
def test_derivatives_are_those_of_finite_differences(kind: type[PartialEdges], kernel: str | None) -> None:
    rng = np.random.default_rng(3)
    state = rng.uniform(-3, 3, (6, 3))
    ends = np.array([0, 0, 1, 2]), np.array([3, 4, 5, 3])
    edges = kind(*ends, rng.uniform(0.5, 2, (4, 1)), np.full((4, 1, 1), 2.0), np.array([0.3, -0.2]))
    found = edges.linearize(state, state)
    for end, jacobian in zip(ends, found.jacobians):
        for column in range(3):
            off = np.zeros_like(state)
            numeric = np.zeros(4)
            for row in range(4):
                off[:] = 0
                off[end[row], column] = 1e-6
                ahead, behind = (edges.linearize(state + s * off, state).residuals[row, 0] for s in (1, -1))
                numeric[row] = wrap(ahead - behind) / 2e-6
            assert np.allclose(jacobian[:, 0, column], numeric, atol=1e-7), column


@pytest.mark.parametrize("kind", [RangeEdges, BearingEdges])
@pytest.mark.parametrize("kernel", [None, Cauchy()])
def test_the_engine_has_the_same_sums(kind: type[PartialEdges], kernel: Cauchy | None) -> None:
    rng = np.random.default_rng(4)
    state = rng.uniform(-3, 3, (6, 3))
    # landmarks may come before poses
    ends = np.array([2, 2, 3, 4]), np.array([0, 1, 5, 0])
    trust = np.linspace(0.3, 1.0, 4)
    W, offset = rng.uniform(1, 4, (4, 1, 1)), np.array([0.3, -0.2])
    edges = kind(*ends, rng.uniform(0.5, 2, (4, 1)), W, offset, kernel=kernel, trust=trust)
    systems = [BlockSystem.from_cliques(6, [edges.cliques()]) for _ in range(2)]
    costs = []
    for system, add in zip(systems, (kind.accumulate, EdgeFamily.accumulate)):
        system.clear()
        costs.append(add(edges, state, state, system))
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)
    np.testing.assert_allclose(systems[0].xi, systems[1].xi, atol=1e-12)
    np.testing.assert_allclose(systems[0].values, systems[1].values, atol=1e-12)


def test_the_residuals_are_those_of_the_sensor() -> None:
    sensor = replace(SENSOR, offset=(0.4, 0.1))
    pose, place = np.array([[1.0, 2.0, 0.7]]), np.array([[4.0, -1.0, 0.0]])
    z = sensor.h(pose[0], place[0, :2])
    for kind, number in ((RangeEdges, z[0]), (BearingEdges, z[1])):
        edges = kind(np.array([0]), np.array([1]), np.array([[number]]), np.ones((1, 1, 1)), np.array(sensor.offset))
        assert abs(edges.linearize(np.concatenate([pose, place]), pose).residuals[0, 0]) < 1e-12


@pytest.mark.parametrize("number", ["range", "bearing"])
def test_gtsams_own_factors_have_the_same_cost_and_minimum(number: str) -> None:
    log = simulate_single_numbers(number, seed=21, poses=80, landmarks=4, every=1)
    graph = Graph.from_log(log)
    factors = to_gtsam(graph, factors="per-edge")
    own = {type(factors.at(k)) for k in range(factors.size())}
    assert (gtsam.RangeFactor2D if number == "range" else gtsam.BearingFactor2D) in own
    found = solve(graph, tolerance=1e-10)
    start = graph.with_initial(found.state + 1e-3)
    reference = solve_with_gtsam(start, initialize="given")
    assert found.converged and reference.cost == pytest.approx(found.cost, rel=1e-9)
    assert np.allclose(reference.poses, found.poses, atol=1e-5)
    assert found.certificate.status == "not applicable"
    # a sensor off the pose and a kernel have factors of this package
    other = Graph.from_log(log, sensor=replace(SENSOR, offset=(0.5, 0.2)), kernel="cauchy")
    state = found.state
    assert 2 * to_gtsam(other).error(_values(other, state)) == pytest.approx(other.cost(state), rel=1e-9)


def _values(graph: Graph, state: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    for node, row in enumerate(state):
        if node < len(graph.steps):
            values.insert(node, gtsam.Pose2(*row))
        else:
            values.insert(node, gtsam.Point2(*row[:2]))
    return values


@pytest.mark.slow
@pytest.mark.parametrize("number", ["range", "bearing"])
def test_the_optimum_is_reached_from_odometry(number: str) -> None:
    for seed in (31, 32):
        log = simulate_single_numbers(number, seed=seed)
        graph = Graph.from_log(log)
        found = solve(graph)
        near = solve(graph.with_initial(from_truth(log, graph)), initialize="given", method="levenberg-marquardt")
        assert found.converged and found.cost <= near.cost * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("number", ["range", "bearing"])
def test_noise_models_that_are_too_narrow_are_said(number: str) -> None:
    log = simulate_single_numbers(number, seed=31)
    assert not any(note.startswith("J is") for note in solve(Graph.from_log(log)).notes)
    quarter = {name: getattr(SENSOR, name) / 4 for name in ("range_rate", "range_std", "bearing_std")}
    narrow = log.replace(sensor=replace(SENSOR, **quarter))
    assert any(note.startswith("J is") for note in solve(Graph.from_log(narrow)).notes)


def test_a_mirror_image_is_never_silent() -> None:
    log = straight()
    found = solve(Graph.from_log(log))
    place = np.abs(found.landmarks[7])
    assert np.allclose(place, [10.0, 4.0], atol=0.5)
    assert any("landmark 7 may be elsewhere" in note and "1 to 1" in note for note in found.notes)
    for other in (solve(found.graph, method="gnc"), solve_with_gtsam(found.graph)):
        assert any("landmark 7 may be elsewhere" in note for note in other.notes)
    odds = doubtful_images(found.graph, found.state)
    assert odds == {7: pytest.approx(1.0, abs=0.2)}
    # one bearing decides
    assert log.partial_sightings is not None
    nan = np.full(40, np.nan)
    bearings = nan.copy()
    bearings[0] = np.arctan2(4.0, 10.0)
    ranges = log.partial_sightings.ranges.copy()
    ranges[0] = np.nan
    sided = log.replace(partial_sightings=replace(log.partial_sightings, ranges=ranges, bearings=bearings))
    decided = solve(Graph.from_log(sided))
    assert np.allclose(decided.landmarks[7], [10.0, 4.0], atol=0.5) and not decided.notes


def test_whole_sightings_go_along_with_single_numbers() -> None:
    log = simulate(seed=5, steps=30, clean=True, orientation=False)
    kept = np.arange(len(log.steps)) % 3 > 0
    partial = PartialSightings(
        steps=log.steps[~kept], landmarks=log.landmarks[~kept], ranges=log.sightings[~kept, 0],
        bearings=np.full(np.sum(~kept), np.nan),
    )  # fmt: skip
    mixed = log.with_sightings(kept, partial_sightings=partial)
    found = solve(Graph.from_log(mixed))
    assert found.converged and set(found.landmarks) == set(log.landmark_ids.tolist())
    with pytest.raises(GraphError, match="say nothing about the heading"):
        Graph.from_log(simulate(seed=5, steps=30).replace(partial_sightings=partial))
    with pytest.raises(GraphError, match="landmarks as nodes"):
        Graph.from_log(mixed, edges="virtual+motion")


def test_landmarks_without_a_place_are_left_out_with_a_note() -> None:
    log = straight()
    assert log.partial_sightings is not None
    once = log.partial_sightings.among(np.arange(40) < 1)
    two = PartialSightings(
        **{
            name: np.concatenate([getattr(log.partial_sightings, name), value])
            for name, value in {"steps": [3], "landmarks": [9], "ranges": [5.0], "bearings": [np.nan]}.items()
        }
    )
    graph = Graph.from_log(log.replace(partial_sightings=two))
    assert graph.landmark_ids.tolist() == [7] and "landmark 9 left out" in graph.notes[0]
    assert Graph.from_log(log.replace(partial_sightings=once)).landmark_ids.tolist() == []


def test_g2o_and_npz_keep_them(tmp_path: Path) -> None:
    for number in ("range", "bearing"):
        log = simulate_single_numbers(number, seed=2, poses=60, landmarks=3)
        found = solve(Graph.from_log(log))
        assert found.graph is not None
        relative_graph(found.graph, state=found.state).save_g2o(tmp_path / "graph.g2o")
        text = (tmp_path / "graph.g2o").read_text()
        assert f"EDGE_{number.upper()}_SE2_XY" in text
        again = Graph.from_g2o(tmp_path / "graph.g2o")
        assert solve(again, initialize="given").cost == pytest.approx(found.cost, rel=1e-6)
        save(log, tmp_path / "log.npz")
        assert load(tmp_path / "log.npz").equals(log)
        finer = with_poses_every(log, 0.5)
        assert finer.partial_sightings is not None and finer.times is not None and log.times is not None
        assert np.allclose(finer.times[finer.partial_sightings.steps], log.times[log.partial_sightings.steps])  # type: ignore[union-attr]


def test_bad_input() -> None:
    good = {"steps": [0], "landmarks": [1], "ranges": [1.0], "bearings": [np.nan]}
    for change, message in (
        ({"bearings": [0.5]}, "both range and bearing"),
        ({"ranges": [np.nan]}, "neither range nor bearing"),
        ({"ranges": [-1.0]}, "above zero"),
        ({"ranges": [np.inf]}, "finite and above zero"),
        ({"ranges": [1.0, 2.0]}, r"shape \(K,\)"),
        ({"landmarks": [0.5]}, "whole numbers"),
    ):
        with pytest.raises(LogError, match=message):
            PartialSightings(**(good | change))
    log = straight()
    with pytest.raises(LogError, match="partial_sightings has step 99"):
        log.replace(partial_sightings=PartialSightings(**(good | {"steps": [99]})))


@pytest.mark.slow
@pytest.mark.parametrize("number", ["range", "bearing"])
def test_gnc_finds_wrong_single_numbers(number: str) -> None:
    log = simulate_single_numbers(number, seed=300, poses=80, landmarks=3)
    single, rng = log.partial_sightings, np.random.default_rng(1)
    assert single is not None
    wrong = rng.random(len(single)) < 0.1
    ranges = np.where(wrong, rng.uniform(5, 40, len(wrong)), single.ranges)
    bearings = np.where(wrong, wrap(single.bearings + np.pi / 2), single.bearings)
    given = (ranges, single.bearings) if number == "range" else (single.ranges, bearings)
    names, columns = ("steps", "landmarks", "ranges", "bearings"), (single.steps, single.landmarks, *given)
    bad = log.replace(partial_sightings=PartialSightings(**dict(zip(names, columns))))
    found = solve(Graph.from_log(bad, kernel="none"), method="gnc", probability=0.999)
    trust = found.other_trust[f"{number}s alone"]
    np.testing.assert_array_equal(trust < 0.5, wrong)
    # the optimum is that of the graph without the wrong ones
    right = PartialSightings(**{name: each[~wrong] for name, each in zip(names, columns)})
    best = solve(Graph.from_log(log.replace(partial_sightings=right), kernel="none"))
    np.testing.assert_allclose(found.poses[:, :2], best.poses[:, :2], atol=1e-4)


def test_the_world_is_as_it_says() -> None:
    log = simulate_single_numbers("range", seed=1)
    assert log.true_poses is not None and log.partial_sightings is not None and log.true_landmarks is not None
    partial = log.partial_sightings
    places = np.array([log.true_landmarks[j] for j in partial.landmarks.tolist()])
    off = partial.ranges - np.hypot(*(places - log.true_poses[partial.steps, :2]).T)
    # 150 of them: the standard deviation of a standard deviation is 6 %
    assert np.std(off) == pytest.approx(0.1, rel=0.25)
    assert np.abs(transform(log.true_poses[0], (0.0, 0.0)) - log.initial_poses[0, :2]).max() == 0
    assert SensorModel().h is not None


@pytest.mark.parametrize("number", ["range", "bearing"])
def test_their_noise_is_calibrated(number: str) -> None:
    log = simulate_single_numbers(number, poses=400).replace(motion=None, sensor=None, simulated=False)
    found = calibrate(log)
    name, value = ("range_std", SENSOR.range_std) if number == "range" else ("bearing_std", SENSOR.bearing_std)
    # of 200 numbers: the standard error of a standard deviation is 5 %
    assert getattr(found.sensor, name) == pytest.approx(value, rel=0.2)
    assert found.counts == {"motion": 399, "sensor": 200} and found.apply(log).sensor == found.sensor
    # the motion is that of the truth, and no landmark is known to be seen whole
    assert "no landmark whose true place is known is seen with range and bearing" in found.notes[0]


@pytest.mark.parametrize("name", ["poses", "landmarks", "every", "lanes"])
def test_a_world_without_anything_is_refused(name: str) -> None:
    with pytest.raises(OptionError, match="poses, landmarks, every and lanes must be at least 1"):
        simulate_single_numbers("range", **{name: 0})


def test_an_empty_cell_of_a_table_is_a_sighting_with_one_number() -> None:
    seconds = [0.1 * k for k in range(101)]
    log = Log.from_tables(
        {"t": seconds, "v": [0.5] * 101, "w": [0.2] * 101},
        {
            "t": [1.0, 2.0, 3.0],
            "id": [3, 3, 4],
            "range": [2.0, np.nan, 1.5],
            "bearing": [0.1, 0.4, np.nan],
        },
    )
    assert len(log.steps) == 1 and log.partial_sightings is not None
    assert log.partial_sightings.landmarks.tolist() == [3, 4]
    assert np.array_equal(log.partial_sightings.ranges, [np.nan, 1.5], equal_nan=True)
    assert np.array_equal(log.partial_sightings.bearings, [0.4, np.nan], equal_nan=True)
    assert "2 of 3 sightings have a range or a bearing alone" in log.notes
    # a table without the other column is the same, unless another column may be the one that is missing
    odometry = {"t": seconds, "v": [0.5] * 101, "w": [0.2] * 101}
    alone = Log.from_tables(odometry, {"t": [1.0, 2.0], "id": [3, 4], "bearing": [0.4, 0.1]})
    assert alone.partial_sightings is not None and np.isnan(alone.partial_sightings.ranges).all()
    assert alone.partial_sightings.bearings.tolist() == [0.4, 0.1]
    assert any("have a range or a bearing alone" in note for note in alone.notes)
    with pytest.raises(LogError, match="no column for bearing"):
        Log.from_tables(
            odometry, {"t": [1.0, 2.0], "id": [3, 4], "range": [2.0, 3.0], "x": [1.0, 2.0], "y": [1.0, 0.0]}
        )
    with pytest.raises(LogError, match="no column for range"):
        Log.from_tables(odometry, {"t": [1.0, 2.0], "id": [3, 4], "bearing": [0.4, 0.1], "way": [2.0, 3.0]})
    with pytest.raises(LogError, match="empty or NaN"):
        Log.from_tables(
            {"t": seconds, "v": [0.5] * 101, "w": [0.2] * 101},
            {"t": [1.0, 2.0], "id": [3, 3], "range": [2.0, np.nan], "bearing": [0.1, np.nan]},
        )


def test_step_by_step_they_count_beside_whole_sightings() -> None:
    log = simulate(seed=5, steps=40, clean=True, orientation=False)
    rows = np.arange(0, len(log.steps), 3)
    partial = PartialSightings(
        steps=log.steps[rows], landmarks=log.landmarks[rows], ranges=log.sightings[rows, 0],
        bearings=np.full(len(rows), np.nan),
    )  # fmt: skip
    left = np.setdiff1d(np.arange(len(log.steps)), rows)
    mixed = log.replace(
        steps=log.steps[left], landmarks=log.landmarks[left], sightings=log.sightings[left], partial_sightings=partial
    )
    batch = solve(Graph.from_log(mixed))
    for backend in ("own", "isam2"):
        online = solve_online(mixed, backend=backend, relinearize=backend == "isam2")
        assert online.cost == pytest.approx(batch.cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "kernel"),
    [
        ("range", "cauchy"),
        ("bearing", "none"),
        pytest.param("range", "none", marks=pytest.mark.nightly),
        pytest.param("bearing", "cauchy", marks=pytest.mark.nightly),
    ],
)
def test_step_by_step_is_the_batch_solution(number: str, kernel: str) -> None:
    log = simulate_single_numbers(number, seed=43, poses=150, landmarks=5)
    batch = solve(Graph.from_log(log, kernel=kernel))
    online = solve_online(log, kernel=kernel)
    assert online.converged and batch.cost * (1 - 1e-9) <= online.cost <= batch.cost * (1 + 1e-6)
    found, known = online.covariance(poses=[0, 140]), batch.covariance(poses=[0, 140])
    np.testing.assert_allclose(found, known, rtol=0.02, atol=1e-9)


def test_step_by_step_a_mirror_image_is_said() -> None:
    log = straight()
    online = solve_online(log)
    assert np.allclose(np.abs(online.landmarks[7]), [10.0, 4.0], atol=0.5)
    assert any("landmark 7 may be elsewhere" in note for note in online.notes)
    # until the end, nothing says on which side it is
    assert log.partial_sightings is not None
    *_, solver = replay(log)
    assert solver.waiting == {7: 40} and solver.landmarks == {}


@pytest.mark.slow
def test_with_a_lag_single_numbers_still_place_landmarks() -> None:
    log = simulate_single_numbers("range", seed=12, poses=200, every=1)
    truth = log.true_poses
    assert truth is not None and log.true_landmarks is not None
    whole, lagged = (solve_online(log, **options) for options in ({}, {"lag": 60}))
    assert lagged.converged
    # at most as far from the truth as three standard deviations of what a lag leaves out: landmarks that are seen again later
    far = [np.hypot(*(each.poses - truth)[:, :2].T).max() for each in (whole, lagged)]
    assert far[1] < 3 * far[0] + 0.5


@pytest.mark.slow
@pytest.mark.parametrize("number", ["range", "bearing"])
def test_step_by_step_with_isam2_is_the_batch_solution(number: str) -> None:
    """Numbers of a landmark without a place wait; when it has one, all of them are in the graph."""
    log = simulate_single_numbers(number, seed=7, poses=120, landmarks=4)
    single, motion = log.partial_sightings, log.motion
    assert single is not None and motion is not None and log.controls is not None and log.dt is not None
    motions, covariances = log.motions(motion)
    solver = OnlineSolver(log.initial_poses[0], backend="isam2", motion=motion, sensor=log.sensor)
    for t in range(log.num_poses):
        if t:
            solver.relate(t - 1, t, motions[t - 1], covariances[t - 1])
        now = single.steps == t
        if now.any():
            solver.observe(single.landmarks[now], np.column_stack([single.ranges[now], single.bearings[now]]))
    solver.relinearize()
    batch = solve(Graph.from_log(log, kernel="none"))
    assert sorted(solver.landmarks) == sorted(batch.landmarks)
    np.testing.assert_allclose(solver.poses, batch.poses, atol=1e-5)


def test_bad_single_numbers_step_by_step() -> None:
    solver = OnlineSolver()
    for sighting in ([np.nan, np.nan], [np.nan, 0.1, 0.2], [-1.0, np.nan], [np.inf, np.nan]):
        with pytest.raises(OptionError, match="sightings must be"):
            solver.observe([1], [sighting])
    solver.observe([1], [[2.0, np.nan]])
    assert solver.waiting == {1: 1} and solver.landmarks == {}
    in_map = OnlineSolver(map={1: (3.0, 0.0), 2: (0.0, 3.0)})
    with pytest.raises(OptionError, match="needs the id of its landmark"):
        in_map.observe(None, [[2.0, np.nan]])


def test_some_of_two_edges_keep_the_place_of_the_sensor():
    """The place of the sensor has two numbers, as many as there are edges."""
    edges = RangeEdges(np.array([0, 1]), np.array([2, 2]), np.ones((2, 1)), np.ones((2, 1, 1)), np.array([0.3, -0.1]))
    one = edges.among(np.array([True, False]))
    assert one.count == 1
    assert one.offset.tolist() == [0.3, -0.1]
