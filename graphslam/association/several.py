"""The best few joint hypotheses where the prior covariance is so large that single pairs tell nothing.

After a long drive without sightings no pair of a new and an old landmark is likely by itself, but the second pair
is, given the first, because both move together. So hypotheses are grown from seeds: a first pair, whatever its own
evidence, then one of the pairs with the most evidence given the first, and so on while the evidence rises. Given the pairs
so far, residuals and covariance of all others are conditioned on them (Schur complements), so that the sum of the steps is
the joint evidence E of `hypotheses`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..se2 import Array

#: the second pairs that are tried after each seed
SECOND = 3


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The pairs (n,) that belong together, as places in the lists of pairs, and the evidence E for them over none."""

    pairs: np.ndarray
    evidence: float


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs (C,) of an item and an older landmark, with what is needed to weigh them jointly.

    Attributes:
        item, landmark: (C,) numbers from 0.
        residuals: (C, d), with ``covariance`` (C, d, C, d) if all of them are right.
        weights: (C,) what the evidence for each has beside log N.
        gate: the most that nu' S^-1 nu of a pair, given the others, may be.
    """

    item: np.ndarray
    landmark: np.ndarray
    residuals: Array
    covariance: Array
    weights: Array
    gate: float

    def evidence(self, chosen: np.ndarray) -> float:
        """E of the pairs (n,), wherever they lie."""
        return float(self._grown(np.atleast_2d(chosen), 1e300, grow=False)[1][0]) if len(chosen) else 0.0

    def several(self, seeds: np.ndarray, most: int, allowed: np.ndarray | None = None) -> list[Hypothesis]:
        """At most so many of the best hypotheses, grown from the pairs (n,), the best first; each has another set of pairs.

        Args:
            allowed: (C,) which pairs may be used; default: all.
        """
        seeds = seeds if allowed is None else seeds[allowed[seeds]]
        if len(seeds) == 0:
            return []
        _, _, second = self._grown(seeds[:, None], self.gate, allowed=allowed)
        begin = np.column_stack(
            [np.repeat(seeds, SECOND + 1), np.column_stack([second, np.full(len(seeds), -1)]).ravel()]
        )
        begin = np.unique(begin, axis=0)
        return _best(*self._grown(begin, self.gate, allowed=allowed)[:2], most)

    def completed(self, chosen: np.ndarray, allowed: np.ndarray | None = None) -> Hypothesis:
        """The hypothesis that begins with the pairs (n,) and grows while the evidence rises."""
        members, evidence, _ = self._grown(np.atleast_2d(chosen), 1e300, allowed=allowed)
        return Hypothesis(np.flatnonzero(members[0]), float(evidence[0]))

    def _grown(
        self, begin: np.ndarray, gate: float, *, grow: bool = True, allowed: np.ndarray | None = None
    ) -> tuple[np.ndarray, Array, np.ndarray]:
        count, d = self.residuals.shape
        allowed = np.ones(count, dtype=bool) if allowed is None else allowed
        return _grown(
            np.ascontiguousarray(begin, dtype=np.int64), self.item, self.landmark, self.residuals,
            np.ascontiguousarray(self.covariance.reshape(count * d, count * d)), self.weights, allowed, gate, self.gate, grow,
        )  # fmt: skip


def _best(members: np.ndarray, evidence: Array, most: int) -> list[Hypothesis]:
    found: list[Hypothesis] = []
    known: set[bytes] = set()
    for k in np.argsort(-evidence, kind="stable"):
        key = members[k].tobytes()
        if np.isfinite(evidence[k]) and key not in known:
            known.add(key)
            found.append(Hypothesis(np.flatnonzero(members[k]), float(evidence[k])))
        if len(found) == most:
            break
    return found


@njit(cache=True, error_model="numpy")
def _grown(begin, item, landmark, residuals, covariance, weights, allowed, first_gate, gate, grow):  # type: ignore[no-untyped-def]
    """Hypotheses (S, C) grown from pairs (S, n), -1 for none, their evidence (S,), and the best second pairs (S, SECOND)."""
    count, d = residuals.shape
    members, total = np.zeros((len(begin), count), np.bool_), np.zeros(len(begin))
    second = np.full((len(begin), SECOND), -1)
    half = 0.5 * d * np.log(2 * np.pi)
    own, gain = np.zeros((d, d)), np.zeros((d, d))
    for k in range(len(begin)):
        nu, S = residuals.copy(), covariance.copy()
        left, forced, steps = allowed.copy(), 0, 0
        while True:
            best, best_evidence = -1, 0.0
            while forced < begin.shape[1] and begin[k, forced] < 0:
                forced += 1
            given = forced < begin.shape[1]
            for c in range(count):
                if (given and c != begin[k, forced]) or not (given or left[c]):
                    continue
                own[:] = S[c * d : (c + 1) * d, c * d : (c + 1) * d]
                square, volume = _solved(own, nu[c])
                value = weights[c] - 0.5 * (square + volume) - half
                if given:
                    best, best_evidence = c, value if square <= first_gate else -np.inf
                    continue
                if square > gate:
                    continue
                if steps == 1:
                    _insert(second[k], c, value, weights, nu, S, d, half)
                if value > best_evidence:
                    best, best_evidence = c, value
            forced += given
            if best < 0 or (not given and not grow):
                break
            total[k] += best_evidence
            if not np.isfinite(total[k]):
                break
            members[k, best] = True
            steps += 1
            b = best * d
            own[:] = np.linalg.inv(S[b : b + d, b : b + d])
            for c in range(count):
                if item[c] == item[best] or landmark[c] == landmark[best]:
                    left[c] = False
            # those that are still to come, the forced ones among them
            for c in range(count):
                needed = left[c]
                for f in range(forced, begin.shape[1]):
                    needed |= begin[k, f] == c
                if not needed:
                    continue
                for r in range(d):
                    for q in range(d):
                        value = 0.0
                        for s in range(d):
                            value += S[c * d + r, b + s] * own[s, q]
                        gain[r, q] = value
                for r in range(d):
                    for q in range(d):
                        nu[c, r] -= gain[r, q] * nu[best, q]
                        for column in range(count * d):
                            S[c * d + r, column] -= gain[r, q] * S[b + q, column]
    return members, total, second


@njit(cache=True, error_model="numpy")
def _solved(S, nu):  # type: ignore[no-untyped-def]
    """nu' S^-1 nu and log det S of a small matrix, which becomes its Cholesky factor; infinite where it is not positive."""
    d, square, volume = len(nu), 0.0, 0.0
    white = nu.copy()
    for j in range(d):
        for k in range(j):
            S[j, j] -= S[j, k] ** 2
            white[j] -= S[j, k] * white[k]
        if not S[j, j] > 0:
            return np.inf, np.inf
        S[j, j] = np.sqrt(S[j, j])
        white[j] /= S[j, j]
        square += white[j] ** 2
        volume += 2 * np.log(S[j, j])
        for i in range(j + 1, d):
            for k in range(j):
                S[i, j] -= S[i, k] * S[j, k]
            S[i, j] /= S[j, j]
    return square, volume


@njit(cache=True, error_model="numpy")
def _insert(second, c, value, weights, nu, S, d, half):  # type: ignore[no-untyped-def]
    """Keep the pairs with the most evidence, in no order."""
    worst, least = -1, value
    for n in range(len(second)):
        o = second[n]
        if o < 0:
            second[n] = c
            return
        square, volume = _solved(S[o * d : (o + 1) * d, o * d : (o + 1) * d].copy(), nu[o])
        other = weights[o] - 0.5 * (square + volume) - half
        if other < least:
            worst, least = n, other
    if worst >= 0:
        second[worst] = c
