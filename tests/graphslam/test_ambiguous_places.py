"""Places that look alike: what `associate` says of them, and the search over alternatives of a drive."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from graphslam import Log, MotionModel, SensorModel
from graphslam.association import associate_from, score
from graphslam.association.ambiguity import CandidatePairs
from graphslam.association.assignment import log_density
from graphslam.association.problem import agree, held, may_be_one
from graphslam.log import UNIDENTIFIED

#: the landmarks of a corridor along the x axis, 8 m long
CORRIDOR = np.array([[1.0, 1.2], [2.5, -1.1], [4.0, 1.3], [5.5, -1.2], [7.0, 1.1]])
SENSOR = SensorModel.constant(0.05, 0.01)
THROUGH = [(0.25, 0.0)] * 32


def drive(
    controls: list, seconds: dict[int, float], motion: MotionModel, odometry: dict[int, float] | None = None
) -> Log:
    """A drive in a world with two identical corridors, 12 m from each other; ``odometry`` replaces measured speeds."""
    rng = np.random.default_rng(0)
    marks = np.concatenate([CORRIDOR, CORRIDOR + [0, 12.0]])
    u, dt = np.array(controls, dtype=float), np.ones(len(controls))
    dt[list(seconds)] = list(seconds.values())
    poses = motion.dead_reckoning(np.zeros(3), u, dt)
    steps, ids, sightings = [], [], []
    for t, pose in enumerate(poses):
        z = SENSOR.h(np.repeat(pose[None], len(marks), axis=0), marks)
        # the robot first turns towards the corridor before it sees again
        seen = (
            (z[:, 0] < 4)
            & (np.abs(z[:, 1]) < 1.2)
            & (rng.random(len(z)) < 0.9)
            & (not min(seconds) < t < max(seconds) + 2)
        )
        for j in np.flatnonzero(seen):
            steps.append(t)
            ids.append(j)
            sightings.append(z[j] + rng.normal(size=2) * [0.05, 0.01])
    measured = u.copy()
    for t, speed in (odometry or {}).items():
        measured[t, 0] = speed
    return Log(
        name="corridors", dt=dt, controls=measured, steps=steps, landmarks=ids, sightings=np.array(sightings),
        true_poses=poses, sensor=SENSOR, motion=motion,
    )  # fmt: skip


def back_to_the_first(measured: float) -> Log:
    """Through both corridors, then 12 m without sightings back to the first one; odometry measures so many metres, +- 6 m."""
    turn = (0.0, np.pi / 2)
    controls = [*THROUGH, turn, *[(0.5, 0.0)] * 24, turn, *THROUGH, turn, (0.2, 0.0), turn, *THROUGH]
    return drive(controls, {91: 60.0}, MotionModel.constant(0.1, 0.003, epsilon=1e-6), {91: measured / 60})


def two_corridors(std: float) -> Log:
    """Through one corridor, then without sightings to the next, 12 m away; odometry measures that right, +- ``std`` [m]."""
    controls = [*THROUGH, (0.0, np.pi), (8 / 60, 0.0), (0.0, -np.pi / 2), (0.2, 0.0), (0.0, -np.pi / 2), *THROUGH]
    return drive(controls, {33: 60.0, 35: 60.0}, MotionModel.constant(std / 60, 3e-4, epsilon=1e-6))


@pytest.mark.parametrize(("measured", "right"), [(12.0, True), (6.5, True), (2.0, False)])
def test_a_return_to_one_of_two_corridors_is_ambiguous(measured: float, right: bool) -> None:
    log = back_to_the_first(measured)
    found = associate_from(log)
    assert found.landmarks == 10
    # which corridor it was is decided by odometry, and may be wrong
    assert (score(found.ids, log.landmarks).precision == 1.0) == right
    (doubt,) = found.ambiguities
    assert doubt.step > 91 and len(doubt.landmarks) == len(doubt.others) == 5 and not doubt.new
    # odometry has a standard deviation of 6 m; the corridors are 12 m from each other
    z = np.array([measured - 12, measured]) / 6
    expected = np.abs(np.diff(z**2) / 2)
    assert doubt.log_factor == pytest.approx(expected[0], abs=1.7)
    assert any("ambiguous" in note and f"{doubt.factor:.3g} times" in note for note in found.notes)


def test_a_return_that_odometry_decides_is_not_ambiguous() -> None:
    log = back_to_the_first(12.0)
    surely = associate_from(log, motion=MotionModel.constant(0.02, 0.003, epsilon=1e-6))
    assert surely.ambiguities == () and score(surely.ids, log.landmarks).precision == 1.0


def test_a_search_that_was_cut_short_says_so() -> None:
    log = back_to_the_first(2.0)
    limit, settled = (
        "but were not tried because of the limit on tries ({}): {};",
        "had not settled when they were compared",
    )
    for tries, left in ((0, 2), (1, 1)):
        assert any(limit.format(tries, left) in note for note in associate_from(log, tries=tries).notes)
    assert any(f"{settled}, after 1 round: 1 of 2;" in note for note in associate_from(log, rounds=1).notes)
    assert not any("limit on tries" in note or settled in note for note in associate_from(log).notes)


def test_two_corridors_are_one_or_two_by_evidence() -> None:
    apart, doubtful, joined = (associate_from(two_corridors(std)) for std in (1.0, 1.6, 1.8))
    assert (apart.landmarks, apart.ambiguities) == (10, ())
    (doubt,) = doubtful.ambiguities
    assert doubtful.landmarks == 10 and doubt.new and 0 < doubt.log_factor < np.log(100)
    assert set(doubt.others) == set(range(5)) and "arrival" in str(doubt)
    assert doubtful.ambiguous > 20 and not doubtful.doubtful[doubtful.of.steps < doubt.step].any()
    (doubt,) = joined.ambiguities
    assert joined.landmarks == 5 and not doubt.new and doubt.others == ()
    assert "a place not seen before" in str(doubt)


def test_grown_hypotheses_have_the_joint_evidence_and_the_best_is_found() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        item, landmark = (each.ravel() for each in np.meshgrid(np.arange(3), np.arange(3), indexing="ij"))
        # items that move together by an unknown offset: alone no pair is likely
        places = rng.uniform(0, 10, (3, 2))
        nu = (places + rng.normal(0, 20, 2))[item] - places[landmark]
        S = np.einsum("ab,rs->arbs", np.full((9, 9), 400.0) + np.eye(9) * 0.01, np.eye(2))
        weights = np.full(9, 5.0)
        pairs = CandidatePairs(item, landmark, nu, S, weights, 100.0)
        joint = {}
        for choice in product(range(-1, 3), repeat=3):
            used = [j for j in choice if j >= 0]
            if used and len(set(used)) == len(used):
                rows = np.array([i * 3 + j for i, j in enumerate(choice) if j >= 0])
                flat = (rows[:, None] * 2 + [0, 1]).ravel()
                density = log_density(nu[rows].ravel(), S.reshape(18, 18)[np.ix_(flat, flat)])[0]
                joint[tuple(rows)] = float(weights[rows].sum() + density)
        for rows, value in joint.items():
            assert pairs.evidence(np.array(rows)) == pytest.approx(value, abs=1e-8)
        best = pairs.k_best(np.arange(9), 3)
        assert best[0].evidence == pytest.approx(max(joint.values()), abs=1e-8)
        assert all(joint[tuple(each.pairs)] == pytest.approx(each.evidence, abs=1e-8) for each in best)


def test_ids_of_some_sightings_are_kept_and_decide_for_the_others() -> None:
    log = back_to_the_first(2.0)
    of_one = log.landmarks == 0
    part = log.replace(landmarks=np.where(of_one, 7, UNIDENTIFIED))
    found = associate_from(part)
    # without them the wrong corridor is chosen
    assert score(found.ids, log.landmarks).precision == 1.0 and found.landmarks == 10 and not found.ambiguities
    assert np.all(found.ids[of_one] == 7) and set(found.ids[~of_one].tolist()) == set(range(8, 17))
    assert np.array_equal(found.kept, of_one) and np.all(np.isinf(found.margins[of_one]))
    assert any(f"{of_one.sum()} of 158 sightings kept the ids" in note for note in found.notes)
    asked = associate_from(part, keep_ids=False)
    np.testing.assert_array_equal(asked.ids, associate_from(log).ids)
    assert not asked.kept.any()


def test_labels_that_agree_with_ids() -> None:
    labels, steps = np.array([0, 0, 0, 1, 1, 2, -1, 1]), np.array([0, 1, 2, 0, 1, 2, 3, 3])
    known = np.array([0, 0, -1, 0, -1, -1, 1, -1])
    found = held(labels, known, steps)
    # of one id, another one, and neither; a landmark goes on as that with the id that most of its sightings have
    assert len({*found[[0, 1, 2, 3, 7]]}) == 1 and len({found[0], found[5], found[6]}) == 3
    # the sighting of step 1 that was of another landmark cannot be of one that this scan has seen by its id
    assert found[4] == -1
    assert agree(found, known) and not agree(labels, known)
    np.testing.assert_array_equal(held(labels, np.full(8, -1), steps), labels)
    assert [may_be_one(*pair) for pair in ((-1, 3), (3, 3), (3, 4))] == [True, True, False]
