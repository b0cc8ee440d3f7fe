"""Checks of a log before it is solved: units, signs, clocks and ids that cannot be right, each with its likely cause.

`check_log` runs them all; no graph is solved. The checks:

readings     sizes; whether the odometry predicts the next sighting of a landmark, and better if numbers are read another way
ids          single ids that are misread, and landmarks that are seen once, or twice at one time
orientations whether the heading of a landmark stays, or another meaning of psi fits better
changed_ids  landmarks that have other ids from some time on
truth        the odometry against true poses
map          the sightings against a true map
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

import numpy as np

from ..log import Log
from ..log.cells import DOUBTFUL_NOISE
from .given import against_map, against_truth
from .ids import Finding, changed_ids, distances_of, ids_of, misread, misread_ids
from .readings import orientations_of, readings_of, single_pose, sizes

__all__ = ["Finding", "check_log", "mistakes_of", "single_pose"]


def check_log(log: Log) -> tuple[Finding, ...]:
    """Probable mistakes in a log; empty where there are none.

    Args:
        log: with or without controls and truth.
    """
    doubts = [Finding(check, message) for check, message in log.doubts if message]
    readings, truth = tuple(readings_of(log)), tuple(against_truth(log))
    checks: list[Iterable[Finding]] = [sizes(log), readings, truth]
    if not readings:
        checks.append(orientations_of(log))
    # where another reading fits better, ids and map may be right, and the sightings wrong
    wrong = np.zeros(len(log.steps), dtype=bool) if readings else misread(log)
    # single misread ids are reported once
    right = log.with_sightings(~wrong)
    checks += [misread_ids(log, wrong), ids_of(right)]
    if not readings:
        # a landmark that is seen only once after the change looks misread, so all are used
        checks += [changed_ids(log), against_map(right, distances_of(right), trusted=not truth)]
    found: dict[str, Finding] = {}
    for finding in chain.from_iterable(checks):
        found.setdefault(finding.check, finding)
    said = {each.check for each in doubts}
    # those about the noise last: numbers that are read in the wrong way make it wrong
    of_noise = [each for each in doubts if each.check == DOUBTFUL_NOISE]
    others = (each for each in found.values() if each.check not in said)
    return (*(each for each in doubts if each not in of_noise), *others, *of_noise)


def mistakes_of(log: Log) -> tuple[Finding, ...]:
    """Probable mistakes in the numbers of a log, whatever its ids: sizes, readings and orientations."""
    return (*sizes(log), *readings_of(log)) or tuple(orientations_of(log))
