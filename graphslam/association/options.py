"""The options of the association of sightings without ids."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from numbers import Real

from ..checks import check_choice, check_count, option
from ..errors import OptionError, quoted

#: how the sightings of one scan are assigned to landmarks
METHODS = ("joint", "nearest")


@dataclass(frozen=True, kw_only=True)
class AssociationOptions:
    """How `associate` decides which sightings are of the same landmark.

    Raises:
        OptionError: an option has an impossible value.
    """

    method: str = option(
        "joint", "Assign the sightings of a scan jointly (joint compatibility), or each to its nearest landmark."
    )
    gate: float = option(0.999, "Share of correct sightings that lie within the gate of their landmark")
    clutter: float = option(0.05, "Share of sightings that are of no landmark, before the log is known")
    factor: float = option(
        100.0,
        "A decision between two landmarks is called ambiguous where the evidence for the better one is less than this",
    )
    confusion: float = option(0.05, "Probability that the class of a sighting is wrong, where the log has classes")
    keep_ids: bool = option(True, "Keep the ids that some sightings of a log have, where others have none")
    window: int = option(30, "Steps between two solutions of the graph along the drive; more on long logs")
    rounds: int = option(10, "The most rounds of association and solving, in turn, at the end")
    slip: bool = option(True, "Raise the noise sideways of motions where the robot slips over long ways")
    tries: int = option(40, "The most alternatives that are tried in full where some are not much less likely")

    agreeing: int = option(2, "Of several starts, the others are left out once this many of them end alike; 0: none is")

    def __post_init__(self) -> None:
        check_choice("method", self.method, METHODS)
        for name in ("gate", "clutter", "confusion"):
            value: float = getattr(self, name)
            if not isinstance(value, Real) or not 0 < value < 1:
                raise OptionError(f"{name} must lie between 0 and 1, not {quoted(value)}")
        if not isinstance(self.factor, Real) or not 1 <= self.factor <= sys.float_info.max:
            raise OptionError(f"factor must be at least 1, not {quoted(self.factor)}")
        for name in ("slip", "keep_ids"):
            if not isinstance(value := getattr(self, name), bool):
                raise OptionError(f"{name} must be True or False, not {quoted(value)}")
        check_count(window=self.window, rounds=self.rounds, tries=self.tries, agreeing=self.agreeing)
        if not 1 <= self.window < 2**31:
            raise OptionError(f"window must lie between 1 and 2^31, not {quoted(self.window)}")
