"""Robots with ranges or bearings alone whose noise nobody knows; `benchmarks/unknown_single_numbers.py` has many."""

from dataclasses import replace

import numpy as np
import pytest

from graphslam import Drive, Graph, Log, LogError, OptionError, PartialSightings, estimate_robot, solve
from graphslam.association import known_noise
from graphslam.identification.robot import known_robot
from graphslam.metrics import ate, mean_nees


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


@pytest.mark.parametrize("ranged", [True, False, None])
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


def test_biases_are_taken_out_where_the_numbers_show_them():
    log = drive(True, wheel_scale=1.04)
    found = estimate_robot(log)
    k = found.parameters.names.index("wheel_scale")
    assert found.parameters.values[k] > 1.02
    assert found.parameters.values[k] == pytest.approx(1.04, abs=4 * found.parameters.deviations["wheel_scale"])
    np.testing.assert_allclose(found.log.controls[:, 0], log.controls[:, 0] / found.parameters.values[k])
    solution = solve(Graph.from_log(found.log))
    assert 1 / 3 < mean_nees(solution.poses, log.true_poses, solution.covariance()) < 4


def test_bearings_leave_lengths_to_the_odometry():
    # in the same way as the command
    log, found = known_noise(drive(False, wheel_scale=1.04))
    assert found is not None and log.motion == found.motion
    assert "wheel_scale" not in found.parameters.names
    assert log.uncertain["wheel_scale"] == 0.03


def test_noise_is_found_whatever_is_imported():
    # graphs, online solvers and drives ask this function
    assert known_robot(drive(True))[1] is not None


def test_the_order_of_the_numbers_does_not_matter():
    log = drive(None)
    backwards = log.replace(partial_sightings=log.partial_sightings.among(np.arange(len(log.partial_sightings))[::-1]))
    one, other = estimate_robot(log), estimate_robot(backwards)
    assert other.sensor.range_std == pytest.approx(one.sensor.range_std, rel=1e-3)
    assert other.motion.nn == pytest.approx(one.motion.nn, rel=1e-2)


def test_few_numbers_are_refused_and_the_graph_says_that_the_noise_is_the_books():
    log = drive(True)
    few = log.replace(partial_sightings=log.partial_sightings.among(np.arange(40)))
    with pytest.raises(LogError, match="40 ranges and bearings alone from .* at least 60 of them and 20 poses"):
        estimate_robot(few)
    assert any("the noise models are the book's" in note for note in solve(Graph.from_log(few)).notes)
    with pytest.raises(OptionError, match="given must be"):
        estimate_robot(log, given=replace(few))
