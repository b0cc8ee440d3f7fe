"""Places that may have been taken for others: for every return to a place, how much more likely it is than any alternative.

What the criterion takes for chance it cannot doubt: in it landmarks are distributed at random, so two places that look
alike are taken for one wherever odometry allows it, unless the drive itself has shown that there are two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .alternatives import Alternative


@dataclass(frozen=True)
class Ambiguity:
    """A place that may be another one.

    Attributes:
        step: where the landmarks come into sight again, or first.
        last: the last step before in which one of them, or else any landmark, was seen.
        landmarks: their ids.
        others: ids of the landmarks that they may be instead; empty where they may never have been seen before.
        new: whether they were taken for landmarks that had never been seen before.
        log_factor: the logarithm of the evidence for ``landmarks`` over that for the alternative.
    """

    step: int
    last: int
    landmarks: tuple[int, ...]
    others: tuple[int, ...]
    new: bool
    log_factor: float

    @property
    def factor(self) -> float:
        """The evidence for ``landmarks`` over that for the alternative."""
        return float(np.exp(np.clip(self.log_factor, -700, 700)))

    def __str__(self) -> str:
        which = _listed(self.landmarks)
        if self.new:
            begin = (
                f"the arrival at {which} at step {self.step}, after a blind drive from step {self.last}, is ambiguous"
            )
            mine = "that nothing there had been seen before"
        else:
            begin = f"the return to {which} at step {self.step}, last seen at step {self.last}, is ambiguous"
            mine = "for it"
        if self.others and set(self.others) <= set(self.landmarks):
            other = f"for {_listed(self.others)}, exchanged"
        else:
            other = f"for {_listed(self.others)} instead" if self.others else "for a place not seen before"
        if self.log_factor >= 0:
            return f"{begin}: the evidence {mine} is only {readable(self.log_factor)} times that {other}"
        more = f"the evidence {other} is {readable(-self.log_factor)} times that {mine}"
        return f"{begin}: taken by itself, {more}; for the drive as a whole no higher evidence was found"


def ambiguities(alternatives: list[Alternative], factor: float) -> tuple[Ambiguity, ...]:
    """The places for which the evidence is less than a factor times that for the best alternative, the worst first."""
    best: dict[int, Alternative] = {}
    for each in alternatives:
        if each.log_factor < np.log(factor) and (
            each.back.step not in best or each.log_factor < best[each.back.step].log_factor
        ):
            best[each.back.step] = each
    found = []
    for step, each in best.items():
        mine, others = tuple(each.back.landmarks.tolist()), tuple(each.others.tolist())
        found.append(Ambiguity(step, each.back.last, mine, others, each.back.new, each.log_factor))
    return tuple(sorted(found, key=lambda doubt: doubt.log_factor))


def readable(log_factor: float) -> str:
    """A factor of evidence in words, from its logarithm: three digits, or the power of ten above a million."""
    if log_factor < np.log(1e6):
        return f"{np.exp(log_factor):,.3g}" if log_factor < np.log(1000) else f"{np.exp(log_factor):,.0f}"
    return f"10^{log_factor / np.log(10):.0f}"


def _listed(landmarks: tuple[int, ...]) -> str:
    names = ", ".join(map(str, landmarks[:6])) + (", ..." if len(landmarks) > 6 else "")
    return f"landmark{'s' if len(landmarks) > 1 else ''} {names}"
