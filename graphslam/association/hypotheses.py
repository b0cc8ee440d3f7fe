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
from numba import njit
from scipy.special import gammaincinv

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
        return _search(
            self.starts, self.landmarks, self.residuals, self.covariance, self.weights, self.bounds, allowed,
            gates(gate, d, items), int(self.landmarks.max()) + 1, most,
        )  # fmt: skip

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


@njit(cache=True, error_model="numpy")
def _search(starts, landmarks, residuals, covariance, weights, bounds, allowed, gate, count, most):  # type: ignore[no-untyped-def]
    items, d = len(starts) - 1, residuals.shape[1]
    # the most that the items from i on can add
    rest = np.zeros(items + 1)
    for i in range(items - 1, -1, -1):
        top = 0.0
        for c in range(starts[i], starts[i + 1]):
            if allowed[c]:
                top = max(top, bounds[c])
        rest[i] = rest[i + 1] + top
    used = np.zeros(count, np.bool_)
    # per depth: which branch was tried last (candidates in their order, then none), evidence, square, pairings
    branch = starts[:-1].copy() - 1
    evidence, square = np.zeros(items + 1), np.zeros(items + 1)
    pairs = np.zeros(items + 1, np.int64)
    taken = np.full(items, -1)
    L, white, members = np.zeros((items * d, items * d)), np.zeros(items * d), np.zeros(items, np.int64)
    best, best_evidence, depth, tried = np.full(items, -1), 0.0, 0, 0
    half = 0.5 * d * np.log(2 * np.pi)
    while depth >= 0:
        if depth == items:
            if evidence[items] > best_evidence:
                best_evidence = evidence[items]
                best[:] = taken
            depth -= 1
            continue
        if taken[depth] >= 0:
            used[landmarks[taken[depth]]] = False
            taken[depth] = -1
        branch[depth] += 1
        c = branch[depth]
        if c > starts[depth + 1] or evidence[depth] + rest[depth] <= best_evidence or tried > most:
            branch[depth] = starts[depth] - 1
            depth -= 1
            continue
        if c == starts[depth + 1]:
            evidence[depth + 1], square[depth + 1], pairs[depth + 1] = evidence[depth], square[depth], pairs[depth]
            depth += 1
            continue
        if not allowed[c] or used[landmarks[c]]:
            continue
        tried += 1
        n = pairs[depth]
        at, total, volume, good = n * d, 0.0, 0.0, True
        for r in range(d):
            row = at + r
            for m in range(n + 1):
                other = c if m == n else members[m]
                for q in range(d if m < n else r + 1):
                    column = m * d + q
                    value = covariance[c * d + r, other * d + q]
                    for k in range(column):
                        value -= L[row, k] * L[column, k]
                    if column == row:
                        good &= value > 0
                        L[row, row] = np.sqrt(value) if value > 0 else 1.0
                    else:
                        L[row, column] = value / L[column, column]
            value = residuals[c, r]
            for k in range(row):
                value -= L[row, k] * white[k]
            white[row] = value / L[row, row]
            total += white[row] ** 2
            volume += np.log(L[row, row])
        if not good or square[depth] + total > gate[n + 1]:
            continue
        members[n], taken[depth] = c, c
        used[landmarks[c]] = True
        evidence[depth + 1] = evidence[depth] + weights[c] - 0.5 * total - volume - half
        square[depth + 1], pairs[depth + 1] = square[depth] + total, n + 1
        depth += 1
    return best, best_evidence
