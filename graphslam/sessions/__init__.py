"""Several logs as one: drives of one place, robots that see each other, and the offsets between the clocks of these."""

from ..graph import Graph
from .clocks import ClockOffsets, clock_offsets
from .drives import Sessions, from_logs, join_logs, join_robots, relations_of, with_common_noise

__all__ = [
    "ClockOffsets",
    "Graph",
    "Sessions",
    "clock_offsets",
    "from_logs",
    "join_logs",
    "join_robots",
    "relations_of",
    "with_common_noise",
]
