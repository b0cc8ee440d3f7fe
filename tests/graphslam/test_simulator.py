from dataclasses import replace

import numpy as np
import pytest
from error_rates import ERROR_RATE, bound
from scipy import stats

from graphslam import MotionModel, OptionError, SensorModel, load, sample_log_path, save, simulate
from graphslam.se2 import wrap
from graphslam.simulation.simulator import MotionFaults, SensorFaults
from graphslam.simulation.worlds import WORLDS

STILL = {
    "range_noise_rate": 0.0, "bearing_noise": 0.0, "orientation_noise": 0.0, "oversight": 0.0,
}  # fmt: skip
NO_BIAS = {"range_bias_rate_std": 0.0, "bearing_bias_std": 0.0, "orientation_bias_std": 0.0}
QUIET = SensorFaults(**STILL, **NO_BIAS)
SMOOTH = MotionFaults(kicks_per_metre=0, velocity_bias_std=0)


def test_the_sample_log_is_what_its_command_makes():
    """Up to a tenth of a millimetre: the driver steers back towards its way point, which enlarges the last digits.

    Those of sine and cosine depend on the processor: with and without AVX-512 the end of the drive differs by 4e-6 m.
    """
    sample, made = load(sample_log_path()), simulate(WORLDS["garden"], seed=1)
    assert made.steps.tolist() == sample.steps.tolist() and made.landmarks.tolist() == sample.landmarks.tolist()
    assert made.replace(
        controls=sample.controls, sightings=sample.sightings, true_poses=sample.true_poses,
        initial_poses=sample.initial_poses,
    ).equals(sample)  # fmt: skip
    np.testing.assert_allclose(made.controls, sample.controls, rtol=0, atol=1e-4)
    np.testing.assert_allclose(made.true_poses, sample.true_poses, rtol=0, atol=1e-4)
    np.testing.assert_allclose(made.sightings, sample.sightings, rtol=0, atol=1e-4)


def test_the_same_seed_makes_the_same_log():
    assert simulate(seed=3).equals(simulate(seed=3))
    assert not simulate(seed=3).equals(simulate(seed=4))


def test_without_faults_the_robot_is_where_dead_reckoning_says():
    log = simulate(motion_faults=SMOOTH, sensor_faults=QUIET)
    np.testing.assert_allclose(log.true_poses[:, :2], log.initial_poses[:, :2], atol=1e-9)
    world = np.array([log.true_landmarks[j] for j in log.landmarks.tolist()])
    exact = SensorModel().h(log.true_poses[log.steps], world)
    np.testing.assert_allclose(wrap(log.sightings - exact), 0, atol=1e-9)


def test_the_camera_has_limits_and_sees_everything_within():
    limits = {"min_range": 1.0, "max_range": 4.0, "field_of_view": 1.0}
    log = simulate(motion_faults=SMOOTH, sensor_faults=QUIET, **limits)
    assert log.sightings[:, 0].min() >= 1.0
    assert log.sightings[:, 0].max() <= 4.0
    assert np.abs(log.sightings[:, 1]).max() <= 0.5
    expected = set()
    for t, pose in enumerate(log.true_poses):
        for j, landmark in log.true_landmarks.items():
            z = SensorModel().h(pose, landmark)
            if 1.0 <= z[0] <= 4.0 and abs(z[1]) <= 0.5:
                expected.add((t, j))
    assert set(zip(log.steps.tolist(), log.landmarks.tolist())) == expected


def test_the_limits_are_those_of_a_camera_with_an_offset():
    """Every landmark within range and view of the camera is seen, and no other, wherever it is on the robot."""
    sensor, limits = SensorModel(offset=(1.5, -0.5)), {"min_range": 1.0, "max_range": 4.0, "field_of_view": 1.0}
    log = simulate(motion_faults=SMOOTH, sensor_faults=QUIET, sensor=sensor, steps=400, **limits)
    expected = set()
    for t, (x, y, theta) in enumerate(log.true_poses):
        camera = np.array([x, y]) + [
            1.5 * np.cos(theta) + 0.5 * np.sin(theta),
            1.5 * np.sin(theta) - 0.5 * np.cos(theta),
        ]
        for j, landmark in log.true_landmarks.items():
            ahead = landmark[:2] - camera
            bearing = wrap(np.arctan2(ahead[1], ahead[0]) - theta)
            if 1.0 <= np.hypot(*ahead) <= 4.0 and abs(bearing) <= 0.5:
                expected.add((t, j))
    assert set(zip(log.steps.tolist(), log.landmarks.tolist())) == expected
    assert np.abs(log.sightings[:, 1]).max() <= 0.5


