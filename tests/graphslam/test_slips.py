"""Stretches on which wheels slip or a gyroscope misreads are found, reported and corrected; other drives stay as they are."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from comparisons.show.language import translated
from graphslam import Drive, Graph, MotionModel, SensorModel, estimate_robot, simulate, solve
from graphslam.identification import slips
from graphslam.identification.robot import with_checked_ids
from graphslam.log.join import end_to_end
from graphslam.metrics import ate
from graphslam.simulation.worlds import SENSORS
from graphslam.solvers import contradictions

ROBOT = {"motion": MotionModel(nn=0.05, on=0.03, oo=0.05), "sensor": SensorModel(range_rate=0.02, bearing_std=0.02)}
#: the odometry reads so many times the true values
FACTORS = {"speed": (1.8, 1.0), "turn": (1.0, 2.0)}


def graph_of(seed, *, factors=(1.0, 1.0), steps=slice(60, 70)):
    """The graph of a known robot whose odometry is wrong in some steps."""
    log = simulate(seed=seed, steps=150, clean=True, orientation=False, max_range=5.0, **ROBOT)
    controls = log.controls.copy()
    controls[steps] *= factors
    log = log.replace(controls=controls, **ROBOT)
    log = log.replace(initial_poses=log.dead_reckoning())
    return Graph.from_log(log, edges="landmark+motion", kernel="cauchy")


def drive(seed, *, column=None, factor=1.0, between=(40.0, 52.0), **options):
    """A drive of two minutes of a robot that nobody knows, which may slip."""
    log, truth = replace(Drive.random(seed), duration=120.0, **options).simulate()
    if column is not None:
        ends, controls = np.cumsum(log.dt), log.controls.copy()
        controls[(ends > between[0]) & (ends <= between[1]), column] *= factor
        log = log.replace(controls=controls)
    return log.replace(initial_poses=log.dead_reckoning()), truth


@pytest.mark.parametrize("kind", FACTORS)
@pytest.mark.parametrize("seed", range(3))
def test_a_known_robot_that_slips_is_corrected(seed, kind, monkeypatch):
    graph = graph_of(seed, factors=FACTORS[kind])
    solution, truth = solve(graph), graph.log.true_poses
    (note,) = (each for each in solution.notes if each.startswith("between steps"))
    assert "オドメトリはほかの計測と" in translated(note, "ja")
    variances = solution.graph.log.control_variances[:, list(FACTORS).index(kind)]
    assert np.all(variances[60:70] > 0) and np.count_nonzero(variances) <= 20
    assert ate(truth, solution.poses) < 2 * solution.expected_ate
    assert np.nanmean(solution.nees(truth)) < 2
    # as it was
    monkeypatch.setattr("graphslam.solvers.contradictions.without_slips_of", lambda solution, _: (solution, ()))
    wrong = solve(graph)
    assert wrong.cost > 1.5 * solution.cost
    if kind == "speed":
        # sightings tell headings well
        assert ate(truth, wrong.poses) > 2 * ate(truth, solution.poses)


@pytest.mark.parametrize("seed", [1015, pytest.param(1010, marks=pytest.mark.nightly)])
def test_wheels_that_read_zero_while_the_robot_moves(seed, monkeypatch):
    """Such odometry is nearly exact by every model, so that sightings seem to be wrong instead, and count little."""
    log, _ = drive(seed, column=0, factor=0.0, between=(40.0, 48.0))
    found = estimate_robot(log)
    solution = solve(Graph.from_log(found.log))
    assert any(slip.begin < 48 and slip.end > 48 and slip.column == 0 for slip in found.slips)
    assert ate(log.true_poses, solution.poses) < 2 * solution.expected_ate
    monkeypatch.setattr(
        "graphslam.identification.robot.without_contradicted", lambda solved, log, *_: (solved, log, ())
    )
    assert ate(log.true_poses, solve(Graph.from_log(estimate_robot(log).log)).poses) > 5 * ate(
        log.true_poses, solution.poses
    )


def test_a_robot_that_is_carried_far_is_said():
    """Between two parts of a drive somebody carries the robot for 12 m, of which the odometry knows nothing."""
    log, _ = replace(Drive.random(1002), duration=200.0).simulate()
    parts = log.at_steps(np.flatnonzero(log.times < 90)), log.at_steps(np.flatnonzero(log.times > 110))
    carried = end_to_end(*parts).replace(control_variances=None, sessions=())
    # within a second
    carried = carried.replace(dt=np.minimum(carried.dt, 1.0), recorded_dt=np.minimum(carried.recorded_dt, 1.0))
    solution = solve(Graph.from_log(carried.replace(initial_poses=carried.dead_reckoning())))
    assert ate(carried.true_poses, solution.poses) > 5 * solution.expected_ate
    (note,) = (each for each in solution.notes if each.startswith("between steps"))
    assert "covariances do not contain it" in note
    first, last = map(int, re.findall(r"\d+", note)[:2])
    assert first <= parts[0].num_poses - 1 < last


@pytest.mark.parametrize("seed", range(3))
def test_a_known_robot_that_does_not_slip_stays(seed, monkeypatch):
    solution = solve(graph_of(seed))
    assert not any("between steps" in note for note in solution.notes)
    monkeypatch.setattr("graphslam.solvers.contradictions.without_slips_of", lambda solution, _: (solution, ()))
    np.testing.assert_array_equal(solve(graph_of(seed)).state, solution.state)


def test_where_parameters_are_estimated_a_slip_is_only_said():
    graph = graph_of(0, factors=FACTORS["turn"])
    graph = Graph.from_log(graph.log, edges="landmark+motion", kernel="cauchy", estimate="wheel_scale")
    solution = solve(graph)
    (note,) = (each for each in solution.notes if each.startswith("between steps"))
    assert "covariances do not contain it" in note and solution.graph.log.control_variances is None
    assert "共分散はこれを含みません" in translated(note, "ja")


def test_z_is_that_of_a_further_unknown(monkeypatch):
    """The largest z of constant errors of the speed, here from whole matrices."""
    solution, tested = solve(graph_of(1)), []

    def kept(*arguments):
        tested.append(slips._Tested(*arguments[:-1]))
        return None, 1.0

    monkeypatch.setattr(contradictions, "largest_slip", kept)
    # without the stretches around it that fit nearly as well
    monkeypatch.setattr(slips, "ROUGHLY", 1e-9)
    contradictions._largest_slip(solution, 0.0)
    (one,), graph = tested, solution.graph
    found, _ = one.largest(slips.CELLS, (0,))
    D = slips._errors(one.ways, np.zeros(len(one.ways.measured), dtype=int), 1)[:, :, 0]
    weighted = np.einsum("eij,ej->ei", one.motions.information, D)
    pulled = np.zeros((len(D), len(graph.initial), 3))
    every = np.arange(len(D))
    pulled[every, one.motions.first] += np.einsum("eji,ej->ei", one.motions.by_first, weighted)
    pulled[every, one.motions.second] += np.einsum("eji,ej->ei", one.motions.by_second, weighted)
    pulled = pulled.reshape(len(D), -1)
    u, own = np.sum(weighted * one.motions.residuals, axis=1), np.diag(np.sum(weighted * D, axis=1))
    P = own - pulled @ np.linalg.pinv(graph.linearize(solution.state)[0].to_sparse().toarray()) @ pulled.T
    # cells are a little longer than motions, so that a few have two of them
    limits = np.linspace(0, one.ways.times[-1] - one.ways.times[0], slips.CELLS + 1)
    cell = np.searchsorted(limits, (one.ways.times[1:] + one.ways.times[:-1]) / 2 - one.ways.times[0]) - 1
    z = []
    for begin in range(slips.CELLS):
        for end in range(begin, min(begin + slips.CELLS // 3, slips.CELLS)):
            inside = (cell >= begin) & (cell <= end)
            if inside.any():
                z.append(abs(u[inside].sum()) / np.sqrt(P[np.ix_(inside, inside)].sum()))
    assert found.z == pytest.approx(max(z), rel=1e-6)


@pytest.mark.parametrize(
    ("seed", "column", "factor"), [pytest.param(1016, 0, 1.4, marks=pytest.mark.nightly), (1002, 1, 0.5)]
)
def test_an_unknown_robot_that_slips_is_corrected(seed, column, factor):
    log, _ = drive(seed, column=column, factor=factor)
    robot = estimate_robot(log)
    assert robot.slips and all(slip.column == column for slip in robot.slips)
    assert robot.slips[0].begin < 46 < robot.slips[0].end
    assert any(doubt.startswith("between steps") for doubt in robot.doubts)
    # the drive as it was recorded, whose ids may be unknown; and another drive of the robot, which did not slip then
    np.testing.assert_allclose(robot.corrected(log).control_variances, robot.log.control_variances)
    assert robot.corrected(log.replace(start_time=log.start_time + 1e4)).control_variances is None
    solution = solve(Graph.from_log(robot.log))
    assert ate(log.true_poses, solution.poses) < 2 * solution.expected_ate
    right = estimate_robot(drive(seed)[0])
    assert right.slips == ()
    # ids count as right as without the slip
    assert robot.ids.share == pytest.approx(right.ids.share, abs=0.01)


def test_ids_are_checked_beside_a_slip():
    log, truth = drive(1016, column=0, factor=1.4, parameters={})
    checked = with_checked_ids(
        log.replace(landmarks=truth.landmarks).with_sightings(~truth.clutter), truth.motion, truth.sensor
    )
    assert any(note.startswith("between steps") for note in checked.notes)
    assert checked.control_variances.any()


def test_a_slip_has_the_error_as_its_standard_deviation():
    """The variance of the way over the stretch is (rate times duration)^2."""
    log = simulate(seed=0, steps=50).replace(**ROBOT)
    slip = slips.Slip(begin=10 * log.dt[0], end=20 * log.dt[0], column=0, rate=0.3, z=9.0)
    more = slips.with_slip(log, slip).control_variances
    assert np.flatnonzero(more.any(axis=1)).tolist() == list(range(10, 20))
    assert np.sum(more[:, 0] * log.dt**2) == pytest.approx((0.3 * (slip.end - slip.begin)) ** 2)


@pytest.mark.parametrize("seed", [4, 5])
def test_a_slip_that_the_weights_make_small_is_found_by_the_likelihood(seed, monkeypatch):
    robot = Drive(
        seed=seed,
        duration=120.0,
        landmarks=40,
        misread=0.0,
        sensor_rate=2.0,
        odometry_rate=20.0,
        sensor=SENSORS["laser"],
    )
    log = robot.simulate()[0]
    ends, controls = np.cumsum(log.dt), log.controls.copy()
    controls[(ends > 60.0) & (ends <= 62.5), 0] *= 1.8
    log = log.replace(controls=controls)
    log = log.replace(initial_poses=log.dead_reckoning())
    (slip,) = estimate_robot(log).slips
    assert slip.z < slips.SLIPPED and slip.begin < 62.5 and slip.end > 60.0
    monkeypatch.setattr(slips, "SUSPECTED", slips.SLIPPED)
    monkeypatch.setattr(slips, "contradicted", lambda _: None)
    assert not estimate_robot(log).slips
