"""Mistakes in a log are found before it is solved, each with its cause; correct logs are left alone."""

import numpy as np
import pytest

from graphslam import MotionModel, Stream, load, sample_log_path, simulate, synchronize
from graphslam.plausibility import pairs_of, plausibility
from graphslam.reading import UNIDENTIFIED


def checks(log):
    return [finding.check for finding in plausibility(log)]


@pytest.fixture(scope="module")
def sample():
    return load(sample_log_path()).replace(true_poses=None)


def bearings(log, change):
    sightings = log.sightings.copy()
    sightings[:, 1] = change(sightings[:, 1])
    return log.replace(sightings=sightings)


def controls(log, factors):
    return log.replace(controls=log.controls * factors, initial_poses=None)


MISTAKES = {
    "bearing sign": lambda log: bearings(log, lambda b: -b),
    "bearing sign (turn rates)": lambda log: controls(log, [1, -1]),
    "axes swapped": lambda log: bearings(log, lambda b: np.pi / 2 - b),
    "sensor direction": lambda log: bearings(log, lambda b: b + np.pi),
    "turn rate unit": lambda log: controls(log, [1, 180 / np.pi]),
    "speed unit": lambda log: controls(log, [1000, 1]),
    "range unit": lambda log: log.replace(sightings=log.sightings * [1000, 1, 1]),
    "contradiction": lambda log: bearings(log, np.rad2deg),
    "contradiction (ids)": lambda log: log.replace(landmarks=np.random.default_rng(0).permutation(log.landmarks)),
    "one landmark": lambda log: log.replace(landmarks=np.full_like(log.landmarks, 4)),
    "ids jump": lambda log: log.replace(landmarks=np.arange(len(log.landmarks))),
    "no motion": lambda log: controls(log, 0),
    "odometry swapped": lambda log: log.replace(controls=log.controls[:, ::-1], initial_poses=None),
    "scale": lambda log: controls(log, [3.6, 1]),
    "sensor direction (right)": lambda log: bearings(log, lambda b: b + np.pi / 2),
    "time unit": lambda log: log.replace(dt=1000 * log.dt),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_found(sample, name):
    findings = plausibility(MISTAKES[name](sample))
    assert name.partition(" (")[0] in [finding.check for finding in findings]
    for finding in findings:
        assert "\n" not in finding.message and finding.message[-1] not in ".?"


def test_the_message_names_the_cause_and_the_option(sample):
    (finding,) = plausibility(bearings(sample, lambda b: -b))
    assert finding.message.startswith(
        "the bearings, or else the turn rates, have the wrong sign (--bearings clockwise): read like this, they fit the "
        "odometry "
    )


@pytest.mark.parametrize("seed", range(10))
def test_correct_logs_are_left_alone(seed):
    assert not checks(simulate(seed=seed))
    assert not checks(simulate(seed=seed, clean=True))
    assert not checks(simulate(seed=seed).without_orientation())


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "robot"),
    [("mrclam6", 1), ("mrclam6", 3), ("lost_in_the_woods", None), ("simulated_535", None), ("simulated_8240", None)],
)
def test_real_logs_are_left_alone_and_their_mistakes_found(shared_data, name, robot):
    log = load(shared_data(name), robot=robot)
    assert not checks(log)
    log = log.replace(true_poses=None)
    assert "bearing sign" in checks(bearings(log, lambda b: -b))
    assert "axes swapped" in checks(bearings(log, lambda b: np.pi / 2 - b))


def precise(late=0.0):
    """A log without noise whose robot meanders, with sightings whose clock is late."""
    t = np.arange(0, 120, 0.05)
    u = np.column_stack([0.5 + 0 * t, 0.6 * np.sin(t / 2)])
    path = MotionModel().dead_reckoning(np.zeros(3), u[:-1], np.diff(t))
    rng = np.random.default_rng(0)
    marks = rng.uniform(path[:, :2].min() - 3, path[:, :2].max() + 3, (30, 2))
    at, ids, rows = [], [], []
    for k in range(0, len(t) - 40, 5):
        d = marks - path[k, :2]
        for j in np.flatnonzero(np.hypot(*d.T) < 4):
            at.append(t[k] + late)
            ids.append(j)
            rows.append((np.hypot(*d[j]), np.arctan2(d[j, 1], d[j, 0]) - path[k, 2]))
    return synchronize(Stream(t, u), Stream(np.array(at), np.array(rows)), np.array(ids))


def test_a_clock_that_is_late_is_found():
    assert not checks(precise())
    (finding,) = plausibility(precise(1.2))
    assert finding.check == "clock"
    assert "the clock of the sightings is about 1.2 s fast (--clocks sightings=-1.2)" in finding.message


def test_other_units_and_directions_are_found():
    log = precise()
    (finding,) = plausibility(log.replace(sightings=log.sightings / [0.3048, 1]))
    assert finding.message.startswith("the ranges are in feet, against the other lengths")
    (finding,) = plausibility(bearings(log, lambda b: b - np.pi / 3))
    assert finding.message.startswith("the sensor looks about 60 degrees to the left (--sensor-yaw 1.0472)")
    (finding,) = plausibility(bearings(log, lambda b: np.pi / 2 - b))
    assert finding.check == "axes swapped"


def test_truth_that_does_not_fit(sample):
    log = load(sample_log_path())
    assert checks(log.replace(true_poses=log.true_poses * [0.001, 0.001, 1])) == ["truth scale"]
    assert "truth sign" in checks(log.replace(true_poses=log.true_poses * [1, -1, -1]))
    turned = log.true_poses + [0, 0, np.pi / 2]
    assert checks(log.replace(true_poses=turned)) == ["truth heading"]


def test_logs_that_cannot_be_checked(sample):
    assert not checks(sample.replace(dt=None, controls=None))
    assert not checks(sample.replace(landmarks=np.full_like(sample.landmarks, UNIDENTIFIED)))
    assert not checks(sample.at_steps([0]))
    assert pairs_of(sample.at_steps([0, 1])) is None


def test_duplicate_ids(sample):
    other = sample.landmarks.copy()
    other[other == 9] = 6
    assert "duplicate ids" in checks(sample.replace(landmarks=other))
