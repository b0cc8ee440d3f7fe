"""The best joint hypothesis: which item (a sighting, or a track of sightings) is which landmark.

Every candidate c pairs an item with a landmark: a residual nu_c that is zero if the two are one, Gaussian, and correlated
with those of the other candidates. A hypothesis h chooses at most one candidate for each item and uses no landmark twice.
Its evidence, over that of the hypothesis that all items are new, is

    E(h) = sum of w_c + log N(nu_h; 0, S_hh),

with w_c = the logarithm of (probability of detection / density of what is new). Only hypotheses that are jointly compatible
count, nu_h' S_hh^-1 nu_h within the gate. The search is depth first, branch and bound, with S_hh factorised row by row.

Source: Neira and Tardos, *Data association in stochastic mapping using the joint compatibility test*, T-RA 2001. There
the number of pairings is maximised; here the evidence, which also tells whether an item is new.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import gammaincinv

from ..engine import engine
from ..se2 import Array

#: the most hypotheses that one search compares; the best so far is then the result
MOST = 20_000


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates by item: those of item i are ``starts[i]`` to ``starts[i+1]`` - 1.

    Attributes:
        starts: (I+1,).
        landmarks: (C,) the landmark of each, a number from 0.
        residuals: (C, d); ``covariance``: (C d, C d) of all of them.
        weights: (C,) w_c.
        bounds: (C,) the most that each can add to the evidence of a hypothesis.
    """

    starts: np.ndarray
    landmarks: np.ndarray
    residuals: Array
    covariance: Array
    weights: Array
    bounds: Array

    @classmethod
    def of(
        cls, items: np.ndarray, landmarks: np.ndarray, residuals: Array, covariance: Array, weights: Array, noise: Array
    ) -> tuple[Candidates, np.ndarray]:
        """Candidates (C,) of items, numbers from 0, in the order in which they are searched; and that order (C,).

        The search takes items with few and likely candidates first, and likely candidates of an item first, so that it
        finds a good hypothesis at once, and compares alternatives for the doubtful items before all others.

        Args:
            noise: (C, d, d) the least that S_cc can become when other candidates are known to be right.
        """
        count, d = residuals.shape
        own = covariance.reshape(count, d, count, d)[np.arange(count), :, np.arange(count)]
        evidence = weights + log_density(residuals, own)[0]
        total = int(items.max(initial=-1)) + 1
        likely = np.full(total, -np.inf)
        np.maximum.at(likely, items, evidence)
        rank = np.empty(total, dtype=np.int64)
        rank[np.lexsort((-likely, np.bincount(items, minlength=total)))] = np.arange(total)
        order = np.lexsort((-evidence, rank[items]))
        # items without a candidate come first, and take no place
        starts = np.append(np.flatnonzero(np.diff(rank[items[order]], prepend=-1)), count)
        columns = (order[:, None] * d + np.arange(d)).ravel()
        return cls(
            starts, np.unique(landmarks, return_inverse=True)[1][order], residuals[order],
            covariance[np.ix_(columns, columns)], weights[order], np.maximum(weights - 0.5 * log_volume(noise), 0.0)[order],
        ), order  # fmt: skip

    def best(self, gate: float, allowed: np.ndarray | None = None, most: int = MOST) -> tuple[np.ndarray, float]:
        """The candidate (I,) of each item that has some in the best hypothesis, -1 for none, and its evidence E.

        Args:
            gate: the share of correct hypotheses that should count.
            allowed: (C,) which candidates may be used; default: all.
            most: the most hypotheses to compare.
        """
        allowed = np.ones(len(self.landmarks), dtype=bool) if allowed is None else allowed
        items, d = len(self.starts) - 1, self.residuals.shape[1]
        if len(self.landmarks) == 0:
            return np.full(items, -1), 0.0
        return engine.best_hypothesis(
            *(np.ascontiguousarray(numbers, dtype=np.int64) for numbers in (self.starts, self.landmarks)),
            *(
                np.ascontiguousarray(part)
                for part in (self.residuals, self.covariance, self.weights, self.bounds, allowed)
            ),
            gates(gate, d, items),
            most,
        )

    def margins(self, chosen: np.ndarray, evidence: float, gate: float, most: int = MOST) -> Array:
        """For each item (I,) how much worse the best hypothesis without its chosen candidate is; infinite for none."""
        margins = np.full(len(chosen), np.inf)
        for i in np.flatnonzero(chosen >= 0):
            allowed = np.ones(len(self.landmarks), dtype=bool)
            allowed[chosen[i]] = False
            margins[i] = evidence - self.best(gate, allowed, most)[1]
        return margins


@cache
def _gates(probability: float, dimension: int, items: int) -> Array:
    return np.array([2 * gammaincinv(dimension * n / 2, probability) if n else 0.0 for n in range(items + 1)])


def gates(probability: float, dimension: int, items: int) -> Array:
    """The quantile (I+1,) of chi-square for 0 to I residuals of a dimension."""
    return _gates(probability, dimension, items)


def log_density(residuals: Array, covariances: Array) -> tuple[Array, Array]:
    """log N(nu; 0, S) (...) and nu' S^-1 nu (...), for residuals (..., d) and covariances (..., d, d)."""
    squares = np.einsum("...i,...i->...", residuals, np.linalg.solve(covariances, residuals[..., None])[..., 0])
    return -0.5 * (squares + log_volume(covariances)), squares


def log_volume(covariances: Array) -> Array:
    """log det(2 pi S) (...)."""
    d = covariances.shape[-1]
    return np.linalg.slogdet(covariances)[1] + d * np.log(2 * np.pi)
