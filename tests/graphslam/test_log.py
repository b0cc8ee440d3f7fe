from dataclasses import replace

import numpy as np
import pytest

from graphslam import (
    AbsolutePositions,
    Graph,
    GraphError,
    LandmarkMap,
    Log,
    LogError,
    MotionModel,
    OptionError,
    PoseRelations,
    SensorModel,
    load,
    save,
    solve,
)
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import PartialSightings


def make(**changes):
    arguments = {
        "dt": 0.5,
        "controls": [[1.0, 0.1], [1.0, 0.0]],
        "steps": [0, 1, 1],
        "landmarks": [7, 7, 3],
        "sightings": [[2.0, 0.1, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]],
    }
    return Log(**(arguments | changes))


def test_defaults_are_dead_reckoning_from_the_origin():
    log = make()
    np.testing.assert_allclose(log.dt, [0.5, 0.5])
    np.testing.assert_allclose(log.initial_poses, MotionModel().dead_reckoning(np.zeros(3), log.controls, log.dt))
    np.testing.assert_allclose(log.times, [0, 0.5, 1.0])
    assert log.num_poses == 3
    assert log.has_orientation
    assert log.landmark_ids.tolist() == [3, 7]
    assert not log.without_orientation().has_orientation


def test_angles_are_wrapped_and_arrays_are_read_only():
    log = make(sightings=[[2.0, np.pi, 9.0], [1.5, -7.0, 0.3], [4.0, 0.0, 3.0]])
    assert np.all((log.sightings[:, 1:] >= -np.pi) & (log.sightings[:, 1:] < np.pi))
    with pytest.raises(ValueError, match="read-only"):
        log.sightings[0, 0] = 1.0


def test_the_caller_keeps_its_arrays():
    sightings = np.array([[2.0, 0.1, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]])
    log = make(sightings=sightings)
    sightings[0, 0] = 99.0
    assert log.sightings[0, 0] == 2.0


def test_two_sightings_of_one_landmark_in_one_step_are_allowed_here():
    assert len(make(landmarks=[7, 3, 3]).steps) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": None}, "dt and controls belong together"),
        ({"dt": [0.5, 0.0]}, r"dt\[1\] is 0"),
        ({"dt": [0.5]}, "dt must have shape"),
        ({"controls": [[1.0, np.nan], [1.0, 0.0]]}, r"controls\[0, 1\] is nan"),
        ({"controls": [1.0, 2.0]}, "controls must have shape"),
        ({"dt": None, "controls": None}, "needs initial_poses"),
        ({"initial_poses": np.zeros((2, 3))}, r"initial_poses must have shape \(3, 3\)"),
        ({"true_poses": np.zeros((4, 3))}, "true_poses must have shape"),
        ({"steps": [0, 1, 3]}, "sighting 2 belongs to step 3, but the log has steps 0 to 2"),
        ({"steps": [1, 0, 1]}, "sighting 1 runs backwards"),
        ({"steps": [0, 1]}, "steps must have one entry per sighting"),
        ({"steps": [0.5, 1, 1]}, "steps must be whole numbers"),
        ({"classes": np.array(["red", None, "red"])}, "classes must be words, or whole numbers, not such as .*red"),
        ({"classes": [0.5, 1, 1]}, "classes must be words, or whole numbers"),
        ({"classes": ["red", "blue"]}, r"classes must have one entry per sighting, shape \(3,\)"),
        ({"landmarks": [None, 1, 2]}, "landmarks must be whole numbers, not such as None"),
        ({"sightings": [[-2.0, 0.1, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]]}, "sighting 0 has range -2 m"),
        ({"sightings": [[2.0, np.inf, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]]}, r"sightings\[0, 1\] is inf"),
        ({"sightings": [[2.0], [1.5], [4.0]]}, "sightings must have shape"),
        ({"true_landmarks": {3: [1.0]}}, r"true_landmarks\[3\] must be"),
        ({"start_time": np.nan}, "start_time"),
        (
            {"sightings": [[2.0, 20, 0], [1.5, -31, 0], [4.0, 5, 0]]},
            r"beyond 2 pi \(median 20 rad\): are they in degrees",
        ),
        (
            {"sightings": [[2.0, 0.2, 120], [1.5, -0.3, 9], [4.0, 0, 0]]},
            r"beyond 2 pi \(median 9 rad\): are they in degrees",
        ),
    ],
)
def test_impossible_logs_are_refused(changes, message):
    with pytest.raises(LogError, match=message):
        make(**changes)


def test_a_log_needs_no_sightings():
    relations = PoseRelations(first=[0, 1], second=[1, 2], motions=[[1, 0, 0.1]] * 2, covariances=0.01 * np.eye(3))
    log = Log(initial_poses=np.zeros((3, 3)), relations=relations)
    assert log.equals(Log(initial_poses=np.zeros((3, 3)), relations=relations, steps=[], landmarks=[], sightings=[]))
    np.testing.assert_allclose(solve(Graph.from_log(log)).poses[1], [1, 0, 0.1], atol=1e-9)
    one = Log(dt=[], controls=[], steps=[0], landmarks=[3], sightings=[[1.0, 0.1]])
    assert one.num_poses == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: PoseRelations(first=[0], second=[1], motions=[[1, 0, 90]], covariances=np.eye(3)),
        lambda: AbsolutePositions(steps=[0, 1], places=[[1, 0, np.nan], [1, 0, -90]], covariances=np.eye(3)),
        lambda: LandmarkMap({1: (1, 0, 90)}),
    ],
)
def test_headings_in_degrees_are_refused(make):
    with pytest.raises(OptionError, match="is 90 rad, beyond 8 pi: is it in degrees"):
        make()


