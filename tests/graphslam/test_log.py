import numpy as np
import pytest

from graphslam import Log, LogError, MotionModel


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
        ({"sightings": [[-2.0, 0.1, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]]}, "sighting 0 has range -2 m"),
        ({"sightings": [[2.0, np.inf, 0.2], [1.5, 0.2, 0.3], [4.0, -0.1, 3.0]]}, r"sightings\[0, 1\] is inf"),
        ({"sightings": [[2.0], [1.5], [4.0]]}, "sightings must have shape"),
        ({"true_landmarks": {3: [1.0]}}, r"true_landmarks\[3\] must be"),
        ({"start_time": np.nan}, "start_time"),
    ],
)
def test_impossible_logs_are_refused(changes, message):
    with pytest.raises(LogError, match=message):
        make(**changes)
