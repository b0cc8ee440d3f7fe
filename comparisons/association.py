"""Ids for logs whose sightings have none, found once for all estimators that solve graphs."""

from __future__ import annotations

import time
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

import fastslam
from graphslam import Association, Log, associate
from graphslam.log import UNIDENTIFIED

from .options import RunOptions

#: what was found for a log, by what it was found with
_FOUND: WeakKeyDictionary[Log, dict[tuple[object, ...], Association]] = WeakKeyDictionary()


def identified(log: Log, options: RunOptions) -> tuple[Log, Association | None]:
    """The log with ids for its sightings, and how they were found; None where it has them and the options use them.

    Raises:
        SlamError: no ids can be found.
    """
    if log.identified and options.filter.uses_ids:
        return log, None
    key = (options.motion, options.sensor, options.front_end, str(options.filter.seed), options.estimate)
    found = _FOUND.setdefault(log, {})
    if key not in found:
        found[key] = _associated(log, options)
    return found[key].log, found[key]


def _associated(log: Log, options: RunOptions) -> Association:
    models = {"motion": options.motion, "sensor": options.sensor}
    # an epsilon that the options name stays
    ways = {"slip": "epsilon" not in options.numbers, "estimate": options.estimate}
    if options.front_end == "batch" or log.controls is None or len(log.steps) == 0:
        # without controls or sightings this refuses the log
        return associate(log, **models, **ways)  # type: ignore[arg-type]
    begin = time.perf_counter()
    front = replace(options.filter, particles=options.front_particles, association="maximum-likelihood")
    result = fastslam.FastSLAM2(log, options=front, **models).run()  # type: ignore[arg-type]
    assert result.association is not None and result.unconfirmed is not None
    lost = (result.association == UNIDENTIFIED) | result.unconfirmed
    found = associate(log, start=(np.where(lost, -1, result.association), result.poses), **models, **ways)  # type: ignore[arg-type]
    note = (
        f"the ids began with those of FastSLAM 2.0 with {front.particles} particles, and were found anew in the graph"
    )
    return replace(found, seconds=time.perf_counter() - begin, notes=(*found.notes, note))
