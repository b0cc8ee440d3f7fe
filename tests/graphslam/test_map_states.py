"""Which landmarks of a map agree with a log, have moved, are gone or are new: `graphslam.association.map_states`."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from graphslam import (
    Drive,
    Graph,
    GraphError,
    LandmarkMap,
    MotionModel,
    OptionError,
    SensorModel,
    join_logs,
    simulate,
    solve,
)
from graphslam.association.map_states import EXACT_STD, MOVE, TURN, _gone, _Views, map_states, session_states
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import PartialSightings

FIRST = simulate(seed=1, clean=True, landmarks=20, steps=80, arena=6.0)
MAP = solve(Graph.from_log(FIRST, edges="landmark+motion")).map


def second(seed, shifts=(), gone=(), new=(), **options):
    """A drive among the landmarks of the first, some of which are elsewhere, gone or new."""
    places = {j: np.array(place) for j, place in FIRST.true_landmarks.items() if j not in gone}
    for j, shift in dict(shifts).items():
        places[j][:2] += shift
    places |= {j: np.array(place) for j, place in dict(new).items()}
    ids = sorted(places)
    log = simulate(seed=seed, clean=True, landmarks=[places[j].tolist() for j in ids], steps=80, **options)
    return log.replace(
        landmarks=np.array(ids)[log.landmarks], true_landmarks={j: places[j] for j in ids if j in log.true_landmarks}
    )


def test_what_has_changed_is_said_and_the_trajectory_is_that_without_it():
    shifts, gone, new = {3: (1.5, 0.0), 7: (0.0, -1.0)}, [5], {50: (0.5, 0.5, 0.0)}
    log = second(2, shifts, gone, new)
    found = map_states(log, MAP)
    assert found.of("moved") == [3, 7] and found.of("new") == [50] and 5 in found.of("vanished")
    assert set(found.map) == set(MAP) - {3, 7}
    for each in found.landmarks:
        if each.id in shifts:
            # chi-square of the error of the shift is below 9.2 at 99 %, with what was stated of it below 0.6 m
            assert np.hypot(*(each.shift - shifts[each.id])) < 0.6 and each.moved > 0.99
    # exactly the graph without the moved landmarks of the map
    clean = solve(Graph.from_log(log, map=MAP.among(set(MAP) - {3, 7})))
    assert np.abs(found.solution.poses - clean.poses)[:, :2].max() < 1e-4


def test_the_shift_is_that_of_a_graph_in_which_it_is_free():
    """The closed form from one solution, against a second solution in which the landmark has a node of its own."""
    log = second(3)
    j = max(MAP, key=lambda j: np.sum(log.landmarks == j))
    at_once = {each.id: each for each in map_states(log, MAP).landmarks}[j]
    free = log.replace(landmarks=np.where(log.landmarks == j, 999, log.landmarks))
    used = MAP.among(set(log.landmark_ids.tolist()))
    solution = solve(Graph.from_log(free, map=used))
    shift = solution.landmarks[999] - solution.landmarks[j]
    P = solution.covariance(landmarks=[j, 999], joint=True)
    V = P[:3, :3] + P[3:, 3:] - P[:3, 3:] - P[3:, :3]
    square = shift @ np.linalg.solve(V, shift)
    # both are linearised at their own solutions, which differ by some tenths of a standard deviation
    assert at_once.chi_square == pytest.approx(square, rel=0.1, abs=0.1)
    assert at_once.shift == pytest.approx(shift[:2], abs=0.2 * np.sqrt(V[0, 0]))
    # one that has moved may have turned or not
    right, *moved = (
        multivariate_normal(cov=V + np.diag(wide) ** 2).pdf(shift)
        for wide in ([0, 0, 0], [MOVE, MOVE, 0], [MOVE, MOVE, TURN])
    )
    odds = 0.05 / 0.95 * np.mean(moved) / right
    assert at_once.moved == pytest.approx(odds / (1 + odds), rel=0.5)


def test_logs_of_two_places_with_the_same_ids_share_nothing_that_stayed():
    elsewhere = [(40, 40), (45, 40), (43, 46), (41, 44)]
    logs = [simulate(seed=1, clean=True), simulate(seed=4, clean=True, start=(42.0, 38.0, 0.0), landmarks=elsewhere)]
    with pytest.raises(GraphError, match="is it the map of another place"):
        session_states(join_logs(logs).log)


@pytest.mark.slow
def test_chi_square_has_its_distribution_where_nothing_has_changed():
    squares = []
    for seed in range(20, 30):
        # a tenth of the noise of the book, whose ranges are off by up to a half
        sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
        found = map_states(second(seed, sensor=sensor), FIRST.true_landmarks, sensor=sensor)
        squares += [each.chi_square for each in found.landmarks if each.chi_square is not None]
    # mean 3, variance 6; those of one drive share its trajectory: a fifth of them counts as independent
    assert len(squares) > 100 and abs(np.mean(squares) - 3) < 4 * np.sqrt(6 / (len(squares) / 5))


@pytest.mark.slow
@pytest.mark.parametrize("use", ["joint", "own", "fixed"])
def test_every_use_of_a_map(use):
    known = MAP if use != "fixed" else LandmarkMap(FIRST.true_landmarks)
    found = map_states(second(2, {3: (1.5, 0.0)}), known.used_as(use), kernel="cauchy")
    assert found.of("moved") == [3] and EXACT_STD < 0.01


def test_a_map_with_and_one_without_headings():
    log = second(2, {3: (1.5, 0.0)})
    flat = {j: place[:2] for j, place in FIRST.true_landmarks.items()}
    for each, known in (
        (log.without_orientation(), MAP),
        (log, LandmarkMap(flat, {j: 0.01 * np.eye(2) for j in flat})),
    ):
        assert map_states(each, known).of("moved") == [3]


def test_a_landmark_that_was_not_in_view_is_not_said_to_be_gone():
    far = LandmarkMap({**MAP, 99: (500.0, 0.0, 0.0)}, MAP.covariances)
    (state,) = [each for each in map_states(second(2), far).landmarks if each.id == 99]
    assert state.state == "not in view" and state.views == 0 and state.vanished == pytest.approx(0.05)
    with pytest.raises(OptionError, match="prior must be a probability"):
        map_states(second(2), far, prior=0.0)


def test_sessions():
    logs = [FIRST.at_steps(np.arange(70)), second(2, {3: (1.5, 0.0)})]
    joined = join_logs(logs)
    (found,) = session_states(joined.log)
    assert found.of("moved") == [3] and "landmark 3 has moved" in found.sentence
    (same,) = joined.states
    assert same.of("moved") == [3]
    with pytest.raises(OptionError, match="is one drive"):
        session_states(FIRST)


def moved_note(*logs):
    """What the solution of joined drives says of landmarks that have moved."""
    notes = solve(Graph.from_log(join_logs(logs).log)).notes
    return [note for note in notes if note.startswith("probably moved before")]


@pytest.mark.parametrize("share", [0.15, pytest.param(0.5, marks=pytest.mark.nightly)])
def test_a_solution_of_joined_drives_names_the_landmarks_that_moved_in_between(share):
    rng = np.random.default_rng(7)
    exact = {"sensor": SensorModel(range_rate=0.02, bearing_std=0.01, orientation_std=0.01)}
    before = simulate(seed=1, clean=True, landmarks=20, steps=80, arena=6.0, **exact)
    moved = sorted(rng.choice(20, round(share * 20), replace=False).tolist())
    logs = [before, second(4, {j: rng.choice([-1, 1], 2) * rng.uniform(0.5, 1.5, 2) for j in moved}, **exact)]
    logs = [log.replace(motion=MotionModel(), **exact) for log in logs]
    (note,) = moved_note(*logs)
    both = set(logs[0].landmark_ids.tolist()) & set(logs[1].landmark_ids.tolist())
    named = {int(word) for word in re.findall(r"\d+", note.split("in all logs: ")[1].split(", by up to")[0])}
    assert named <= set(moved) and len(named) >= 0.7 * len(both & set(moved))
    assert (
        moved_note(
            before.replace(motion=MotionModel(), **exact), second(4, **exact).replace(motion=MotionModel(), **exact)
        )
        == []
    )


@pytest.mark.parametrize(("seed", "size"), [(35, 0.3), (30, 0.15)])
def test_a_map_that_is_off_everywhere_is_no_map_of_which_most_has_moved(seed, size):
    """A few places agree by chance where all are off: the others counted as moved, and the ATE was 3.7 and 0.12 m."""
    robot = {
        "motion": MotionModel(nn=0.02, no=1e-4, on=0.02, oo=0.02),
        "sensor": SensorModel(range_rate=0, range_std=0.03, bearing_std=0.02),
    }
    world = np.random.default_rng(seed).uniform(-5, 5, (16, 2))
    log = simulate(seed=seed, steps=80, clean=True, orientation=False, landmarks=world, **robot).replace(**robot)
    rng = np.random.default_rng(seed)
    known = {j: place[:2] + size * rng.normal(size=2) for j, place in log.true_landmarks.items()}
    found = map_states(log, known, kernel="cauchy")
    assert found.of("moved") == []
    assert np.hypot(*(found.solution.poses - log.true_poses)[:, :2].T).max() < 1.5 * size


@pytest.mark.slow
def test_a_landmark_all_of_whose_sightings_are_left_out_was_not_seen():
    """Where the noise is estimated, single sightings that contradict their id are left out; S is zero for such a landmark."""
    log, _ = replace(Drive.random(9003), misread=0.0, duration=60.0).simulate()
    found = map_states(log, log.true_landmarks)
    used = found.solution.graph.log
    left_out = set(log.landmark_ids.tolist()) - set(used.landmarks[found.solution.graph.sighting_rows].tolist())
    assert left_out
    states = {each.id: each for each in found.landmarks}
    for j in left_out:
        assert states[j].state in ("vanished", "not in view") and states[j].shift is None and states[j].seen == 0
    assert len(found.of("agrees")) > len(found.of("moved"))


def test_a_map_without_landmarks_is_refused():
    with pytest.raises(GraphError, match="the map has no landmarks"):
        map_states(second(2), MAP.among([]))


@pytest.mark.parametrize(("ids", "sees"), [(1000, "landmarks 1000, 1001"), (None, "none with an id")])
def test_a_log_without_landmarks_of_the_map_is_refused(ids, sees):
    log = second(2)
    other = np.full(len(log.steps), UNIDENTIFIED) if ids is None else log.landmarks + ids
    with pytest.raises(GraphError, match=f"sees no landmark of the map: it sees {sees}.* the map has landmarks"):
        map_states(log.replace(landmarks=other), MAP)


@pytest.mark.parametrize("part", [0.5, 1.0])
@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_ranges_alone_show_where_a_landmark_is(part, shift):
    """Of one landmark a part of the sightings, or each, has its range alone; it is there, or has moved, with all of them."""
    log = second(2, {3: (shift, 0.0)}).without_orientation()
    rows = np.flatnonzero(log.landmarks == 3)
    rows = rows[: int(part * len(rows))]
    alone = PartialSightings(
        steps=log.steps[rows], landmarks=log.landmarks[rows], ranges=log.sightings[rows, 0],
        bearings=np.full(len(rows), np.nan),
    )  # fmt: skip
    others = np.ones(len(log.steps), dtype=bool)
    others[rows] = False
    found = map_states(log.with_sightings(others, partial_sightings=alone), MAP)
    (state,) = [each for each in found.landmarks if each.id == 3]
    assert state.state == ("moved" if shift else "agrees") and state.seen == np.sum(log.landmarks == 3)
    # at 99 %; ranges alone leave one direction open
    assert (part == 1 or np.hypot(*(state.shift - [shift, 0.0])) < 0.6) and (state.chi_square < 9.2) == (shift == 0)
    assert len(found.of("moved")) == (shift > 0) and not found.of("vanished")


def test_where_many_landmarks_are_never_seen_they_are_hidden_and_not_gone():
    """Tags that show from one side only: a fifth of those that were not seen and are there counted as gone."""
    seen = [_Views(np.ones(12), np.full(81, 12), np.arange(12) < count) for count in (3, 5, 6, 7, 8, 9, 10, 11, 12, 12)]
    one, many = (_gone(seen, [np.full(81, 12)] * count, prior=0.05) for count in (1, 8))
    assert one(np.full(81, 12)) > 0.5 > 0.3 > many(np.full(81, 12))
