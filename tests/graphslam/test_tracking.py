"""Logs without ids in a map, and robots that are lifted: `graphslam.maps.constellation` and `graphslam.maps.tracking`."""

import numpy as np
import pytest

from graphslam import (
    Drive,
    Graph,
    GraphError,
    LandmarkMap,
    Log,
    MotionModel,
    OnlineSolver,
    OptionError,
    SensorModel,
    first_fix,
    simulate,
    solve,
)
from graphslam.association.map_states import map_states
from graphslam.log import UNIDENTIFIED
from graphslam.maps import tracking
from graphslam.maps.constellation import Constellations, match, merged
from graphslam.maps.localization import possible_fixes
from graphslam.maps.stretch import Stretch
from graphslam.maps.tracker import Tracker
from graphslam.maps.tracking import follow
from graphslam.online.localizer import relation_covariance
from graphslam.se2 import inverse, turn_matrix, wrap

MODELS = {
    "motion": MotionModel(nn=0.05, no=0.001, on=0.02, oo=0.05),
    "sensor": SensorModel(range_rate=0.03, bearing_std=0.02, orientation_std=0.02),
}
WORLD = {"clean": True, "orientation": False, "max_range": 8.0, "arena": 15.0, "landmarks": 60, **MODELS}
FIRST = simulate(seed=4, steps=40, start=(0.0, -5.0, 0.3), **WORLD)
TRUE = LandmarkMap(FIRST.true_landmarks)


def unnamed(log):
    return log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED), true_landmarks=None)


def elsewhere(seed, start):
    """A drive in the same world from another pose."""
    world = WORLD | {"landmarks": [m.tolist() for m in FIRST.true_landmarks.values()]}
    return simulate(seed=seed, steps=40, start=start, **world)


def lifted(first, second):
    """Two drives as one, whose odometry stands still between them."""
    return Log(
        dt=np.concatenate([first.dt, [3.0], second.dt]), controls=np.concatenate([first.controls, [[0, 0]], second.controls]),
        steps=np.concatenate([first.steps, first.num_poses + second.steps]),
        landmarks=np.concatenate([first.landmarks, second.landmarks]),
        sightings=np.concatenate([first.sightings, second.sightings]),
    )  # fmt: skip


def off(pose, true):
    return np.hypot(*(pose - true)[:2]), abs(wrap(pose[2] - true[2]))


def test_a_constellation_without_noise_is_found_exactly():
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 40, (200, 2))
    pose = np.array([20.0, 15.0, 2.0])
    near = np.argsort(np.hypot(*(places - pose[:2]).T))[:8]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    y = np.column_stack([(places[near] - pose[:2]) @ [[c, -s], [s, c]], np.full(8, np.nan)])
    small = np.tile(1e-6 * np.eye(3), (8, 1, 1))
    known = Constellations.of(LandmarkMap(dict(enumerate(places))), 8.0)
    seen = merged(y, small, 0 * small, np.zeros(8))
    (best, partners), *others = match(seen, known)
    assert np.allclose(best.pose, pose, atol=1e-6) and best.agree.all()
    assert np.array_equal(partners[np.argsort(seen.which)], near[np.argsort(seen.which)])
    assert all(best.evidence - each.evidence > 20 for each, _ in others)


def test_sightings_of_one_landmark_are_merged():
    rng = np.random.default_rng(1)
    landmarks = np.array([[3.0, 0.0], [0.0, 4.0], [-2.0, 1.0]])
    steps = np.repeat(np.arange(6), 3)
    y = np.column_stack([np.tile(landmarks, (6, 1)) + 0.1 * rng.normal(size=(18, 2)), np.full(18, np.nan)])
    noise = np.tile(0.01 * np.eye(3), (18, 1, 1))
    seen = merged(y, noise, 0 * noise, steps)
    assert np.array_equal(seen.which, np.tile([0, 1, 2], 6)) and list(seen.counts) == [6, 6, 6]
    # the mean of six, and its covariance
    for k in range(3):
        assert np.allclose(seen.places[k, :2], y[k::3, :2].mean(axis=0))
        assert np.allclose(seen.covariances[k, :2, :2], 0.01 / 6 * np.eye(2))


def test_landmarks_at_one_place_that_face_other_ways_are_merged_by_places_alone():
    y, C = np.array([[3.0, 0.0, 0.0], [3.0, 0.01, 2.0]]), np.tile(0.01 * np.eye(3), (2, 1, 1))
    for compared, count in ((2, 1), (3, 2)):
        assert len(merged(y, C, np.zeros_like(C), np.arange(2), compared=compared).counts) == count


