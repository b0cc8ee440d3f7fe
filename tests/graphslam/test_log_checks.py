"""Mistakes in a log are found before it is solved, each with its cause; correct logs are left alone."""

import re
from pathlib import Path

import numpy as np
import pytest

from graphslam import (
    Drive,
    Graph,
    LogError,
    MotionModel,
    SensorModel,
    Stream,
    estimate_robot,
    load,
    sample_log_path,
    simulate,
    synchronize,
)
from graphslam.log.rows import UNIDENTIFIED
from graphslam.log_checks import check_log
from graphslam.log_checks.readings import pairs_of
from graphslam.se2 import wrap


def checks(log):
    return [finding.check for finding in check_log(log)]


@pytest.fixture(scope="module")
def sample():
    return load(sample_log_path()).replace(true_poses=None)


@pytest.fixture(scope="module")
def own():
    return load(Path(__file__).parents[2] / "examples" / "own_robot")


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
    "contradiction": lambda log: bearings(log, lambda phi: wrap(np.rad2deg(phi))),
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
    findings = check_log(MISTAKES[name](sample))
    assert name.partition(" (")[0] in [finding.check for finding in findings]
    for finding in findings:
        assert "\n" not in finding.message and finding.message[-1] not in ".?"


def test_sightings_in_the_axes_of_the_world_are_found():
    log, _ = Drive(seed=3, duration=120.0).simulate()
    heading = log.true_poses[log.steps, 2]
    assert "fixed axes" not in checks(log)
    assert "fixed axes" in checks(bearings(log, lambda b: wrap(b + heading + 0.7)))
    # a compass counts clockwise
    assert "fixed axes" in checks(bearings(log, lambda b: wrap(2 - b - heading)))


