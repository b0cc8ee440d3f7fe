from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from graphslam import OptionError, simulate
from graphslam.engine import available_threads


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
def test_few_particles_take_few_threads(particles: int, threads: int, expected: int) -> None:
    assert FastSLAM1(particles=particles, threads=threads)._engine.threads == expected


def test_a_large_filter_is_the_same_in_two_threads() -> None:
    """Large enough that sums and maxima are computed in threads, too."""
    log = simulate(seed=1, steps=6, clean=True)
    a, b = (FastSLAM2(log, particles=70_000, ess_threshold=1.0, threads=threads).run() for threads in (1, 2))
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_array_equal(a.ess, b.ess)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_can_continue_a_filter() -> None:
    slam, twin = (FastSLAM1(particles=9000, seed=1, threads=2) for _ in range(2))
    for filter_ in (slam, twin):
        filter_.move((0.2, 0.1), 1.0)
    child = os.fork()
    if child == 0:
        slam.move((0.2, 0.1), 1.0)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    # and the parent, too
    for filter_ in (slam, twin):
        filter_.move((0.2, 0.1), 1.0)
    np.testing.assert_array_equal(slam.state.poses, twin.state.poses)


def test_a_filter_in_several_python_threads() -> None:
    """They take turns; a step is never seen half done."""
    slam = FastSLAM1(particles=9000, seed=1, threads=2)

    def drive() -> None:
        for _ in range(50):
            slam._engine.move_by_control(1, (0.1, 0.1, 0.01, 0.01, 1.0, 1e-6), True)
            assert np.isfinite(slam._engine.poses).all()

    with ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(drive) for _ in range(4)]:
            future.result()


@pytest.mark.parametrize("threads", [0, -1, 1.5])
def test_bad_number(threads: float) -> None:
    with pytest.raises(OptionError, match="threads must be"):
        FastSLAM1(threads=threads)


def test_the_limit_of_the_environment_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert available_threads() == 1
    assert FastSLAM1(particles=100_000)._engine.threads == 1
