"""Hill climbing: alternatives are tried, refined, and kept where the total evidence is significantly higher."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..log import Log
from ..se2 import Array
from .alternatives import Alternative, all_alternatives
from .classes import Classes
from .densities import Field
from .evidence import evidence
from .map_solution import Backbone, MapSolution
from .options import AssociationOptions
from .refining import Refined, refine, unrefined

#: alternatives are tried whose linearised evidence is at most this much lower [nats]
PROMISING = 30.0
#: the rounds of association and solving of a trial
ROUNDS = 4
#: alternatives of each return that are tried
MOST = 3
#: so many poses are solved in all to examine the returns of a drive, and so many returns at least
WORK, LEAST_EVENTS = 75_000, 10


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best association that trials of alternatives lead to, and how the search went.

    Attributes:
        refined: the association.
        alternatives: the alternatives of the result.
        tried, unsettled: how many alternatives were tried, and how many of them had not settled after `ROUNDS` rounds.
        left: how many alternatives of the result are promising and were not tried, because no tries were left.
        rivals: what else was solved on the way, the promising alternatives of the result as they are among it: the evidence
            for the association over that for the rival [nats], and its poses (T+1, 3).
    """

    refined: Refined
    alternatives: list[Alternative]
    tried: int
    unsettled: int
    left: int
    rivals: list[tuple[float, Array]]


def search(
    log: Log, backbone: Backbone, refined: Refined, field: Field, classes: Classes, options: AssociationOptions
) -> SearchResult:
    """Try alternatives while the evidence rises."""
    events, unsettled = max(LEAST_EVENTS, WORK // log.num_poses), 0
    densities, brief = refined.densities, replace(options, rounds=min(options.rounds, ROUNDS))
    best = evidence(log, backbone, refined.solved, field, densities)
    tried: set[bytes] = set()
    solved: list[tuple[float, Array]] = []
    while True:
        found = all_alternatives(
            log, backbone, refined.solved, field, densities, classes, options, most=MOST, events=events
        )
        promising = sorted((a for a in found if a.log_factor < PROMISING), key=lambda a: a.log_factor)
        for alternative in promising:
            if len(tried) == options.tries or (key := alternative.labels.tobytes()) in tried:
                continue
            tried.add(key)
            trials = [refine(log, backbone, alternative.labels, alternative.poses, field, densities, classes, brief)]
            if alternative.log_factor < 0:
                # refining merges pairs, which may undo what all landmarks of a place together say
                trials.append(
                    unrefined(log, backbone, alternative.labels, alternative.poses, densities, classes, brief)
                )
            unsettled += any(not trial.settled for trial in trials if trial is not None)
            ends = [(evidence(log, backbone, t.solved, field, densities), t) for t in trials if t is not None]
            solved += [(value, end.solved.poses) for value, end in ends]
            value, end = max(ends, key=lambda each: each[0], default=(-np.inf, refined))
            if value > best + np.log(options.factor):
                solved.append((best, refined.solved.poses))
                refined, best = end, value
                break
        else:
            left = len({alternative.labels.tobytes() for alternative in promising} - tried)
            for alternative in promising[: options.tries]:
                # refining may end at the association itself, though the alternative is nearly as likely
                other = MapSolution.of(backbone, alternative.labels, alternative.poses)
                solved.append((evidence(log, backbone, other, field, densities), other.poses))
            rivals = [(best - value, poses) for value, poses in solved if np.isfinite(value)]
            return SearchResult(refined, found, len(tried), unsettled, left, rivals)
