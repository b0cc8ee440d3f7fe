"""Noise from simulated logs whose noise is known: it is found again, within the error that the data allow.

The bands are standard errors that `calibrate` states itself, so these also test the errors: over many numbers |value -
truth| / error is that of a standard normal.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from graphslam import (
    Drive,
    Log,
    LogError,
    MotionModel,
    OptionError,
    SensorModel,
    calibrate,
    estimate_robot,
    load,
    sample_log_path,
    simulate,
)
from graphslam.association import associate_from, score
from graphslam.calibration import Calibration
from graphslam.identification.corrections import without_biases
from graphslam.identification.declared import CORRECTIONS
from graphslam.identification.odometry import motion_parts, sensor_parts
from graphslam.identification.robot import RobotEstimate
from graphslam.log import UNIDENTIFIED
from graphslam.simulation.drives import DriveTruth

MOTION = MotionModel(nn=0.08, no=0.03, on=0.05, oo=0.1, epsilon=1e-6)
SENSOR = SensorModel(range_rate=0.04, range_std=0.05, bearing_std=0.03, orientation_std=0.06)
WAY_POINTS = [(6.0, -4.0), (6.0, 5.0), (-6.0, 5.0), (0.0, 0.0), (-6.0, -5.0)]


def drive(seed: int, steps: int = 1000, orientation: bool = False, **more: object) -> Log:
    """A robot that drives straight on and turns on the spot, so that noise per metre and per radian can be distinguished."""
    options: dict = {"motion": MOTION, "sensor": SENSOR, "landmarks": 20, "way_points": WAY_POINTS, "dt": 1.0} | more
    return simulate(seed=seed, steps=steps, clean=True, orientation=orientation, speed=0.5, turn_rate=0.5, **options)


def wrong(log: Log, range_scale=1.0, range_bias=0.0, wheel_scale=1.0, turn_rate_bias=0.0) -> Log:
    """The log as sensors would record it whose measurements are all wrong in the same way."""
    sightings, controls = log.sightings.copy(), log.controls * [wheel_scale, 1.0] + [0.0, turn_rate_bias]
    sightings[:, 0] = range_scale * sightings[:, 0] + range_bias
    return log.replace(sightings=sightings, controls=controls)


WRONG = {"range_scale": 1.07, "range_bias": 0.12, "wheel_scale": 1.05, "turn_rate_bias": 0.02}


def errors_in_sigmas(found, motion: MotionModel, sensor: SensorModel, **means: float) -> dict[str, float]:
    """(value - truth) / standard error of every number that has an error.

    Nearer to zero, which no variance can be below, errors are not normal, and numbers have bounds.
    """
    truth = vars(motion) | vars(sensor) | CORRECTIONS | means
    return {
        name: (value - truth[name]) / found.errors[name]
        for name, value in found.numbers.items()
        if np.isfinite(found.errors.get(name, np.nan))
    }


def assert_found(found, name: str, true: float) -> None:
    """A number lies within four of its errors, or below 1.3 times its 95 % bound."""
    if np.isfinite(found.errors[name]):
        assert abs(found.numbers[name] - true) < 4 * found.errors[name], name
    else:
        assert true < 1.3 * found.bounds[name], name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_noise_from_truth(seed: int) -> None:
    found = calibrate(drive(seed, orientation=True))
    assert found.source == "truth"
    off = errors_in_sigmas(found, MOTION, SENSOR)
    names = {"nn", "oo", "range_rate", "bearing_std", "orientation_std", "range_scale", "range_bias", "wheel_scale"}
    assert names <= off.keys()
    assert max(map(abs, off.values())) < 4
    assert found.counts["motion"] == 1000
    # the tails are as good as Gaussian
    assert min(found.degrees.values()) > 20


@pytest.mark.nightly
def test_the_standard_errors_are_those_of_many_logs() -> None:
    logs = [wrong(drive(seed, steps=100), 1.2, 0.5, 1.3, 0.1) for seed in range(6)]
    means = {"range_scale": 1.2, "range_bias": 0.5, "wheel_scale": 1.3, "turn_rate_bias": 0.1}
    off = [errors_in_sigmas(calibrate(log), MOTION, SENSOR, **means) for log in logs]
    for name in ("bearing_std", *means):
        z = np.array([entry[name] for entry in off])
        # chi-square of 6 degrees of freedom: 99.9 % lie between 0.3 and 24.1
        assert 0.3 < np.sum(z**2) < 24.1, name


@pytest.mark.slow
def test_range_scale_and_bias() -> None:
    log = drive(5, steps=300)
    sightings = wrong(log, 1.07, 0.12).sightings
    found = calibrate(log.replace(sightings=sightings))
    assert abs(found.range_scale - 1.07) < 4 * found.errors["range_scale"] < 0.05
    assert abs(found.range_bias - 0.12) < 4 * found.errors["range_bias"] < 0.1
    straight = calibrate(wrong(log, 0.9, -0.1))
    # noise is that of the corrected range: the line takes nothing from it
    assert found.sensor.bearing_std == pytest.approx(straight.sensor.bearing_std, rel=1e-3)
    assert found.sensor.Q([3.0, 0.0])[0, 0] == pytest.approx(straight.sensor.Q([3.0, 0.0])[0, 0], rel=1e-3)
    back = found.apply(log.replace(sightings=sightings))
    np.testing.assert_allclose(back.sightings[:, 0], (sightings[:, 0] - found.range_bias) / found.range_scale)
    assert (back.motion, back.sensor) == (found.motion, found.sensor)


@pytest.mark.slow
def test_residuals_do_not_look_at_the_truth() -> None:
    log, found = warehouse(1001)
    blind = calibrate(log.replace(true_poses=None, true_landmarks=None))
    assert blind.numbers == Calibration.of(found).numbers


@pytest.mark.slow
def test_wrong_sightings_and_slips_do_not_blow_the_noise_up() -> None:
    log = drive(2, steps=400)
    rng = np.random.default_rng(0)
    sightings = log.sightings.copy()
    wrong = rng.choice(len(sightings), len(sightings) // 20, replace=False)
    sightings[wrong, 0] += rng.uniform(1, 3, len(wrong))
    bad = log.replace(sightings=sightings)
    robust, plain = calibrate(bad), calibrate(bad, degrees=np.inf)
    right = SENSOR.Q([3.0, 0.0])[0, 0]
    assert plain.sensor.Q([3.0, 0.0])[0, 0] > 5 * right
    assert robust.sensor.Q([3.0, 0.0])[0, 0] < 1.5 * right
    assert robust.degrees["sensor"] < 10
    assert any("robust" in note for note in robust.notes)


def test_the_parts_make_up_the_models() -> None:
    log = drive(0, steps=30, orientation=True)
    motion = MotionModel(nn=0.1, no=0.2, on=0.3, oo=0.4, sigma_v=0.5, sigma_omega=0.6, slip=0.7, epsilon=1e-3)
    parts = motion_parts(log)
    variances = {name: vars(motion)[name] ** (1 if name == "epsilon" else 2) for name in parts}
    whole = sum(variances[name] * part for name, part in parts.items())
    np.testing.assert_allclose(whole, log.motions(motion)[1], rtol=1e-9, atol=1e-15)
    parts = sensor_parts(log.sightings)
    np.testing.assert_allclose(sum(vars(SENSOR)[n] ** 2 * C for n, C in parts.items()), SENSOR.Q(log.sightings))


@pytest.mark.slow
def test_scales_and_biases_from_truth() -> None:
    log = drive(6, steps=300)
    found = calibrate(wrong(log, **WRONG))
    for name, value in WRONG.items():
        assert abs(getattr(found, name) - value) < 4 * found.errors[name] < abs(value - (name.endswith("scale"))), name
    back = found.apply(wrong(log, **WRONG))
    # both lines are corrected, and so is dead reckoning, which is the initial guess
    np.testing.assert_allclose(
        back.controls, (wrong(log, **WRONG).controls - [0, found.turn_rate_bias]) / [found.wheel_scale, 1]
    )
    np.testing.assert_array_equal(back.initial_poses, back.dead_reckoning())
    # a second calibration finds nothing more
    again = calibrate(back)
    assert again.corrections == CORRECTIONS
    # nor does one of a robot with nothing wrong
    assert calibrate(log).corrections == again.corrections


@pytest.mark.slow
def test_a_mean_of_motions_counts_outliers_in_full() -> None:
    """A tenth of the motions slip: on average the robot drives less than the wheels say, though most motions are right."""
    log, rng = (
        drive(3, steps=600, motion=MotionModel(nn=0.01, no=0.01, on=0.01, oo=0.01, epsilon=1e-8)),
        np.random.default_rng(1),
    )
    controls = log.controls.copy()
    slipped = rng.choice(600, 60, replace=False)
    controls[slipped, 0] *= 2
    found = calibrate(log.replace(controls=controls))
    ratio = np.sum(controls[:, 0] * log.controls[:, 0]) / np.sum(log.controls[:, 0] ** 2)
    assert ratio > 1.05
    assert found.wheel_scale == pytest.approx(ratio, abs=4 * found.errors["wheel_scale"])
    assert found.wheel_scale > 1.02


@pytest.mark.nightly
def test_several_logs_give_one_noise() -> None:
    one, other = drive(1, steps=200), drive(2, steps=200)
    both, sighted = calibrate([one, other]), len(one.steps) + len(other.steps)
    assert str(both) == str(calibrate(one, other)) and both.counts == {"motion": 400, "sensor": sighted}
    assert both.logs == (one.name, other.name)
    off = errors_in_sigmas(both, MOTION, SENSOR)
    assert {"nn", "oo", "range_rate", "bearing_std"} <= off.keys() and max(map(abs, off.values())) < 4
    assert both.errors["bearing_std"] < 0.8 * min(calibrate(log).errors["bearing_std"] for log in (one, other))
    with pytest.raises(LogError, match="has orientation psi and"):
        calibrate(one, drive(1, steps=20, orientation=True))


# -- from residuals ----------------------------------------------------------------------------------------------------


def recorded(seed: int, **wrong: float) -> tuple[Log, DriveTruth]:
    """A drive of two minutes of the robot whose biases are those of `Drive`, and ``wrong``."""
    parameters = {"wheel_scale": 1.02, "turn_rate_bias": 0.004, "sensor_delay": 0.03} | wrong
    return Drive(seed=seed, duration=120.0, landmarks=20, parameters=parameters).simulate()


@cache
def warehouse(seed: int, **wrong: float) -> tuple[Log, RobotEstimate]:
    log, _ = recorded(seed, **wrong)
    return log, estimate_robot(log)


@cache
def residuals_of_the_sample() -> Calibration:
    return calibrate(load(sample_log_path()), source="residuals")


def with_ids_of(log: Log, found: RobotEstimate) -> Log:
    """The recorded log with the ids that were found; noise files carry no ids."""
    return found.ids.correct(log)


def test_a_calibration_from_residuals_is_the_estimate() -> None:
    """Models and biases applied to the recorded log give the log of the estimate to the last bit, and so the same graph."""
    log, found = warehouse(1001)
    calibrated = calibrate(log, source="residuals")
    assert (calibrated.motion, calibrated.sensor) == (found.motion, found.sensor)
    assert calibrated.source == "residuals" and not calibrated.doubts
    for name, value in zip(found.parameters.names, found.parameters.values):
        assert calibrated.numbers[name] == value
        assert calibrated.errors[name] == pytest.approx(found.parameters.deviations[name])
    applied = calibrated.apply(with_ids_of(log, found))
    for name in ("controls", "sightings", "initial_poses", "landmarks"):
        np.testing.assert_array_equal(getattr(applied, name), getattr(found.log, name))
    assert (applied.motion, applied.sensor) == (found.log.motion, found.log.sensor)


def test_all_biases_are_taken_out_again() -> None:
    """A noise-free drive of the robot, with all biases but the delay: the correction is exact."""
    log = drive(3, steps=40, orientation=True)
    p = {"wheel_scale": 1.05, "turn_scale": 0.9, "turn_rate_bias": 0.02, "curvature_bias": -0.03, "range_scale": 1.1,
         "range_bias": 0.1, "bearing_bias": 0.07}  # fmt: skip
    nu, omega = log.controls.T
    controls = np.column_stack([1.05 * nu, 0.9 * omega + 0.02 - 0.03 * nu])
    recorded = log.replace(controls=controls, sightings=log.sightings * [1.1, 1, 1] + [0.1, 0.07, 0])
    back = without_biases(recorded, **p)
    np.testing.assert_allclose(back.controls, log.controls, atol=1e-12)
    np.testing.assert_allclose(back.sightings, log.sightings, atol=1e-12)
    np.testing.assert_array_equal(back.initial_poses, back.dead_reckoning())


@pytest.mark.nightly
def test_several_logs_of_one_robot() -> None:
    """Information adds up: the error of a bias is below those of each, and the truth within four errors."""
    logs = [warehouse(seed)[0] for seed in (1001, 1003, 1004)]
    both = calibrate(*logs, source="residuals")
    assert both.logs == tuple(log.name for log in logs) and not both.doubts
    for name, true in {"wheel_scale": 1.02, "turn_rate_bias": 0.004, "sensor_delay": 0.03, "turn_scale": 1.0}.items():
        single = [warehouse(seed)[1].parameters.deviations[name] for seed in (1001, 1003, 1004)]
        assert both.errors[name] < 0.9 * min(single)
        assert abs(both.numbers[name] - true) < 4 * both.errors[name]
    assert abs(both.sensor.bearing_std - 0.006) < 0.2 * 0.006
    assert both.sensor.offset == (both.numbers["sensor_ahead"], both.numbers["sensor_left"])


@pytest.mark.slow
def test_logs_of_different_robots_disagree() -> None:
    one, other = warehouse(1001)[1], warehouse(1003, wheel_scale=0.97)[1]
    (doubt,) = Calibration.of(one, other).doubts
    assert doubt.startswith("the logs disagree beyond chance on wheel_scale (1.0")


def test_combining_a_log_with_itself_counts_the_prior_once() -> None:
    """n times the same data: the inverse covariance is n times that of the data, plus the prior once."""
    found = warehouse(1001)[1]
    twice = Calibration.of(found, found)
    prior = np.diag([spread**-2 for _, spread in found.parameters.priors.values()])
    data = np.linalg.inv(found.parameters.covariance) - prior
    expected = np.sqrt(np.diag(np.linalg.inv(2 * data + prior)))
    assert [twice.errors[name] for name in found.parameters.names] == pytest.approx(expected.tolist())
    assert twice.sensor.bearing_std == pytest.approx(found.sensor.bearing_std)
    assert twice.errors["bearing_std"] == pytest.approx(found.sensor.bearing_std * found.errors["bearing_std"] / 2**0.5)


# -- bad input ---------------------------------------------------------------------------------------------------------


def test_a_log_without_sightings() -> None:
    log = drive(0, steps=20)
    empty = log.replace(steps=[], landmarks=[], sightings=np.zeros((0, 2)))
    with pytest.raises(LogError, match="no sightings"):
        calibrate(empty)


@pytest.mark.slow
def test_true_poses_without_a_map() -> None:
    """They tell the motion, and with the scale of the wheels that of the ranges, which residuals only tell together."""
    log, truth = recorded(1001, range_scale=1.04)
    whole = calibrate(log.with_sightings(~(truth.misread | truth.clutter)))
    found = calibrate(log.replace(true_landmarks=None))
    for name in ("wheel_scale", "turn_rate_bias", "nn", "oo"):
        assert found.numbers[name] == whole.numbers[name], name
    assert abs(found.range_scale - 1.04) < 4 * found.errors["range_scale"] < 0.03
    assert (found.turn_scale, found.curvature_bias) == (1.0, 0.0) and found.source == "residuals"
    (note,) = [note for note in found.notes if "true place" in note]
    assert "with wheel_scale and turn_rate_bias, are from the true poses" in note
    # without headings nothing is taken from the truth, and a note says so
    blind = calibrate(log.replace(true_landmarks=None, true_poses=log.true_poses * [1, 1, np.nan]))
    assert "no true poses with headings are known: all numbers are from residuals" in blind.notes


def test_truth_without_landmarks_or_headings() -> None:
    log = drive(0, steps=20)
    for poorer in (log.replace(true_landmarks=None), log.replace(true_poses=log.true_poses * [1, 1, np.nan])):
        with pytest.raises(LogError, match="residuals"):
            calibrate(poorer, source="truth")


def without_ids(log: Log) -> Log:
    return log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))


@pytest.mark.nightly
def test_sightings_without_ids() -> None:
    log = load(sample_log_path())
    known, found = residuals_of_the_sample(), calibrate(without_ids(log), source="residuals")
    # all ids are found
    assert found.counts == known.counts
    for name, error in known.errors.items():
        assert found.numbers[name] == pytest.approx(known.numbers[name], abs=0.1 * np.nan_to_num(error, nan=np.inf)), (
            name
        )
    assert "with 13 landmarks that were found" in found.notes[0]
    # true poses count, but landmarks that were found have no true positions
    assert "no landmark whose true place is known is seen" in " ".join(calibrate(without_ids(log)).notes)
    with pytest.raises(LogError, match="without landmark ids"):
        calibrate(without_ids(log), source="truth")


@pytest.mark.slow
def test_truth_that_is_sparser_than_the_poses_tells_no_motions() -> None:
    """Every second pose has no truth, as with true poses once a second: all numbers are then from residuals."""
    log = load(sample_log_path())
    assert log.true_poses is not None
    truth = log.true_poses.copy()
    truth[1::2] = np.nan
    found = calibrate(log.replace(true_poses=truth))
    assert (
        found.source == "residuals" and "only 0 motions have true poses at both ends (10 are needed)" in found.notes[0]
    )
    assert found.numbers == residuals_of_the_sample().numbers
    with pytest.raises(LogError, match="0 motions with true poses at both ends are too few .* source 'residuals'"):
        calibrate(log.replace(true_poses=truth), source="truth")
    short = log.replace(true_poses=truth).at_steps(np.arange(15))
    with pytest.raises(
        LogError, match="at least 60 sightings .*; the ground truth is not used, because only 0 motions"
    ):
        calibrate(short)


@pytest.mark.nightly
def test_noise_that_is_much_too_wide_at_first_does_not_keep_wrong_ids() -> None:
    motion = MotionModel(nn=0.02, no=0.002, on=0.02, oo=0.02)
    sensor = SensorModel(range_rate=0.001, range_std=0.05, bearing_std=0.02)
    log = simulate(
        seed=0, steps=90, dt=1.0, speed=0.5, turn_rate=0.4, clean=True, orientation=False, motion=motion, sensor=sensor,
        landmarks=20, arena=4.0, max_range=3.5, way_points=((3.0, -3.0), (3.0, 3.0), (-3.0, 3.0), (-3.0, -3.0)),
    ).replace(motion=None, sensor=None)  # fmt: skip
    wide = score(associate_from(log).ids, log.landmarks)
    found = calibrate(without_ids(log), source="residuals")
    right = score(associate_from(found.apply(log)).ids, log.landmarks)
    assert wide.precision < 0.7 and right.precision > 0.98
    assert abs(found.sensor.bearing_std - 0.02) < 4 * found.errors["bearing_std"] < 0.01


def test_no_controls() -> None:
    log = drive(0, steps=60)
    still = log.replace(dt=None, controls=None)
    found = calibrate(still)
    assert found.motion is None
    assert found.sensor.bearing_std == pytest.approx(SENSOR.bearing_std, rel=0.3)
    with pytest.raises(LogError, match="no controls"):
        calibrate(still, source="residuals")


def test_too_few_and_too_exact() -> None:
    with pytest.raises(LogError, match="too few"):
        calibrate(drive(0, steps=2), source="truth")
    with pytest.raises(LogError, match="at least 60 sightings and 20 poses"):
        calibrate(drive(0, steps=2))
    log = drive(0, steps=50)
    exact = calibrate(log.replace(true_poses=log.dead_reckoning()))
    assert exact.motion is not None
    # as good as none, and a model that can be used all the same
    np.testing.assert_array_less(exact.motion.covariance(np.zeros(3), [0.5, 0.3], 1.0).diagonal(), 2e-9)


def test_wrong_options() -> None:
    log = drive(0, steps=20)
    with pytest.raises(OptionError, match="source"):
        calibrate(log, source="guess")
    with pytest.raises(OptionError, match="range_scale"):
        without_biases(log, range_scale=-1.0)
    with pytest.raises(OptionError, match="range_bias"):
        without_biases(log, range_bias=np.nan)
    with pytest.raises(OptionError, match="not 'sensor_ahead'"):
        without_biases(log, sensor_ahead=0.1)
    with pytest.raises(LogError, match="below zero"):
        without_biases(log, range_bias=50.0)
    with pytest.raises(LogError, match="no controls, and sensor_delay, wheel_scale"):
        without_biases(log.replace(dt=None, controls=None), wheel_scale=1.1, sensor_delay=0.1, range_bias=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_noise_that_enters_by_the_controls(seed):
    """Speed and turn rate are off by noise, and the robot drives true arcs: nothing sideways but epsilon, 1e-8."""
    rng, steps = np.random.default_rng(seed), 1500
    true = MotionModel(nn=0.05, no=0.02, on=0.04, oo=0.06, epsilon=1e-8, sigma_v=0.03, sigma_omega=0.05)
    u = np.column_stack([np.abs(rng.normal(0.5, 0.3, steps)), rng.normal(0, 0.5, steps)])
    dt = np.full(steps, 0.5)
    noise = rng.normal(size=(steps, 2)) * np.sqrt(np.diagonal(true.M(u, dt), axis1=1, axis2=2))
    poses = np.zeros((steps + 1, 3))
    for t in range(steps):
        poses[t + 1] = true.f(poses[t], u[t] + noise[t], 0.5) + rng.normal(size=3) * 1e-4
    landmark, sensor = np.array([3.0, 4.0, 0.5]), SensorModel()
    z = sensor.h(poses, np.broadcast_to(landmark, poses.shape)) + rng.normal(size=poses.shape) * 0.05
    z[:, 0] = np.abs(z[:, 0])
    log = Log(dt=dt, controls=u, steps=np.arange(steps + 1), landmarks=np.zeros(steps + 1, dtype=int), sightings=z,
              true_poses=poses, true_landmarks={0: landmark})  # fmt: skip
    found = calibrate(log)
    assert found.degrees["motion"] > 20
    for name in ("nn", "no", "on", "oo", "sigma_v", "sigma_omega"):
        assert_found(found, name, getattr(true, name))


# -- noise near zero ---------------------------------------------------------------------------------------------------


def arcs(seed: int, epsilon: float, bearing: float = 0.05) -> Log:
    """300 motions whose noise enters by the controls, almost nothing sideways, and three landmarks."""
    rng, steps = np.random.default_rng(seed), 300
    true = MotionModel(nn=0.05, no=0.02, on=0.04, oo=0.06, sigma_v=0.03, sigma_omega=0.05)
    u = np.column_stack([np.abs(rng.normal(0.5, 0.3, steps)), rng.normal(0, 0.5, steps)])
    noise = rng.normal(size=(steps, 2)) * np.sqrt(np.diagonal(true.M(u, 0.5), axis1=1, axis2=2))
    poses = np.zeros((steps + 1, 3))
    for t in range(steps):
        poses[t + 1] = true.f(poses[t], u[t] + noise[t], 0.5) + rng.normal(size=3) * epsilon**0.5
    marks = np.array([[3.0, 4.0, 0.5], [-3.0, 2.0, 0.0], [5.0, -5.0, 1.0]])
    at, ids = np.repeat(np.arange(steps + 1), 3), np.arange(3 * (steps + 1)) % 3
    z = SensorModel().h(poses[at], marks[ids]) + rng.normal(size=(len(at), 3)) * [0.05, bearing, 0.05]
    z[:, 0] = np.abs(z[:, 0]) + 1e-3
    return Log(dt=0.5, controls=u, steps=at, landmarks=ids, sightings=z, true_poses=poses,
               true_landmarks=dict(enumerate(marks)))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "epsilon"), [(0, 1e-10), (1, 1e-10), (2, 1e-12), (5, 0.0)])
def test_noise_that_enters_only_by_the_controls(seed: int, epsilon: float) -> None:
    found = calibrate(arcs(seed, epsilon))
    true = {"nn": 0.05, "no": 0.02, "on": 0.04, "oo": 0.06, "sigma_v": 0.03, "sigma_omega": 0.05}
    for name, value in true.items():
        assert_found(found, name, value)
    # the least epsilon that a model has, and a bound in place of an error
    assert found.motion.epsilon == pytest.approx(1e-9, rel=0.1)
    assert np.isnan(found.errors["epsilon"]) and found.bounds["epsilon"] < 2e-9


def test_a_bearing_without_noise() -> None:
    found = calibrate(arcs(0, 1e-10, bearing=0.0).without_orientation())
    assert found.sensor.bearing_std == pytest.approx(1e-5, rel=0.1)
    assert np.isnan(found.errors["bearing_std"]) and found.bounds["bearing_std"] < 2e-5
    assert found.sensor.Q([3.0, 0.0])[0, 0] == pytest.approx(0.05**2, rel=0.2)


def test_ranges_that_are_all_the_same_determine_no_line() -> None:
    """A robot that turns on the spot before one landmark: the correction is the least that explains the range."""
    rng, steps = np.random.default_rng(0), 80
    poses = np.column_stack([np.zeros((steps + 1, 2)), 0.1 * np.arange(steps + 1)])
    z = SensorModel().h(poses, np.array([2.0, 0.0])) + rng.normal(size=(steps + 1, 2)) * 0.03
    log = Log(initial_poses=poses, steps=np.arange(steps + 1), landmarks=np.zeros(steps + 1, dtype=int),
              sightings=z, true_poses=poses, true_landmarks={0: [2.0, 0.0]})  # fmt: skip
    found = calibrate(log)
    assert 2 * found.range_scale + found.range_bias == pytest.approx(np.mean(z[:, 0]), abs=1e-3)
    assert np.isnan(found.errors["range_scale"])


@pytest.mark.slow
def test_parts_that_are_alike_have_bounds() -> None:
    """At a constant speed nn and sigma_v say the same: together they are known, each alone has only a bound."""
    log = simulate(seed=1, steps=200, clean=True)
    found = calibrate(log)
    along = np.diagonal(found.motion.M(log.controls, log.dt), axis1=1, axis2=2)[:, 0]
    assert along == pytest.approx(np.diagonal(MotionModel().M(log.controls, log.dt), axis1=1, axis2=2)[:, 0], rel=0.3)
    assert np.isnan(found.errors["nn"]) and 0.19 < found.bounds["nn"] < 0.25
    assert np.isnan(found.errors["sigma_v"]) and 0.03 < found.bounds["sigma_v"] < 0.08
