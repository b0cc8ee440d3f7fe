"""Robots with ranges or bearings alone whose noise nobody knows; `benchmarks/unknown_single_numbers.py` has many."""

from dataclasses import replace
from types import SimpleNamespace

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
    PartialSightings,
    SensorModel,
    estimate_robot,
    solve,
)
from graphslam.association import known_noise
from graphslam.identification.corrections import without_biases
from graphslam.identification.known import known_robot
from graphslam.log.rows import NO_ID, UNIDENTIFIED
from graphslam.metrics import ate, mean_nees
from graphslam.solvers import unknown_robot


def drive(ranged: bool | None, seed: int = 1, **parameters: float) -> Log:
    """A minute of a robot that sees ranges alone, bearings alone, or (None) one after the other."""
    settings = Drive(seed=seed, duration=60.0, misread=0.0, parameters=parameters)
    log, truth = settings.simulate()
    rows = np.arange(len(log.steps))
    keep = rows % 2 == 0 if ranged is None else np.full(len(rows), ranged)
    numbers = PartialSightings(
        steps=log.steps, landmarks=truth.landmarks, ranges=np.where(keep, log.sightings[:, 0], np.nan),
        bearings=np.where(keep, np.nan, log.sightings[:, 1]),
    )  # fmt: skip
    return log.with_sightings(np.zeros(len(rows), dtype=bool)).replace(partial_sightings=numbers)


@pytest.mark.slow
@pytest.mark.parametrize("ranged", [*(pytest.param(each, marks=pytest.mark.nightly) for each in (True, False)), None])
def test_noise_is_estimated_by_default(ranged):
    log = drive(ranged)
    book, graph = solve(Graph.from_log(log, noise="book")), Graph.from_log(log)
    solution = solve(graph)
    true = log.true_poses
    assert mean_nees(book.poses, true, book.covariance()) < 0.1
    assert 0.1 < mean_nees(solution.poses, true, solution.covariance()) < 4
    assert ate(solution.poses, true) < 2 * ate(book.poses, true)
    assert solution.cost < 1.5 * graph.expected_cost
    assert not any("book" in note or "partial sightings" in note for note in (*graph.notes, *graph.log.notes))


@pytest.mark.nightly
def test_biases_are_taken_out_where_the_numbers_show_them():
    log = drive(True, wheel_scale=1.04)
    found = estimate_robot(log)
    k = found.parameters.names.index("wheel_scale")
    assert found.parameters.values[k] > 1.02
    assert found.parameters.values[k] == pytest.approx(1.04, abs=4 * found.parameters.deviations["wheel_scale"])
    np.testing.assert_allclose(found.log.controls[:, 0], log.controls[:, 0] / found.parameters.values[k])
    solution = solve(Graph.from_log(found.log))
    assert 1 / 3 < mean_nees(solution.poses, log.true_poses, solution.covariance()) < 4


@pytest.mark.nightly
def test_bearings_leave_lengths_to_the_odometry():
    # in the same way as the command
    log, found = known_noise(drive(False, wheel_scale=1.04))
    assert found is not None and log.motion == found.motion
    assert "wheel_scale" not in found.parameters.names
    assert log.uncertain["wheel_scale"] == 0.03
    assert any(
        "not show a bias of the odometry beside its noise: turn_rate_bias, curv" in each for each in found.remarks
    )
    assert found.remarks[-1].startswith("not estimated from these ranges and bearings alone: sensor_delay, wheel_scale")


@pytest.mark.slow
def test_numbers_that_hardly_show_the_noise_of_the_odometry_are_doubted():
    doubt = "too short, or the sensor too poor, to tell the noise of the odometry"
    # a minute of ranges of a few landmarks, and of bearings
    doubts = [estimate_robot(drive(ranged)).doubts for ranged in (True, False)]
    assert [any(doubt in each for each in one) for one in doubts] == [True, False]


def test_noise_is_found_whatever_is_imported():
    # graphs, online solvers and drives ask this function; sightings are those of another estimator
    log = drive(True)
    few = log.replace(partial_sightings=log.partial_sightings.among(np.arange(40)))
    assert "40 ranges and bearings alone" in known_robot(few)[0].notes[-1]


def test_biases_are_taken_out_of_all_sightings_or_refused():
    full, truth = Drive(seed=1, duration=20.0, misread=0.0).simulate()
    half = np.arange(len(full.steps)) % 2 == 0
    numbers = PartialSightings(
        steps=full.steps[~half], landmarks=truth.landmarks[~half], ranges=full.sightings[~half, 0],
        bearings=np.full(np.sum(~half), np.nan),
    )  # fmt: skip
    mixed = full.with_sightings(half, landmarks=truth.landmarks[half]).replace(partial_sightings=numbers)
    corrected = without_biases(mixed, range_bias=0.2)
    np.testing.assert_allclose(corrected.sightings[:, 0], mixed.sightings[:, 0] - 0.2)
    np.testing.assert_allclose(corrected.partial_sightings.ranges, numbers.ranges - 0.2)
    assert "alone keep the delay" in without_biases(mixed, sensor_delay=0.1).notes[-1]
    alone = mixed.with_sightings(np.zeros(np.sum(half), dtype=bool))
    with pytest.raises(LogError, match="out of which sensor_delay cannot be taken"):
        without_biases(alone, sensor_delay=0.1)
    with pytest.raises(LogError, match="partial sighting .* which a range bias of 50 m takes below zero"):
        without_biases(alone, range_bias=50.0)


