"""Which noise models a graph has: those that are given, estimated or the book's; and what its notes say of that."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from graphslam import Drive, Graph, Log, MotionModel, OptionError, estimate_robot, solve
from graphslam.identification.result import RobotEstimate
from graphslam.simulation.drives import DriveTruth


@cache
def warehouse() -> tuple[Log, DriveTruth, RobotEstimate]:
    log, truth = Drive(seed=5, duration=150.0, landmarks=20).simulate()
    return log, truth, estimate_robot(log)


def test_what_is_taken_out_of_a_log_stands_in_the_notes_of_graph_and_solution() -> None:
    log, _, found = warehouse()
    graph = Graph.from_log(log)
    assert set(found.sentences) <= set(graph.notes) and set(graph.notes) <= set(solve(graph).notes)
    assert found.ids.sentence in graph.notes and any("biases estimated from this log" in note for note in graph.notes)


def test_a_noise_model_that_is_given_is_kept_and_the_other_one_estimated() -> None:
    log, truth, found = warehouse()
    given = replace(truth.sensor, offset=(0.0, 0.0))
    graph = Graph.from_log(log, sensor=given)
    assert graph.sensor is not None and graph.sensor.range_std == given.range_std
    assert graph.sensor.bearing_std == given.bearing_std and graph.sensor.offset == found.sensor.offset
    assert graph.motion == found.motion
    (note,) = (each for each in graph.notes if each.startswith("the noise of the sensor is the given one"))
    # its place is estimated from the one that is given
    assert "its place, given as (0, 0) m, is estimated as" in note
    moved = Graph.from_log(log, motion=MotionModel(nn=0.07))
    assert moved.motion == MotionModel(nn=0.07) and moved.sensor == found.sensor
    assert Graph.from_log(log, sensor=given, noise="book").motion == MotionModel()
    with pytest.raises(OptionError, match="leave it out"):
        Graph.from_log(log, motion=MotionModel(), sensor=given, noise="auto")
    few = Graph.from_log(log.at_steps(range(10)), motion=MotionModel(nn=0.07))
    assert any(note.startswith("the noise of the sensor is the book's, because") for note in few.notes)
