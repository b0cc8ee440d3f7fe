"""Drives of robots that nobody has calibrated: their errors are those that the truth states.

Tolerances: each test of a fixed seed would fail for fewer than one in a million of other seeds.
"""

from dataclasses import replace

import numpy as np
import pytest
from error_rates import ERROR_RATE, bound, chi_square_bounds
from scipy import stats

from graphslam import Drive, Graph, Log, LogError, MotionModel, OptionError, solve
from graphslam.identification.declared import PARAMETERS
from graphslam.log.rows import UNIDENTIFIED
from graphslam.log.streams import Stream, truth_at
from graphslam.se2 import between, wrap
from graphslam.simulation.drives import SPREADS, correlated_errors
from graphslam.simulation.places import PLACES, Place, follow
from graphslam.simulation.worlds import SENSORS

BIASES = {
    "wheel_scale": 0.97, "turn_scale": 1.01, "turn_rate_bias": -0.006, "curvature_bias": 0.004, "range_scale": 1.01,
    "range_bias": 0.04, "bearing_bias": 0.02, "sensor_ahead": 0.1, "sensor_left": -0.04, "sensor_delay": 0.05,
}  # fmt: skip
HONEST = {"misread": 0.0, "clutter": 0.0, "parameters": {}}


def chi_square_fits(squares: np.ndarray) -> bool:
    """Whether squares of standard normal numbers have a plausible sum."""
    low, high = chi_square_bounds(squares.size)
    return bool(low < squares.sum() < high)


def without_biases(log: Log, p: dict) -> Log:
    nu = log.controls[:, 0] / p["wheel_scale"]
    omega = (log.controls[:, 1] - p["turn_rate_bias"] - p["curvature_bias"] * nu) / p["turn_scale"]
    return log.replace(controls=np.column_stack([nu, omega]))


def eyes(log: Log, p: dict) -> np.ndarray:
    """The true poses of the sensor when it saw each sighting."""
    path = Stream(log.start_time + np.concatenate([[0.0], np.cumsum(log.dt)]), log.true_path)
    poses = truth_at(log.times[log.steps] - p["sensor_delay"], path)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] += c * p["sensor_ahead"] - s * p["sensor_left"]
    poses[:, 1] += s * p["sensor_ahead"] + c * p["sensor_left"]
    return poses


def errors_of_sightings(log: Log, truth, p: dict) -> np.ndarray:
    """Errors (M, d) over their true standard deviations, of the sightings of true landmarks."""
    at = eyes(log, p)
    real = ~truth.clutter & np.isfinite(at[:, 0])
    to = np.array([log.true_landmarks[j] for j in truth.landmarks[real].tolist()])
    d = to[:, :2] - at[real, :2]
    bearing = np.arctan2(d[:, 1], d[:, 0])
    exact = [np.hypot(*d.T), bearing - at[real, 2]]
    if log.has_orientation:
        exact.append(bearing - to[:, 2])
    exact = np.column_stack(exact)
    e = log.sightings[real] - exact
    e[:, 0] = (log.sightings[real, 0] - p["range_bias"]) / p["range_scale"] - exact[:, 0]
    e[:, 1] -= p["bearing_bias"]
    e[:, 1:] = wrap(e[:, 1:])
    sensor = truth.sensor
    deviations = np.array([[1.0, sensor.bearing_std, sensor.orientation_std]])[:, : e.shape[1]].repeat(len(e), axis=0)
    deviations[:, 0] = np.hypot(sensor.range_rate * exact[:, 0], sensor.range_std)
    return e / deviations


def test_the_same_seed_makes_the_same_drive_and_log():
    assert Drive.random(1000) == Drive.random(1000) != Drive.random(1001)
    log, truth = Drive.random(1000).simulate()
    again, same = Drive.random(1000).simulate()
    assert log.equals(again)
    assert np.array_equal(truth.landmarks, same.landmarks) and np.array_equal(truth.misread, same.misread)
    assert not replace(Drive.random(1000), seed=1).simulate()[0].equals(log)