@pytest.mark.parametrize("seed", range(3))
def test_the_first_fix_without_ids_is_that_with_them(seed):
    log = elsewhere(10 + seed, (4.0 * seed - 4, 3.0, 2.0 * seed))
    fix = first_fix(unnamed(log), TRUE, **MODELS)
    assert fix.odds > 1000
    way = fix.pose - log.true_poses[0]
    way[2] = wrap(way[2])
    # chi-square with 3 degrees of freedom is below 21 in 9,999 of 10,000
    assert way @ np.linalg.solve(fix.covariance, way) < 21


def test_two_alike_rooms_are_alternatives_with_even_odds():
    there = {100 + j: np.append(m[:2] + (100.0, 0.0), m[2:]) for j, m in TRUE.items()}
    log = unnamed(elsewhere(10, (-4.0, 3.0, 0.0)))
    fixes = possible_fixes(log, LandmarkMap({**TRUE, **there}), **MODELS)
    assert np.allclose(fixes[0].pose - fixes[1].pose, np.sign(fixes[0].pose[0] - 50) * np.array([100, 0, 0]), atol=1e-3)
    assert fixes[0].odds == pytest.approx(1, rel=0.05) and fixes[1].odds == pytest.approx(1, rel=0.05)
    with pytest.raises(GraphError, match=r"with probability 0\.5; .* with probability 0\.5"):
        first_fix(log, LandmarkMap({**TRUE, **there}), **MODELS)


def test_a_log_without_ids_is_solved_in_a_map():
    log = elsewhere(10, (-4.0, 3.0, 0.0))
    graph = Graph.from_log(unnamed(log), map=TRUE, **MODELS)
    found = follow(unnamed(log), TRUE, **MODELS).landmarks
    known = found != UNIDENTIFIED
    assert known.mean() > 0.8 and np.array_equal(found[known], log.landmarks[known])
    with_ids = solve(Graph.from_log(log.with_sightings(known), map=TRUE, **MODELS))
    assert np.allclose(solve(graph).poses, with_ids.poses, atol=1e-6)
    assert any("without ids their landmark" in note for note in graph.notes)


@pytest.mark.parametrize("with_ids", [True, False])
def test_a_lifted_robot_is_found_again(with_ids):
    first, second = FIRST, elsewhere(11, (5.0, 6.0, -2.0))
    log = lifted(*((first, second) if with_ids else (unnamed(first), unnamed(second))))
    graph = Graph.from_log(log, map=TRUE, kernel="none", **MODELS)
    (note,) = [note for note in graph.notes if "lifted" in note]
    assert f"and {first.num_poses}, and put down" in note
    # the drives are apart: each has the solution that it has alone
    poses = solve(graph).poses
    for part, rows in ((first, slice(first.num_poses)), (second, slice(first.num_poses, None))):
        alone = solve(Graph.from_log(part if with_ids else unnamed(part), map=TRUE, kernel="none", **MODELS)).poses
        assert np.abs(poses[rows] - alone)[:, :2].max() < 1e-3


def test_drives_without_kidnapping_are_not_changed():
    for seed in range(20, 30):
        assert not follow(elsewhere(seed, (0.0, 0.0, 0.5 * seed)), TRUE, **MODELS).lifted


def test_a_landmark_that_has_moved_is_no_kidnapping():
    log = elsewhere(10, (-4.0, 3.0, 0.0))
    j = int(np.bincount(log.landmarks).argmax())
    moved = LandmarkMap({**TRUE, j: TRUE[j] + (2.0, 0.0, 0.0)[: len(TRUE[j])]})
    assert not follow(log, moved, **MODELS).lifted


def shelf(log, step):
    """The eight landmarks around a point 3 m ahead of the robot, and a map that has them elsewhere, by the same way."""
    x, y, theta = log.true_poses[step]
    ahead = np.array([x + 3 * np.cos(theta), y + 3 * np.sin(theta)])
    near = sorted(TRUE, key=lambda j: np.hypot(*(TRUE[j][:2] - ahead)))[:8]
    return set(near), LandmarkMap({j: m + (1.5, -1.0, 0.0)[: len(m)] if j in near else m for j, m in TRUE.items()})


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "step"), [(22, 5), (21, 25)])
def test_landmarks_that_moved_together_are_no_kidnapping(seed, step):
    """At the beginning they made a wrong first fix, and later lifts to and fro: three in each of these drives."""
    log = elsewhere(seed, (0.0, 0.0, 0.5 * seed))
    near, known = shelf(log, step)
    found = follow(log, known, **MODELS)
    assert not found.lifted and set(found.moved) <= near and len(found.moved) >= 5
    graph = Graph.from_log(log, map=known, **MODELS)
    assert any("moved since the map was made" in note for note in graph.notes)
    assert set(graph.map) == set(TRUE) - set(found.moved)
    states = map_states(log, known, **MODELS)
    assert set(found.moved) <= set(states.of("moved")) <= near and not states.of("new")


