"""The probability that a pose in a map is off by more than a bound: `graphslam.maps.tracker`, online and after a drive."""

import numpy as np
import pytest
from scipy.stats import norm

from comparisons.estimators import bounds_of
from comparisons.options import RunOptions
from graphslam import (
    Graph,
    LandmarkMap,
    MotionModel,
    OnlineSolver,
    OptionError,
    SensorModel,
    simulate,
    solve,
)
from graphslam.maps.stretch import Stretch
from graphslam.maps.tracker import beyond, inflation, presence
from graphslam.online import replay
from graphslam.se2 import compose, wrap

MODELS = {
    "motion": MotionModel(nn=0.05, no=0.001, on=0.02, oo=0.05, epsilon=1e-6),
    "sensor": SensorModel(range_rate=0.05, bearing_std=0.03),
}
WORLD = {"clean": True, "orientation": False, "max_range": 6.0, "arena": 12.0, "landmarks": 30, **MODELS}
BOUNDS = (0.15, 0.05)


def drive(seed, **options):
    log = simulate(seed=seed, steps=40, **(WORLD | options))
    return log, LandmarkMap({j: m[:2] for j, m in log.true_landmarks.items()})


def online(log, known, **options):
    """The solver after every step of a drive, asked by hand."""
    solver = OnlineSolver(map=known, **MODELS, **options)
    for step in range(log.num_poses):
        if step:
            solver.move(log.controls[step - 1], log.dt[step - 1])
        now = log.steps == step
        solver.observe(log.landmarks[now], log.sightings[now])
        yield solver


def off(poses, true):
    return (np.hypot(*(poses - true)[:, :2].T) > BOUNDS[0]) | (np.abs(wrap(poses[:, 2] - true[:, 2])) > BOUNDS[1])


@pytest.mark.slow
def test_poses_do_not_follow_a_landmark_that_has_moved():
    """Without a kernel they do: then the whole map seems wrong, and few poses count as safe."""
    off_when_safe = {None: [], "none": []}
    for seed in range(4):
        log, known = drive(seed)
        often = np.bincount(log.landmarks).argmax()
        changed = LandmarkMap({j: m + (1.0 if j == often else 0.0) for j, m in known.items()})
        for kernel, found in off_when_safe.items():
            for step, solver in enumerate(online(log, changed, kernel=kernel)):
                if solver.located and solver.integrity_risk(*BOUNDS) < 0.05:
                    found.extend(off(solver.pose[None], log.true_poses[step : step + 1]))
    assert len(off_when_safe[None]) > 10 > len(off_when_safe["none"])
    assert np.mean(off_when_safe[None]) < 0.3


def test_the_probability_of_a_circle_is_that_of_rayleigh():
    for std in (0.01, 0.2, 1.0, 30.0):
        P = np.diag([std**2, std**2, 1e-8])
        assert beyond(P, 0.5) == pytest.approx(np.exp(-(0.5**2) / (2 * std**2)), rel=2e-4, abs=1e-7)


def test_the_probability_of_a_heading_is_that_of_a_gaussian():
    P = np.diag([1e-8, 1e-8, 0.04])
    assert beyond(P, 1.0, 0.3) == pytest.approx(2 * norm.sf(0.3 / 0.2), abs=1e-7)
    assert beyond(P, np.inf, 0.3) == pytest.approx(2 * norm.sf(0.3 / 0.2), abs=1e-7)


def test_correlated_errors_are_counted_right():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 3, 3)) * [0.2, 0.2, 0.1]
    P = np.swapaxes(roots, 1, 2) @ roots
    for one, p in zip(P, beyond(P, 0.3, 0.15)):
        e = rng.multivariate_normal(np.zeros(3), one, 30_000)
        share = np.mean((np.hypot(e[:, 0], e[:, 1]) > 0.3) | (np.abs(e[:, 2]) > 0.15))
        # 4 standard deviations of the share
        assert abs(share - p) < 4 * np.sqrt(p * (1 - p) / 30_000)


def test_bounds_must_be_positive():
    with pytest.raises(OptionError, match="radians must be a bound above 0"):
        beyond(np.eye(3), 0.5, 0.0)
    with pytest.raises(OptionError, match="metres must be a number, not 'a'"):
        beyond(np.eye(3), "a")


def test_a_bound_of_the_heading_in_degrees_is_refused():
    """It bounded nothing, so that the stated risk was too small."""
    with pytest.raises(OptionError, match="radians is 10, beyond pi, which bounds no heading: is it in degrees"):
        beyond(np.eye(3), 0.5, 10)
    assert bounds_of(RunOptions.of(map="map.npz", bound=(0.5, 360.0))) == (0.5, np.inf)
    assert bounds_of(RunOptions.of(map="map.npz", bound=(0.5, 10.0))) == (0.5, np.radians(10.0))