def test_the_log_is_a_recording_that_does_not_tell_its_noise():
    log, truth = Drive(duration=60).simulate()
    assert not log.simulated and log.motion is None and log.sensor is None and log.notes == ()
    assert log.composite and log.true_path is not None
    assert len(truth.landmarks) == len(truth.misread) == len(truth.clutter) == len(log.steps)
    assert set(truth.parameters) == set(PARAMETERS)
    np.testing.assert_array_equal(log.initial_poses[0], log.true_poses[0])


@pytest.mark.parametrize("gyroscope", [False, True])
def test_odometry_errors_have_the_stated_noise_and_biases(gyroscope):
    drive = Drive(duration=600, parameters=BIASES)
    if gyroscope:
        drive = replace(drive, motion=replace(drive.motion, on=0.0, oo=0.0, sigma_omega=0.02, sigma_v=0.05))
    recorded, truth = drive.simulate()

    def squares(log: Log) -> np.ndarray:
        # windows of some five seconds, so that hardly a control is shared by two
        log = log.at_steps(np.arange(0, log.num_poses, 30))
        motions, covariances = log.motions(truth.motion)
        e = between(log.true_poses[:-1], log.true_poses[1:]) - motions
        e[:, 2] = wrap(e[:, 2])
        white = np.linalg.solve(np.linalg.cholesky(covariances), e[..., None])[..., 0]
        return white**2

    corrected = squares(without_biases(recorded, drive.parameters))
    assert chi_square_fits(corrected), corrected.mean(axis=0)
    assert not chi_square_fits(squares(recorded))


@pytest.mark.parametrize(("place", "sensor"), [("warehouse", "camera"), ("orchard", "laser"), ("field", "reflectors")])
def test_errors_of_sightings_have_the_stated_noise_and_biases(place, sensor):
    drive = Drive(
        place=place, sensor=SENSORS[sensor], duration=200, sensor_rate=5, orientation=sensor == "camera", clutter=0.02,
        parameters=BIASES,
    )  # fmt: skip
    log, truth = drive.simulate()

    def plausible(p: dict) -> bool:
        e = errors_of_sightings(log, truth, p)
        return chi_square_fits(e**2) and bool(np.all(np.abs(e.mean(axis=0)) < bound(e.shape[1]) / np.sqrt(len(e))))

    assert plausible(drive.parameters)
    for name in ("range_bias", "bearing_bias", "sensor_ahead", "sensor_delay"):
        assert not plausible(drive.parameters | {name: PARAMETERS[name].ideal}), name


def test_correlated_errors_have_the_stated_variance_and_correlation():
    pairs, part, tau, lapse = 20_000, 0.6, 4.0, 2.0
    seen = np.tile(np.arange(pairs), 2)
    e = correlated_errors(np.repeat([0.0, lapse], pairs), seen, part, tau, np.random.default_rng(0)).reshape(
        2, pairs, 3
    )
    expected = part * np.exp(-lapse / tau)
    products = (e[0] * e[1]).ravel()
    assert abs(products.mean() - expected) < bound() * np.sqrt((1 + expected**2) / products.size)
    assert chi_square_fits(e[0] ** 2) and chi_square_fits(e[1] ** 2)


def test_a_drive_with_correlated_errors_repeats_its_errors_within_a_visit():
    drive = Drive(duration=300, correlated=0.8, correlation=70, **HONEST)
    for part in (0.8, 0.0):
        log, truth = replace(drive, correlated=part).simulate()
        assert truth.correlated == part and truth.correlation_time == 7.0
        e = errors_of_sightings(log, truth, drive.parameters)[:, 1]
        order = np.lexsort((log.times[log.steps], truth.landmarks))
        same = np.diff(truth.landmarks[order]) == 0
        near = same & (np.diff(log.times[log.steps][order]) < 0.25)
        products = (e[order][1:] * e[order][:-1])[near]
        # independent: the standard error is at most 1 / sqrt(n); correlated: about 0.8 less a few standard errors of visits
        assert near.sum() > 1000
        if part == 0:
            assert abs(products.mean()) < bound() / np.sqrt(near.sum())
        else:
            assert products.mean() > 0.4


