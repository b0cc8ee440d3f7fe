"""Ids: single ones that are misread, and landmarks that are seen once, or twice at one time.

`changed_ids` finds the time from which on landmarks have other ids, as after a restart of a detector that counts them. Checks
of maps compare distances between landmarks that are seen shortly after one another (`Distances`). Over a short way
they hardly depend on the drift of the odometry.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..log.rows import UNIDENTIFIED
from ..models import SensorModel
from ..se2 import Array


@dataclass(frozen=True)
class Finding:
    """Something in a log that is probably a mistake.

    Attributes:
        check: a short name, "bearing sign" for example.
        message: one sentence with the likely cause.
    """

    check: str
    message: str


class Carried:
    """The K sightings of a log that have ids, where dead reckoning puts them.

    Attributes:
        rows: (K,) their rows in the log.
        steps, ids, ranges: (K,).
        way: (K,) to the pose of each, [rad] turned plus [ranges] driven; a range is the median one.
        places: (K, 2); without controls seen from the pose.
    """

    def __init__(self, log: Log) -> None:
        self.rows = rows = np.flatnonzero(log.landmarks != UNIDENTIFIED)
        self.ids, self.steps, z = log.landmarks[rows], log.steps[rows], log.sightings[rows, :2]
        # without controls poses are too far apart to be compared
        way, poses = 1e9 * np.arange(log.num_poses), np.zeros((log.num_poses, 3))
        if log.controls is not None and log.dt is not None and len(rows):
            driven = np.abs(log.controls) @ [1 / float(np.median(z[:, 0])), 1.0] * log.dt
            way = np.concatenate([[0.0], np.cumsum(driven)])[log.control_starts]
            poses = log.dead_reckoning()
        self.ranges, self.way = z[:, 0], way[self.steps]
        self.places = (log.sensor or SensorModel()).h_inverse(poses[self.steps], z)[:, :2]

    def pairs(self, way: float, most: int, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (P,) of a sighting and a later one, within a way and so many sightings; those nearest in time come first.

        Of so many sightings one is taken, ``every``.
        """
        found = [(np.zeros(0, dtype=np.int64),) * 2]
        for back in range(1, min(most, len(self.rows) - 1) + 1):
            a = np.arange(0, len(self.rows) - back, every)
            a = a[self.way[a + back] - self.way[a] <= way]
            found.append((a, a + back))
        a, b = map(np.concatenate, zip(*found))
        return a, b

    def apart(self, a: np.ndarray, b: np.ndarray) -> Array:
        """The distances [m] between the places of sightings a and b (P,)."""
        return np.linalg.norm(self.places[a] - self.places[b], axis=1)

    def share(self, a: np.ndarray, b: np.ndarray) -> Array:
        """The same over the longer of both ranges."""
        return self.apart(a, b) / np.maximum(self.ranges[a], self.ranges[b])


#: two landmarks are compared if they are seen within this way, [rad] turned plus [ranges] driven, and number of sightings
_SHORT, _BACKWARDS = 3.0, 30
#: distances that are computed at most
_COMPUTED = 200_000


@dataclass(frozen=True, eq=False)
class Distances:
    """K distances between landmarks.

    Attributes:
        pair: (K, 2) the ids of the two landmarks, the smaller first.
        distance: (K,) [m].
        range: (K,) the mean range of the two sightings [m].
    """

    pair: np.ndarray
    distance: Array
    range: Array


