"""The first fix in a map: closed forms, misread ids, calibrated covariances, and what is said where there is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from graphslam import Graph, GraphError, LandmarkMap, Log, MotionModel, SensorModel, first_fix, simulate, solve
from graphslam.log import UNIDENTIFIED
from graphslam.maps.localization import _agreed, _cause
from graphslam.maps.map_evidence import Weighed
from graphslam.maps.registration import Points, register
from graphslam.maps.stretch import Stretch, drifted, moved
from graphslam.se2 import between, compose, wrap

ANGLES, PLACES = st.floats(-np.pi, np.pi), st.floats(-50, 50)


def points_of(measured, places, ids, std=0.01):
    count = len(ids)
    covariances = np.tile(std**2 * np.eye(3), (count, 1, 1))
    return Points(np.array(measured), covariances, np.array(places), 0 * covariances, np.array(ids), 100.0)


def log_of(sightings, ids, sensor):
    """A log of one pose, anywhere."""
    return Log(dt=np.zeros(0), controls=np.zeros((0, 2)), initial_poses=[[7, 8, 0]], steps=np.zeros(len(ids), dtype=int),
               landmarks=ids, sightings=sightings, sensor=sensor)  # fmt: skip


@given(PLACES, PLACES, ANGLES)
def test_two_landmarks_fix_the_pose_exactly(x, y, theta):
    pose, sensor = np.array([x, y, theta]), SensorModel()
    places = {1: pose[:2] + (3.0, 1.0), 2: pose[:2] + (-1.0, 2.0)}
    z = np.array([sensor.h(pose, places[j]) for j in (1, 2)])
    fix = first_fix(log_of(z, [1, 2], sensor), LandmarkMap(places))
    assert np.allclose(fix.pose[:2], pose[:2], atol=1e-9)
    assert abs(wrap(fix.pose[2] - theta)) < 1e-9
    assert len(fix.agree) == 2 and not len(fix.disagree)


@given(PLACES, PLACES, ANGLES)
def test_one_landmark_with_a_heading_fixes_the_pose(x, y, theta):
    pose, place = np.array([x, y, theta]), np.array([x + 2.0, y - 1.0, 0.7])
    matches = register(points_of(compose(np.array([0, 0, 0]), between(pose, place))[None], place[None], [4]))
    assert np.allclose(matches[0].pose[:2], pose[:2], atol=1e-9)
    assert abs(wrap(matches[0].pose[2] - theta)) < 1e-9


def test_a_landmark_with_a_wrong_id_is_found():
    pose = np.array([1.0, 2.0, 0.3])
    places = np.array([[3.0, 0, np.nan], [0, 4.0, np.nan], [-2.0, -1.0, np.nan], [5.0, 5.0, np.nan]])
    measured = places.copy()
    measured[:, :2] = between(pose, np.nan_to_num(places))[:, :2]
    wrong = places[[0, 1, 2, 0]]
    best, *_ = register(points_of(measured, wrong, [0, 1, 2, 0]))
    assert best.agree.tolist() == [True, True, True, False]
    assert np.allclose(best.pose, pose, atol=1e-9)


MODELS = {
    "sensor": SensorModel(range_rate=0.03, bearing_std=0.02),
    "motion": MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05, epsilon=1e-6),
}


def errors_of_fixes(seeds, share=0.0, **world):
    """e' P^-1 e of the first fixes of drives, of whose ids this share is misread."""
    rng, squares = np.random.default_rng(0), []
    for seed in range(seeds):
        log = simulate(clean=True, orientation=False, seed=seed, **world, **MODELS)
        misread = rng.random(len(log.steps)) < share
        ids = log.landmarks.copy()
        ids[misread] = rng.integers(0, 6, misread.sum())
        known = {j: m[:2] for j, m in log.true_landmarks.items()}
        fix = first_fix(log.replace(landmarks=ids), known, **MODELS)
        error = fix.pose - log.true_poses[0]
        error[2] = wrap(error[2])
        squares.append(error @ np.linalg.solve(fix.covariance, error))
    return np.array(squares)