def test_misread_ids_and_clutter_are_as_frequent_as_stated_and_known_to_the_truth():
    drive = Drive(misread=0.08, clutter=0.03, parameters={})
    log, truth = drive.simulate()
    real = ~truth.clutter
    n = int(real.sum())
    assert abs(truth.misread.sum() - 0.08 * n) < bound() * np.sqrt(n * 0.08 * 0.92)
    total = len(real)
    assert abs(truth.clutter.sum() - 0.03 * total) < bound() * np.sqrt(total * 0.03)
    assert truth.misread_share == np.mean(truth.misread | truth.clutter)
    assert np.all(truth.landmarks[truth.clutter] == UNIDENTIFIED) and not np.any(truth.misread & truth.clutter)
    assert np.array_equal(log.landmarks != truth.landmarks, truth.misread | truth.clutter)
    new = log.landmarks >= drive.landmarks
    assert 0 < new.sum() < 0.2 * truth.misread.sum() and np.all(truth.misread[new])
    # a wrong id is any other one: no landmark is taken much more often than the mean
    wrong = log.landmarks[truth.misread & ~new]
    counts = np.bincount(wrong, minlength=drive.landmarks)
    assert stats.chisquare(counts).pvalue > ERROR_RATE


def test_the_sensor_sees_within_its_limits_and_not_through_racks():
    drive = Drive(duration=300, missed=0.0, **HONEST)
    place = PLACES["warehouse"](40, 8.0, np.random.default_rng(0))
    log, truth = drive.simulate()
    at = eyes(log, drive.parameters)
    to = np.array([log.true_landmarks[j] for j in truth.landmarks.tolist()])[:, :2] - at[:, :2]
    assert np.hypot(*to.T).max() <= drive.sensor.max_range + 1e-6
    assert np.abs(wrap(np.arctan2(to[:, 1], to[:, 0]) - at[:, 2])).max() <= drive.sensor.field_of_view / 2 + 1e-6
    wall = Place(np.array([[2.0, 0.0, np.pi], [2.0, 5.0, np.pi]]), True, np.array([[1.0, -1.0, 1.0, 1.0]]), iter(()))
    eyes_at = np.array([[0.0, 0.0], [0.0, 5.0], [4.0, 5.0], [1.5, 0.0]])
    # hidden by the wall; beside it; from behind; in front of the wall
    assert wall.in_sight(eyes_at, np.array([0, 1, 1, 0])).tolist() == [False, True, False, True]
    assert len(place.walls) >= 5


def test_a_pause_of_the_sensor_leaves_a_gap():
    longest = [np.diff(Drive(duration=120, gaps=n, gap=30.0).simulate()[0].times).max() for n in (0, 1)]
    assert longest[1] >= 30.0 > 15.0 > longest[0]


def test_the_robot_stays_within_its_speeds_and_follows_its_way_points():
    way = [(0.0, 0.0, 0.0), (10.0, 0.0, 3.0), (10.0, 8.0, 0.0), (0.0, 8.0, 0.0)] * 20
    path = follow(way, speed=1.2, turn_rate=0.9, duration=120, slip=0.0, wander=0.0, rng=np.random.default_rng(0))
    nu, omega = path.controls.T
    assert nu.min() >= 0 and nu.max() <= 1.2 and np.abs(omega).max() <= 0.9
    assert np.mean(nu == 0) > 0.02  # it stops for three seconds
    for x, y, _ in way[:4]:
        assert np.hypot(*(path.poses[:, :2] - [x, y]).T).min() < 0.5
    times = np.arange(0, 120, 0.013)
    driven = MotionModel().dead_reckoning(path.at(times[:1])[0], path.odometry(times)[:-1], np.diff(times))
    np.testing.assert_allclose(driven, path.at(times), atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1040))
