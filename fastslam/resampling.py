"""Resampling schemes by name: how many copies each particle gets. All are unbiased: E[copies_i] = N w_i.

Every scheme returns the ancestors in ascending order. This costs nothing, keeps the copies of one particle together in
memory, and lets the genealogy find distinct ancestors by comparing neighbours.

Source: Douc, Cappe and Moulines, *Comparison of resampling schemes for particle filtering*, ISPA 2005.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from graphslam.se2 import Array

Scheme = Callable[[Array, np.random.Generator], np.ndarray]


def systematic(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N positions 1/N apart with one random offset: one uniform number, the lowest variance of the copies."""
    return _evenly_spaced(np.cumsum(weights), rng.random())


def stratified(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """One uniform position in each of N equal strata: N uniform numbers."""
    count = len(weights)
    return _at_positions(np.cumsum(weights), (rng.random(count) + np.arange(count)) / count)


def multinomial(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N independent draws from the weights: N uniform numbers, the highest variance of the copies."""
    return _at_positions(np.cumsum(weights), np.sort(rng.random(len(weights))))


def residual(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """floor(N w_i) copies, and multinomial draws from the remainders for the rest: one uniform number per draw."""
    count = len(weights)
    expected = count * weights / weights.sum()
    # the tolerance keeps rounding errors from losing a copy where N w_i is a whole number
    copies = np.floor(expected * (1 + 1e-12)).astype(np.int64)
    rest = count - int(copies.sum())
    if rest > 0:
        extra = _at_positions(np.cumsum(np.maximum(expected - copies, 0.0)), np.sort(rng.random(rest)))
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


@njit(cache=True, error_model="numpy", nogil=True)
def _evenly_spaced(cumulative: Array, offset: float) -> np.ndarray:
    """Return `_at_positions` for the positions (offset + 0, 1, 2, ...) / N, without branches that cannot be predicted.

    The first position of particle k is the number of positions before cumulative[k-1]. Each particle writes its index
    there; if it has no position, the next particle overwrites it. Then the indices are spread to the right. This takes
    4 ns per particle instead of 12.
    """
    count, total = len(cumulative), cumulative[-1]
    scale = count / total
    ancestors = np.zeros(count + 1, np.int64)
    first = 0
    for k in range(count):
        ancestors[first] = k
        after = count if cumulative[k] == total else int(np.ceil(cumulative[k] * scale - offset))
        first = min(max(after, 0), count)
    highest = 0
    for i in range(count):
        highest = max(highest, ancestors[i])
        ancestors[i] = highest
    return ancestors[:count]


@njit(cache=True, error_model="numpy", nogil=True)
def _at_positions(cumulative: Array, positions: Array) -> np.ndarray:
    """Return the first k with cumulative[k] > position * total for each of the ascending positions in [0, 1).

    A particle of weight zero is never chosen: where rounding puts a position at the very end, the last particle with a
    weight is taken.
    """
    total = cumulative[-1]
    last = len(cumulative) - 1
    while last > 0 and cumulative[last - 1] == total:
        last -= 1
    ancestors = np.empty(len(positions), np.int64)
    k = 0
    for i in range(len(positions)):
        while k < last and cumulative[k] <= positions[i] * total:
            k += 1
        ancestors[i] = k
    return ancestors