def test_a_lift_in_a_map_with_moved_landmarks_is_noticed():
    log = lifted(FIRST, elsewhere(11, (5.0, 6.0, -2.0)))
    near, known = shelf(FIRST, 20)
    found = follow(log, known, **MODELS)
    assert list(found.lifted) == [FIRST.num_poses] and set(found.moved) <= near


def test_a_lift_that_three_sightings_show_is_noticed():
    """A fix that is sure at once has hardly any sightings: their odds count, not their number."""
    log = lifted(FIRST, elsewhere(11, (5.0, 6.0, -2.0)))
    few = follow(
        log.with_sightings((log.steps < FIRST.num_poses) | (np.arange(len(log.steps)) % 2 == 0)), TRUE, **MODELS
    )
    assert list(few.lifted) == [int(log.steps[log.steps >= FIRST.num_poses].min())]


def test_landmarks_that_the_map_lacks_get_ids_where_sightings_have_none():
    log = elsewhere(12, (-4.0, 3.0, 0.0))
    count = np.bincount(log.landmarks, minlength=len(TRUE))
    missing = np.argsort(-count)[[3, 6, 9]].tolist()
    known = TRUE.among(set(TRUE) - set(missing))
    graph = Graph.from_log(unnamed(log), map=known, **MODELS)
    solution = solve(graph)
    new = {j: m for j, m in solution.landmarks.items() if j not in known}
    assert len(new) >= 3 and any("are new" in note for note in graph.notes)
    for j in missing:
        # a few decimetres from where it is, with the noise of this sensor
        assert min(np.hypot(*(m[:2] - TRUE[j][:2])) for m in new.values()) < 0.5
    found = follow(unnamed(log), known, **MODELS).landmarks
    for j in new:
        assert len(set(log.landmarks[found == j].tolist())) == 1


def driven(log, solver, late=0):
    """Give a solver a drive, with sightings some steps late; the first step at which it was located."""
    when = None
    for step in range(log.num_poses + late):
        if 0 < step < log.num_poses:
            solver.move(log.controls[step - 1], log.dt[step - 1])
        if step >= late:
            now = log.steps == step - late
            solver.observe(log.landmarks[now] if log.identified else None, log.sightings[now], pose=step - late)
        when = step if when is None and solver.located else when
    return when


@pytest.mark.slow
@pytest.mark.parametrize("with_ids", [True, False])
def test_a_robot_that_drives_finds_itself_and_notices_that_it_was_lifted(with_ids):
    log = lifted(FIRST, elsewhere(11, (5.0, 6.0, -2.0)))
    log = log if with_ids else unnamed(log)
    solver = OnlineSolver(map=TRUE, **MODELS)
    when = driven(log, solver)
    assert when is not None and when < 20
    batch = solve(Graph.from_log(log, map=TRUE, kernel="cauchy", **MODELS))
    # ids that were not clear at the time may differ from those that the whole log gives
    assert np.abs(solver.poses - batch.poses)[:, :2].max() < (1e-3 if with_ids else 0.2)
    assert set(solver.landmarks) >= set(log.landmark_ids.tolist()) - {UNIDENTIFIED}


@pytest.mark.parametrize("with_ids", [True, False])
def test_late_sightings_find_a_robot_and_notice_that_it_was_lifted(with_ids):
    second = elsewhere(11, (5.0, 6.0, -2.0))
    log, true = lifted(FIRST, second), np.concatenate([FIRST.true_poses, second.true_poses])
    solver = OnlineSolver(map=TRUE, **MODELS)
    assert driven(log if with_ids else unnamed(log), solver, late=2) is not None
    assert np.hypot(*(solver.poses - true)[:, :2].T).max() < 0.5
    assert solver.integrity_risk(1.0) < 0.01
    assert [note for note in solver.notes if "the robot was lifted before pose " in note]


def test_in_a_map_an_id_of_minus_one_is_none():
    log, poses = elsewhere(10, (-4.0, 3.0, 0.0)), []
    for missing in (UNIDENTIFIED, -1):
        solver = OnlineSolver(map=TRUE, **MODELS)
        for step in range(10):
            if step > 0:
                solver.move(log.controls[step - 1], log.dt[step - 1])
            now = log.steps == step
            solver.observe(np.where(log.landmarks[now] % 2 == 0, missing, log.landmarks[now]), log.sightings[now])
        assert missing not in solver.landmarks
        poses.append(solver.poses)
    np.testing.assert_array_equal(*poses)


