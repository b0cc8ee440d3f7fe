"""Resampling schemes by name: how many copies each particle gets. All are unbiased: E[copies_i] = N w_i.

Every scheme returns the ancestors in ascending order. This costs nothing, keeps the copies of one particle together in
memory, and lets the genealogy find distinct ancestors by comparing neighbours.

Source: Douc, Cappe and Moulines, *Comparison of resampling schemes for particle filtering*, ISPA 2005.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graphslam.engine import engine
from graphslam.se2 import Array

Scheme = Callable[[Array, np.random.Generator], np.ndarray]


def systematic(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N positions 1/N apart with one random offset: one uniform number, the lowest variance of the copies."""
    return engine.evenly_spaced(np.cumsum(weights), rng.random())


def stratified(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """One uniform position in each of N equal strata: N uniform numbers."""
    count = len(weights)
    return engine.at_positions(np.cumsum(weights), (rng.random(count) + np.arange(count)) / count)


def multinomial(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N independent draws from the weights: N uniform numbers, the highest variance of the copies."""
    return engine.at_positions(np.cumsum(weights), np.sort(rng.random(len(weights))))


def residual(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """floor(N w_i) copies, and multinomial draws from the remainders for the rest: one uniform number per draw."""
    count = len(weights)
    expected = count * weights / weights.sum()
    # the tolerance keeps rounding errors from losing a copy where N w_i is a whole number
    copies = np.floor(expected * (1 + 1e-12)).astype(np.int64)
    rest = count - int(copies.sum())
    if rest > 0:
        extra = engine.at_positions(np.cumsum(np.maximum(expected - copies, 0.0)), np.sort(rng.random(rest)))
        copies += np.bincount(extra, minlength=count)
    return np.repeat(np.arange(count), copies)


#: the schemes by the names of `options.RESAMPLING`: weights (N,) that sum to about 1, generator -> ancestors (N,)
RESAMPLING_SCHEMES: dict[str, Scheme] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
    "multinomial": multinomial,
}


def effective_sample_size(log_weights: Array) -> float:
    """Return ESS = (sum w)² / sum w², between 1 and N, from log weights (N,) that need not be normalised.

    Source: Kong, Liu and Wong, *Sequential imputations and Bayesian missing data problems*, JASA 1994.
    """
    weights = np.exp(log_weights - np.max(log_weights))
    return float(min(weights.sum() ** 2 / (weights @ weights), len(weights)))
