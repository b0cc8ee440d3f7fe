"""Copies of particle filters, and arrays that the engine refuses."""

import pickle
import subprocess
import sys
from copy import copy, deepcopy

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from fastslam.filters.particle_filter import ParticleFilter
from graphslam import simulate
from graphslam.engine import engine

FILTERS = {
    "mcl": lambda log: MonteCarloLocalization(log, particles=50, seed=3),
    "fastslam1": lambda log: FastSLAM1(log, particles=50, seed=3, landmark_update="joint"),
    "fastslam2, estimated range noise": lambda log: FastSLAM2(log, particles=50, seed=3, range_noise="estimated"),
    "fastslam2, smoothing": lambda log: FastSLAM2(log, particles=50, seed=3, smoothing=10),
    "fastslam1, no ids": lambda log: FastSLAM1(log, particles=50, seed=3, association="maximum-likelihood"),
    "fastslam2, no ids": lambda log: FastSLAM2(log, particles=50, seed=3, association="maximum-likelihood"),
}


def halfway(kind: str) -> ParticleFilter:
    """A filter that has processed half of a log, with resampling."""
    one = FILTERS[kind](simulate(seed=4, steps=60))
    for state, _ in zip(one, range(30)):
        assert state is not None
    return one


@pytest.mark.parametrize("make", [copy, deepcopy])
@pytest.mark.parametrize("kind", FILTERS)
def test_a_copy_continues_with_the_same_numbers(kind, make):
    one = halfway(kind)
    before, poses = one.trajectory(), one.state.poses
    other = make(one)
    np.testing.assert_array_equal(other.trajectory(), before)
    first = other.run()
    # the copy did not touch the original, which ends in the same place
    np.testing.assert_array_equal(one.trajectory(), before)
    np.testing.assert_array_equal(one.state.poses, poses)
    second = one.run()
    assert any(second.resampled[30:])
    for name in ("poses", "mean_poses", "log_weights", "ess", "ancestors"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.log_evidence == second.log_evidence
    assert first.landmarks.keys() == second.landmarks.keys()
    for j in first.landmarks:
        np.testing.assert_array_equal(first.landmarks[j], second.landmarks[j])
        np.testing.assert_array_equal(first.landmark_covariances[j], second.landmark_covariances[j])
    if second.smoothed is not None:
        np.testing.assert_array_equal(first.smoothed.trajectories, second.smoothed.trajectories)


def test_a_copy_has_maps_of_its_own():
    one = halfway("fastslam1")
    other = deepcopy(one)
    j = next(iter(one.state.map()))
    before = one.state.map()[j].mean
    other.move((0.0, 0.0), 1.0)
    other.observe([j], [[3.0, 1.0, 0.5]])
    assert not np.array_equal(other.state.map()[j].mean, before)
    np.testing.assert_array_equal(one.state.map()[j].mean, before)


def test_a_filter_that_is_pickled_is_one_sentence():
    with pytest.raises(TypeError, match=r"cannot be pickled; pickle its result\(\), or copy it with copy.deepcopy"):
        pickle.dumps(halfway("fastslam2, no ids"))


def test_floating_point_ids_are_refused():
    particles = engine.ParticleFilter(np.zeros((10, 3)), 1, False)
    particles.use_ids(False, 0, None)
    z, q = np.array([[1.0, 0.2]]), np.array([[0.01, 0.01]])
    with pytest.raises(TypeError):
        particles.weigh_identified(np.array([1.5]), z, q, 0)
    particles.weigh_identified(np.array([7], dtype=np.int32), z, q, 0)
    assert particles.landmarks().tolist() == [7]
    with pytest.raises(TypeError):
        particles.branch(np.linspace(0, 9, 10))


WITHOUT_MEMORY = """
import copy, resource
import numpy as np
from graphslam.engine import engine
filter = engine.ParticleFilter(np.zeros((300_000, 3)), 1, False)
filter.use_ids(False, 0, None)
filter.weigh_identified(np.arange(3), np.array([[1.0, 0.0], [2.0, 1.0], [3.0, 0.5]]), np.full((3, 2), 0.1), 0)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 10_000_000, resource.RLIM_INFINITY))
try:
    copy.deepcopy(filter)
except MemoryError:
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(filter.best)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is limited as Linux does it")
def test_a_copy_that_runs_out_of_memory_leaves_the_filter_as_it_was():
    done = subprocess.run([sys.executable, "-c", WITHOUT_MEMORY], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("0\n", 0), done.stderr