def distances_of(log: Log) -> Distances:
    """The distances of a log; without controls those of landmarks that are seen from one pose."""
    seen = Carried(log)
    a, b = seen.pairs(_SHORT, _BACKWARDS, max(1, len(seen.ids) * _BACKWARDS // _COMPUTED))
    other = seen.ids[a] != seen.ids[b]
    a, b = a[other], b[other]
    pair = np.sort(np.column_stack([seen.ids[a], seen.ids[b]]), axis=1)
    return Distances(pair, seen.apart(a, b), (seen.ranges[a] + seen.ranges[b]) / 2)


#: fewer sightings are not checked
_FEWEST = 20
#: a sighting is compared with those within this way before and after it, [rad] turned plus [ranges] driven, and with at most
#: the second number of sightings on each side
_WAY, _AROUND = 2.0, 40
#: two sightings of one id show one place up to the first number [ranges], those of two ids up to the second, because
#: landmarks may be close to each other, or up to the third times the median error
_NEAR, _CLOSE, _TIMES = 0.1, 0.03, 3.0
#: the fewest sightings of the place that have to show other ids, which are seen there again
_OTHERS = 2
#: misread ids are reported from this number and this share of the sightings on, if that is above what is expected by chance;
#: above the second share there is another cause
_LEAST, _FEW, _MOST = 3, 0.004, 1 / 3


def misread(log: Log) -> np.ndarray:
    """Which sightings (M,) have an id that the sightings of the same place contradict, shortly before and after them.

    The odometry carries every sighting to its place over the short way. An id is misread where no other sighting shows it at
    its place, and some show other ids there that are seen again. Where a detector starts to count again, the new id is seen
    again at the place, and so it is not misread.
    """
    found = np.zeros(len(log.steps), dtype=bool)
    seen = Carried(log)
    ids = seen.ids
    if log.controls is None or len(ids) <= _FEWEST:
        return found
    a, b = seen.pairs(_WAY, _AROUND)
    later = seen.steps[a] != seen.steps[b]
    a, b = a[later], b[later]
    same, distance = ids[a] == ids[b], seen.share(a, b)
    least = np.full(len(ids), np.inf)
    np.minimum.at(least, b[same], distance[same])
    if not np.isfinite(least).any():
        return found
    error = _TIMES * float(np.median(least[np.isfinite(least)]))
    own, other = same & (distance <= max(_NEAR, error)), ~same & (distance <= max(_CLOSE, error))
    again = np.bincount(a[own], minlength=len(ids)) + np.bincount(b[own], minlength=len(ids)) > 0
    others = np.zeros(len(ids), dtype=int)
    for p, q in ((a, b), (b, a)):
        others += np.bincount(p[other & again[q]], minlength=len(ids))
    wrong = ~again & (others >= _OTHERS)
    # where landmarks are close to each other, sightings with the right id and a large error lie near others, too
    by_chance = np.sum(~again) * float(np.mean(others[again] >= _OTHERS)) if again.any() else 0.0
    if max(_LEAST, _FEW * len(ids), by_chance + np.sqrt(by_chance)) <= np.sum(wrong) <= _MOST * len(ids):
        found[seen.rows] = wrong
    return found


def misread_ids(log: Log, wrong: np.ndarray) -> Iterator[Finding]:
    """The finding of misread ids; ``wrong`` (M,) is the result of `misread`."""
    if (count := int(np.sum(wrong))) == 0:
        return
    total, k = int(np.sum(log.landmarks != UNIDENTIFIED)), int(np.argmax(wrong))
    these = f"at least {count} of {total} sightings have ids"
    reason = "that the sightings of the same place just before and after contradict"
    first = f"the first one landmark {log.landmarks[k]} at step {log.steps[k]}: single ids are probably misread"
    advice = "a robust kernel or method gnc limits what they do"
    yield Finding("misread ids", f"{these} {reason}, {first}; {advice}")


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
        message = f"{which}, so that nothing corrects the odometry; rows may be missing, or clocks differ"
        yield Finding("seen once", message)
    elif len(names) == 1:
        message = f"all {len(known)} sightings are of one landmark, {names[0]}; ids may be in another column"
        yield Finding("one landmark", message)
    elif len(known) > _FEWEST and np.mean(counts) < 1.5:
        message = f"{len(known)} sightings are of {len(names)} landmarks, so that nearly each is seen once"
        cause = "the ids may be a running number"
        yield Finding("ids jump", f"{message}; {cause}")
    order = np.lexsort((*log.sightings.T[::-1], log.landmarks, log.steps))
    steps, ids, ranges = log.steps[order], log.landmarks[order], log.sightings[order, 0]
    twice = (np.diff(steps) == 0) & (np.diff(ids) == 0)
    if (same := twice & np.all(np.diff(log.sightings[order], axis=0) == 0, axis=1)).any():
        count, k = int(np.sum(same)), int(np.argmax(same))
        again = f"{count} of {len(same) + 1} sightings repeat another one of the same step, landmark and numbers"
        which = f"the first of landmark {ids[k]} at step {steps[k]}"
        if ids[k] == UNIDENTIFIED:
            which = f"the first without an id at step {steps[k]}"
        cause = "rows were probably written twice, and these sightings count twice"
        yield Finding("doubled sightings", f"{again}, {which}: {cause}")
    apart = twice & (ids[1:] != UNIDENTIFIED) & (np.abs(np.diff(ranges)) > 0.2 * ranges[1:])
    if np.sum(apart) > 0.02 * len(known):
        k = int(np.argmax(apart))
        seen = f"landmark {ids[k]} is seen twice at step {steps[k]}"
        away = f"{ranges[k]:.2f} and {ranges[k + 1]:.2f} m away ({np.sum(apart)} such pairs)"
        cause = "several objects may have one id, ids may be misread, or different stamps became one"
        yield Finding("duplicate ids", f"{seen}, {away}; {cause}")


#: a landmark is compared with those seen before it within this way, [rad] turned plus [ranges] driven, and number of
#: sightings
_BACK_WAY, _BACK = 0.6, 40
#: a landmark stays where it is up to the first number [ranges], or the second times the median error
_STAYS, _STAYS_TIMES = 0.1, 3.0
#: landmarks that change at one time at least, and how many times as many as those that stay
_FEWEST_CHANGED, _MORE = 3, 2
#: times that are tried at most
_MOST_TIMES = 2000
#: the ids cannot be checked where sightings move by more than this [ranges, median]
_COARSE = 0.15


def changed_ids(log: Log) -> Iterator[Finding]:
    """The time from which on ids are other ones: several landmarks at once are where others have just been seen."""
    seen = Carried(log)
    ids, way, count = seen.ids, seen.way, len(seen.ids)
    if log.controls is None or count < 10 * _FEWEST_CHANGED:
        return

    def apart(a: np.ndarray, b: np.ndarray) -> Array:
        return np.where(way[b] - way[a] <= _BACK_WAY, seen.share(a, b), np.inf)

    own = _previous(ids)
    error = np.where(own >= 0, apart(np.maximum(own, 0), np.arange(count)), np.inf)
    if not np.isfinite(error).any() or (usual := float(np.median(error[np.isfinite(error)]))) > _COARSE:
        return
    near = max(_STAYS, _STAYS_TIMES * usual)
    stays = error <= near
    before, moved = seen.pairs(_BACK_WAY, _BACK)
    # only a landmark that was seen at its place before can have got another id: in dense fields new ones are beside others by
    # chance
    likely = ~stays[moved] & stays[before] & (ids[before] != ids[moved])
    before, moved = before[likely], moved[likely]
    # an id that is then seen again at its place is no other one: one of the two is misread, or two landmarks are close
    rank = np.unique(ids, return_inverse=True)[1]
    sequence, now = np.sort(rank * count + np.arange(count)), rank[before] * count + moved
    then = sequence[np.minimum(np.searchsorted(sequence, now, side="right"), count - 1)]
    again = (then // count == rank[before]) & (then > now)
    again &= apart(moved, then % count) <= near
    before, moved = before[~again], moved[~again]
    distance = apart(before, moved)
    order = np.lexsort((distance, moved))
    found, nearest = np.unique(moved[order], return_index=True)
    nearest = order[nearest]
    new, partner = np.zeros(count, dtype=bool), np.where(stays, own, -1)
    new[found], partner[found] = distance[nearest] <= near, before[nearest]
    # (landmarks with another id, those that keep theirs, the first ones) at each time at which there may be a change
    times: list[tuple[int, int, np.ndarray]] = []
    for k in np.flatnonzero(new)[:_MOST_TIMES]:
        after = np.arange(k, np.searchsorted(way, way[k] + _BACK_WAY / 2, side="right"))
        after = after[(partner[after] < k) & (partner[after] >= 0)]
        changed = after[new[after]]
        if len(changed) > 1:
            changed = changed[np.unique(ids[changed], return_index=True)[1]]
            changed = changed[np.unique(ids[partner[changed]], return_index=True)[1]]
        times.append((len(changed), int(np.sum(stays[after])), np.sort(changed)))
    if not times:
        return
    number, kept, changed = max(times, key=lambda each: each[0] - each[1])
    far = [n > m for n, m, first in times if abs(way[first[0]] - way[changed[0]]) > 2 * _BACK_WAY]
    again = np.isin(changed, own[stays])
    # two that are seen again there are enough where nothing else in the log looks like it
    if (number >= _FEWEST_CHANGED and number > _MORE * kept) or (
        number == _FEWEST_CHANGED - 1 and not kept and not any(far) and again.all()
    ):
        renamed = ", ".join(" becomes ".join(map(str, (ids[partner[k]], ids[k]))) for k in changed[:3].tolist())
        step = int(seen.steps[changed[0]])
        when = f"step {step}" if log.times is None else f"{log.times[step] - log.start_time:.1f} s after the start"
        message = f"landmarks have other ids from about {when} on ({renamed})"
        cause = "a detector may have counted them anew"
        yield Finding("ids change", f"{message}; {cause}")


def _previous(ids: np.ndarray) -> np.ndarray:
    """For each id (N,) the last place before it with the same id; -1 where there is none."""
    order = np.argsort(ids, kind="stable")
    previous = np.full(len(ids), -1)
    again = ids[order[1:]] == ids[order[:-1]]
    previous[order[1:][again]] = order[:-1][again]
    return previous
