"""`fastslam.associate`: the front ends, as Python calls them. tests/comparisons/test_found_ids.py has those of a run."""

import numpy as np
import pytest

from fastslam import FilterOptions, associate
from graphslam import MotionModel, OptionError, SensorModel, load, sample_log_path, simulate
from graphslam.association import associate_from, score
from graphslam.log import UNIDENTIFIED

LOG = load(sample_log_path())


@pytest.mark.slow
@pytest.mark.parametrize(("front_end", "starts"), [("auto", 2), ("fastslam2", 1), ("batch", 1), ("best", 4)])
def test_each_front_end_finds_the_ids(front_end, starts):
    found = associate(LOG, front_end=front_end)
    assert score(found.ids, LOG.landmarks).precision == 1.0
    assert (found.verdict.starts, found.verdict.reliable) == (starts, starts > 1)
    assert sum("the ids began with those of" in note for note in found.notes) == (front_end != "batch")


def test_by_default_two_front_ends_compete():
    found = associate(LOG)
    assert found.verdict.starts == 2
    assert any("those of FastSLAM 2.0, the drive with the local filter, with 30 particles" in n for n in found.notes)


def test_a_given_start_stands_for_the_front_ends():
    start = (LOG.landmarks, LOG.initial_poses)
    given, alone = associate(LOG, start=start), associate_from(LOG, start=start)
    np.testing.assert_array_equal(given.ids, alone.ids)
    assert given.notes == alone.notes


def test_options_are_checked():
    with pytest.raises(OptionError, match="front_end must be one of auto, fastslam2, batch, best"):
        associate(LOG, front_end="other")
    with pytest.raises(OptionError, match="front_particles must be at least 1"):
        associate(LOG, front_particles=0)
    with pytest.raises(OptionError, match="associate has no option 'particles'"):
        associate(LOG, particles=3)
    with pytest.raises(OptionError, match="filters must be a FilterOptions"):
        associate(LOG, filters=3)
    few = associate(LOG, filters=FilterOptions(seed=3), front_end="fastslam2", front_particles=5)
    assert "with 5 particles" in few.notes[-1]


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [True, False])
def test_noise_that_nobody_knows_is_estimated_first(hidden):
    """As in `slam-compare run`: with the book's noise, several times too wide, neighbouring landmarks were joined."""
    robot = {"motion": MotionModel(nn=0.05, on=0.03, oo=0.05), "sensor": SensorModel(range_rate=0.02, bearing_std=0.02)}
    true = simulate(seed=1, steps=150, clean=True, orientation=False, max_range=5.0, **robot)
    log = true.replace(simulated=False, motion=None, sensor=None)
    if hidden:
        log = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    found = associate(log, front_end="batch")
    assert len(found.ids) == len(log.steps) and score(found.ids, true.landmarks).precision == 1.0
    assert found.log.sensor.bearing_std == pytest.approx(0.02, rel=0.3)
    # noise that is given is taken as it is
    assert associate(log, sensor=SensorModel(), front_end="batch").log.sensor != found.log.sensor
