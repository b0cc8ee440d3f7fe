"""Whether an association can be relied on: a statement that separates good maps from bad ones, calibrated on simulated logs.

A map is good where the ATE is at most 1.5 times that of the same graph with the true ids. The criterion is how much more
likely the map is than any other one with another trajectory that the search has met, and whether several starts found it.
`docs/association.md` has the shares of errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..metrics import ate
from ..se2 import Array
from .ambiguity import readable
from .competing import Competition, spread, tolerance
from .densities import Field

#: the evidence for a reliable map over that for any other one [nats]; with 30, one of 42 maps called good was bad
CLEAR = 40.0
#: so many starts have to end alike
ALIKE = 2


@dataclass(frozen=True)
class Verdict:
    """Whether the map of an association can be relied on, and why not.

    Attributes:
        reliable: whether the ids are unlikely to have led to a wrong trajectory.
        reasons: why not, one sentence each; empty where it is reliable.
        lead: the logarithm of the evidence over that for the best rival with another trajectory; infinite for none.
        starts, agreeing: how many starts of the search were used, and how many ended with this trajectory.
        deviation: the standard deviation of the positions of the aligned trajectory, root mean square [m].
    """

    reliable: bool
    reasons: tuple[str, ...]
    lead: float
    starts: int
    agreeing: int
    deviation: float

    def __str__(self) -> str:
        if self.reliable:
            return (
                f"the map can be relied on: {self.agreeing} starts of the search ended in its trajectory, and no other that "
                "was found is nearly as likely"
            )
        return f"do not rely on the map without a check: {'; '.join(self.reasons)}"


def verdict(competition: Competition, field: Field) -> Verdict:
    """The verdict on the best end of a competition."""
    k = competition.best
    best = competition.ends[k].refined.solved
    near = tolerance(best, field)
    gaps, agreeing = [np.inf], 0
    for value, end in zip(competition.values, competition.ends, strict=True):
        behind = competition.values[k] - value
        found: list[tuple[float, Array]] = [(0.0, end.refined.solved.poses), *end.rivals]
        agreeing += ate(best.poses, end.refined.solved.poses) <= near
        gaps += [behind + gap for gap, poses in found if ate(best.poses, poses) > near]
    lead = float(min(gaps))
    reasons: list[str] = []
    if len(competition.ends) < ALIKE:
        reasons.append("only one start of the search was tried, so that nothing tells whether it ended in the best map")
    elif agreeing < ALIKE:
        reasons.append(f"only one of {len(competition.ends)} starts of the search ended in its trajectory")
    if lead <= 0:
        reasons.append("another map that was tried is as likely")
    elif lead < CLEAR:
        reasons.append(
            f"another map that was tried is less likely by a factor of {readable(lead)}, and {readable(CLEAR)} is needed"
        )
    return Verdict(not reasons, tuple(reasons), lead, len(competition.ends), agreeing, spread(best))
