from __future__ import annotations

import numpy as np
import pytest
from error_rates import bound
from hypothesis import given
from hypothesis import strategies as st

from fastslam import RESAMPLING_SCHEMES, effective_sample_size
from fastslam.options import RESAMPLING, FilterOptions
from graphslam import OptionError
from graphslam.engine import engine

weights_lists = st.lists(st.one_of(st.just(0.0), st.floats(1e-9, 1.0)), min_size=1, max_size=40).filter(
    lambda w: sum(w) > 0
)


@pytest.mark.slow
@pytest.mark.parametrize("name", RESAMPLING_SCHEMES)
@given(weights=weights_lists, seed=st.integers(0, 2**32))
def test_ancestors_ascend_and_have_weight(name: str, weights: list[float], seed: int) -> None:
    w = np.array(weights) / sum(weights)
    ancestors = RESAMPLING_SCHEMES[name](w, np.random.default_rng(seed))
    assert ancestors.shape == w.shape
    assert np.all(np.diff(ancestors) >= 0)
    assert np.all(w[ancestors] > 0)


@pytest.mark.parametrize("name", RESAMPLING_SCHEMES)
def test_unbiased(name: str) -> None:
    """The mean number of copies is N w, within the errors of the multinomial, the widest scheme, at a rate of 1e-6."""
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.full(20, 0.5))
    runs = 4000
    copies = sum(np.bincount(RESAMPLING_SCHEMES[name](weights, rng), minlength=20) for _ in range(runs)) / runs
    error = np.sqrt(20 * weights * (1 - weights) / runs)
    assert np.all(np.abs(copies - 20 * weights) < bound(20) * error + 1e-12)


@pytest.mark.parametrize(
    ("name", "below", "above"), [("systematic", 1, 1), ("residual", 1, np.inf), ("stratified", 2, 2)]
)
def test_copies_stay_near_their_expectation(name: str, below: float, above: float) -> None:
    """Systematic: floor or ceil of N w. Residual: floor at least, with no bound above. Stratified: less than 2 away."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        weights = rng.dirichlet(np.full(50, 0.3))
        difference = np.bincount(RESAMPLING_SCHEMES[name](weights, rng), minlength=50) - 50 * weights
        assert difference.min() > -below - 1e-9
        assert difference.max() < above + 1e-9


@pytest.mark.parametrize("name", ["systematic", "stratified", "residual"])
def test_equal_weights_keep_every_particle(name: str) -> None:
    ancestors = RESAMPLING_SCHEMES[name](np.full(997, 1 / 997), np.random.default_rng(0))
    np.testing.assert_array_equal(ancestors, np.arange(997))


def test_systematic_by_hand() -> None:
    class Fixed:
        def random(self) -> float:
            return 0.5

    weights = np.array([0.1, 0.0, 0.6, 0.3])
    # positions 1/8, 3/8, 5/8, 7/8 over 0.1, 0.1, 0.7, 1.0
    np.testing.assert_array_equal(RESAMPLING_SCHEMES["systematic"](weights, Fixed()), [2, 2, 2, 3])  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [1, 2, 63, 1000])
def test_evenly_spaced_positions_by_search(count: int) -> None:
    """The branch-free version against the plain search, also with many particles of no weight at either end."""
    rng = np.random.default_rng(count)
    for _ in range(50):
        weights = rng.exponential(size=count) ** 3 * (rng.random(count) < 0.7)
        weights[: count // 5] = weights[count - count // 5 :] = 0.0
        if weights.sum() == 0:
            continue
        offset, cumulative = rng.random(), np.cumsum(weights)
        expected = np.searchsorted(cumulative, (offset + np.arange(count)) / count * cumulative[-1], side="right")
        np.testing.assert_array_equal(engine.evenly_spaced(cumulative, offset), expected)


def test_effective_sample_size() -> None:
    assert effective_sample_size(np.zeros(10)) == 10
    assert effective_sample_size(np.array([0.0, -np.inf, -np.inf])) == 1
    # (0.5 + 0.25 + 0.25)² / (1/4 + 1/16 + 1/16) = 8/3, whatever the scale
    assert effective_sample_size(np.log([0.5, 0.25, 0.25]) - 1e4) == pytest.approx(8 / 3, rel=1e-9)


def test_names() -> None:
    assert tuple(RESAMPLING_SCHEMES) == RESAMPLING
    with pytest.raises(OptionError, match=r"systematic.*not 'low variance'"):
        FilterOptions(resampling="low variance")
