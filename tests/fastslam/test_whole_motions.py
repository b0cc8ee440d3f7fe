"""Motions of several controls, sensors at an offset, and sightings without ids, in the particle filters."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, ParticleFilter, textbook
from graphslam import Log, LogError, MotionModel, OptionError, SensorModel, simulate
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import wrap

MOTION = MotionModel.constant(0.05, 0.05, epsilon=1e-6)
PLACES = {0: np.array([3.0, 2.0]), 1: np.array([-1.0, 3.0]), 2: np.array([2.0, -2.0])}
FILTERS = [MonteCarloLocalization, FastSLAM1, FastSLAM2]


def drive(sensor: SensorModel, motions: int = 12, seed: int = 0) -> Log:
    """A drive with three controls to a motion, everything seen from everywhere, with the models' own noise."""
    rng = np.random.default_rng(seed)
    controls = np.tile([[0.5, 0.4], [0.6, 0.2], [0.4, 0.3]], (motions, 1))
    starts = 3 * np.arange(motions + 1)
    noisy = controls + 0.05 * rng.normal(size=controls.shape)
    truth = MOTION.dead_reckoning(np.array([0.5, 0.2, 0.3]), noisy, 0.3)[starts]
    steps = np.repeat(np.arange(motions + 1), len(PLACES))
    ids = np.tile(list(PLACES), motions + 1)
    exact = sensor.h(truth[steps], np.array([PLACES[j] for j in ids.tolist()]))
    sightings = exact + rng.normal(size=exact.shape) * np.sqrt(np.diagonal(sensor.Q(exact), axis1=1, axis2=2))
    return Log(
        dt=0.3, controls=controls, control_starts=starts, steps=steps, landmarks=ids, sightings=sightings,
        initial_poses=MOTION.dead_reckoning(truth[0], controls, 0.3)[starts], true_poses=truth, true_landmarks=PLACES,
        motion=MOTION, sensor=sensor,
    )  # fmt: skip


#: how many standard deviations a mean of 200,000 independent particles may be off, and, times the root of 2, a covariance
SAMPLED = bound(12) / np.sqrt(200_000)
CENTRED = SensorModel(range_rate=0.02, bearing_std=0.02)
AHEAD = SensorModel(range_rate=0.02, bearing_std=0.02, offset=(0.6, -0.4))


@pytest.mark.parametrize("sensor", [CENTRED, AHEAD], ids=["centred", "ahead"])
def test_a_motion_drawn_at_once_has_the_accumulated_gaussian(sensor: SensorModel) -> None:
    log = drive(sensor, motions=1).replace(steps=[], landmarks=[], sightings=np.empty((0, 2)))
    slam = FastSLAM1(log, particles=200_000)
    slam.run()
    (mean,), (P,) = log.motions()
    x, y, theta = log.initial_poses[0]
    turn = np.array([[np.cos(theta), -np.sin(theta), 0], [np.sin(theta), np.cos(theta), 0], [0, 0, 1]])
    scale = np.sqrt(np.diag(turn @ P @ turn.T))
    expected = np.array([x, y, theta]) + turn @ mean
    poses = slam.state.poses
    np.testing.assert_allclose(wrap(poses.mean(axis=0) - expected) / scale, 0, atol=SAMPLED)
    # a sensor on an arm moves the robot's pose by second order only
    np.testing.assert_allclose(
        np.cov(poses.T) / np.outer(scale, scale),
        turn @ P @ turn.T / np.outer(scale, scale),
        atol=np.sqrt(2) * SAMPLED,
    )


