"""Checks of a log before it is solved: units, signs, clocks and ids that cannot be right, each with its likely cause.

`plausibility` runs them all; no graph is solved. Beside it:

sizes     numbers that are too large or zero
ids       landmarks that are seen once, or twice at one time
renamed   landmarks that have other ids from some time on
readings  whether the odometry predicts the next sighting of a landmark, and better if the numbers are read another way
truth     the odometry against true poses
map       the sightings against a true map
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

from ..log import Log
from .distances import distances_of
from .finding import Finding
from .ids import ids_of
from .map import against_map
from .readings import readings_of
from .renamed import renamed
from .sizes import sizes
from .truth import against_truth

__all__ = ["Finding", "plausibility"]


def plausibility(log: Log) -> tuple[Finding, ...]:
    """What is probably wrong with a log; empty where nothing is.

    Args:
        log: with or without controls and truth.
    """
    found: dict[str, Finding] = {}
    doubts: Iterable[Finding] = (Finding(check, message) for check, message in log.doubts)
    readings, truth = tuple(readings_of(log)), tuple(against_truth(log))
    checks: list[Iterable[Finding]] = [doubts, sizes(log), ids_of(log), readings, truth]
    if not readings:
        # else ids and map may be right, and the sightings wrong
        distances = distances_of(log)
        checks += [renamed(log, distances, trusted=not truth), against_map(log, distances, trusted=not truth)]
    for finding in chain.from_iterable(checks):
        found.setdefault(finding.check, finding)
    return tuple(found.values())
