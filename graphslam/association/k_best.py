"""The k best joint hypotheses where the prior covariance is so large that no single pair is significant.

After a long drive without sightings no pair of a new and an old landmark is likely by itself, but the second pair
is, given the first, because both move together. So a hypothesis begins with a seed: a first pair, whatever its own
evidence, then one of the pairs with the most evidence given the first, and so on while the evidence rises. Given the pairs
so far, residuals and covariance of all others are conditioned on them (Schur complements), so that the sum of the steps is
the joint evidence E of `hypotheses`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine import engine
from ..se2 import Array

#: the second pairs that are tried after each seed
SECOND = 3


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The pairs (n,) that belong together, as places in the lists of pairs, and the evidence E for them over none."""

    pairs: np.ndarray
    evidence: float


@dataclass(frozen=True, eq=False)
class CandidatePairs:
    """CandidatePairs (C,) of an item and an older landmark, with what is needed to weigh them jointly.

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
        """The best hypotheses, at most ``most``, begun from the pairs (n,), the best first; each has another set of pairs.

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
        """The hypothesis that begins with the pairs (n,), to which pairs are added while the evidence rises."""
        members, evidence, _ = self._grown(np.atleast_2d(chosen), 1e300, allowed=allowed)
        return Hypothesis(np.flatnonzero(members[0]), float(evidence[0]))

    def _grown(
        self, begin: np.ndarray, gate: float, *, grow: bool = True, allowed: np.ndarray | None = None
    ) -> tuple[np.ndarray, Array, np.ndarray]:
        allowed = np.ones(len(self.residuals), dtype=bool) if allowed is None else allowed
        return engine.grow_hypotheses(
            np.ascontiguousarray(begin, dtype=np.int64),
            *(np.ascontiguousarray(numbers, dtype=np.int64) for numbers in (self.item, self.landmark)),
            *(np.ascontiguousarray(part) for part in (self.residuals, self.covariance, self.weights, allowed)),
            gate,
            self.gate,
            grow,
        )


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
