"""`fastslam.associate`: the front ends, as Python calls them. tests/comparisons/test_found_ids.py has those of a run."""

import numpy as np
import pytest

from fastslam import FilterOptions, associate
from graphslam import OptionError, load, sample_log_path
from graphslam.association import associate_from, score

LOG = load(sample_log_path())


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
