"""Ids: single ones that are misread, and landmarks that are seen once, or twice at one time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Log
from ..models import SensorModel
from ..reading import UNIDENTIFIED
from .distances import ways
from .finding import Finding

#: fewer sightings are not checked
_FEWEST = 20
#: a sighting is compared with those within this way before and after it, [rad] turned plus [ranges] driven, so many each
_WAY, _AROUND = 2.0, 40
#: two sightings of one id show one place up to the first number [ranges], those of two ids up to the second, because
#: landmarks may be close to each other, or up to the third times the median error
_NEAR, _CLOSE, _TIMES = 0.1, 0.03, 3.0
#: so many sightings of the place have to show other ids, which are seen again there
_OTHERS = 2
#: misread ids are reported from so many on, and from this share of the sightings; above the second share the cause is another
_LEAST, _FEW, _MOST = 3, 0.004, 1 / 3


def misread(log: Log) -> np.ndarray:
    """Which sightings (M,) have an id that the sightings of the same place contradict, shortly before and after them.

    The odometry carries every sighting to its place over the short way. An id is misread where no other sighting shows it at
    its place, and some show other ids there that are seen again. Where a detector starts to count again, the new id is seen
    again at the place, and so it is not misread.
    """
    found = np.zeros(len(log.steps), dtype=bool)
    known = np.flatnonzero(log.landmarks != UNIDENTIFIED)
    if log.controls is None or len(known) <= _FEWEST:
        return found
    steps, ids, ranges = log.steps[known], log.landmarks[known], log.sightings[known, 0]
    way = ways(log, known)[steps]
    places = (log.sensor or SensorModel()).h_inverse(log.dead_reckoning()[steps], log.sightings[known, :2])[:, :2]
    pairs = []
    for back in range(1, min(_AROUND, len(ids) - 1) + 1):
        a = np.flatnonzero((way[back:] - way[:-back] <= _WAY) & (steps[back:] != steps[:-back]))
        b = a + back
        distance = np.linalg.norm(places[a] - places[b], axis=1) / np.maximum(ranges[a], ranges[b])
        pairs.append(np.stack([a, b, ids[a] == ids[b]]))
        pairs.append(distance)
    a, b, same = np.concatenate(pairs[::2], axis=1)
    distance = np.concatenate(pairs[1::2])
    least = np.full(len(ids), np.inf)
    np.minimum.at(least, b[same == 1], distance[same == 1])
    if not np.isfinite(least).any():
        return found
    error = _TIMES * float(np.median(least[np.isfinite(least)]))
    own, other = ((same == 1) & (distance <= max(_NEAR, error))), ((same == 0) & (distance <= max(_CLOSE, error)))
    again = np.bincount(a[own], minlength=len(ids)) + np.bincount(b[own], minlength=len(ids)) > 0
    others = sum(np.bincount(p[other & again[q]], minlength=len(ids)) for p, q in ((a, b), (b, a)))
    wrong = ~again & (others >= _OTHERS)
    if max(_LEAST, _FEW * len(ids)) <= np.sum(wrong) <= _MOST * len(ids):
        found[known] = wrong
    return found


def misread_ids(log: Log, wrong: np.ndarray) -> Iterator[Finding]:
    """The finding of misread ids; ``wrong`` (M,) is the result of `misread`."""
    if (count := int(np.sum(wrong))) == 0:
        return
    total, k = int(np.sum(log.landmarks != UNIDENTIFIED)), int(np.argmax(wrong))
    yield Finding(
        "misread ids",
        f"at least {count} of {total} sightings have ids that the sightings of the same place just before and after "
        f"contradict, the first one landmark {log.landmarks[k]} at step {log.steps[k]}: single ids are probably misread; a "
        "robust kernel or method gnc limits what they do",
    )


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