def test_a_start_that_is_given_is_used():
    log = elsewhere(10, (-4.0, 3.0, 0.0))
    solver = OnlineSolver(log.true_poses[0], map=TRUE, start_covariance=0.01 * np.eye(3), **MODELS)
    assert solver.located
    with pytest.raises(OptionError, match="start_covariance needs start"):
        OnlineSolver(map=TRUE, start_covariance=0.01 * np.eye(3), **MODELS)
    driven(log, solver)
    assert np.hypot(*(solver.poses - log.true_poses)[:, :2].T).max() < 0.5


def test_psi_that_is_not_used_in_a_map_without_headings_is_said():
    pose = FIRST.true_poses[0]
    solver = OnlineSolver(pose, map=TRUE, **MODELS)
    z = np.append(MODELS["sensor"].h(pose, TRUE[0]), 0.3)
    solver.observe([0], [z[:2]])
    assert solver.notes == ()
    solver = OnlineSolver(pose, map=TRUE, **MODELS)
    solver.observe([0], [z])
    assert len(solver.landmarks[0]) == 2 and "psi is not used" in solver.notes[0]


def test_two_landmarks_with_headings_locate_a_robot():
    """`first_fix` stops at two landmarks with headings; 4 of 14 such drives were never located."""
    models = {
        "motion": MotionModel(nn=0.05, no=0.03, on=0.05, oo=0.05),
        "sensor": SensorModel(range_rate=0.03, bearing_std=0.015),
    }
    few = np.random.default_rng(12).uniform(-5, 5, (14, 3))
    log = simulate(seed=62, steps=10, start=(-2.0, 1.0, 1.0), clean=True, landmarks=few, max_range=6.0, **models)
    solver = OnlineSolver(map=log.true_landmarks, **models)
    assert driven(log, solver) is not None
    assert np.hypot(*(solver.poses - log.true_poses)[:, :2].T).max() < 0.5


def test_exact_odometry_before_the_first_sighting_is_no_obstacle_to_a_fix():
    """A robot that turns on the spot has motions of 0.03 mm, beside which a free start was lost in rounding errors."""
    models = {"motion": MotionModel(nn=0.02, on=0.01, oo=0.02, no=0.0, epsilon=1e-9), "sensor": MODELS["sensor"]}
    log = elsewhere(3, (-4.0, 3.0, 0.0)).replace(motion=models["motion"])
    # it turns before it sees anything
    log = Log(
        dt=np.append(np.ones(4), log.dt), controls=np.concatenate([np.tile([0.0, 0.3], (4, 1)), log.controls]),
        steps=log.steps + 4, landmarks=log.landmarks, sightings=log.sightings,
    )  # fmt: skip
    solver = OnlineSolver(map=TRUE, **models)
    assert driven(log, solver) is not None
    solution = solve(Graph.from_log(log, map=TRUE, kernel="cauchy", **models))
    np.testing.assert_allclose(solver.poses[:, :2], solution.poses[:, :2], atol=1e-3)


def test_ranges_alone_before_the_first_sighting_are_no_obstacle_to_a_fix():
    """They do not hold the first pose, which stays at its fix until a whole sighting of the map comes."""
    models = {"motion": MotionModel(nn=0.02, on=0.01, oo=0.02, no=0.0, epsilon=1e-9), "sensor": MODELS["sensor"]}
    log = elsewhere(3, (-4.0, 3.0, 0.0)).without_orientation()
    solver = OnlineSolver(map={j: place[:2] for j, place in TRUE.items()}, **models)
    for step in range(log.num_poses):
        if step:
            solver.move(log.controls[step - 1], log.dt[step - 1])
        seen = log.steps == step
        ids, sightings = log.landmarks[seen], log.sightings[seen].copy()
        if step < 4 and len(ids):
            ids, sightings = ids[:1], sightings[:1]
            sightings[:, 1] = np.nan
        if len(ids):
            solver.observe(ids, sightings)
    assert solver.located
    assert off(solver.poses[-1], log.true_poses[-1])[0] < 0.5


@pytest.mark.parametrize("given", [True, False])
def test_sightings_without_psi_in_a_map_with_headings(given):
    log = simulate(seed=1, steps=20, clean=True)
    solver = OnlineSolver(log.true_poses[0] if given else None, map=log.true_landmarks)
    assert driven(log.without_orientation(), solver) is not None
    assert np.abs(solver.poses - log.true_poses)[:, :2].max() < 0.5
    # psi that comes later is not used
    solver.observe(log.landmarks[-2:], log.sightings[-2:])
    assert solver.covariance(landmarks=[0]).shape == (1, 2, 2)