def test_the_message_names_the_cause_and_the_option(sample):
    (finding,) = check_log(bearings(sample, lambda b: -b))
    assert finding.message.startswith(
        "the bearings, or else the turn rates, have the wrong sign (bearings='clockwise'): read like this, they fit the "
        "odometry "
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_correct_logs_are_left_alone(seed):
    assert not checks(simulate(seed=seed))
    assert not checks(simulate(seed=seed, clean=True))
    assert not checks(simulate(seed=seed).without_orientation())
    assert not checks(simulate(seed=seed).replace(true_poses=None))


@pytest.mark.slow
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
    (finding,) = check_log(precise(1.2))
    assert finding.check == "clock"
    assert "the clock of the sightings is about 1.2 s fast (clocks='sightings=-1.2')" in finding.message


def test_other_units_and_directions_are_found():
    log = precise()
    (finding,) = check_log(log.replace(sightings=log.sightings / [0.3048, 1]))
    assert finding.message.startswith("the ranges are in feet, against the other lengths")
    (finding,) = check_log(bearings(log, lambda b: b - np.pi / 3))
    assert finding.message.startswith("the sensor looks about 60 degrees to the left (sensor_yaw=1.0472)")
    (finding,) = check_log(bearings(log, lambda b: np.pi / 2 - b))
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
    assert pairs_of(sample.at_steps([0, 1])) is None


def test_duplicate_ids(sample):
    other = sample.landmarks.copy()
    other[other == 9] = 6
    assert "duplicate ids" in checks(sample.replace(landmarks=other))


def test_a_doubled_sighting_without_an_id_is_said_to_have_none(sample):
    ids, z = sample.landmarks.copy(), sample.sightings.copy()
    k = int(np.argmax(np.diff(sample.steps) == 0))
    ids[k : k + 2], z[k + 1] = UNIDENTIFIED, z[k]
    found = message(sample.replace(landmarks=ids, sightings=z), "doubled sightings")
    assert f"the first without an id at step {sample.steps[k]}" in found


def message(log, check):
    (finding,) = (finding for finding in check_log(log) if finding.check == check)
    return finding.message


@pytest.mark.parametrize("truth", [True, False], ids=["with truth", "without"])
@pytest.mark.parametrize("change", [lambda ids: ids + 1, lambda ids: ids + 100], ids=["by one", "new ones"])
def test_ids_that_change_in_the_middle(own, change, truth):
    log = own if truth else own.replace(true_poses=None)
    ids, middle = log.landmarks.copy(), len(log.landmarks) // 2
    ids[middle:] = change(ids[middle:])
    found = message(log.replace(landmarks=ids), "ids change")
    when = log.times[log.steps[middle]] - log.start_time
    assert found.startswith(f"landmarks have other ids from about {when:.1f} s after the start on (")
    assert found.endswith("); a detector may have counted them anew") and " becomes " in found


def test_ids_that_are_exchanged_in_the_middle(own):
    ids, middle = own.landmarks.copy(), len(own.landmarks) // 2
    names = own.landmark_ids
    ids[middle:] = np.roll(names, 5)[np.searchsorted(names, ids[middle:])]
    found = message(own.replace(landmarks=ids, true_poses=None), "ids change")
    assert " becomes " in found


TRUTH = {
    "x and y of the truth are swapped: read like this, the robot looks where it drives": lambda x: x[:, [1, 0, 2]],
    "x of the truth has the wrong sign: read like this, the robot looks where it drives": lambda x: x * [-1, 1, 1],
    "y of the truth has the wrong sign: read like this, the robot looks where it drives": lambda x: x * [1, -1, 1],
    "the true path turns the other way than the odometry: x and y of the truth may be swapped, or one of them or of the turn "
    "rates have the wrong sign": lambda x: x[:, [1, 0, 2]] * [1, 1, np.nan],
}


@pytest.mark.parametrize("expected", TRUTH, ids=["swapped", "x", "y", "without headings"])
def test_truth_that_is_mirrored(own, expected):
    for log in (own, simulate(seed=1)):
        assert message(log.replace(true_poses=TRUTH[expected](log.true_poses)), "truth mirrored") == expected


def test_truth_whose_headings_mean_nothing():
    log = load(sample_log_path())
    log = log.replace(true_poses=log.true_poses * [1, 1, np.rad2deg(1)])
    assert "have nothing to do with the direction of driving" in message(log, "truth heading")


def test_a_map_that_does_not_belong_to_the_log(own):
    true = own.true_landmarks
    assert message(own.replace(true_landmarks={j + 500: m for j, m in true.items()}), "map ids") == (
        "none of the 14 landmarks that are seen (1, 2, 3, ...) is among the 14 of the true map (501, 502, 503, ...); the ids "
        "of one of them may be of another list or column"
    )
    found = message(own.replace(true_landmarks={j: 1000 * m for j, m in true.items()}), "map")
    assert found.endswith(" times as large: it may be in another unit")
    assert "mirror image of what is seen" in message(
        own.replace(true_landmarks={j: m[::-1] for j, m in true.items()}), "map mirrored"
    )
    shifted = own.replace(true_landmarks=dict(zip(true, np.roll(list(true.values()), 1, axis=0))))
    assert "its ids may belong to other landmarks" in message(shifted, "map")
    exchanged = np.random.default_rng(0).permutation(list(true.values()))
    log = own.replace(true_landmarks=dict(zip(true, exchanged)), true_poses=None)
    assert "the ids of the map may belong to other landmarks" in message(log, "map")
    assert not checks(own.replace(true_landmarks={j: true[j] for j in list(true)[:3]}))


def test_landmarks_that_are_seen_once(sample):
    one = sample.replace(steps=[5], landmarks=[7], sightings=[[1.0, 0.2]])
    assert message(one, "seen once") == (
        "the only sighting is of landmark 7, so that nothing corrects the odometry; rows may be missing, or clocks differ"
    )
    two = sample.replace(steps=[5, 9], landmarks=[7, 8], sightings=[[1.0, 0.2], [1.0, 0.2]])
    assert "the 2 sightings are of 2 landmarks" in message(two, "seen once")


def test_turn_rates_in_degrees_of_a_robot_that_turns_slowly():
    """2 m/s and 4 degrees/s: read as radians, half a second between sightings seems to be a turn of 2 rad."""
    rng = np.random.default_rng(1)
    times = 0.05 * np.arange(1200)
    headings = 0.07 * times
    places = np.cumsum(0.1 * np.column_stack([np.cos(headings), np.sin(headings)]), axis=0)
    marks = places[::60] + rng.uniform(-15, 15, (20, 2))
    rows = []
    for k in range(0, 1200, 10):
        ahead = marks - places[k]
        distance, bearing = np.hypot(*ahead.T), wrap(np.arctan2(ahead[:, 1], ahead[:, 0]) - headings[k])
        rows += [(times[k], j, distance[j], bearing[j]) for j in np.flatnonzero((distance < 25) & (abs(bearing) < 1.2))]
    seen = np.array(rows)
    for factor, expected in ((1.0, []), (180 / np.pi, ["turn rate unit"])):
        odometry = Stream(times, np.tile([2.0, 0.07 * factor], (1200, 1)))
        log = synchronize(odometry, Stream(seen[:, 0], seen[:, 2:]), seen[:, 1].astype(int))
        assert [check for check in checks(log) if check != "landmark seen once"] == expected


def test_a_range_that_means_nothing_measured_is_told(sample):
    sightings = sample.sightings.copy()
    sightings[[3, 40, 77], 0] = 65.535
    findings = {finding.check: finding.message for finding in check_log(sample.replace(sightings=sightings))}
    assert "3 sightings have the same range of 65.535 m" in findings["range without measurement"]
    # a single far sighting, or a range that repeats among others, is none
    sightings[[40, 77], 0] = sample.sightings[[40, 77], 0]
    assert "range without measurement" not in checks(sample.replace(sightings=sightings))
    rounded = np.round(sample.sightings, 0) + [1, 0, 0]
    assert "range without measurement" not in checks(sample.replace(sightings=rounded))


def test_a_sensor_that_reports_its_limit_for_all_that_is_farther_is_told(sample):
    limit = np.quantile(sample.sightings[:, 0], 0.8)
    clipped = sample.replace(sightings=np.minimum(sample.sightings, [limit, np.inf, np.inf]))
    findings = {finding.check: finding.message for finding in check_log(clipped)}
    count = np.count_nonzero(sample.sightings[:, 0] >= limit)
    assert f"{count} of {len(sample.steps)} sightings have the same range" in findings["range limit"]
    # ranges of a sensor with steps of 10 cm repeat, too
    stepped = np.ceil(sample.sightings * [10, 1e6, 1e6]) / [10, 1e6, 1e6]
    assert "range limit" not in checks(sample.replace(sightings=stepped))


def test_the_limit_of_a_sensor_is_told_of_a_corrected_log():
    """A delay that is taken out changes each range, so that no two are equal any more."""
    log, _ = Drive(seed=1, duration=60, parameters={"sensor_delay": 0.1}).simulate()
    clipped = log.replace(sightings=np.minimum(log.sightings, [np.median(log.sightings[:, 0]), np.inf]))
    assert "range limit" in checks(Graph.from_log(clipped).log)


@pytest.mark.parametrize("share", [0.01, 0.02, 0.05, 0.1])
def test_single_misread_ids_are_counted(share):
    """The sentence says how many at least, and not that a detector counted the landmarks anew."""
    log, rng = load(sample_log_path()), np.random.default_rng(0)
    ids, names = log.landmarks.copy(), log.landmark_ids
    wrong = np.flatnonzero(rng.random(len(ids)) < share)
    ids[wrong] = names[(np.searchsorted(names, ids[wrong]) + rng.integers(1, len(names), len(wrong))) % len(names)]
    findings = {finding.check: finding.message for finding in check_log(log.replace(landmarks=ids))}
    assert set(findings) == {"misread ids"}
    count, total = map(int, re.match(r"at least (\d+) of (\d+) sighting", findings["misread ids"]).groups())
    assert total == len(ids) and 0.6 * len(wrong) <= count <= len(wrong) + 1
    assert "single ids are probably misread" in findings["misread ids"]
    assert not checks(log)


def test_ids_that_change_are_told_among_misread_ones(own):
    rng, ids, middle = np.random.default_rng(0), own.landmarks + 0, len(own.landmarks) // 2
    ids[middle:] += 100
    wrong = np.flatnonzero(rng.random(len(ids)) < 0.03)
    ids[wrong] = rng.permutation(ids)[: len(wrong)]
    assert "counted them anew" in message(own.replace(landmarks=ids, true_poses=None), "ids change")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_landmarks_that_are_close_to_each_other_have_not_changed_their_ids(seed):
    """Several new landmarks at a time are beside others by chance where 600 stand on 48 m x 48 m."""
    rng, side, lane = np.random.default_rng(seed), 40.0, 8.0
    route = [(x, lane * k) for k in range(6) for x in ((0.0, side) if k % 2 == 0 else (side, 0.0))]
    log = simulate(
        steps=1500, dt=1.0, speed=0.25, turn_rate=1.0, way_points=route[1:], start=(0.0, 0.0, 0.0), clean=True, seed=seed,
        landmarks=rng.uniform(-4, side + 4, (600, 2)), max_range=5.55, field_of_view=3.14, orientation=False,
        motion=MotionModel(nn=0.019, no=1e-4, on=0.013, oo=0.02, epsilon=1e-6),
        sensor=SensorModel(range_rate=0.014, bearing_std=0.005),
    )  # fmt: skip
    assert not checks(log)


@pytest.mark.parametrize("seed", [0, 1])
def test_large_errors_among_many_landmarks_are_no_misread_ids(seed):
    """A sighting with a large error has others around it by chance where 80 landmarks stand on 12 m x 12 m."""
    landmarks = np.random.default_rng(seed).uniform(-6, 6, (80, 2))
    assert not checks(simulate(seed=seed, steps=400, landmarks=landmarks, clean=True, orientation=False))


def test_bearings_that_are_no_degrees(own):
    wrong = own.sightings.copy()
    wrong[:, 1] *= np.pi / 180
    assert "angles='sightings=radians'" in message(own.replace(sightings=wrong), "bearing unit")


def test_a_truth_at_every_other_pose_is_compared(own):
    """As of GPS once a second: no two neighbouring poses have a true one."""
    for log in (own, simulate(seed=1)):
        truth = log.true_poses.copy()
        truth[1::2] = np.nan
        assert not checks(log.replace(true_poses=truth))
        # degrees of latitude and longitude, taken for metres
        assert message(log.replace(true_poses=truth * [1e-5, 1e-5, 1]), "truth scale").startswith("the odometry drives")
        assert message(log.replace(true_poses=truth[:, [1, 0, 2]]), "truth mirrored").startswith("x and y of the truth")


def test_jitter_of_the_true_poses_is_no_other_unit():
    """True poses at 10 Hz with errors of 2 cm move three times as far as a robot with 0.1 m/s, from one to the next."""
    log = simulate(seed=0, steps=800, dt=0.1, speed=0.1, clean=True, motion=MotionModel.constant(0.01, 0.01))
    truth = log.true_poses.copy()
    truth[:, :2] += np.random.default_rng(0).normal(0, 0.02, truth[:, :2].shape)
    assert (
        np.hypot(*np.diff(truth[:, :2], axis=0).T).sum()
        > 2.5 * np.hypot(*np.diff(log.true_poses[:, :2], axis=0).T).sum()
    )
    assert "truth scale" not in checks(log.replace(true_poses=truth))
    assert "truth scale" in checks(log.replace(true_poses=truth * [3.0, 3.0, 1.0]))


def test_a_single_pose_is_said(sample):
    log = sample.at_steps(np.array([0]))
    assert checks(log) == ["single pose"] and not checks(sample)
    notes = Graph.from_log(log, edges="landmark+motion").notes
    assert any(note.startswith("the log has a single pose") for note in notes)
    with pytest.raises(LogError, match="sightings? from 1 pose;"):
        estimate_robot(log)