@pytest.mark.nightly
def test_the_covariance_of_the_fix_is_that_of_its_errors():
    """The errors follow chi square with three degrees of freedom, although sightings share those of the odometry."""
    squares = errors_of_fixes(300, steps=8, max_range=10.0)
    # 3.3 standard deviations of the mean of 300: one test in a thousand fails
    assert abs(np.mean(squares) - 3) < 3.3 * np.sqrt(6 / 300)
    assert np.mean(squares > chi2.ppf(0.99, 3)) < 0.01 + 3.3 * np.sqrt(0.01 / 300)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "count"), [(0.3, 40), *(pytest.param(share, 100, marks=pytest.mark.nightly) for share in (0.1, 0.3))]
)
def test_misread_ids_do_not_move_the_fix(share, count):
    squares = errors_of_fixes(count, share, steps=30)
    # of right fixes one in 10^5 has an error beyond 26
    assert np.all(squares < 26)


def drive_with_misread_ids(share, seed, steps=240, count=40, reach=5.0):
    """A log of a circle among many landmarks, most of them never in view, the map, and the true first pose."""
    rng = np.random.default_rng(seed)
    places, motion = rng.uniform(-12, 12, (count, 2)), MotionModel.constant(0.05, 0.03, epsilon=1e-6)
    sensor, controls = SensorModel(range_rate=0, range_std=0.05, bearing_std=0.01), np.tile([0.5, 0.1], (steps, 1))
    poses = [rng.uniform([-4, -4, -3], [4, 4, 3])]
    for control in controls:
        poses.append(motion.f(poses[-1], control, 0.25))
    rows = []
    for k, pose in enumerate(poses):
        for j, place in enumerate(places):
            z = sensor.h(pose, place)
            if 0.3 < z[0] < reach and abs(z[1]) < np.pi / 2:
                read = int(rng.integers(count)) if rng.random() < share else j
                rows.append((k, read, z + rng.normal(0, [0.05, 0.01])))
    at, ids, z = zip(*rows)
    controls = controls + rng.normal(0, [0.05, 0.03], controls.shape)
    log = Log(dt=np.full(steps, 0.25), controls=controls, steps=at, landmarks=ids, sightings=np.array(z), motion=motion,
              sensor=sensor)  # fmt: skip
    return log, dict(enumerate(places)), poses[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "seed"),
    [(0.1, 2), (0.3, 1), (0.3, 2), *(pytest.param(0.2, seed, marks=pytest.mark.nightly) for seed in (1, 2))],
)
def test_misread_ids_of_landmarks_out_of_view_do_not_contradict_the_right_map(share, seed):
    """More landmarks contradict than agree here: those that are never in view, named by a few misread ids each."""
    log, known, pose = drive_with_misread_ids(share, seed)
    fix = first_fix(log, known)
    off = fix.pose - pose
    off[2] = wrap(off[2])
    assert fix.odds > 1000
    assert off @ np.linalg.solve(fix.covariance, off) < 26
    with pytest.raises(GraphError, match="with the map in centimetres"):
        first_fix(log, {j: 100 * place for j, place in known.items()})


@pytest.mark.slow
@pytest.mark.parametrize(("share", "seed"), [(0.2, 2), (0.3, 1), (0.3, 2)])
def test_no_unit_is_blamed_whose_map_fits_the_first_sightings_by_chance(share, seed):
    """Four to six sightings at one place agree with a map in centimetres, which is but a point there."""
    log, known, _ = drive_with_misread_ids(share, seed)
    # the cause that the right map would be given if it were refused
    assert _cause(Stretch.of(log), LandmarkMap(known), []) == ""


@pytest.mark.parametrize(
    ("fits", "contradict", "agree", "rows", "accepted"),
    [
        (9, 8, 639, 1393, False),  # a map 5 % too large: landmarks nearby agree
        (9, 8, 754, 1393, True),
        (5, 1, 26, 56, True),  # a third of the ids of six landmarks misread
        (3, 3, 6, 11, False),
    ],
)
def test_more_landmarks_and_more_sightings_must_agree(fits, contradict, agree, rows, accepted):
    ids = np.concatenate(
        [np.resize(np.arange(fits), agree), np.resize(np.arange(fits, fits + contradict), rows - agree)]
    )
    best = Weighed(np.zeros(3), np.eye(3), np.arange(rows) < agree, 30.0, fits, contradict, False)
    assert _agreed(best, ids, 30, sure=True) == accepted