@pytest.mark.parametrize("id", [UNIDENTIFIED, NO_ID])
def test_single_numbers_need_ids(id):
    with pytest.raises(LogError, match="partial sighting 1 has no id"):
        PartialSightings(steps=[0, 1], landmarks=[3, id], ranges=[1.0, 1.0], bearings=[np.nan, np.nan])


def test_covariances_say_that_they_lack_biases_of_the_sensor():
    log = drive(True)
    names = dict.fromkeys(("range_bias", "sensor_left", "wheel_scale"), 0.03)
    graph = Graph.from_log(log.replace(motion=MotionModel(), sensor=SensorModel(), uncertain=names))
    assert graph.held.names == ("wheel_scale",)
    assert any(note.endswith("taken out of the log: range_bias, sensor_left") for note in graph.notes)


def test_a_robot_that_stands_is_refused_in_plain_words():
    steps, ids = np.repeat(np.arange(41), 3), np.tile(np.arange(3), 41)
    ranges = 5.0 + ids + 0.01 * np.random.default_rng(0).normal(size=len(ids))
    numbers = PartialSightings(steps=steps, landmarks=ids, ranges=ranges, bearings=np.full(len(ids), np.nan))
    log = Log(
        dt=np.ones(40), controls=np.zeros((40, 2)), steps=[], landmarks=[], sightings=np.zeros((0, 2)),
        partial_sightings=numbers,
    )  # fmt: skip
    with pytest.raises(GraphError, match="give no landmark a place"):
        estimate_robot(log)


def test_the_estimate_begins_with_the_sensor_that_was_given(monkeypatch):
    monkeypatch.setattr(unknown_robot, "solve", lambda graph: SimpleNamespace(poses=graph.sensor, landmarks={}))
    monkeypatch.setattr(unknown_robot, "_from_solution", lambda _, sensor, first, __: (sensor.offset, first.offset))
    log, given = drive(True), (MotionModel(), SensorModel(offset=(1.0, 0.0)))
    assert estimate_robot(log, given=given) == ((1.0, 0.0), (1.0, 0.0))
    assert estimate_robot(log, sensor=SensorModel(offset=(0.5, 0.0)), given=given) == ((0.5, 0.0), (0.5, 0.0))
    assert estimate_robot(log) == ((0.0, 0.0), (0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(("count", "told"), [(1, False), (15, False), (200, True)])
def test_few_ranges_among_bearings_leave_lengths_to_the_odometry(count, told, monkeypatch):
    bearings, ranges = drive(False), drive(True).partial_sightings
    numbers, few = bearings.partial_sightings, np.arange(len(ranges)) % (len(ranges) // count) == 0
    mixed = PartialSightings(
        steps=numbers.steps, landmarks=numbers.landmarks, ranges=np.where(few, ranges.ranges, np.nan),
        bearings=np.where(few, np.nan, numbers.bearings),
    )  # fmt: skip
    solution = SimpleNamespace(poses=bearings.true_poses, landmarks=bearings.true_landmarks)
    monkeypatch.setattr(unknown_robot, "solve", lambda _: solution)
    monkeypatch.setattr(unknown_robot, "fit", lambda unknowns, _: (unknowns, {}))
    monkeypatch.setattr(unknown_robot, "hold_needless", lambda _, __: {})
    found = estimate_robot(bearings.replace(partial_sightings=mixed))
    assert ("wheel_scale" in found.parameters.names) == told
    assert ("wheel_scale" not in found.untested) == told
    # bearings tell where their sensor is, in metres of the odometry
    assert "sensor_ahead" not in found.untested


@pytest.mark.slow
def test_the_order_of_the_numbers_does_not_matter():
    log = drive(None)
    backwards = log.replace(partial_sightings=log.partial_sightings.among(np.arange(len(log.partial_sightings))[::-1]))
    one, other = estimate_robot(log), estimate_robot(backwards)
    assert other.sensor.range_std == pytest.approx(one.sensor.range_std, rel=1e-3)
    assert other.motion.nn == pytest.approx(one.motion.nn, rel=1e-2)


def test_few_numbers_are_refused_and_the_graph_says_that_the_noise_is_the_books():
    log = drive(True)
    few = log.replace(partial_sightings=log.partial_sightings.among(np.arange(40)))
    with pytest.raises(LogError, match="40 ranges and bearings alone from .* at least 60 sightings and 20 poses"):
        estimate_robot(few)
    assert any("the noise models are the book's" in note for note in solve(Graph.from_log(few)).notes)
    with pytest.raises(OptionError, match="given must be"):
        estimate_robot(log, given=replace(few))