def test_proposal_of_a_whole_motion_in_closed_form() -> None:
    """The pose given one sighting of a landmark that is nearly known: (H_x' Q^-1 H_x + P^-1)^-1."""
    log = drive(CENTRED, motions=1)
    first = log.landmarks == 0
    log = log.replace(steps=log.steps[first], landmarks=log.landmarks[first], sightings=log.sightings[first])
    slam = FastSLAM2(log, particles=200_000, ess_threshold=0.0)
    slam.run()
    start, (mean,), (P,) = log.initial_poses[0], *log.motions()
    c, s = np.cos(start[2]), np.sin(start[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    predicted, P = start + turn @ mean, turn @ P @ turn.T
    landmark = textbook.initialize_landmark(start, log.sightings[0], CENTRED)
    H_x, H_m = CENTRED.H_pose(predicted, landmark.mean), CENTRED.H(predicted, landmark.mean)
    Q = H_m @ landmark.covariance @ H_m.T + CENTRED.Q(log.sightings[1])
    covariance = np.linalg.inv(H_x.T @ np.linalg.inv(Q) @ H_x + np.linalg.inv(P))
    r = log.sightings[1] - CENTRED.h(predicted, landmark.mean)
    expected = predicted + covariance @ H_x.T @ np.linalg.inv(Q) @ r
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(wrap(slam.state.mean_pose - expected) / scale, 0, atol=SAMPLED)
    correlation = covariance / np.outer(scale, scale)
    np.testing.assert_allclose(slam.state.covariance() / np.outer(scale, scale), correlation, atol=np.sqrt(2) * SAMPLED)


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("sensor", [CENTRED, AHEAD], ids=["centred", "ahead"])
def test_filters_follow_a_drive(kind: type[ParticleFilter], sensor: SensorModel) -> None:
    log = drive(sensor)
    result = kind(log, particles=2000, seed=1).run()
    off = np.hypot(*(result.mean_poses - log.true_poses)[:, :2].T)
    drifted = np.hypot(*(log.initial_poses - log.true_poses)[:, :2].T)
    # ranges of 4 m have an error of 8 cm; an offset of 0.7 m left out or doubled would exceed the bound
    assert off.max() < 0.12
    assert off[-4:].mean() < drifted[-4:].mean()
    if kind is not MonteCarloLocalization:
        for j, place in PLACES.items():
            assert np.hypot(*(result.landmarks[j] - place)) < 0.15


def test_moves_by_hand_carry_the_sensor() -> None:
    slam = MonteCarloLocalization(map=PLACES, particles=100_000, start=[0.5, 0.2, 0.3], motion=MOTION, sensor=AHEAD)
    slam.move([0.5, 0.8], 1.0)
    scale = np.sqrt(np.diag(slam.state.covariance()))
    off = slam.state.mean_pose - MOTION.f([0.5, 0.2, 0.3], [0.5, 0.8], 1.0)
    # the mean of curved motions is off the noise-free one by half of the variance of the heading, 1 / 800 of their length
    assert np.all(np.abs(off) < bound(3) * scale / np.sqrt(100_000) + [1e-3, 1e-3, 0.0])
    slam.move([9.0, 9.0], 0.0)
    np.testing.assert_allclose(slam.trajectory()[0], [0.5, 0.2, 0.3], atol=1e-12)


def test_mean_poses_are_those_of_the_robot_and_not_of_its_sensor() -> None:
    slam = FastSLAM1(particles=500, motion=MotionModel(on=1.0, oo=1.0), sensor=AHEAD)
    for _ in range(3):
        slam.move([1.0, 0.3], 1.0)
    np.testing.assert_allclose(slam.result().mean_poses[-1], slam.pose, atol=1e-12)


@pytest.mark.parametrize("weight", ["exact", "linearised"])
@pytest.mark.parametrize("spread", [np.zeros((3, 3)), np.diag([1e-2, 0.0, 1e-3]), np.full((3, 3), 1e-3)])
def test_a_motion_may_have_no_noise_in_some_direction(spread: np.ndarray, weight: str) -> None:
    """The evidence is that of FastSLAM 1.0, whose error is at most 0.01 with these particles."""
    places, evidence = np.array(list(PLACES.values())), []
    for kind in (FastSLAM1, FastSLAM2):
        slam = kind(particles=20_000, sensor=SensorModel(), proposal_weight=weight)
        slam.observe(list(PLACES), slam.sensor.h(np.zeros(3), places))
        slam.move(motion=[0.5, 0.0, 0.1], covariance=spread)
        slam.observe(list(PLACES), slam.sensor.h(np.array([0.5, 0.0, 0.1]), places))
        assert np.isfinite(slam.covariance()).all() and slam.state.ess > 10_000
        evidence.append(slam.result().log_evidence)
    assert evidence[1] == pytest.approx(evidence[0], abs=0.02)


def test_unknown_ids_need_an_association() -> None:
    log = drive(CENTRED).replace(landmarks=np.full(39, UNIDENTIFIED))
    for kind in FILTERS:
        with pytest.raises(OptionError, match="has sightings without ids"):
            kind(log, particles=2, association="known")
    # localisation has none but that of the ids
    with pytest.raises(OptionError, match="take FastSLAM, which finds out"):
        MonteCarloLocalization(log, particles=2)
    result = FastSLAM2(log, particles=500).run()
    assert len(result.landmarks) == 3
    assert result.options.association == "maximum-likelihood"


def test_the_lectures_filters_take_one_control_a_step() -> None:
    for version in (textbook.fastslam1, textbook.fastslam2):
        with pytest.raises(LogError, match="one control a step"):
            next(version(drive(CENTRED), rng=np.random.default_rng(0)))
        slips = simulate(steps=3, seed=0).replace(motion=MotionModel(slip=0.1))
        with pytest.raises(LogError, match="slip"):
            next(version(slips, rng=np.random.default_rng(0)))
        nameless = slips.replace(motion=None, landmarks=np.full(len(slips.steps), UNIDENTIFIED))
        with pytest.raises(LogError, match="has sightings without ids"):
            next(version(nameless, rng=np.random.default_rng(0)))


@pytest.mark.parametrize("kind", FILTERS)
def test_particles_slip_sideways(kind: type[ParticleFilter]) -> None:
    """Single controls of a robot that slips have the covariance of the model, over a log and one by one."""
    motion = MotionModel(nn=0.1, no=0.0, on=0.1, oo=0.1, epsilon=1e-6, slip=0.4)
    expected = motion.covariance(np.zeros(3), [2.0, 0.6], 1.0)
    log = simulate(steps=1, seed=0).replace(
        dt=1.0, controls=[[2.0, 0.6]], motion=motion, initial_poses=np.zeros((2, 3))
    )
    log = log.with_sightings(np.zeros(len(log.steps), dtype=bool))
    driven, moved = kind(log, particles=40_000, seed=1), kind(log, particles=40_000, seed=1)
    driven.run()
    moved.move([2.0, 0.6], 1.0)
    for slam in (driven, moved):
        assert slam.state.step == 1
        spread = np.cov(slam.state.poses.T)
        scale = np.sqrt(np.diag(expected))
        off = (spread - expected) / np.outer(scale, scale)
        # an error rate of 1e-6 for nine moments of 40,000 independent particles
        np.testing.assert_allclose(off, 0, atol=bound(9) * np.sqrt(2 / 40_000))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
@pytest.mark.parametrize("pieces", [1, 4])
def test_particles_spread_as_far_where_sightings_cut_the_controls(kind: type[ParticleFilter], pieces: int) -> None:
    """50 controls of 0.1 s with sigma_omega 0.3 rad/s: a heading variance of 50 (0.3 0.1)², however they are cut."""
    blind = SensorModel.constant(1e3, 1e3)
    controls = np.tile([0.2, 0.1], (50 * pieces, 1))
    log = Log(
        dt=0.1 / pieces, controls=controls, recorded_dt=np.full(len(controls), 0.1), steps=np.arange(len(controls)),
        landmarks=np.zeros(len(controls), dtype=int), sightings=np.tile([5.0, 0.0], (len(controls), 1)),
        motion=MotionModel.constant(0.1, 0.3, epsilon=1e-9), sensor=blind,
    )  # fmt: skip
    slam = kind(log, particles=20_000, seed=1)
    slam.run()
    headings = slam.state.poses[:, 2]
    assert np.var(wrap(headings - np.mean(headings))) == pytest.approx(50 * 0.03**2, rel=bound() * np.sqrt(2 / 20_000))
    np.testing.assert_allclose(np.sum(log.motions()[1][:, 2, 2]), 50 * 0.03**2, rtol=1e-4)


def test_the_evidence_is_the_density_of_the_sightings() -> None:
    """Without noise of the motion it is the product of the densities at the known poses, however many particles there are."""
    still = MotionModel(nn=0, no=0, on=0, oo=0, epsilon=1e-30)
    log = drive(CENTRED, motions=3).replace(motion=still)
    poses, marks = log.dead_reckoning()[log.steps], np.array([PLACES[j] for j in log.landmarks.tolist()])
    residual = log.sightings - CENTRED.h(poses, marks)
    q = np.diagonal(CENTRED.Q(log.sightings), axis1=1, axis2=2)
    expected = -0.5 * np.sum(wrap(residual) ** 2 / q + np.log(2 * np.pi * q))
    result = MonteCarloLocalization(log, particles=7, seed=0).run()
    np.testing.assert_allclose(result.log_evidence, expected, rtol=1e-6)


def test_the_evidence_finds_the_slip() -> None:
    slips = MotionModel(nn=0.02, no=0, on=0.01, oo=0.02, epsilon=1e-8, slip=0.15)
    sensor = SensorModel(range_rate=0.01, bearing_std=0.01)
    log = simulate(seed=3, steps=60, clean=True, motion=slips, sensor=sensor, orientation=False)
    evidence = {
        slip: FastSLAM2(log, motion=slips.changed(slip=slip), particles=200, seed=0).run().log_evidence
        for slip in (0.0, 0.15, 1.0)
    }
    assert evidence[0.15] > max(evidence[0.0], evidence[1.0]) + 10