@pytest.mark.parametrize("orientation", [False, True])
def test_the_fix_is_that_of_the_graph_of_the_sightings_that_agree(orientation):
    """With the noise of the book, the odometry of a few steps is far from linear; the graph is another way to the minimum."""
    for seed in range(6):
        log = simulate(seed=seed, clean=True, arena=8.0, landmarks=8, steps=20, orientation=orientation)
        known = {j: m[: 2 + orientation] for j, m in log.true_landmarks.items()}
        fix = first_fix(log, known)
        used = np.isin(np.arange(len(log.steps)), fix.agree)
        part = log.with_sightings(used).at_steps(np.arange(fix.step + 1))
        best = solve(Graph.from_log(part, map=known, kernel=None), initialize="given")
        way, P = fix.pose - best.poses[0], best.covariance(poses=0)
        way[2] = wrap(way[2])
        assert way @ np.linalg.solve(P, way) < 0.02**2
        assert np.allclose(fix.covariance, P, atol=0.01 * np.trace(P))


@pytest.mark.slow
@pytest.mark.parametrize("count", [15, pytest.param(40, marks=pytest.mark.nightly)])
def test_maps_of_another_place_with_the_same_ids_are_refused_or_said_to_be_possible(count):
    """The expectation of the odds is 1, so that less than one map in a thousand has odds above a thousand."""
    refused = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        log = simulate(
            seed=seed, clean=True, arena=8.0, landmarks=int(rng.integers(4, 12)), steps=int(rng.integers(8, 60))
        )
        places = rng.uniform([-4, -4, -np.pi], [4, 4, np.pi], (len(log.true_landmarks), 3))
        try:
            fix = first_fix(log, dict(zip(log.true_landmarks, places)))
        except GraphError:
            refused += 1
            continue
        assert fix.odds < 1000
        assert "the odds against other places and other maps are only" in fix.sentence
    assert refused > 0.75 * count


def test_where_the_robot_is_in_the_log_does_not_matter():
    log = simulate(steps=10, seed=3)
    known = LandmarkMap(log.true_landmarks)
    moved = log.replace(initial_poses=compose(np.array([100.0, -50.0, 2.0]), log.initial_poses))
    assert np.allclose(first_fix(moved, known).pose, first_fix(log, known).pose, atol=1e-9)


def test_the_fix_turns_with_the_map():
    log, frame = simulate(steps=10, seed=4), np.array([3.0, -4.0, 2.5])
    turned = {j: compose(frame, m) for j, m in log.true_landmarks.items()}
    there, here = first_fix(log, turned), first_fix(log, log.true_landmarks)
    expected = compose(frame, here.pose)
    assert np.allclose(there.pose[:2], expected[:2], atol=1e-6)
    assert abs(wrap(there.pose[2] - expected[2])) < 1e-6
    assert there.odds == pytest.approx(here.odds, rel=2)  # the area of the map is that of its bounding box


def refused(log, known):
    with pytest.raises(GraphError) as caught:
        first_fix(log, known, **MODELS)
    return str(caught.value)


@pytest.mark.slow
def test_one_landmark_with_a_heading_does_not_make_a_map_in_another_unit_fit():
    log = simulate(seed=1, clean=True)  # 118 sightings on a way whose drift leaves several places open
    for factor, unit in (
        (1000, "in millimetres"),
        (100, "in centimetres"),
        (0.001, "in kilometres"),
        (1 / 0.3048, "in feet"),
    ):
        for d in (2, 3):
            known = {j: m[:d] * np.array([factor, factor, 1])[:d] for j, m in log.true_landmarks.items()}
            with pytest.raises(GraphError, match=unit):
                first_fix(log, known)


