"""Tolerances of tests that compare samples: they follow from the number of independent samples and from an error rate.

A test with a fixed random seed still draws other samples on another processor, because the order and the fusing of floating
point operations decide some comparison of a chain or of resampling differently. So its tolerance must hold for nearly every
seed, not for the one that is written there: the probability that a correct program fails is below `ERROR_RATE` per test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, norm, t

Array = np.ndarray

#: the probability that one test fails although the program is right
ERROR_RATE = 1e-6


def bound(comparisons: int = 1, degrees: float = np.inf) -> float:
    """How many standard errors the largest of so many differences may be, by the union bound, to either side.

    The differences are Gaussian; with ``degrees`` of freedom of their standard errors, Student's t.
    """
    tail = ERROR_RATE / (2 * comparisons)
    return float(norm.isf(tail) if np.isinf(degrees) else t.isf(tail, degrees))


def chi_square_bounds(degrees: float, comparisons: int = 1) -> tuple[float, float]:
    """Between which numbers a sum of so many squares of standard normal numbers is."""
    tail = ERROR_RATE / (2 * comparisons)
    return float(chi2.isf(1 - tail, degrees)), float(chi2.isf(tail, degrees))


def share_bound(trials: int, comparisons: int = 1) -> float:
    """How far the share of successes of independent trials may be from its probability (Hoeffding's inequality)."""
    return float(np.sqrt(np.log(2 * comparisons / ERROR_RATE) / (2 * trials)))


def batch_errors(chains: Array, batches: int = 30) -> tuple[Array, Array]:
    """The standard errors of means and of standard deviations of correlated samples (chains, samples, coordinates).

    Each chain is cut into ``batches`` parts that are far longer than its correlation, so that their means, of the samples and
    of their squared deviations, are independent. The errors of standard deviations are parts of these.
    """
    length = chains.shape[1] // batches
    samples = chains[:, : batches * length]
    d = samples - samples.mean(axis=(0, 1))
    parts = d.reshape(len(chains) * batches, length, -1)
    count = len(parts)
    variance = np.mean(d**2, axis=(0, 1))
    of_means = parts.mean(axis=1).std(axis=0, ddof=1) / np.sqrt(count)
    of_variances = (parts**2).mean(axis=1).std(axis=0, ddof=1) / np.sqrt(count)
    return of_means, of_variances / (2 * variance)


def mean_error(values: ArrayLike) -> Array:
    """The standard error of the mean of independent values, along the first axis."""
    values = np.asarray(values)
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def check_mean(values: ArrayLike, expected: ArrayLike) -> None:
    """Fail if the mean of independent estimates (runs, numbers) is farther from the expected one than their spread allows."""
    values = np.asarray(values)
    check_normal(values.mean(axis=0) - expected, mean_error(values), len(values) - 1)


def check_normal(differences: ArrayLike, errors: ArrayLike, degrees: float = np.inf) -> None:
    """Fail if a difference of independent estimates is larger than its standard error allows."""
    ratios = np.abs(np.asarray(differences) / np.asarray(errors)).ravel()
    assert ratios.max() < bound(ratios.size, degrees), (ratios.max(), bound(ratios.size, degrees))