def test_random_drives_are_recordings_within_the_stated_ranges(seed):
    drive = Drive.random(seed)
    log, truth = drive.simulate()
    p = truth.parameters
    assert abs(p["wheel_scale"] - 1) <= 0.04 and abs(p["turn_rate_bias"]) <= 0.008 and 0 <= p["sensor_delay"] <= 0.06
    assert 0 <= truth.misread_share <= 0.2 and len(log.landmark_ids) >= 4
    assert 100 <= len(log.steps) <= 20_000
    assert all(abs(p[name] - PARAMETERS[name].ideal) <= 4 * SPREADS.get(name, 0.0) for name in PARAMETERS)


def test_random_drives_cover_the_range():
    drives = [Drive.random(seed) for seed in range(1000, 1200)]
    assert {drive.place for drive in drives} == set(PLACES)
    along, bearing = (np.array(values) for values in zip(*[(d.motion.nn, d.sensor.bearing_std) for d in drives]))
    assert along.max() / along.min() > 100 and bearing.max() / bearing.min() > 30
    assert 0.1 < np.mean([drive.misread == 0 for drive in drives]) < 0.4
    assert 0.3 < np.mean([drive.correlated > 0 for drive in drives]) < 0.7
    assert {drive.orientation for drive in drives} == {True, False}
    assert any(d.motion.sigma_omega > 0 for d in drives) and any(d.motion.oo > 0 for d in drives)


@pytest.mark.slow
@pytest.mark.parametrize("precise", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_whoever_knows_noise_and_ids_finds_the_biases(precise):
    """With single controls in place of their mean around each pose the delay is 0.038 +- 0.002 s for 0.05 s."""
    biases = {name: value for name, value in BIASES.items() if name != "range_scale"}
    drive = Drive(seed=0, duration=80, odometry_rate=20, parameters=biases, clutter=0.01)
    if precise:
        # a long mean of controls blurs turns: over 0.3 s to each side it takes the delay off
        wheels = replace(drive.motion, nn=0.002, no=0.0002, on=0.001, oo=0.002, slip=0.001)
        sensor = replace(drive.sensor, range_rate=0.002, range_std=0.003, bearing_std=0.001)
        drive = replace(drive, motion=wheels, sensor=sensor)
    log, truth = drive.simulate()
    right = log.with_sightings(~truth.clutter, landmarks=truth.landmarks[~truth.clutter])
    graph = Graph.from_log(
        right, motion=truth.motion, sensor=truth.sensor, edges="landmark+motion", estimate=list(biases)
    )
    found = solve(graph).parameters
    errors = np.array([(found[name] - value) / found.deviations[name] for name, value in biases.items()])
    assert np.abs(errors).max() < bound(errors.size), dict(zip(biases, errors))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"place": "attic"}, "place must be one of"),
        ({"landmarks": 3}, "landmarks must be at least 4"),
        ({"misread": 1.0}, "misread must lie between 0 and 1, not 1.0"),
        ({"duration": 0.0}, "duration"),
        ({"parameters": {"wheels": 1.0}}, "there is no 'wheels'"),
        ({"sensor": replace(SENSORS["camera"], max_range=np.inf)}, "sensor needs a max_range"),
        ({"parameters": {"wheel_scale": "1"}}, "wheel_scale must be a finite number, not '1'"),
        ({"duration": 10.0, "odometry_rate": 0.05}, "a drive of 10 s must have two rows of odometry, but has 1"),
        ({"duration": 10.0, "silence": 20.0, "silences": 1}, "but has 0"),
    ],
)
def test_impossible_settings_are_refused(settings, message):
    with pytest.raises(OptionError, match=message):
        Drive(**settings).simulate()


@pytest.mark.parametrize("settings", [{"duration": 3.0}, {"duration": 0.3, "clutter": 0.1}])
def test_a_drive_may_be_shorter_than_a_silence(settings):
    try:
        log, _ = Drive(**settings).simulate()
    except LogError as error:
        assert "no landmark is seen" in str(error)
    else:
        assert len(log.steps) > 0