def test_psi_that_comes_after_sightings_without():
    log = simulate(seed=1, steps=20, clean=True)
    solver = OnlineSolver(map=log.true_landmarks)
    for step in range(log.num_poses):
        if step:
            solver.move(log.controls[step - 1], log.dt[step - 1])
        now = log.steps == step
        solver.observe(log.landmarks[now], log.sightings[now, : 3 if step else 2])
    assert np.abs(solver.poses - log.true_poses)[:, :2].max() < 0.5


def test_the_axes_of_a_relation_from_the_new_pose():
    """The tracker has the covariance of the graph, whichever pose is named first."""
    z, P = np.array([1.0, 0.5, 1.2]), np.diag([0.16, 0.0016, 0.01])
    turned = turn_matrix(z[2])
    there = relation_covariance((0, 1, z, np.linalg.inv(P)), 1)
    back = relation_covariance((1, 0, inverse(z), np.linalg.inv(turned.T @ P @ turned)), 1)
    assert np.allclose(there, P, atol=1e-12)
    # without the lever, which turns the error of the heading into one of the position
    assert np.allclose(back[2, 2], P[2, 2])
    rng = np.random.default_rng(0)
    drawn = inverse(inverse(z) + rng.multivariate_normal(np.zeros(3), turned.T @ P @ turned * 1e-6, 200_000)) - z
    assert np.allclose(np.cov(drawn.T) * 1e6, back, atol=0.003)


def test_searches_that_find_nothing_become_rarer(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an exact map that is off by 0.15 m every doubt is a false one, and each search takes a second."""
    log, truth = Drive(seed=3003, duration=300.0, landmarks=30).simulate()
    rng, steps = np.random.default_rng(3003), list[int]()
    wrong = LandmarkMap({j: place[:2] + rng.normal(0, 0.15, 2) for j, place in log.true_landmarks.items()})

    def nothing(drive: Stretch, tracker: Tracker, landmarks: LandmarkMap) -> tuple[None, set[int]]:
        steps.append(tracker.since)
        return None, set()

    monkeypatch.setattr(tracking, "elsewhere", nothing)
    tracking.follow(log, wrong, motion=truth.motion, sensor=truth.sensor)
    # 18 if each doubt were looked into as the first one
    assert 4 <= len(steps) <= 12 and steps[-1] > 500


@pytest.mark.nightly
def test_the_noise_of_an_unknown_robot_is_estimated_with_the_ids_that_the_map_gives():
    """The book's noise, which is far too wide, finds no place, or loses half of the sightings."""
    log, _ = Drive(seed=3, duration=120.0, landmarks=25, parameters={}).simulate()
    true = LandmarkMap({j: place[:2] for j, place in log.true_landmarks.items()})
    named, nameless = solve(Graph.from_log(log, map=true)), Graph.from_log(unnamed(log), map=true)
    solution = solve(nameless)
    assert not any("the noise models are the book's" in note for note in solution.notes)
    assert nameless.sensor.bearing_std == pytest.approx(named.graph.sensor.bearing_std, rel=0.3)
    assert np.count_nonzero(nameless.log.landmarks != UNIDENTIFIED) > 0.9 * len(log.steps)
    assert 0.5 < solution.expected_ate / named.expected_ate < 2.0
    with pytest.raises(GraphError, match="do not say surely where in the map it begins"):
        Graph.from_log(unnamed(log), map=true, noise="book")
    other = LandmarkMap({j: place * [1, -1] for j, place in true.items()})
    with pytest.raises(GraphError, match="where in the map it begins"):
        Graph.from_log(unnamed(log), map=other, noise="auto")


def test_a_robot_that_is_not_found_says_so():
    log = elsewhere(10, (-4.0, 3.0, 0.0))
    mirrored = {j: (place[0], -place[1]) for j, place in TRUE.items()}
    for known, ids in ((mirrored, len(log.steps)), ({1000 + j: place for j, place in mirrored.items()}, 0)):
        solver = OnlineSolver(map=known, **MODELS)
        assert driven(log, solver) is None
        (note,) = (note for note in solver.notes if "not been found" in note)
        assert f"of {len(log.steps)} sightings, {ids} have ids of the map" in note
    # one that is found says nothing
    solver = OnlineSolver(map=TRUE, **MODELS)
    assert driven(log, solver) is not None and not any("not been found" in note for note in solver.notes)
