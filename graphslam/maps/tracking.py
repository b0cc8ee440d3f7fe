"""A log followed through a map: what its sightings are of where it has no ids, and where the robot was lifted.

From the first fix on, a filter says of each sighting whether it agrees with the map (`maps.tracker`). Where its doubt
reaches `DOUBT`, the sightings since it left 0 are given a fix of their own. If that is a sure one, at another place, the
robot was lifted and put down there (*kidnapped*): the control before says nothing about this, and what follows begins at the
new fix.

**Moved landmarks.** Landmarks that were moved together look like a lift as long as no others are seen, and where the log
begins among them, its first fix is wrong. So the robot is followed twice from the doubt on to the end of the log, from the
new fix and from where it was believed to be. Landmarks count whose sightings agree with only one of both. After a lift hardly
any of them agree with the old place. Otherwise the fewer have moved: the log is followed again without them. Landmarks that
were all that agreed so far have moved, too, if they are few and the new place is nearby.

Source: Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, section 7.1 (kidnapping).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GraphError
from ..errors.checks import listed
from ..log import UNIDENTIFIED, Log
from ..log.geometry import with_datum
from ..models import ANYWHERE, MotionModel, SensorModel, additional_variances
from ..se2 import Array, begun_at, difference
from .landmark_map import CORRELATIONS_LOST, LandmarkMap
from .localization import SURE, Fix, carried_back, first_fix, fix_with_ids, possible_fixes
from .parts import Part, displaced_part
from .stretch import Stretch, drifted
from .tracker import NOTHING, Tracker

#: the sum of contradictions at which another place is looked for
DOUBT = 4
#: the standard deviation [m] of a pose from which on chance lets sightings agree
VAGUE = 0.7
#: squared Mahalanobis distance [3 degrees of freedom] beyond which a fix is another place
ELSEWHERE = 30.0
#: the fewest landmarks that show a lift, and how many times as many as contradict it
SHOW, LIFTS = 3, 6
#: landmarks have moved where so many more agree with the other place, of those with so many more sightings of their own; how
#: many more landmarks end the count
MORE, OFTEN, DECIDE = 2, 3, 15
#: the most parts of a map that are left out
MOST_PARTS = 3
#: where so few landmarks agreed since the last fix, and the other place is nearer than this [m], they moved together
GROUP, NEARBY = 4, 2.0


@dataclass(frozen=True, eq=False)
class Followed:
    """A log along a map.

    Attributes:
        landmarks: (M,) the landmark of each sighting, `UNIDENTIFIED` where that is not clear.
        fixes: {step: fix} where the log begins, and where the robot was put down.
        lifted: {step: (last step that agreed before, distance [m] to where it was expected)} of the latter.
        agree: (M,) whether the sighting agrees with a landmark of the map.
        moved: the landmarks of the map that were left out, because they have moved.
        parts: those of them that lie wrong together.
    """

    landmarks: np.ndarray
    fixes: dict[int, Fix]
    lifted: dict[int, tuple[int, float]]
    agree: np.ndarray
    moved: tuple[int, ...] = ()
    parts: tuple[Part, ...] = ()


def in_frame_of(
    log: Log, landmarks: LandmarkMap, *, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> tuple[Log, LandmarkMap, tuple[str, ...]]:
    """The log with its initial poses in the frame of a map, the map without landmarks that have moved, and notes.

    Each note is one sentence; see `first_fix` and the module.

    Sightings without ids get those of the map; landmarks that it lacks get new ones, and what is neither is left out. Where
    the robot was lifted, the control says nothing. The log has no psi where a landmark that is seen and exact in the map has
    no heading there.
    """
    notes, log = [CORRELATIONS_LOST] * landmarks.correlated, with_datum(log, landmarks.datum, "the datum of the map")
    found = follow(log, landmarks, motion=motion, sensor=sensor)
    fix = found.fixes[0]
    placed = begun_at(fix.pose, log.initial_poses)
    notes.append(f"the first pose was found in the map: {fix.sentence}")
    for step, (before, way) in found.lifted.items():
        placed[step:] = begun_at(found.fixes[step].pose, placed[step:])
        lifted = f"the robot was lifted between steps {before} and {step}"
        put_down = f"and put down {way:.2f} m from where it was expected: {found.fixes[step].sentence}"
        notes.append(f"{lifted}, {put_down}")
    landmarks = landmarks.among(set(landmarks) - set(found.moved)) if found.moved else landmarks
    notes += [part.sentence for part in found.parts]
    if single := sorted(set(found.moved).difference(*(part.ids for part in found.parts))):
        which = f"some landmarks have moved since the map was made, as the others show: {listed('landmark', single)}"
        notes.append(f"{which}; the map is used without them")
    log = log.replace(initial_poses=placed, **_freed(log, found.lifted))
    if not log.identified:
        known = found.landmarks != UNIDENTIFIED
        new = sorted(set(found.landmarks[known].tolist()) - set(landmarks))
        added = f"; {listed('landmark', new)} {'is' if len(new) == 1 else 'are'} new" if new else ""
        of_map = np.isin(found.landmarks, list(landmarks)).sum()
        gives = f"the map gives {of_map} of {len(known)} sightings without ids their landmark{added}"
        notes.append(f"{gives}; {(~known).sum()} are left out")
        log = log.with_sightings(known, landmarks=found.landmarks[known])
    seen = [j for j in log.landmark_ids.tolist() if j in landmarks]
    if log.has_orientation and (bare := [j for j in seen if j not in landmarks.covariances and len(landmarks[j]) == 2]):
        notes.append(f"psi is not used, because the map has no heading of {listed('landmark', bare)}, exact in it")
        log = log.without_orientation()
    return log, landmarks, tuple(notes)


def follow(
    log: Log, landmarks: LandmarkMap, *, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> Followed:
    """A log along a map, from its first fix to its end.

    Raises:
        GraphError: as `first_fix`.
    """
    drive, moved, parts = Stretch.of(log, motion, sensor), set[int](), list[Part]()
    if drive.identified and log.controls is not None:
        while len(parts) < MOST_PARTS and (part := displaced_part(drive, landmarks.among(set(landmarks) - moved))):
            parts.append(part)
            moved |= set(part.ids)
    found: Followed | set[int] = moved
    while not isinstance(found, Followed):
        moved |= found
        try:
            found = _followed(log, drive, landmarks.among(set(landmarks) - moved), True)
        except GraphError:
            if not moved:
                raise
            # what is left does not suffice
            found, moved, parts = _followed(log, drive, landmarks, False), set(), []
    return replace(found, moved=tuple(sorted(moved)), parts=tuple(parts))


def _followed(log: Log, drive: Stretch, landmarks: LandmarkMap, leave_out: bool) -> Followed | set[int]:
    """A log along a map; or the landmarks that have moved as soon as some are found, where these are to be left out."""
    fix = first_fix(drive, landmarks)
    named = np.where(log.identified, log.landmarks, UNIDENTIFIED)
    result = Followed(named, {0: fix}, {}, np.zeros(len(log.steps), dtype=bool))
    if log.controls is None:
        if not log.identified:
            raise GraphError(f"{log.name} has no controls, and sightings without ids need them in a map")
        return result
    newest = int(drive.landmarks.max(initial=UNIDENTIFIED))
    tracker = Tracker(landmarks, drive.sensor, fix.pose, fix.covariance, newest)
    # each search that finds nothing, as in a map that is wrong, makes the next ones rarer
    rows_at, step, last, tried, least = drive.rows_at, 0, 0, DOUBT, DOUBT
    while True:
        rows = rows_at[step]
        if len(rows):
            seen = tracker.see(step, rows, drive.landmarks[rows], drive.sightings[rows])
            named[rows], result.agree[rows] = seen.landmarks, seen.agree
            for row, id in seen.earlier.items():
                named[row] = id
            if tracker.doubt == 0:
                tried, last = least, step if seen.agree.any() else last
            if tracker.doubt >= tried and tracker.since > 0:
                tried, least = 2 * tracker.doubt, least + DOUBT
                put_down, moved = elsewhere(drive, tracker, landmarks)
                if moved and leave_out:
                    return moved
                if put_down is not None:
                    since, found, way = put_down
                    so_far = (log.steps >= max(result.fixes)) & (log.steps < since) & result.agree
                    few = set(named[so_far].tolist())
                    if leave_out and drive.identified and len(few) <= GROUP and way < NEARBY:
                        return few
                    result.fixes[since] = found
                    result.lifted[since] = min(last, since - 1), way
                    tracker.place(found.pose, found.covariance)
                    step, last, tried, least = since, since, DOUBT, DOUBT
                    # sightings from here on are judged again
                    again = np.flatnonzero(log.steps >= since)
                    tracker.forget(again)
                    if not log.identified:
                        named[again] = UNIDENTIFIED
                    continue
        if step == log.num_poses - 1:
            return result
        noise = drive.noise[step]
        if noise[0, 0] + noise[1, 1] > NOTHING:
            begun_again = sure_fix(drive.after(step + 1), landmarks)
            if begun_again is None:
                return result
            tracker.place(begun_again.pose, begun_again.covariance)
            last = step + 1
        else:
            tracker.move(drive.motions[step], noise)
        step += 1


def elsewhere(
    drive: Stretch, tracker: Tracker, landmarks: LandmarkMap
) -> tuple[tuple[int, Fix, float] | None, set[int]]:
    """Where a robot is that the sightings of a drive contradict, if that is sure, and at another place than was expected.

    Returns:
        The first step from which on they agree, the fix of its pose, and its distance [m] from where it was expected; None
        where it was not lifted. Then the landmarks that have moved instead, where that is clear.
    """
    since, (x, P) = tracker.since, tracker.expected
    after = drive.after(since)
    fix = sure_fix(after, landmarks)
    if fix is None:
        return None, set()
    # the first contradictions may be clutter, and the robot have been lifted after them
    later = int(after.steps[fix.agree].min())
    if later and (fix := sure_fix(after.after(later), landmarks)) is None:
        return None, set()
    for step in range(later - 1, -1, -1):
        now = np.flatnonzero(after.steps == step)
        back = carried_back(fix, after.after(step), later - step)
        there = Tracker(landmarks, drive.sensor, back.pose, back.covariance)
        seen = there.see(step, now, after.landmarks[now], after.sightings[now])
        if seen.contradict.sum() > seen.agree.sum() or np.trace(back.covariance[:2, :2]) > VAGUE**2:
            break
        if seen.agree.any():
            later, fix = step, back
    (*_, x), (*_, P) = drifted(x, after.motions[:later], after.noise[:later], P)
    way = difference(fix.pose, x)
    if float(way @ np.linalg.solve(fix.covariance + P, way)) < ELSEWHERE:
        return None, set()
    if not drive.identified:
        # too many sightings agree with the old place by chance
        return (since + later, fix, float(np.hypot(*way[:2]))), set()
    there, stayed = (Tracker(landmarks, drive.sensor, *at) for at in ((fix.pose, fix.covariance), tracker.expected))
    votes = voters(after, there, later, stayed)
    new, old = ({j for j, n in votes.items() if sign * n > 0} for sign in (1, -1))
    if len(new) >= max(SHOW, LIFTS * len(old)):
        return (since + later, fix, float(np.hypot(*way[:2]))), set()
    few, many = sorted(({j for j in each if abs(votes[j]) >= OFTEN} for each in (new, old)), key=len)
    return None, few if len(many) >= max(SHOW, len(few) + MORE) else set()


def voters(drive: Stretch, there: Tracker, later: int, stayed: Tracker) -> Counter[int]:
    """Of each landmark the sightings that agree only with a robot put down, less those that agree only with one that was not.

    Args:
        drive: until its end, an unknown motion, or `DECIDE` more landmarks of one kind are looked at.
        there, stayed: trackers of both, at step ``later``, where it was put down, and at step 0.
    """
    count, rows_at = Counter[int](), drive.rows_at
    for step in range(drive.num_poses):
        if len(rows := rows_at[step]):
            b = stayed.see(step, rows, drive.landmarks[rows], drive.sightings[rows])
        if len(rows) and step >= later:
            a = there.see(step, rows, drive.landmarks[rows], drive.sightings[rows])
            count.update(a.landmarks[a.agree & ~b.agree].tolist())
            count.subtract(b.landmarks[b.agree & ~a.agree].tolist())
        if step == drive.num_poses - 1 or abs(sum(np.sign(n) for n in count.values())) >= DECIDE:
            break
        motion, noise = drive.motions[step], drive.noise[step]
        if noise[0, 0] + noise[1, 1] > NOTHING:
            break
        stayed.move(motion, noise)
        if step >= later:
            there.move(motion, noise)
    return count


def sure_fix(drive: Stretch, landmarks: LandmarkMap) -> Fix | None:
    """A sure fix of a stretch; None where there is none."""
    fix: Fix | None
    try:
        # without the search for what is wrong with the map
        if drive.identified:
            fix = fix_with_ids(drive, landmarks)
        else:
            fix = next(iter(possible_fixes(drive, landmarks)), None)
    except GraphError:
        return None
    if fix is None or fix.odds <= SURE:
        return None
    # as many as `first_fix` stops at: two without headings fit a mirrored map as well
    with_psi = drive.sightings.shape[1] == 3
    headings = with_psi and any(len(landmarks.get(j, ())) == 3 for j in drive.landmarks[fix.agree].tolist())
    return fix if len(fix.agree) > 2 - headings else None


def _freed(log: Log, lifted: dict[int, tuple[int, float]]) -> dict[str, Array]:
    """The variances of the controls, with those that say nothing before the steps at which the robot was put down."""
    if not lifted:
        return {}
    assert log.controls is not None and log.dt is not None
    variances = additional_variances(log.control_variances, len(log.controls))
    for step in lifted:
        pieces = np.arange(log.control_starts[step - 1], log.control_starts[step])
        longest = pieces[np.argmax(log.dt[pieces])]
        variances[longest] = np.array(ANYWHERE) / max(float(log.dt[longest]), 1e-6) ** 2
    return {"control_variances": variances}