def test_a_drift_is_that_of_its_motions_one_after_the_other():
    rng = np.random.default_rng(0)
    x, P = np.array([300.0, -200.0, 3.0]), 0.1 * np.eye(3)
    motions, roots = rng.normal([0.1, 0, 0], [0.1, 0.01, 0.3], (400, 3)), 0.01 * rng.normal(size=(400, 3, 3))
    noise = roots @ np.swapaxes(roots, 1, 2)
    poses, covariances = drifted(x, motions, noise, P)
    for k, one in enumerate(motions):
        x, P = moved(x, P, one, noise[k])
        assert np.abs(wrap(poses[k + 1] - x)).max() < 1e-11
        # as correlations
        assert (np.abs(covariances[k + 1] - P) / np.sqrt(np.outer(np.diag(P), np.diag(P)))).max() < 1e-11


def test_a_mirrored_map_with_one_likely_place_is_said():
    """The only place that fits had "probability 1", and the advice was to take more sightings."""
    quiet = {"motion": MotionModel(nn=0.05, no=0.001, on=0.05, oo=0.05)}
    quiet["sensor"] = SensorModel(range_rate=0.03, bearing_std=0.02)
    world = {"landmarks": np.random.default_rng(3).uniform(-7, 7, (24, 2)), "max_range": 8.0, "steps": 80}
    log = simulate(seed=202, start=(-2.0, 1.0, 1.0), clean=True, orientation=False, **world, **quiet)
    known = {j: place[:2] * (1, -1) for j, place in log.true_landmarks.items()}
    with pytest.raises(GraphError, match="they would with the map mirrored"):
        first_fix(log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)), known, **quiet)


@pytest.mark.slow
def test_maps_that_do_not_fit_are_refused_with_the_cause():
    log = simulate(steps=40, seed=1, clean=True, orientation=False, max_range=10.0, **MODELS)
    true = {j: m[:2] for j, m in log.true_landmarks.items()}
    assert "mirrored" in refused(log, {j: m * (1, -1) for j, m in true.items()})
    assert "with the map with ids one lower" in refused(log, {j + 1: m for j, m in true.items()})
    assert "with the map with ids one higher" in refused(log, {j - 1: m for j, m in true.items() if j > 0})
    assert "in millimetres" in refused(log, {j: m * 1000 for j, m in true.items()})
    assert "in feet" in refused(log, {j: m / 0.3048 for j, m in true.items()})
    # metres of a degree at 35.6 degrees of latitude, by the radii of curvature of the ellipsoid WGS 84
    latitude, root = np.radians(35.6), np.sqrt(1 - 0.00669438 * np.sin(np.radians(35.6)) ** 2)
    degree = np.radians(6378137.0) * np.array([np.cos(latitude) / root, (1 - 0.00669438) / root**3])
    assert "in degrees" in refused(log, {j: m / degree + (139.7, 35.6) for j, m in true.items()})
    rng = np.random.default_rng(0)
    assert "another place" in refused(log, {j: rng.uniform(-20, 20, 2) for j in true})
    assert "sees no landmark of the map" in refused(log, {100 + j: m for j, m in true.items()})
    assert "two are needed" in refused(log, {1: true[1]})
    unknown = log.replace(landmarks=np.full(len(log.steps), np.iinfo(np.int64).min))
    assert "without ids" in refused(unknown, {j: rng.uniform(-20, 20, 2) for j in range(30)})
    assert "with the map mirrored" in refused(unknown, {j: m * (1, -1) for j, m in true.items()})
    assert "with the map in feet" in refused(unknown, {j: m / 0.3048 for j, m in true.items()})
    # chi-square with 3 degrees of freedom is below 21 in 9,999 of 10,000
    fix = first_fix(unknown, LandmarkMap(true), **MODELS)
    way = fix.pose - log.true_poses[0]
    assert way @ np.linalg.solve(fix.covariance, way) < 21
    empty = np.zeros(0, dtype=np.intp)
    blind = log.replace(steps=empty, landmarks=empty, sightings=np.zeros((0, 3)))
    assert "has no sightings of range and bearing" in refused(blind, true)
    assert "the map has no landmarks" in refused(log, {})