def test_what_is_no_log_is_told_what_it_is(tmp_path):
    graph = Graph.from_log(make())
    for value, remedy in (
        (graph, "take its attribute log"),
        ([make()], "give one log; Graph.from_logs and"),
        (1, "graphslam.load"),
    ):
        with pytest.raises(OptionError, match=remedy):
            save(value, tmp_path / "log.npz")
    with pytest.raises(OptionError, match="Graph.save_g2o writes a graph"):
        save(replace(graph, log=None), tmp_path / "log.npz")


def fine(**changes):
    """Three poses, two and three controls apart."""
    arguments = {
        "dt": [0.1, 0.2, 0.3, 0.1, 0.1],
        "controls": [[1.0, 0.1], [1.0, 0.0], [0.5, 0.2], [0.4, -1.0], [0.1, 0.0]],
        "control_starts": [0, 2, 5],
        "true_poses": [[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 1.0, np.nan]],
    }
    return make(**(arguments | changes))


def test_odometry_finer_than_the_poses():
    log = fine(start_time=10.0)
    assert log.num_poses == 3
    assert log.composite and not make().composite
    np.testing.assert_allclose(log.times, [10.0, 10.3, 10.8])
    every = MotionModel().dead_reckoning(np.zeros(3), log.controls, log.dt)
    np.testing.assert_allclose(log.initial_poses, every[[0, 2, 5]])
    np.testing.assert_allclose(log.dead_reckoning(), log.initial_poses)
    assert log.covered.tolist() == [True, False, True]


def test_poses_left_out_join_their_motions():
    log = fine(control_variances=np.arange(15).reshape(5, 3), start_time=1.0)
    joined = log.at_steps([0, 2])
    assert joined.control_starts.tolist() == [0, 5]
    np.testing.assert_allclose(joined.dead_reckoning(), log.dead_reckoning()[[0, 2]])
    assert len(joined.steps) == 1  # what was seen from the pose between is gone
    end = log.at_steps([1, 2])
    assert end.start_time == pytest.approx(1.3)
    np.testing.assert_allclose(end.control_variances, log.control_variances[2:])
    assert end.steps.tolist() == [0, 0]
    assert log.nearer_than(2.0).sightings[:, 0].max() == 2.0
    alone = PartialSightings(
        steps=[0, 0, 1], landmarks=[1, 2, 1], ranges=[1.0, 3.0, np.nan], bearings=[np.nan, np.nan, 0.5]
    )
    assert log.replace(partial_sightings=alone).nearer_than(2.0).partial_sightings.landmarks.tolist() == [1, 1]
    with pytest.raises(LogError, match="must increase"):
        log.at_steps([1, 1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"control_starts": [0, 2, 2, 5]}, "increase from 0 to the number of controls"),
        ({"control_starts": [0, 2, 4]}, "increase from 0 to the number of controls"),
        ({"control_starts": [0.0, 2.0, 5.0]}, "whole numbers"),
        ({"control_variances": -np.ones((5, 2))}, "a variance is not negative"),
        ({"true_poses": [[0.0, np.nan, 0.0], [0] * 3, [0] * 3]}, "a row must be complete"),
        ({"true_poses": [[np.nan, np.nan, 0.0], [0] * 3, [0] * 3]}, "a row must be complete"),
        ({"true_poses": [[np.inf, 0.0, 0.0], [0] * 3, [0] * 3]}, "finite"),
        ({"dt": None, "controls": None, "initial_poses": np.zeros((3, 3))}, "control_starts without controls"),
    ],
)  # fmt: skip
def test_impossible_odometry_is_refused(changes, message):
    with pytest.raises(LogError, match=message):
        fine(**changes)


def test_everything_survives_a_file(tmp_path):
    log = fine(
        control_variances=np.ones((5, 2)), landmarks=[UNIDENTIFIED, 7, 3], motion=MotionModel.constant(0.1, 0.2),
        sensor=SensorModel(range_std=0.3, offset=(0.2, 0.1)),
    )  # fmt: skip
    save(log, tmp_path / "log.npz")
    again = load(tmp_path / "log.npz")
    assert again.equals(log)
    assert (again.motion, again.sensor) == (log.motion, log.sensor)
    assert not log.identified and log.landmark_ids.tolist() == [3, 7]
    with pytest.raises(LogError, match="motions of several controls"):
        save(log.replace(true_poses=None), tmp_path / "log.txt")


def test_the_noise_of_a_log_is_the_default():
    log = make(motion=MotionModel(nn=0.5), sensor=SensorModel(range_rate=0.01))
    # the noise of a log decides which edges suit it, too
    edges = "virtual+motion"
    own = Graph.from_log(log, edges=edges)
    given = Graph.from_log(make(), motion=log.motion, sensor=log.sensor, edges=edges)
    assert own.cost(own.initial) == given.cost(given.initial) != Graph.from_log(make(), edges=edges).cost(given.initial)


def test_a_graph_needs_ids():
    with pytest.raises(GraphError, match="sightings without an id"):
        Graph.from_log(make(landmarks=[UNIDENTIFIED] * 3))
