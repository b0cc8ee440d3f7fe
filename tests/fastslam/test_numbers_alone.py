"""Ranges and bearings alone in the filters: closed forms of weights and updates, and delayed landmarks."""

import numpy as np
import pytest
from scipy.stats import norm

from comparisons.show.language import translated
from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from graphslam import OptionError, SensorModel
from graphslam.metrics import ate
from graphslam.se2 import wrap
from graphslam.simulation.worlds import simulate_single_numbers

SENSOR = SensorModel(range_rate=0.1, range_std=0.2, bearing_std=0.1)
NAN = np.nan


@pytest.mark.parametrize("sighting", [(4.0, NAN), (NAN, 0.3)])
def test_localisation_weighs_by_the_likelihood_of_one_number(sighting):
    rng = np.random.default_rng(0)
    start, m = rng.standard_normal((50, 3)) * (1, 1, 0.3), np.array([4.0, 1.0])
    found = MonteCarloLocalization(map={3: m}, particles=50, start=start, sensor=SENSOR, stage="weights")
    found.observe([3], [sighting])
    away = m - start[:, :2]
    if np.isnan(sighting[1]):
        log_l = norm.logpdf(sighting[0], np.hypot(*away.T), np.hypot(0.1 * sighting[0], 0.2))
    else:
        log_l = norm.logpdf(wrap(sighting[1] - np.arctan2(away[:, 1], away[:, 0]) + start[:, 2]), 0, 0.1)
    total = np.log(np.exp(log_l).sum())
    np.testing.assert_allclose(found.state.log_weights, log_l - total, atol=1e-9)
    assert found._log_evidence == pytest.approx(total - np.log(50), abs=1e-9)


@pytest.mark.parametrize("sighting", [(4.2, NAN), (NAN, 0.2)])
@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_one_number_updates_a_landmark_as_a_kalman_filter(kind, sighting):
    """Nothing has moved, so that 2.0 is 1.0: K = S H' / (H S H' + Q) with the row H of the number."""
    found = kind(particles=1, start=(1.0, -0.5, 0.4), sensor=SENSOR)
    found.observe([7], [(4.0, 0.1)])
    (before,) = found.state.map().values()
    found.observe([7], [sighting])
    (after,) = found.state.map().values()
    away = before.mean - (1.0, -0.5)
    r = np.hypot(*away)
    if np.isnan(sighting[1]):
        H, e, Q = away / r, sighting[0] - r, (0.1 * sighting[0]) ** 2 + 0.2**2
    else:
        e = wrap(sighting[1] - np.arctan2(away[1], away[0]) + 0.4)
        H, Q = np.array([-away[1], away[0]]) / r**2, 0.1**2
    V = H @ before.covariance @ H + Q
    K = before.covariance @ H / V
    np.testing.assert_allclose(after.mean, before.mean + K * e, atol=1e-8)
    np.testing.assert_allclose(after.covariance, before.covariance - np.outer(K, H @ before.covariance), atol=1e-8)


@pytest.mark.parametrize("number", ["range", "bearing"])
def test_single_numbers_correct_dead_reckoning(number):
    log = simulate_single_numbers(number, seed=5)
    off = ate(log.true_poses, log.initial_poses)
    known = MonteCarloLocalization(log, particles=500, seed=0).run()
    assert ate(log.true_poses, known.poses) < 0.4 * off
    found = FastSLAM1(log, particles=500, seed=0).run()
    assert ate(log.true_poses, found.poses) < 0.7 * off and len(found.landmarks) > 4


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2, MonteCarloLocalization])
def test_a_log_needs_no_whole_sightings(kind):
    """A log to which none are given has room for psi in its empty array."""
    log = simulate_single_numbers("range", seed=5, poses=100)
    found = kind(log, particles=50, seed=0).run()
    other = kind(log.replace(sightings=np.empty((0, 3))), particles=50, seed=0).run()
    np.testing.assert_array_equal(found.poses, other.poses)
    both = log.replace(steps=[0], landmarks=[1], sightings=[[1.0, 0.0, 0.0]])
    with pytest.raises(OptionError, match="sightings with psi beside ranges or bearings alone"):
        kind(both, particles=50)


def test_a_landmark_with_a_mirror_image_waits():
    """Ranges from a straight way leave two places; three from a bent one leave the right one."""
    m = np.array([3.0, 2.0])
    ways = {
        "straight": [(k, 0.0, 0.0) for k in range(8)],
        "bent": [(k, 0.3 * k * k, np.arctan(0.6 * k)) for k in range(8)],
    }
    for name, poses in ways.items():
        exact = SensorModel(range_rate=0.001, range_std=0.01, bearing_std=0.1)
        filter_ = FastSLAM1(particles=20, start=poses[0], sensor=exact, seed=0)
        for k, pose in enumerate(np.array(poses)):
            if k:
                before = np.array(poses[k - 1])
                c, s = np.cos(before[2]), np.sin(before[2])
                d = pose - before
                motion = (c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2])
                filter_.move(motion=motion, covariance=1e-8 * np.eye(3))
            filter_.observe([1], [(np.hypot(*(m - pose[:2])), NAN)])
        if name == "straight":
            assert filter_.landmarks == {}
            (note,) = (note for note in filter_.result().notes if "left out" in note)
            assert note.startswith("landmark 1 left out: ")
            assert translated(note, "ja").startswith("ランドマーク1は除きました")
        else:
            assert not any("left out" in note for note in filter_.result().notes)
            assert np.hypot(*(filter_.landmarks[1] - m)) < 0.05


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
@pytest.mark.parametrize("number", [(3.0, NAN), (NAN, 2.0)])
def test_the_order_of_numbers_and_whole_sightings_in_a_scan_does_not_matter(kind, number):
    """The landmark stands where the whole sighting puts it, also where a number of it is named first."""
    found = []
    for scan in ([(3.0, 2.0), number], [number, (3.0, 2.0)]):
        filter_ = kind(particles=10, sensor=SENSOR, seed=0)
        filter_.observe([5, 5], scan)
        found.append(filter_.landmarks[5])
    np.testing.assert_allclose(found, np.tile([3 * np.cos(2), 3 * np.sin(2)], (2, 1)), atol=1e-9)


def test_what_cannot_be():
    filter_ = MonteCarloLocalization(map={1: (0.0, 1.0)}, particles=5)
    for sighting in ([NAN, NAN], [NAN, 0.1, 0.2], [-1.0, NAN]):
        with pytest.raises(OptionError, match="NaN stands for"):
            filter_.observe([1], [sighting])
    with pytest.raises(OptionError, match="a range or a bearing alone needs"):
        FastSLAM1(particles=5, landmark_update="joint").observe([1], [[1.0, NAN]])
