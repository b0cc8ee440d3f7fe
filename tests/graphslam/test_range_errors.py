"""Ranges that are off for single landmarks are found, reported and corrected, and reflected ranges are reported."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from comparisons.show.language import translated
from graphslam import Drive, Graph, estimate_robot, solve
from graphslam.association.associate import known_noise
from graphslam.identification.result import BOOK_NOISE
from graphslam.identification.sensor_errors import _spread
from graphslam.identification.sighting_errors import OFFSET, SCALE, Ids, RangeErrors, evened
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import PartialSightings
from graphslam.metrics import ate


def drive(seed, errors, kind):
    """A drive of 200 s with errors (L,) of the ranges to its landmarks, the log with right ranges, and the true landmarks."""
    right, truth = replace(Drive.random(seed), duration=200.0).simulate()
    sightings, real = right.sightings.copy(), truth.landmarks != UNIDENTIFIED
    each = errors[truth.landmarks[real]]
    sightings[real, 0] = sightings[real, 0] * (1 + each) if kind == SCALE else sightings[real, 0] + each
    return right.replace(sightings=sightings), right, truth


def tags(seed, size=0.03):
    """Scales of all landmarks, whose mean over those that are seen is zero."""
    _, truth = replace(Drive.random(seed), duration=200.0).simulate()
    scales = size * np.random.default_rng(seed).standard_normal(truth.landmarks.max() + 1)
    return scales - scales[np.unique(truth.landmarks[truth.landmarks != UNIDENTIFIED])].mean()


@pytest.mark.parametrize("seed", [102, pytest.param(103, marks=pytest.mark.nightly)])
def test_tags_of_wrong_sizes_are_found_and_corrected(seed, monkeypatch):
    scales = tags(seed)
    log, right, _ = drive(seed, scales, SCALE)
    robot = estimate_robot(log)
    ranges = robot.ranges
    assert ranges.kind == SCALE and ranges.spread == pytest.approx(0.03, rel=0.4)
    known = [id for id in ranges.found if id < len(scales)]
    z = [(ranges.found[id][0] - scales[id]) / ranges.found[id][1] for id in known]
    # chi-squared of 15 errors is below 2.5 times 15 with a probability above 0.998
    assert len(known) >= 15 and np.mean(np.square(z)) < 2.5
    (doubt,) = (each for each in robot.doubts if "differs from landmark to landmark" in each)
    assert "ランドマークごとに異なる割合" in translated(doubt, "ja")
    largest = max(ranges.found, key=lambda id: abs(ranges.found[id][0]))
    assert f": {largest}: {100 * ranges.found[largest][0]:+.2g} +- " in doubt
    solution = solve(Graph.from_log(robot.log))
    healthy = estimate_robot(right)
    assert healthy.ranges is None
    assert ate(log.true_poses, solution.poses) < 1.3 * ate(log.true_poses, solve(Graph.from_log(healthy.log)).poses)
    # as it was
    monkeypatch.setattr("graphslam.identification.robot.range_errors_of", lambda *_: None)
    monkeypatch.setattr("graphslam.identification.sighting_errors._moved", lambda *_: {})
    wrong = solve(Graph.from_log(estimate_robot(log).log))
    assert ate(log.true_poses, wrong.poses) > 1.4 * ate(log.true_poses, solution.poses)


@pytest.mark.nightly
def test_covariances_contain_the_mean_of_the_tags():
    """All ranges 1 % too long look like wheels that are; with tags of 3 % this is 3 % over the root of their number."""
    log = drive(1005, tags(1005) + 0.01, SCALE)[0]
    robot = estimate_robot(log)
    n = len(robot.ranges.found)
    assert robot.log.uncertain["range_scale"] == pytest.approx(robot.ranges.spread / n**0.5)
    (doubt,) = (each for each in robot.doubts if "differs from landmark to landmark" in each)
    assert f"all lengths may be off by {100 * robot.ranges.spread / n**0.5:.1g} %" in doubt
    solution = solve(Graph.from_log(robot.log))
    assert np.nanmedian(solution.nees(log.true_poses)) < 3


def test_a_single_landmark_is_found_and_its_sightings_come_back():
    _, _, truth = drive(105, np.zeros(100), OFFSET)
    landmark = int(np.bincount(truth.landmarks[truth.landmarks != UNIDENTIFIED]).argmax())
    log, right, truth = drive(105, 0.4 * (np.arange(100) == landmark), OFFSET)
    robot = estimate_robot(log)
    assert robot.ranges.kind == OFFSET and list(robot.ranges.found) == [landmark] and robot.ranges.spread is None
    s, error = robot.ranges.found[landmark]
    assert abs(s - 0.4) < 4 * error and error < 0.1
    (doubt,) = (each for each in robot.doubts if "single landmarks" in each)
    assert f": {landmark}: {s:+.2g} +- " in doubt and "一部のランドマーク" in translated(doubt, "ja")
    healthy = estimate_robot(right)
    # sightings of it whose id was misread keep their range, and so do not fit it
    own = (truth.landmarks == landmark) & (log.landmarks == landmark)
    dropped = [np.count_nonzero(each.ids.dropped[own]) for each in (robot, healthy)]
    assert dropped[0] <= dropped[1] + 2
    # another log of the same place is corrected, too
    even = replace(robot, ranges=None).corrected(evened(log, robot.ranges))
    np.testing.assert_array_equal(robot.corrected(log).sightings, even.sightings)


@pytest.mark.parametrize("seed", [1104, pytest.param(1035, marks=pytest.mark.nightly)])
def test_errors_that_last_are_not_those_of_landmarks(seed):
    """Correlated errors gained up to 20 in the log likelihood without the division by the sightings that count as one."""
    robot = estimate_robot(Drive.random(seed).simulate()[0])
    assert robot.correlations.max() > 0.2
    assert robot.ranges is None and robot.ids.reflections is None


def test_reflected_ranges_are_said():
    right = replace(Drive.random(1005), duration=200.0).simulate()[0]
    rng, sightings = np.random.default_rng(5), right.sightings.copy()
    sightings[:, 0] += (rng.random(len(sightings)) < 0.15) * rng.exponential(0.5, len(sightings))
    robot = estimate_robot(right.replace(sightings=sightings))
    (doubt,) = (each for each in robot.doubts if "reflected" in each)
    assert "反射" in translated(doubt, "ja")
    assert robot.ranges is None
    assert estimate_robot(right).ids.reflections is None


def test_reflections_need_an_excess_of_long_ranges():
    none = np.zeros(3, dtype=bool)

    def said(long, short, fitting):
        return Ids(none, none, none, none, (long, short, fitting)).reflections

    assert said(40, 0, 900) is not None
    # 5 standard errors of the excess are 5 * 60**0.5 = 39
    assert said(49, 11, 900) is None and said(50, 10, 900) is not None
    # and at least one in a hundred
    assert said(40, 0, 9000) is None


def test_the_most_probable_spread_is_that_of_the_normal_distribution():
    """_spread against the density of the estimates, N(0, d² I + P^-1), as SciPy has it."""
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(2)
    A = rng.standard_normal((6, 9))
    P = 400 * A @ A.T
    found = rng.multivariate_normal(np.zeros(6), 0.05**2 * np.eye(6) + np.linalg.inv(P))
    spread, gain = _spread(P @ found, P)

    def density(d):
        return multivariate_normal.logpdf(found, np.zeros(6), d**2 * np.eye(6) + np.linalg.inv(P))

    assert gain == pytest.approx(density(spread) - density(0.0), rel=1e-6)
    assert density(spread) >= max(density(0.9 * spread), density(1.1 * spread))


def test_a_log_with_even_ranges():
    log, _ = replace(Drive.random(1003), duration=60.0).simulate()
    alone = PartialSightings(steps=[3, 5], landmarks=[1, 2], ranges=[4.0, np.nan], bearings=[np.nan, 0.1])
    log = log.replace(partial_sightings=alone)
    ranges, own = RangeErrors(SCALE, {1: (0.1, 0.01)}), log.landmarks == 1
    right = evened(log, ranges)
    np.testing.assert_allclose(right.sightings[own, 0] * 1.1, log.sightings[own, 0])
    np.testing.assert_array_equal(right.sightings[~own], log.sightings[~own])
    assert right.partial_sightings.ranges[0] == pytest.approx(4 / 1.1) and np.isnan(right.partial_sightings.ranges[1])
    assert ranges.log_density(log.landmarks) == pytest.approx(-own.sum() * np.log(1.1))
    assert evened(log, None) is log
    # ranges stay above zero
    short = evened(log, RangeErrors(OFFSET, {1: (100.0, 0.01)}))
    np.testing.assert_allclose(short.sightings[own, 0], log.sightings[own, 0] / 2)


def test_ids_that_were_found_carry_no_errors(monkeypatch):
    """The log that is solved does not have these ids, so that its ranges could not be corrected."""
    monkeypatch.setattr("graphslam.identification.robot.range_errors_of", lambda *_: pytest.fail("looked for"))
    log, _, _ = drive(1005, tags(1005), SCALE)
    log = log.at_steps(np.arange(log.num_poses // 3))
    assert estimate_robot(log, single_landmarks=False).ranges is None
    _, robot = known_noise(log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)), "auto")
    assert robot.ranges is None


def test_a_search_that_fails_says_nothing(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr("graphslam.identification.sensor_errors._spread", fails)
    assert estimate_robot(replace(Drive.random(1003), duration=60.0).simulate()[0]).ranges is None


@pytest.mark.parametrize("kind", [SCALE, OFFSET])
@pytest.mark.parametrize("spread", [None, 0.03])
def test_all_sentences_are_translated(kind, spread):
    for sentence in RangeErrors(kind, {5: (0.083, 0.004), 7: (-0.05, 0.01)}, spread, alike=True).sentences:
        assert not re.search("[a-z]{3,}", translated(sentence, "ja"))


def test_a_landmark_that_is_moved_has_another_id_from_then_on():
    """It takes the place of another one half-way, and nobody sees the other one before or this one after that."""
    right, _ = replace(Drive.random(2003), duration=150.0, misread=0.0, clutter=0.0).simulate()
    times = right.times[right.steps] - right.times[0]
    later, seen = times > 75.0, right.landmark_ids
    fewest = [min(np.sum((right.landmarks == id) & part) for part in (later, ~later)) for id in seen]
    other, id = seen[np.argsort(fewest)[-2:]]
    gone = ((right.landmarks == id) & later) | ((right.landmarks == other) & ~later)
    log = right.with_sightings(~gone, landmarks=np.where(right.landmarks == other, id, right.landmarks)[~gone])
    robot = estimate_robot(log)
    ((new, (old, moment)),) = robot.ids.moved.items()
    assert old == id and new == 1_000_000 + id and moment == pytest.approx(75.0, abs=10.0)
    assert {new, old} < set(robot.log.landmark_ids.tolist()) and robot.ids.share < 0.05
    (note,) = (each for each in robot.sentences if "as if somebody had moved them" in each)
    assert f": {id} at " in note and "動かされた" in translated(note, "ja")
    assert note in replace(robot, basis=BOOK_NOISE).sentences
    error = ate(log.true_poses, solve(Graph.from_log(robot.log)).poses)
    assert error < 1.3 * ate(right.true_poses, solve(Graph.from_log(right)).poses)
