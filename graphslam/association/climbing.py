"""Hill climbing: other accounts of the drive are tried, refined, and kept where the evidence as a whole is surely higher."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..log import Log
from .accounts import Account, all_accounts
from .classes import Classes
from .densities import Field
from .evidence import evidence
from .options import AssociationOptions
from .refining import Refined, refine, unrefined
from .solved import Backbone

#: accounts are tried whose linearised evidence is at most this much lower [nats]
PROMISING = 30.0
#: the rounds of association and solving of a trial
ROUNDS = 4
#: accounts of each return that are tried
MOST = 3
#: so many poses are solved in all to examine the returns of a drive, and so many returns at least
WORK, LEAST_EVENTS = 75_000, 10


def climb(
    log: Log, backbone: Backbone, refined: Refined, field: Field, classes: Classes, options: AssociationOptions
) -> tuple[Refined, list[Account]]:
    """The best association that the trials lead to, and the other accounts of it."""
    tries, events = options.tries, max(LEAST_EVENTS, WORK // log.num_poses)
    densities, brief = refined.densities, replace(options, rounds=min(options.rounds, ROUNDS))
    best = evidence(log, backbone, refined.solved, field, densities)
    tried: set[bytes] = set()
    while True:
        found = all_accounts(
            log, backbone, refined.solved, field, densities, classes, options, most=MOST, events=events
        )
        promising = sorted((a for a in found if a.log_factor < PROMISING), key=lambda a: a.log_factor)
        for account in promising:
            if tries == 0 or (key := account.labels.tobytes()) in tried:
                continue
            tried.add(key)
            tries -= 1
            trials = [refine(log, backbone, account.labels, account.poses, field, densities, classes, brief)]
            if account.log_factor < 0:
                # refining merges pairs, which may undo what all landmarks of a place together say
                trials.append(unrefined(log, backbone, account.labels, account.poses, densities, classes, brief))
            ends = [(evidence(log, backbone, t.solved, field, densities), t) for t in trials if t is not None]
            value, end = max(ends, key=lambda each: each[0], default=(-np.inf, refined))
            if value > best + np.log(options.factor):
                refined, best = end, value
                break
        else:
            return refined, found
