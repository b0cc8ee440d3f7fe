"""The Gaussian numbers of the motions; the elementary functions behind them are tested in `engine/tests/numbers.cpp`."""

from __future__ import annotations

import numpy as np
import pytest
from error_rates import ERROR_RATE, bound
from scipy import stats

from fastslam.particles import standard_normals


def test_normals_are_normal() -> None:
    """An error rate of 1e-6 for all: 5 distributions, and 25 moments of each of three kinds, by their standard errors."""
    normals = standard_normals(np.random.default_rng(1), 200_000)
    many = bound(80) / np.sqrt(200_000)
    assert normals.shape == (200_000, 5)
    for column in normals.T:
        assert stats.kstest(column, "norm").pvalue > ERROR_RATE / 80
    np.testing.assert_allclose(np.cov(normals.T), np.eye(5), atol=np.sqrt(2) * many)
    # their squares must be uncorrelated, too, and so must be the numbers of different particles
    np.testing.assert_allclose(np.corrcoef(normals.T**2), np.eye(5), atol=many)
    np.testing.assert_allclose(np.corrcoef(normals[1:].T, normals[:-1].T)[:5, 5:], 0, atol=many)
    # more than 4 standard deviations are expected 63 times in a million
    low, high = stats.poisson.interval(1 - ERROR_RATE / 80, 1e6 * 2 * stats.norm.sf(4))
    assert low <= np.sum(np.abs(normals) > 4) <= high


def test_keys_give_unrelated_numbers() -> None:
    rng = np.random.default_rng(2)
    first, second = standard_normals(rng, 100_000), standard_normals(rng, 100_000)
    np.testing.assert_allclose(np.corrcoef(first.T, second.T)[:5, 5:], 0, atol=bound(25) / np.sqrt(100_000))


def test_numbers_depend_on_the_particle_alone() -> None:
    normals = standard_normals(np.random.default_rng(3), 500)
    np.testing.assert_array_equal(standard_normals(np.random.default_rng(3), 20), normals[:20])


@pytest.mark.parametrize("seed", range(3))
def test_one_number_is_drawn_per_key(seed: int) -> None:
    a, b = np.random.default_rng(seed), np.random.default_rng(seed)
    standard_normals(a, 1000)
    b.random()
    assert a.random() == b.random()