def test_clean_noise_is_the_models_own():
    """Whitened motion and sensor residuals against the truth are standard normal at an error rate of 1e-6."""
    motion, sensor = MotionModel(), SensorModel(range_rate=0.05)
    log = simulate(steps=3000, clean=True, motion=motion, sensor=sensor, seed=5, max_range=30.0, arena=50.0)
    moved = log.true_poses[1:] - motion.f(log.true_poses[:-1], log.controls, log.dt)
    moved[:, 2] = wrap(moved[:, 2])
    covariance = motion.covariance(log.true_poses[:-1], log.controls, log.dt)
    white = np.linalg.solve(np.linalg.cholesky(covariance), moved[:, :, None]).ravel()
    assert stats.kstest(white, "norm").pvalue > ERROR_RATE / 4
    world = np.array([log.true_landmarks[j] for j in log.landmarks.tolist()])
    exact = sensor.h(log.true_poses[log.steps], world)
    seen = log.sightings - exact
    seen[:, 1:] = wrap(seen[:, 1:])
    white = seen / np.sqrt(np.diagonal(sensor.Q(exact), axis1=1, axis2=2))
    assert len(white) > 500
    for column in white.T:
        assert stats.kstest(column, "norm").pvalue > ERROR_RATE / 4


def test_velocity_bias_scales_the_whole_run():
    log = simulate(motion_faults=MotionFaults(kicks_per_metre=0, velocity_bias_std=0.2), seed=2)
    lengths = np.linalg.norm(np.diff(log.true_poses[:, :2], axis=0), axis=1)
    assert np.ptp(lengths) < 1e-9
    assert abs(lengths[0] / np.linalg.norm(np.diff(log.initial_poses[:2, :2], axis=0)) - 1) > 0.01


@pytest.mark.slow
def test_pebbles_turn_the_robot_at_the_given_rate():
    log = simulate(motion_faults=MotionFaults(kicks_per_metre=5, kick_std=0.1, velocity_bias_std=0), steps=9000, seed=1)
    # variance of the heading per metre is rate times kick variance: 0.05 rad² per metre, 5,400 m driven
    turned = np.diff(np.unwrap(log.true_poses[:, 2])) - log.controls[:, 1] * log.dt
    # a step has k = 3 kicks on average, and its squared turn a mean of k and a variance of 3 k + 2 k² (times kick variances)
    error = bound() * np.sqrt((3 * 3 + 2 * 3**2) / 9000) / 3
    assert np.sum(turned**2) / (9000 * 0.6) == pytest.approx(5 * 0.1**2, rel=error)


def test_stuck_wheels_stop_the_robot_for_a_while():
    faults = MotionFaults(kicks_per_metre=0, velocity_bias_std=0, stuck_interval=30.0, stuck_duration=30.0)
    log = simulate(motion_faults=faults, steps=2000, seed=0)
    still = np.linalg.norm(np.diff(log.true_poses[:, :2], axis=0), axis=1) < 1e-12
    assert 0.3 < still.mean() < 0.6
    assert np.all(log.controls[:, 0] > 0)


def test_wheels_that_are_stuck_for_no_time_are_never_stuck():
    free = MotionFaults(kicks_per_metre=0, velocity_bias_std=0)
    log = simulate(motion_faults=replace(free, stuck_interval=10.0, stuck_duration=0.0))
    np.testing.assert_array_equal(log.true_poses, simulate(motion_faults=free).true_poses)


def test_kidnapping_sets_the_robot_down_elsewhere():
    faults = MotionFaults(kicks_per_metre=0, velocity_bias_std=0, kidnap_interval=60.0)
    log = simulate(motion_faults=faults, steps=2000, seed=0)
    jumps = np.linalg.norm(np.diff(log.true_poses[:, :2], axis=0), axis=1) > 0.61
    # 6,000 s at one in 60 s: a Poisson count, of which the few jumps of less than 0.61 m are not seen
    low, high = stats.poisson.interval(1 - ERROR_RATE, 100)
    assert low - 5 <= jumps.sum() <= high


def test_sensor_bias_is_one_for_the_run():
    faults = SensorFaults(**STILL, range_bias_rate_std=0.2, bearing_bias_std=0.1, orientation_bias_std=0.1)
    log = simulate(motion_faults=SMOOTH, sensor_faults=faults, seed=3)
    world = np.array([log.true_landmarks[j] for j in log.landmarks.tolist()])
    exact = SensorModel().h(log.true_poses[log.steps], world)
    assert np.ptp(log.sightings[:, 0] / exact[:, 0]) < 1e-12
    assert np.ptp(wrap(log.sightings[:, 1] - exact[:, 1])) < 1e-12
    assert abs(log.sightings[0, 0] / exact[0, 0] - 1) > 1e-3