def test_larger_residuals_make_larger_covariances():
    rng = np.random.default_rng(1)
    squares = rng.chisquare(2, 4000)
    assert inflation([]) == 1.0 and inflation(squares) == pytest.approx(1, abs=0.1)
    # noise that is twice as large has four times the squares
    assert inflation(4 * squares) == pytest.approx(4, rel=0.1)


@pytest.mark.nightly
def test_residuals_at_a_solution_count_although_it_follows_them():
    """Half the noise in the sensor model than in the log: covariances of the solution get about four times as large."""
    ratios = []
    for seed in range(100, 106):
        log, known = drive(seed)
        for share in (1.0, 0.5):
            sensor = SensorModel(range_rate=0.05 * share, bearing_std=0.03 * share)
            solution = solve(Graph.from_log(log, map=known, motion=MODELS["motion"], sensor=sensor))
            plain = beyond(solution.covariance(), *BOUNDS)
            # the inflation that explains what is said
            scales = np.linspace(0.5, 8.0, 151)
            said = np.array([beyond(scale * solution.covariance(), *BOUNDS).sum() for scale in scales])
            ratios.append(scales[np.argmin(np.abs(said - solution.integrity_risk(*BOUNDS).sum()))])
            assert (solution.integrity_risk(*BOUNDS) >= plain - 1e-9).all()
    # medians of some 100 squares, with a standard deviation of 15 %
    assert np.mean(ratios[::2]) < 1.3 and np.mean(ratios[1::2]) == pytest.approx(4, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("when", ["driving", pytest.param("after", marks=pytest.mark.nightly)])
def test_the_share_of_poses_that_are_off_is_what_was_said(when):
    """Over 15 drives, more is not off than was said, within 3.3 standard errors from drive to drive, nor much less.

    Covariances grow with large residuals, and do not shrink with small ones, so that p is rather too large.
    """
    found = []
    for seed in range(100, 115):
        log, known = drive(seed)
        if when == "driving":
            solvers = online(log, known)
            p, poses = map(np.array, zip(*((s.integrity_risk(*BOUNDS), s.pose) for s in solvers)))
        else:
            solution = solve(Graph.from_log(log, map=known, **MODELS))
            p, poses = solution.integrity_risk(*BOUNDS), solution.poses
        found.append((p, off(poses, log.true_poses)))
    for low, high in ((0.0, 1.0), (0.0, 0.05), (0.05, 0.3), (0.3, 1.0)):
        within = [(p[now], wrong[now]) for p, wrong in found if (now := (p >= low) & (p <= high)).any()]
        more = np.array([np.sum(wrong - p) for p, wrong in within])
        count = sum(len(p) for p, _ in within)
        # the poses of a drive depend on each other, drives do not
        assert sum(more) < 3.3 * np.sqrt(np.sum(more**2))
        assert sum(more) / count > -0.25 and count > 10


def test_before_the_robot_is_located_the_risk_is_one():
    log, known = drive(3)
    first = next(online(log.with_sightings(log.steps > 4), known))
    assert not first.located and first.integrity_risk(100.0) == 1.0


def test_without_a_map_the_risk_is_against_the_first_pose():
    robot = OnlineSolver()
    assert robot.integrity_risk(0.5) < 1e-9
    said = []
    for _ in range(8):
        robot.move((1.0, 0.1), 1.0)
        said.append(robot.integrity_risk(0.5))
        assert said[-1] == pytest.approx(float(beyond(robot.covariance(), 0.5)))
    assert np.all(np.diff(said) > 0) and said[-1] > 0.3


def test_a_drive_that_is_somewhere_else_is_not_there():
    log, known = drive(4)
    there = Stretch.of(log, **MODELS)
    right = presence(there, log.true_poses, known)
    shifted = presence(there, compose(np.array([1.0, -2.0, 0.5]), log.true_poses), known)
    assert right.min() > 0.999 and shifted.max() < 0.001


def test_a_lift_is_seen_in_the_probabilities():
    """Nothing tells when it happened between the last sighting before and the first one after it."""
    log, known = drive(5)
    log = log.with_sightings((log.steps < 15) | (log.steps > 25))
    noise = Stretch.of(log, **MODELS)
    noise.noise[25] = np.diag([1e6, 1e6, 1e3])
    p = presence(noise, log.true_poses, known)
    last = int(log.steps[log.steps < 15].max())
    assert p[last + 1 : 26] == pytest.approx(np.arange(25 - last, 0, -1) / (26 - last), abs=1e-3)
    assert p[:last].min() > 0.99 and p[30:].min() > 0.99


def test_replay_says_the_risk_at_every_step():
    log, known = drive(6)
    risks = [solver.integrity_risk(*BOUNDS) for solver in replay(log, map=known, **MODELS)]
    assert len(risks) == log.num_poses and all(0 <= each <= 1 for each in risks)
    # more sightings make it sure that the robot is there
    assert risks[0] > np.median(risks)
