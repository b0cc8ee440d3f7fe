from __future__ import annotations

import os

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from fastslam.threads import Threads, available_threads
from graphslam import OptionError, simulate


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2, MonteCarloLocalization])
def test_same_result_whatever_the_number_of_threads(kind: type) -> None:
    log = simulate(seed=1, steps=20)
    one, three = (kind(log, particles=3 * 4096 + 77, seed=1, threads=threads) for threads in (1, 3))
    for a, b in zip(one, three, strict=True):
        np.testing.assert_array_equal(a.poses, b.poses)
        np.testing.assert_array_equal(a.log_weights, b.log_weights)
    assert any(one.result().resampled)
    for j, mean in one.result().landmarks.items():
        np.testing.assert_array_equal(mean, three.result().landmarks[j])


@pytest.mark.parametrize(("particles", "threads", "expected"), [(100, 4, 1), (8192, 4, 2), (10_000, 2, 2), (1, 1, 1)])
def test_ranges_cover_every_particle_once(particles: int, threads: int, expected: int) -> None:
    team, visits = Threads(particles, threads), np.zeros(particles, dtype=int)

    def work(lo: int, hi: int) -> None:
        visits[lo:hi] += 1

    team.run(work)
    np.testing.assert_array_equal(visits, 1)
    assert team.count == expected


def test_light_work_stays_in_one_thread_longer() -> None:
    ranges: list[tuple[int, int]] = []

    def work(lo: int, hi: int) -> None:
        ranges.append((lo, hi))

    Threads(10_000, 2).run_light(work)
    assert ranges == [(0, 10_000)]
    ranges.clear()
    Threads(100_000, 2).run_light(work)
    assert sorted(ranges) == [(0, 50_176), (50_176, 100_000)]


def test_a_large_filter_is_the_same_in_two_threads() -> None:
    """Large enough that sums and maxima are computed in threads, too."""
    log = simulate(seed=1, steps=6, clean=True)
    a, b = (FastSLAM2(log, particles=70_000, ess_threshold=1.0, threads=threads).run() for threads in (1, 2))
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_array_equal(a.ess, b.ess)


def test_errors_of_a_thread_are_raised() -> None:
    def work(lo: int, hi: int) -> None:
        if lo > 0:
            raise ValueError("in the other thread")

    with pytest.raises(ValueError, match="in the other thread"):
        Threads(10_000, 2).run(work)


def test_a_forked_process_starts_its_own_threads() -> None:
    def work(lo: int, hi: int) -> None:
        pass

    team = Threads(10_000, 2)
    team.run(work)
    team._process = -1  # in a child this is its parent's number
    team.run(work)
    assert team._process == os.getpid()


@pytest.mark.parametrize("threads", [0, -1, 1.5])
def test_bad_number(threads: float) -> None:
    with pytest.raises(OptionError, match="threads must be"):
        FastSLAM1(threads=threads)


def test_the_limit_of_numba_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert available_threads() == 1
    assert FastSLAM1(particles=100_000)._threads.count == 1
