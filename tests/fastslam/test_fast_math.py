"""The vectorised elementary functions against the C library, and the Gaussian numbers computed with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from error_rates import ERROR_RATE, bound
from scipy import stats

from fastslam import fast_math
from fastslam.noise import standard_normals
from graphslam.se2 import wrap

RNG = np.random.default_rng(0)
SPECIAL = np.pi * np.arange(-8, 9) / 4


def each(function: Callable, *arguments: np.ndarray) -> np.ndarray:
    return np.array([function(*values) for values in zip(*arguments, strict=True)])


def test_sincos() -> None:
    near = np.concatenate([RNG.uniform(-10, 10, 4000), SPECIAL, np.nextafter(SPECIAL, 9), np.nextafter(SPECIAL, -9)])
    np.testing.assert_allclose(each(fast_math.sincos, near), np.column_stack([np.sin(near), np.cos(near)]), atol=3e-16)
    far = RNG.uniform(-1e6, 1e6, 1000)
    np.testing.assert_allclose(each(fast_math.sincos, far), np.column_stack([np.sin(far), np.cos(far)]), atol=1e-12)


def test_atan2() -> None:
    x, y = RNG.uniform(-3, 3, (2, 4000)) * 10.0 ** RNG.uniform(-8, 8, (2, 4000))
    np.testing.assert_allclose(each(fast_math.atan2, y, x), np.arctan2(y, x), rtol=5e-16)
    axes = np.array([[0, 1], [1, 0], [0, -1], [-1, 0], [1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=float)
    np.testing.assert_allclose(each(fast_math.atan2, *axes.T), np.arctan2(*axes.T), rtol=5e-16)
    assert np.isnan(fast_math.atan2(0.0, 0.0))


def test_log_and_exp() -> None:
    x = np.concatenate([10.0 ** RNG.uniform(-300, 300, 4000), 1 + RNG.uniform(-1e-3, 1e-3, 1000), [1.0, 2.0, 0.5]])
    np.testing.assert_allclose(each(fast_math.log, x), np.log(x), rtol=5e-16)
    y = np.concatenate([RNG.uniform(-700, 700, 4000), RNG.uniform(-1, 1, 1000), [0.0]])
    np.testing.assert_allclose(each(fast_math.exp, y), np.exp(y), rtol=5e-16)
    assert fast_math.exp(-1e4) == fast_math.exp(-np.inf) == 0.0


def test_wrap_angle() -> None:
    inside = np.concatenate([RNG.uniform(-np.pi, np.pi, 2000), [-np.pi, np.nextafter(np.pi, 0), 0.0]])
    np.testing.assert_array_equal(each(fast_math.wrap_angle, inside), inside)
    angles = np.concatenate(
        [RNG.uniform(-60, 60, 4000), SPECIAL, np.nextafter(SPECIAL, 99), np.nextafter(SPECIAL, -99)]
    )
    wrapped = each(fast_math.wrap_angle, angles)
    assert np.all((wrapped >= -np.pi) & (wrapped < np.pi))
    difference = wrapped - wrap(angles)
    np.testing.assert_allclose(np.abs(difference - 2 * np.pi * np.round(difference / (2 * np.pi))), 0, atol=1e-14)


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
