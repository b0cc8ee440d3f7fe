"""A sensor that was turned on its robot, and a lens, are found and reported, and the bearings are corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from comparisons.show.language import translated
from graphslam import Drive, Graph, estimate_robot, simulate, solve
from graphslam.identification import sensor_errors
from graphslam.identification.sensor_errors import Lens, Turn, turned_back, undistorted
from graphslam.log.cells import DOUBTFUL_NOISE
from graphslam.log_checks import check_log
from graphslam.metrics import ate
from graphslam.se2 import wrap

#: when the sensor is turned, and by how much
TIME, ANGLE = 100.0, 0.06


def turned(seed, turns=((TIME, ANGLE),)):
    """A drive of 200 s of a robot that nobody knows, whose sensor is turned now and then, and the log as it was before."""
    log, _ = replace(Drive.random(seed), duration=200.0).simulate()
    sightings, times = log.sightings.copy(), log.times[log.steps] - log.times[0]
    for time, angle in turns:
        sightings[times > time, 1] = wrap(sightings[times > time, 1] + angle)
    return log.replace(sightings=sightings), log


@pytest.mark.parametrize("seed", [1002, pytest.param(1012, marks=pytest.mark.nightly)])
def test_a_turned_sensor_is_found_and_corrected(seed, monkeypatch):
    log, right = turned(seed)
    robot = estimate_robot(log)
    (turn,) = robot.turns
    assert abs(turn.angle - ANGLE) < 4 * turn.error and turn.error < ANGLE / 5
    assert abs(turn.time - TIME) < 5
    (doubt,) = (each for each in robot.doubts if "the sensor was turned" in each)
    assert "センサの向きが変わった" in translated(doubt, "ja")
    # another drive of the robot began with the sensor in one of the two directions
    other = log.replace(start_time=log.start_time + 1e4)
    later = log.times[log.steps] - log.times[0] > turn.time
    differ = robot.corrected(other).sightings[:, 1] - robot.corrected(log).sightings[:, 1]
    np.testing.assert_allclose(wrap(differ), np.where(later, turn.angle, 0.0), atol=0.02)
    solution = solve(Graph.from_log(robot.log))
    assert np.nanmean(solution.nees(log.true_poses)) < 3
    unturned = estimate_robot(right)
    assert unturned.turns == ()
    best = solve(Graph.from_log(unturned.log))
    assert ate(log.true_poses, solution.poses) < 1.5 * ate(log.true_poses, best.poses)
    # as it was
    monkeypatch.setattr("graphslam.identification.robot.turn_of", lambda *_: None)
    wrong = solve(Graph.from_log(estimate_robot(log).log))
    assert np.nanmean(wrong.nees(log.true_poses)) > 2 * np.nanmean(solution.nees(log.true_poses))


def test_the_doubts_of_drives_that_are_joined_are_those_of_each():
    """They were left out, although the bearings are corrected."""
    log, _ = turned(1002)
    graph = Graph.from_logs([log.replace(name="first"), log.replace(name="second")])
    said = [note for note in graph.notes if "the sensor was turned" in note]
    assert [note.partition(": from step ")[0] for note in said] == ["first", "second"]
    assert [each.message for each in check_log(graph.log) if each.check == DOUBTFUL_NOISE] == said


@pytest.mark.parametrize(("seed", "duration", "bias"), [(797933, 60.0, 0.223), (847624, 120.0, 0.196)])
def test_a_sensor_that_is_mounted_askew_was_not_turned(seed, duration, bias):
    """A bias of the whole drive far beyond its prior is not likelier in all but the first seconds."""
    drive = Drive.random(seed)
    log, _ = replace(drive, duration=duration, parameters={**drive.parameters, "bearing_bias": bias}).simulate()
    robot = estimate_robot(log)
    assert robot.turns == ()
    assert robot.parameters.values[robot.parameters.names.index("bearing_bias")] == pytest.approx(bias, abs=0.06)


def test_bearings_are_turned_back_from_each_moment_on():
    log, right = turned(1002, ((50.0, 0.1), (120.0, -0.2)))
    corrected = turned_back(log, [Turn(50.0, 0.1, 0.0), Turn(120.0, -0.2, 0.0)])
    np.testing.assert_allclose(corrected.sightings, right.sightings, atol=1e-12)
    assert turned_back(log, ()) is log


def test_z_is_that_of_a_further_unknown(monkeypatch):
    """z, angle and standard error, here from whole matrices of nodes and biases."""
    tested = []
    monkeypatch.setattr("graphslam.identification.robot.turn_of", lambda few, _: tested.append(few))
    estimate_robot(turned(1002)[0])
    (few,) = tested
    linear = few.linearized()
    n, K = linear.xi.size, len(linear.prior)
    H, gradient = np.zeros((n + K + 1, n + K + 1)), np.zeros(n + K + 1)
    H[n : n + K, n : n + K] = np.diag(linear.prior)
    gradient[n : n + K] = linear.prior * (few.parameters.values - few.parameters.means)
    later = few.log.times[few.seen_from] - few.log.times[0] > TIME
    for edges, step in zip(linear.edges, (np.zeros(len(linear.edges[0].first)), later)):
        for k in range(len(edges.first)):
            J = np.zeros((edges.residuals.shape[1], n + K + 1))
            J[:, 3 * edges.first[k] : 3 * edges.first[k] + 3] = edges.by_first[k]
            J[:, 3 * edges.second[k] : 3 * edges.second[k] + 3] += edges.by_second[k]
            J[:, n : n + K] = edges.by_parameters[k]
            J[1, -1] = step[k]
            H += J.T @ edges.information[k] @ J
            gradient += J.T @ edges.information[k] @ edges.residuals[k]
    free = np.ones(n + K + 1, dtype=bool)
    free[:3] = False
    if linear.flat:
        free[3 * few.poses + 2 : n : 3] = False
    step, covariance = -np.linalg.solve(H[np.ix_(free, free)], gradient[free]), np.linalg.inv(H[np.ix_(free, free)])
    z, angle, error = sensor_errors._steps(few, np.array([TIME]))
    assert angle[0] == pytest.approx(step[-1], rel=1e-4)
    assert error[0] == pytest.approx(covariance[-1, -1] ** 0.5, rel=1e-4)
    assert z[0] == pytest.approx(abs(step[-1]) / covariance[-1, -1] ** 0.5, rel=1e-4)


@pytest.mark.parametrize(
    ("seed", "near", "bend"), [(1001, 0.04, 0.0), pytest.param(1009, 0.0, 0.05, marks=pytest.mark.nightly)]
)
def test_a_scale_of_the_bearings_and_a_lens_are_found_and_corrected(seed, near, bend, monkeypatch):
    drive = Drive.random(seed)
    right, _ = replace(drive, duration=200.0).simulate()
    edge, sightings = drive.sensor.field_of_view / 2, right.sightings.copy()
    sightings[:, 1] *= 1 + near + bend * (sightings[:, 1] / edge) ** 2
    log = right.replace(sightings=sightings)
    robot = estimate_robot(log)
    lens = robot.lens
    assert (
        abs(lens.near - near) < 4 * lens.errors[0]
        and abs(lens.near + lens.bend - near - bend) < 4 * lens.errors[1] + 0.005
    )
    (doubt,) = (each for each in robot.doubts if "distortion of a lens" in each)
    assert "レンズの歪み" in translated(doubt, "ja")
    solution = solve(Graph.from_log(robot.log))
    healthy = estimate_robot(right)
    assert healthy.lens is None
    best = solve(Graph.from_log(healthy.log))
    assert ate(log.true_poses, solution.poses) < 1.5 * ate(log.true_poses, best.poses)
    # as it was
    monkeypatch.setattr("graphslam.identification.robot.lens_of", lambda _: None)
    wrong = solve(Graph.from_log(estimate_robot(log).log))
    assert ate(log.true_poses, wrong.poses) > 1.3 * ate(log.true_poses, solution.poses)


@pytest.mark.nightly
def test_a_lens_that_was_turned_is_one_lens_and_one_turn():
    """The axis of the lens turns with the sensor; undone in the other order, a part of the turn was found as a second one."""
    right, _ = replace(Drive.random(1002), duration=200.0).simulate()
    sightings = right.sightings.copy()
    sightings[right.times[right.steps] - right.times[0] > TIME, 1] -= 0.3
    sightings[:, 1] *= 1.05
    robot = estimate_robot(right.replace(sightings=sightings))
    (turn,) = robot.turns
    assert turn.angle == pytest.approx(-0.3, abs=0.01) and robot.lens.near == pytest.approx(0.05, abs=0.01)


def test_bearings_of_zero_have_no_lens():
    """A sensor that sees straight ahead alone has no field of view whose edge could be off."""
    places = np.random.default_rng(0).uniform(-10, 10, (40, 2))
    log = simulate(seed=1, steps=600, dt=0.5, clean=True, orientation=False, landmarks=places)
    log = log.with_sightings(np.abs(log.sightings[:, 1]) < 0.1)
    assert estimate_robot(log.replace(sightings=log.sightings * [1.0, 0.0])).lens is None


def test_a_log_without_the_error_of_its_lens():
    log, _ = replace(Drive.random(1003), duration=60.0).simulate()
    edge = float(np.abs(log.sightings[:, 1]).max())
    lens = Lens(0.02, 0.03, edge)
    c = log.sightings[:, 1]
    np.testing.assert_allclose(undistorted(log, lens).sightings[:, 1], c - 0.02 * c - 0.03 * c**3 / edge**2)
    assert undistorted(log, None) is log
    # the density of what was measured, by differences
    slopes = (lens.corrected(c + 1e-6) - lens.corrected(c - 1e-6)) / 2e-6
    inside = np.abs(c) < edge - 1e-5
    assert lens.log_density(c[inside]) == pytest.approx(np.log(slopes[inside]).sum(), abs=1e-4)


def test_sensors_that_see_all_around_have_no_lens(monkeypatch):
    """The error would have a jump at pi."""
    found = []
    monkeypatch.setattr("graphslam.identification.sensor_errors._growth", lambda *_: found.append(_))
    drive = next(d for d in map(Drive.random, range(1000, 1100)) if d.sensor.field_of_view > 6)
    assert estimate_robot(replace(drive, duration=60.0).simulate()[0]).lens is None and found == []