@pytest.mark.parametrize(("fault", "share"), [("oversight", 0.3), ("phantom", 0.3), ("occlusion", 0.3)])
def test_faulty_sightings_come_at_their_rate(fault, share):
    clear = simulate(motion_faults=SMOOTH, sensor_faults=QUIET, steps=1500)
    faults = SensorFaults(**(STILL | NO_BIAS | {fault: share}))
    log = simulate(motion_faults=SMOOTH, sensor_faults=faults, steps=1500)
    # each sighting is a trial of its own: an error rate of 1e-6
    error = bound() * np.sqrt(share * (1 - share) / len(clear.steps))
    if fault == "oversight":
        assert len(log.steps) / len(clear.steps) == pytest.approx(1 - share, abs=error)
        return
    assert len(log.steps) == len(clear.steps)
    wrong = np.abs(log.sightings[:, 0] - clear.sightings[:, 0]) > 1e-9
    assert wrong.mean() == pytest.approx(share, abs=error)
    if fault == "occlusion":
        assert np.all(log.sightings[wrong, 0] > clear.sightings[wrong, 0])
        assert log.sightings[:, 0].max() <= 6.0


def test_way_points_are_visited_in_turn():
    route = [(5.0, 0.0), (5.0, 5.0), (0.0, 5.0), (0.0, 0.0)]
    log = simulate(
        steps=200, dt=1.0, speed=0.3, turn_rate=1.0, way_points=route, start=(0, 0, 0), motion_faults=SMOOTH,
        sensor_faults=QUIET,
    )  # fmt: skip
    times = [int(np.argmin(np.linalg.norm(log.true_poses[:75, :2] - p, axis=1))) for p in route]
    assert times[:3] == sorted(times[:3])
    for p in route:
        assert np.linalg.norm(log.true_poses[:, :2] - p, axis=1).min() < 0.31


def test_random_landmarks_and_no_orientation():
    log = simulate(landmarks=30, orientation=False, seed=9)
    assert len(log.true_landmarks) == 30
    assert log.sightings.shape[1] == 2
    assert all(m.shape == (2,) for m in log.true_landmarks.values())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps must be at least 1"),
        ({"dt": 0.0}, "dt must be a positive"),
        ({"max_range": -1.0}, "max_range must be a positive"),
        ({"min_range": 7.0}, "min_range must lie between"),
        ({"landmarks": 0}, "landmarks must be at least 1"),
        ({"landmarks": [[1.0]]}, "landmarks must be a number or an array"),
        ({"way_points": [1.0, 2.0]}, "way_points must have shape"),
        ({"start": (0.0, 0.0)}, "start must be"),
        ({"clean": True, "sensor_faults": SensorFaults()}, "clean means no faults"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(OptionError, match=message):
        simulate(**options)


def test_impossible_faults():
    with pytest.raises(OptionError, match="phantom must lie between 0 and 1"):
        SensorFaults(phantom=1.5)
    with pytest.raises(OptionError, match="stuck_interval must not be negative"):
        MotionFaults(stuck_interval=-1.0)


def test_biases_are_noted_and_their_values_are_those_of_the_data(tmp_path):
    faults = SensorFaults(
        range_noise_rate=0, bearing_noise=0, orientation_noise=0, range_bias_rate_std=0.1, bearing_bias_std=0.05,
        orientation_bias_std=0, oversight=0,
    )  # fmt: skip
    log = simulate(seed=5, sensor_faults=faults, motion_faults=MotionFaults(velocity_bias_std=0))
    (note,) = log.notes
    exact = SensorModel().h(
        log.true_poses[log.steps], np.array([log.true_landmarks[j] for j in log.landmarks.tolist()])
    )
    assert (
        f"(range x {log.sightings[0, 0] / exact[0, 0]:.3f}, bearing {log.sightings[0, 1] - exact[0, 1]:+.3f} rad)"
        in note
    )
    # the note ends in the command that estimates them, and names no parameter without a bias
    assert note.endswith("to estimate the biases: --estimate range_scale,bearing_bias --estimators graph-marginal")
    assert "--estimate wheel_scale,turn_scale,bearing_bias " in load(sample_log_path()).notes[0]
    save(log, tmp_path / "log.npz")
    assert load(tmp_path / "log.npz").notes == log.notes
    assert simulate(seed=5, clean=True).notes == ()


def test_the_limits_of_the_sensor_apply_where_they_are_stricter_than_those_of_the_world():
    sensor = SensorModel(offset=(1.5, 0.4), max_range=2.5, field_of_view=1.0)
    log = simulate(seed=3, clean=True, sensor=sensor, min_range=0, max_range=4.0)
    places = np.array([log.true_landmarks[j][:2] for j in log.landmarks.tolist()])
    assert sensor.sees(log.true_poses[log.steps], places).all()
    # and all that it sees is reported
    assert 5 < len(places) == sum(np.sum(sensor.sees(log.true_poses, m[:2])) for m in log.true_landmarks.values())
