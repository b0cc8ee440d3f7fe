"""Sampled association: against an enumeration by hand; landmarks that were not seen, and those that are one."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from error_rates import bound, check_normal, mean_error, share_bound

from fastslam import FastSLAM1, FastSLAM2, textbook
from fastslam.anonymous_maps import DROPPED, SURE, AnonymousLandmarks, log_odds
from fastslam.existence_kernels import EVIDENCE, LAST_STEP, merge
from graphslam import OptionError, SensorModel
from graphslam.se2 import wrap

NOISE = {"range_rate": 0.0, "range_std": 0.4, "bearing_std": 0.05, "field_of_view": 3.0, "min_range": 0.5}
SENSOR = SensorModel(max_range=20.0, **NOISE)
DETECTION, CLUTTER, THRESHOLD = 0.7, 0.2, 0.05
OPTIONS = {
    "association": "sampled",
    "detection_probability": DETECTION,
    "clutter_share": CLUTTER,
    "new_landmark_threshold": THRESHOLD,
    "ess_threshold": 0.0,
    "sensor": SENSOR,
}
#: ahead of the robot, so near to each other that a sighting may be of either
PLACES = np.array([[5.0, 0.3], [5.6, -0.3]])
SCAN = np.array([[5.2, 0.02], [5.5, -0.08]])


def log_new(z: np.ndarray) -> float:
    """A perfectly known landmark at the border of the ellipse that holds 1 - p: -2 log p for two coordinates."""
    return float(np.log(THRESHOLD) - 0.5 * np.log(np.linalg.det(2 * np.pi * SENSOR.Q(z))))


def hypotheses(
    belief: textbook.Gaussian, marks: list[textbook.Gaussian], exists: float
) -> dict[tuple[int, ...], tuple[float, float]]:
    """For each assignment of the scan, its probability and its weight: the product of the sums over what is left."""
    evidence = [
        [np.exp(log_new(z))]
        + [DETECTION * exists * np.exp(textbook.correct_pose(belief, m, z, SENSOR)[1]) for m in marks]
        for z in SCAN
    ]
    found = {}
    for choice in product(range(3), repeat=2):
        if choice[0] and choice[0] == choice[1]:
            continue
        probability, weight, used = 1.0, 1.0, set()
        for k, j in enumerate(choice):
            left = sum(w for n, w in enumerate(evidence[k]) if n not in used)
            probability, weight = probability * evidence[k][j] / left, weight * left
            used |= {j} - {0}
        found[choice] = probability, weight
    return found


def test_draws_and_weights_are_those_of_all_hypotheses() -> None:
    """Two landmarks, two sightings, seven assignments: how often each is drawn, and the weight of a particle with it."""
    count = 40_000
    slam = FastSLAM1(particles=count, seed=5, threads=1, **OPTIONS)
    first = SENSOR.h(np.zeros(3), PLACES)
    slam.observe(None, first)
    slam.move((0.0, 0.0), 0.0)
    before = slam.state.log_weights[0]
    slam.observe(None, SCAN)
    marks = [textbook.initialize_landmark(np.zeros(3), z, SENSOR) for z in first]
    odds = (1 - CLUTTER) / CLUTTER
    expected = hypotheses(textbook.Gaussian(np.zeros(3), np.zeros((3, 3))), marks, odds / (1 + odds))
    assert sum(p for p, _ in expected.values()) == pytest.approx(1.0)
    maps = slam._maps
    assert isinstance(maps, AnonymousLandmarks)
    owned = {j: maps.gaussians(j, slice(None)) for j in range(4)}
    # the landmark that a sighting updated has moved; one that it created is the third or fourth
    moved = np.column_stack([np.any(owned[j][0] != marks[j].mean, axis=1) for j in range(2)])
    new = np.column_stack([owned[j][2] > 0 for j in (2, 3)])
    means = np.stack([owned[j][0] for j in range(2)])
    log_weights = slam.state.log_weights - before
    shift = None
    for choice, (probability, weight) in expected.items():
        mine = np.all(new == [j == 0 for j in choice], axis=1) & np.all(moved == [1 in choice, 2 in choice], axis=1)
        for k, j in enumerate(choice):
            if j:
                mine &= np.all(
                    np.isclose(means[j - 1], textbook.update_landmark(np.zeros(3), marks[j - 1], SCAN[k], SENSOR).mean),
                    1,
                )
        share = mine.mean()
        assert abs(share - probability) < share_bound(count, len(expected))
        if share > 0:
            # normalised weights differ from these by one factor
            difference = log_weights[mine] - np.log(weight)
            shift = difference[0] if shift is None else shift
            np.testing.assert_allclose(difference, shift, atol=1e-9)


def test_exact_and_linearised_weights_of_2_0_estimate_the_same_evidence() -> None:
    """The mean weight over all draws is the evidence of the scan: the same however the poses are drawn."""
    weights = {}
    for name, kind, weight in (
        ("1.0", FastSLAM1, "exact"),
        ("exact", FastSLAM2, "exact"),
        ("linearised", FastSLAM2, "linearised"),
    ):
        slam = kind(particles=100_000, seed=1, threads=1, proposal_weight=weight, **OPTIONS)
        slam.observe(None, SENSOR.h(np.zeros(3), PLACES))
        slam.move((0.3, 0.02), 1.0)
        log_weights = slam._weigh(
            np.zeros(2, dtype=int), SCAN.copy(), np.diagonal(SENSOR.Q(SCAN), axis1=1, axis2=2).copy()
        )
        weights[name] = np.exp(log_weights)
    evidence, errors = ({name: f(w) for name, w in weights.items()} for f in (np.mean, mean_error))
    check_normal(evidence["exact"] - evidence["1.0"], np.hypot(errors["exact"], errors["1.0"]))
    # the linearisation itself takes off 0.2 % here, as a million particles show
    error = bound() * np.hypot(errors["linearised"], errors["1.0"])
    assert evidence["linearised"] == pytest.approx(evidence["1.0"], abs=0.01 * evidence["1.0"] + error)


def test_no_landmark_is_used_twice_in_a_scan() -> None:
    slam = FastSLAM1(particles=2000, seed=2, **OPTIONS)
    slam.observe(None, [[5.0, 0.0]])
    slam.move((0.0, 0.0), 0.0)
    slam.observe(None, [[5.0, 0.0], [5.0, 0.0], [5.0, 0.0]])
    for i in range(0, 2000, 50):
        assert len(slam.state.map(i, provisional=True)) >= 3


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_a_phantom_vanishes_and_costs_weight(kind: type[FastSLAM1]) -> None:
    """A landmark that the sensor should see and does not: its odds fall by 1 - P_D a step, until it is dropped."""
    rules = log_odds(DETECTION, CLUTTER)
    options = OPTIONS | {"new_landmark_threshold": 1e-6}
    slam = kind(particles=20, **options)
    slam.observe(None, [[4.0, 0.2], [8.0, -0.3]])
    gone = 0
    while len(slam.state.map(provisional=True)) == 2:
        slam.move((0.0, 0.0), 0.0)
        slam.observe(None, [[4.0, 0.2]])
        gone += 1
        assert gone < 20
    # the odds of the first sighting are 4, and fall below 0.1; the last miss counts when its step is over
    misses = int(np.ceil(rules.first / rules.miss))
    assert 0.3**misses * 4 <= DROPPED < 0.3 ** (misses - 1) * 4
    assert gone == misses + 1
    # beyond the sensor's range nothing is missed
    far = kind(particles=20, **options | {"sensor": SensorModel(max_range=8.5, **NOISE)})
    far.observe(None, [[4.0, 0.2], [8.0, -0.3]])
    for _ in range(8):
        far.move((0.0, 0.0), 0.0)
        far.observe(None, [[4.0, 0.2]])
    assert len(far.state.map(provisional=True)) == 2


def test_a_missed_landmark_weighs() -> None:
    """A particle whose map has a landmark that is not seen gets the factor 1 - P_D e, at the next scan."""
    slam = FastSLAM1(particles=20_000, seed=0, **OPTIONS)
    slam.observe(None, [[5.0, 0.0]])
    slam.move((0.0, 0.0), 0.0)
    slam.observe(None, [[5.0, 0.12]])  # some particles take it for a new landmark
    slam.move((0.0, 0.0), 0.0)
    before = slam.state.log_weights
    maps = slam._maps
    assert isinstance(maps, AnonymousLandmarks)
    doubled = maps.gaussians(1, slice(None))[2] > 0
    odds = (1 - CLUTTER) / CLUTTER
    missed = np.log(1 - DETECTION * odds / (1 + odds))
    np.testing.assert_allclose(maps._misses, np.where(doubled, missed, 0.0), atol=1e-12)
    assert 0 < doubled.sum() < 20_000
    slam.observe(None, [[15.0, 1.0]])  # new for all
    change = slam.state.log_weights - before
    np.testing.assert_allclose(change[doubled] - change[~doubled][0], missed, atol=1e-9)


def test_log_odds_are_those_of_bayes() -> None:
    """Two hypotheses, a landmark or clutter, and the densities of what was seen and missed."""
    rules, density, new = log_odds(DETECTION, CLUTTER), 3.0, 0.4
    evidence = rules.first + rules.hit + rules.graded * np.log(density / new) - rules.miss
    exists = (1 - CLUTTER) * new * DETECTION * density * (1 - DETECTION)
    clutter = CLUTTER * new * CLUTTER * new
    assert DROPPED * np.exp(evidence) == pytest.approx(exists / clutter)
    assert DROPPED * np.exp(rules.confirmed) == pytest.approx(SURE)


@pytest.mark.parametrize("columns", [2, 3])
def test_landmarks_that_are_one_are_merged(columns: int) -> None:
    """The older becomes the product of both Gaussians; not where one scan saw both, nor where they are too far apart."""
    rng = np.random.default_rng(2)
    means, covariances = rng.normal(0, 0.1, (2, columns)), []
    means[:, 2:] += np.array([[np.pi - 0.02], [-np.pi + 0.02]])[:, : columns - 2]
    pool = np.zeros((2, LAST_STEP + 1, 3))
    pool[:, [3, 6, 8]] = 1.0
    upper = np.triu_indices(3)
    for c in range(2):
        root = rng.normal(0, 0.2, (columns, columns)) + 0.2 * np.eye(columns)
        covariances.append(root @ root.T)
        full = np.eye(3)
        full[:columns, :columns] = covariances[c]
        for i in range(3):
            pool[c, :columns, i], pool[c, 3:9, i] = means[c], full[upper]
    pool[1, 0, 2] += 5.0
    pool[0, EVIDENCE], pool[1, EVIDENCE] = 3.0, 2.0
    pool[0, LAST_STEP], pool[1, LAST_STEP] = [4, 5, 4], 5
    untouched = pool.copy()
    merge(0, 3, pool, np.array([0, 1]), float(columns == 3), 20.0, (0.0, 0.0), 4.0)
    np.testing.assert_array_equal(pool[:, :, 1:], untouched[:, :, 1:])
    assert (pool[0, EVIDENCE, 0], pool[1, EVIDENCE, 0], pool[0, LAST_STEP, 0]) == (4.0, 0.0, 5.0)
    P = [np.linalg.inv(S) for S in covariances]
    difference = means[1] - means[0]
    difference[2:] = wrap(difference[2:])
    expected = np.linalg.inv(P[0] + P[1])
    mean = means[0] + expected @ P[1] @ difference
    mean[2:] = wrap(mean[2:])
    full = np.zeros((3, 3))
    full[upper] = pool[0, 3:9, 0]
    np.testing.assert_allclose(
        full[:columns, :columns][np.triu_indices(columns)], expected[np.triu_indices(columns)], atol=1e-12
    )
    np.testing.assert_allclose(pool[0, :columns, 0], mean, atol=1e-12)


def test_options() -> None:
    for name in ("detection_probability", "clutter_share"):
        with pytest.raises(OptionError, match=f"{name} must lie between 0 and 1, not 1"):
            FastSLAM1(**{name: 1})
    with pytest.raises(OptionError, match="merge_interval must be a number of scans, or 0 for never, not -1"):
        FastSLAM1(merge_interval=-1)
