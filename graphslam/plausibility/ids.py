"""Ids: landmarks that are seen once, or twice at one time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Log
from ..reading import UNIDENTIFIED
from .finding import Finding

#: fewer sightings tell nothing about their ids
_FEWEST = 20


def ids_of(log: Log) -> Iterator[Finding]:
    """Landmarks of which too few are seen again, and sightings of one landmark at one time."""
    known = log.landmarks[log.landmarks != UNIDENTIFIED]
    if len(known) == 0 or log.num_poses == 1 < len(known):
        return
    names, counts = np.unique(known, return_counts=True)
    if len(known) == len(names) <= _FEWEST:
        which = f"the only sighting is of landmark {names[0]}"
        if len(known) > 1:
            which = f"the {len(known)} sightings are of {len(known)} landmarks"
        yield Finding(
            "seen once", f"{which}, so that nothing corrects the odometry; rows may be missing, or clocks differ"
        )
    elif len(names) == 1:
        yield Finding(
            "one landmark", f"all {len(known)} sightings are of one landmark, {names[0]}; ids may be in another column"
        )
    elif len(known) > _FEWEST and np.mean(counts) < 1.5:
        yield Finding(
            "ids jump",
            f"{len(known)} sightings are of {len(names)} landmarks, so that nearly each is seen once; the ids may be a "
            "running number",
        )
    order = np.lexsort((*log.sightings.T[::-1], log.landmarks, log.steps))
    steps, ids, ranges = log.steps[order], log.landmarks[order], log.sightings[order, 0]
    twice = (np.diff(steps) == 0) & (np.diff(ids) == 0)
    if (same := twice & np.all(np.diff(log.sightings[order], axis=0) == 0, axis=1)).any():
        k = int(np.argmax(same))
        yield Finding(
            "doubled sightings",
            f"{np.sum(same)} of {len(same) + 1} sightings repeat another one of the same step, landmark and numbers, the "
            f"first of landmark {ids[k]} at step {steps[k]}: rows were probably written twice, and these sightings count "
            "twice",
        )
    apart = twice & (ids[1:] != UNIDENTIFIED) & (np.abs(np.diff(ranges)) > 0.2 * ranges[1:])
    if np.sum(apart) > 0.02 * len(known):
        k = int(np.argmax(apart))
        yield Finding(
            "duplicate ids",
            f"landmark {ids[k]} is seen twice at step {steps[k]}, {ranges[k]:.2f} and {ranges[k + 1]:.2f} m away "
            f"({np.sum(apart)} such pairs); several objects may have one id, or different stamps became one",
        )
