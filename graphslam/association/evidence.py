"""The evidence for an association as a whole: what makes the results of different front ends and hypotheses comparable.

With the graph of labels A solved, Laplace's approximation of log p(Z, A), without what all associations of a log share, is

    E = -J/2 - 1/2 log det(Omega / 2 pi) + sum over sightings with a landmark of [log P_D - log c + 1/2 log det(Q^-1 / 2 pi)]
        + L log rho + (views without a sighting) log(1 - P_D),

where L is the number of landmarks, rho their density and c that of clutter. Sightings that are clutter have the factor 1.

Counts of how often each landmark was in the field of view, and was then seen.

The best joint hypothesis: which item (a sighting, or a track of sightings) is which landmark.

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

from ..engine import engine
from ..se2 import Array
from .map_solution import MapSolution, Problem
from .problem import INSIDE, Densities


@dataclass(frozen=True, eq=False)
class Visibility:
    """Counts (L,) for each landmark: the scans in which it was well within the field of view, and in which it was seen.

    ``whole`` and ``anywhere`` count the same for the whole field, at whose border noise decides whether a landmark is in it.
    """

    views: np.ndarray
    within: np.ndarray
    whole: np.ndarray
    anywhere: np.ndarray

    @classmethod
    def of(cls, problem: Problem, solved: MapSolution) -> Visibility:
        """The counts for the landmarks of a solved graph."""
        log, field = problem.log, problem.field
        scans = np.unique(log.steps)
        limits = np.array(
            [[field.nearest / s, field.farthest * s, np.cos(min(field.bearing * s, np.pi))] for s in (INSIDE, 1.0)]
        )
        origin = np.array(problem.backbone.origin)
        everywhere = engine.count_views(solved.poses[scans], solved.landmarks, origin, limits)
        inside = _inside(solved.poses[log.steps[solved.rows]], solved.landmarks[solved.which], origin, limits)
        seen = [np.bincount(solved.which, each, len(solved.landmarks)).astype(np.int64) for each in inside]
        return cls(everywhere[0], seen[0], everywhere[1], seen[1])

    def misses(self, densities: Densities) -> Array:
        """The logarithm (L,) of the probability of the views without a sighting; half of it at the border of the field."""
        well = self.views - self.within
        border = np.maximum(self.whole - self.anywhere - well, 0)
        return well * densities.missed + border * np.log1p(-np.exp(densities.seen) / 2)


def _inside(poses: Array, landmarks: Array, origin: Array, limits: Array) -> np.ndarray:
    """For each of the limits (S, 3) whether a landmark (n, d) is inside seen from a pose (n, 3), (S, n)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = (landmarks[:, :2] - poses[:, :2]).T
    x, y = c * dx + s * dy - origin[0], c * dy - s * dx - origin[1]
    square, ahead = x * x + y * y, x * np.abs(x)
    low, high, cosine = limits.T[:, :, None]
    return np.asarray((square >= low**2) & (square <= high**2) & (ahead >= cosine * np.abs(cosine) * square))


#: the most hypotheses that one search compares; the best so far is then the result
MAX_HYPOTHESES = 20_000


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

    def best(
        self, gate: float, allowed: np.ndarray | None = None, most: int = MAX_HYPOTHESES
    ) -> tuple[np.ndarray, float]:
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
            self.starts, self.landmarks, self.residuals, self.covariance, self.weights, self.bounds, allowed,
            gates(gate, d, items), most,
        )  # fmt: skip

    def margins(self, chosen: np.ndarray, evidence: float, gate: float, most: int = MAX_HYPOTHESES) -> Array:
        """For each item (I,) how much worse the best hypothesis without its chosen candidate is; infinite for none."""
        margins = np.full(len(chosen), np.inf)
        for i in np.flatnonzero(chosen >= 0):
            allowed = np.ones(len(self.landmarks), dtype=bool)
            allowed[chosen[i]] = False
            margins[i] = evidence - self.best(gate, allowed, most)[1]
        return margins


@cache
def gates(probability: float, dimension: int, items: int) -> Array:
    """The quantile (I+1,) of chi-square for 0 to I residuals of a dimension."""
    from scipy.special import gammaincinv

    return np.array([2 * gammaincinv(dimension * n / 2, probability) if n else 0.0 for n in range(items + 1)])


def log_density(residuals: Array, covariances: Array) -> tuple[Array, Array]:
    """log N(nu; 0, S) (...) and nu' S^-1 nu (...), for residuals (..., d) and covariances (..., d, d)."""
    squares = np.einsum("...i,...i->...", residuals, np.linalg.solve(covariances, residuals[..., None])[..., 0])
    return -0.5 * (squares + log_volume(covariances)), squares


def log_volume(covariances: Array) -> Array:
    """log det(2 pi S) (...)."""
    d = covariances.shape[-1]
    return np.linalg.slogdet(covariances)[1] + d * np.log(2 * np.pi)


def evidence(problem: Problem, solved: MapSolution) -> float:
    """E of a solved graph; only differences between associations of one log, with the same densities, mean anything."""
    d, count, densities = solved.landmarks.shape[1], len(solved.landmarks), problem.densities
    Q = np.asarray(problem.backbone.places.covariances)[solved.rows]
    sightings = len(solved.rows) * (densities.seen - densities.clutter) - 0.5 * float(np.sum(log_volume(Q)))
    # poses are the same in number for all associations, so their powers of 2 pi are left out
    volume = 0.5 * d * count * np.log(2 * np.pi) - 0.5 * solved.log_determinant
    misses = float(Visibility.of(problem, solved).misses(densities).sum())
    return -0.5 * solved.cost + volume + sightings + count * densities.new + misses
