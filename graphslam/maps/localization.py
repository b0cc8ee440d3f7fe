"""A log in the frame of a map: which sightings are of its landmarks, and where the robot was at the first pose.

The first fix needs no start pose: the first sightings of landmarks of the map, carried back to the first pose by the
odometry, are registered in the map (`maps.registration`). More of them are taken until the odds of the fix, against any
other place and against the map of another place, are above `SURE` by their joint evidence (`maps.map_evidence`), and until
three landmarks agree, because two fit a mirrored map as well, or two with headings, because one fits a map in any unit. More
landmarks must agree than contradict, and most sightings or twice as many landmarks (`_agreed`). Where all sightings together
do not reach `SURE`, the fix says its odds. The pose and its covariance are those of the drive smoothed by the sightings that
agree (`maps.stretch`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from ..errors import GraphError
from ..errors.checks import check_type, listed
from ..log import UNIDENTIFIED, Log, check_is_log
from ..models import MotionModel, SensorModel
from ..se2 import Array, in_frame, lever_matrix
from .constellation import Constellations, Merged, match, merged, with_alike
from .landmark_map import LandmarkMap, as_map
from .map_evidence import Weighed, log_sum
from .registration import RIGHT, Match, Points, evenly, register
from .stretch import Drift, Stretch, backwards, moved, paired, points_of, seen_from, smoothed, together
from .tracker import Tracker

#: odds from which a fix is taken at once, and below which there is none even after all sightings
SURE, LEAST = 1e3, 0.1
#: a fix whose heading has a larger standard deviation [rad] leaves it open
OPEN = 0.5
#: the most sightings by which a whole trajectory is put into a map
ENOUGH = 300
#: how many more sightings are taken at a time
GROWTH = 1.5
#: without ids, the sightings with which a fix is tried first, the most that are tried, and the fewest landmarks that agree,
#: which also holds where ids are misread
BEGIN, LONGEST, FEWEST = 8, 400, 4
#: windows that begin later on the way, and the sightings between their beginnings
WINDOWS, LATER = 16, 40
#: odds from which a place is as likely as others
ALIKE = 0.05
#: common mistakes in maps, and the factors of x and y that correct them
CHANGES = {
    "mirrored: is its y axis to the left of x?": (1.0, -1.0),
    "in centimetres: give it in metres": (0.01, 0.01),
    "in millimetres: give it in metres": (0.001, 0.001),
    "in kilometres: give it in metres": (1000.0, 1000.0),
    "in feet: give it in metres": (0.3048, 0.3048),
}
DEGREES = "in degrees, x as longitude and y as latitude: project it to metres"
#: the part of the sightings that agree beyond which no other of these mistakes is tried
SURE_SHARE = 0.9
#: attempts with more sightings and less evidence after which no more are taken
PATIENCE = 3


@dataclass(frozen=True, eq=False)
class Fix:
    """The first pose of a log in the frame of a map.

    Attributes:
        pose: (3,) of step 0 [m, m, rad].
        covariance: (3, 3) of it, with the uncertainty of the map.
        step: the last step whose sightings were used.
        agree, disagree: the rows of the log's sightings that were used, and of those that contradict the fix: their ids were
            misread, or their landmarks have moved.
        odds: of the fix against all other places, and against the map of another place.
    """

    pose: Array
    covariance: Array
    step: int
    agree: np.ndarray
    disagree: np.ndarray
    odds: float

    def __repr__(self) -> str:
        """One line: the pose and its standard deviations, and what it comes from."""
        x, y, theta = self.pose
        std = np.sqrt(np.diagonal(self.covariance))
        return (
            f"<Fix ({x:.3f}, {y:.3f}) m, {np.degrees(theta):.1f} deg, standard deviations {std[0]:.3f} m, {std[1]:.3f} m, "
            f"{np.degrees(std[2]):.1f} deg; {self.sentence}>"
        )

    @property
    def sentence(self) -> str:
        """The source of the fix, in words."""
        wrong = f", {len(self.disagree)} contradict it" if len(self.disagree) else ""
        count = len(self.agree)
        agree = f"{count} sightings agree up to step" if count != 1 else "1 sighting agrees up to step"
        doubt = f"; the odds against other places and other maps are only {self.odds:.2g} to 1"
        return f"{agree} {self.step}{wrong}{'' if self.odds > SURE else doubt}"


def first_fix(
    log: Log | Stretch,
    landmarks: LandmarkMap | Mapping[int, Array] | str | PathLike[str],
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
) -> Fix:
    """The first pose of a log in the frame of a map, from sightings of its landmarks; the log's own first pose is not used.

    Args:
        log: with ids of the map's landmarks, or a `Stretch` of one; sightings of other landmarks are not used. Without ids
            the constellation of the first sightings says where the log begins, see `possible_fixes`.
        landmarks: the map, in any form that `Graph.from_log` takes.
        motion, sensor: the noise models; default: those of the log, else the book's. A `Stretch` has its own.

    Raises:
        GraphError: the log sees no landmark of the map or too few, or no place in the map fits what it sees, or several do;
            the message names the likely cause, or the places and their odds.
    """
    landmarks, log = as_map(landmarks), _stretch(log, motion, sensor)
    if not log.identified:
        return _sure(log, landmarks, possible_fixes(log, landmarks))
    fix, points, matches, found = _with_ids(log, landmarks)
    if fix is None:
        raise _no_fix(log, landmarks, points, matches, found)
    return fix


def fix_with_ids(log: Stretch, landmarks: LandmarkMap) -> Fix | None:
    """The fix of a stretch whose landmarks have ids, or None; without the search for the reason, which takes longer.

    Raises:
        GraphError: no landmark of the map is seen.
    """
    return _with_ids(log, landmarks)[0]


def _with_ids(log: Stretch, landmarks: LandmarkMap) -> tuple[Fix | None, Points, list[Match], list[Weighed]]:
    """`_searched` with all sightings of landmarks of the map, and the pose of the fix smoothed."""
    fix, points, matches, found = _searched(log, landmarks, _rows(log, landmarks), Drift(log))
    if fix is not None:
        end = smoothed(log, landmarks, fix.agree, found[0])
        fix = replace(fix, pose=end.pose, covariance=end.covariance)
    return fix, points, matches, found


def _searched(
    log: Stretch, landmarks: LandmarkMap, rows: np.ndarray, drift: Drift, first: int = 1
) -> tuple[Fix | None, Points, list[Match], list[Weighed]]:
    """The fix by the first sightings ``rows`` that suffice, or None; and what was last tried, one by one and together.

    More than ``first`` of them are used, or all. The pose of the fix is not smoothed.
    """
    count = first
    while True:
        count = min(max(count + 1, int(count * GROWTH)), len(rows))
        step = int(log.steps[rows[count - 1]])
        # all sightings of a moment count
        count = int(np.searchsorted(log.steps[rows], step, side="right"))
        used = rows[:count]
        drift.go_to(step)
        points = points_of(log, landmarks, used, drift)
        try:
            matches, found = register(points), list[Weighed]()
        except np.linalg.LinAlgError:
            raise GraphError(
                f"sightings of {log.name} have covariances that are singular to double precision, so that they cannot be "
                "compared with the map: is the noise of the sensor too small, or are ranges in another unit?"
            ) from None
        whole = count == len(rows)
        # one by one they are surer than together, because they share the errors of the odometry
        if whole or odds_of(matches) > SURE:
            found = together(log, landmarks, used, drift, points, matches)
            odds = odds_of(found)
            if odds > (LEAST if whole else SURE):
                best = found[0]
                # one landmark with a heading fits a map in any unit, and two without one a mirrored map
                enough = whole or best.fits > 2 - best.oriented
                enough &= _agreed(best, points.ids, len(landmarks), odds > SURE)
                if best.covariance[2, 2] < OPEN**2 and enough:
                    agree, others = used[best.agree], used[~best.agree]
                    return Fix(best.pose, best.covariance, step, agree, others, odds), points, matches, found
        if whole:
            return None, points, matches, found


def _agreed(best: Weighed, ids: np.ndarray, size: int, sure: bool) -> bool:
    """Whether more landmarks and more sightings (of landmarks ``ids``) agree than contradict.

    Where twice as many landmarks agree as contradict, sightings need not: some landmarks are seen more often than others.
    Misread ids name any of the ``size`` landmarks of the map: on a long drive nearly all, most of them never in view, so
    that more landmarks contradict than agree although the map is right. So where the odds are sure and most sightings
    agree, landmarks do not count that contradict as seldom as misread ids explain, up to three standard deviations beyond
    their mean. Twice as many as of the others must agree, and `FEWEST`: in a map that is some percent too large, those nearby
    agree, and in a mirrored one those on a line.
    """
    more = 2 * int(best.agree.sum()) > len(best.agree)
    if best.fits > best.contradict and (more or best.fits > 2 * best.contradict):
        return True
    times = np.unique(ids[~np.isin(ids, ids[best.agree])], return_counts=True)[1]
    misread = (1 - RIGHT) * len(ids) / size
    often = int(np.sum(times > misread + 3 * misread**0.5))
    return sure and more and best.fits > max(2 * often, FEWEST - 1)


def possible_fixes(
    log: Log | Stretch,
    landmarks: LandmarkMap | Mapping[int, Array] | str | PathLike[str],
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
) -> list[Fix]:
    """Where a log without ids may begin in a map, the most probable place first, each with its odds.

    The first sightings, merged into landmarks, are matched as a constellation (`maps.constellation`). More are taken
    until the odds of the best place against all others and none are above `SURE` and at least `FEWEST` landmarks agree, more
    than contradict. If all, or `LONGEST`, do not suffice, the first odds are below that: the map is ambiguous.

    Args:
        log: its ids, if it has any, are not used.
        landmarks, motion, sensor: as in `first_fix`.

    Returns:
        The places; empty where none fits. ``agree`` and ``disagree`` are the rows of the sightings.

    Raises:
        GraphError: the map or the log is empty.
    """
    landmarks, log = as_map(landmarks), _stretch(log, motion, sensor)
    _check_not_empty(log, landmarks)
    known = Constellations.of(landmarks, float(np.quantile(log.sightings[:, 0], 0.98)))
    best = list[Fix]()
    in_order = np.sort(log.steps)
    for begin in range(0, min(WINDOWS * LATER, len(in_order)), LATER):
        step = int(in_order[begin]) if begin else 0
        fixes = _fixes_here(log.after(step), known, landmarks)
        # each window is another chance for a place that only looks right
        chances = 1 + begin // LATER
        alike = [fix.odds / (1 + fix.odds) for fix in fixes if fix.odds > ALIKE]
        if fixes and fixes[0].odds > SURE * chances:
            first = _followed_back(fixes[0], log, step, landmarks, chances)
            return [first] + [carried_back(fix, log, step) for fix in fixes[1:]]
        # two places that are alike: other sightings are unlikely to tell them apart
        if len(alike) > 1 and sum(alike) > 1 - 1 / (SURE * chances):
            return [carried_back(fix, log, step) for fix in fixes]
        fixes = [replace(carried_back(fix, log, step), odds=fix.odds / chances) for fix in fixes]
        if fixes and (not best or fixes[0].odds > best[0].odds):
            best = fixes
    return best


def _followed_back(fix: Fix, log: Stretch, step: int, landmarks: LandmarkMap, chances: int) -> Fix:
    """The sure fix of a pose as one of the first pose, corrected by the sightings before it."""
    tracker, agree, disagree = Tracker(landmarks, log.sensor, fix.pose, fix.covariance), [], []
    back, noise = backwards(log.motions[:step], log.noise[:step])
    rows_at = log.rows_at
    for before in range(step - 1, -1, -1):
        tracker.move(back[before], noise[before])
        if len(rows := rows_at[before]):
            seen = tracker.see(before, rows, np.full(len(rows), UNIDENTIFIED), log.sightings[rows])
            agree.append(rows[seen.agree])
            disagree.append(rows[seen.contradict])
    later = np.flatnonzero(log.steps >= step)
    return Fix(
        tracker.pose, tracker.covariance, step + fix.step,
        np.concatenate([*agree[::-1], later[fix.agree]]).astype(int),
        np.concatenate([*disagree[::-1], later[fix.disagree]]).astype(int), fix.odds / chances,
    )  # fmt: skip


def _fixes_here(log: Stretch, known: Constellations, landmarks: LandmarkMap) -> list[Fix]:
    """The same from the first step of a log on alone."""
    drift, count = Drift(log), BEGIN
    whole = min(LONGEST, len(log.steps))
    attempts: list[tuple[float, np.ndarray, int, Merged, list[tuple[Match, np.ndarray]]]] = []
    order = np.argsort(log.steps, kind="stable")
    while True:
        step = int(log.steps[order[min(count, whole) - 1]])
        rows = order[: int(np.searchsorted(log.steps[order], step, side="right"))]
        drift.go_to(step)
        at = log.steps[rows]
        y, sensed, lever = seen_from(drift.poses[at], log.sightings[rows], log.sensor)
        J = lever_matrix(lever)
        seen = merged(y, sensed, J @ drift.covariances[at] @ np.swapaxes(J, 1, 2), at)
        found = match(seen, known)
        best = found[0][0] if found else None
        sure = False
        if best is not None and odds_of([each for each, _ in found]) > SURE:
            fits, against = int(np.sum(best.agree)), np.asarray(found[0][1] < 0)
            sure = fits >= max(FEWEST, int(np.sum(seen.counts[against] > 1)) + 1) and fits > int(np.sum(against))
            if sure:
                found = with_alike(seen, known, found)
                best, sure = found[0][0], odds_of([each for each, _ in found]) > SURE
        attempts.append((best.evidence if best else -np.inf, rows, step, seen, found))
        # the errors of a long way hide a constellation
        since = len(attempts) - 1 - int(np.argmax([each[0] for each in attempts]))
        if sure or count >= whole or since >= PATIENCE:
            break
        count = int(count * GROWTH)
    if not sure:
        _, rows, step, seen, found = max(attempts, key=lambda each: each[0])
    fixes = []
    for k, (each, partners) in enumerate(found):
        odds = odds_of([match for match, _ in found], k)
        agree, disagree = rows[each.agree[seen.which]], rows[partners[seen.which] < 0]
        fixes.append(Fix(each.pose, each.covariance, step, agree, disagree, odds if sure else min(odds, SURE)))
    if sure:
        named = np.full(len(log.steps), UNIDENTIFIED)
        named[rows] = known.ids[found[0][1][seen.which]]
        one = smoothed(replace(log, landmarks=named), landmarks, fixes[0].agree, found[0][0])
        fixes[0] = replace(fixes[0], pose=one.pose, covariance=one.covariance)
    return fixes


def carried_back(fix: Fix, log: Stretch, step: int) -> Fix:
    """The fix of a pose of a stretch as one of its first pose."""
    if step == 0:
        return fix
    drift, rows = Drift(log), np.flatnonzero(log.steps >= step)
    drift.go_to(step)
    pose, covariance = moved(fix.pose, fix.covariance, *backwards(drift.poses[step], drift.covariances[step]))
    return replace(
        fix, pose=pose, covariance=covariance, step=step + fix.step, agree=rows[fix.agree], disagree=rows[fix.disagree]
    )


def _sure(log: Stretch, landmarks: LandmarkMap, fixes: list[Fix]) -> Fix:
    """The first of the places where a log may begin.

    Raises:
        GraphError: there is none, or another one is nearly as likely; with their odds.
    """
    if fixes and fixes[0].odds > SURE:
        return fixes[0]
    likely = [fix for fix in fixes if fix.odds > 1 / SURE][:4]
    sure = sum(fix.odds / (1 + fix.odds) for fix in likely)
    # several places that are alike leave no doubt about the map
    for name, changed in _corrected(landmarks) if sure < 0.99 or len(likely) == 1 else ():
        known = Constellations.of(changed, float(np.quantile(log.sightings[:, 0], 0.98)))
        others = _fixes_here(log, known, changed)
        if others and others[0].odds > SURE:
            which = f"{log.name} has sightings without ids, which do not say where in the map it begins"
            raise GraphError(f"{which}; they would with the map {name}")
    if not likely or sure < 0.5:
        which = f"{log.name} has sightings without ids, and they do not say where in the map it begins"
        cause = "is it the map of another place, or has the noise another size?"
        raise GraphError(f"{which}: no place surely has a constellation of landmarks like theirs; {cause}")
    places = "; ".join(
        f"({fix.pose[0]:.2f}, {fix.pose[1]:.2f}) m, {np.degrees(fix.pose[2]):.0f} degrees with probability "
        f"{fix.odds / (1 + fix.odds):.3g}"
        for fix in likely
    )
    which = f"{log.name} has sightings without ids, and they do not say surely where in the map it begins"
    raise GraphError(f"{which}: {places}; more sightings are needed, or give it the pose")


def registered(
    poses: Array, nodes: np.ndarray, sightings: Array, ids: np.ndarray, landmarks: LandmarkMap, sensor: SensorModel
) -> Array:
    """Poses (P, 3), moved as a whole to where the sightings (M, 2 or 3) from them fit a map best; unmoved where none fits."""
    known = np.flatnonzero(np.isin(ids, list(landmarks)))
    known = known[evenly(len(known), ENOUGH)]
    y = seen_from(poses[nodes[known]], sightings[known], sensor)
    matches = register(paired(y, np.zeros((len(y[0]), 3, 3)), ids[known], landmarks))
    return in_frame(matches[0].pose, poses) if matches else poses


def _stretch(log: Log | Stretch, motion: MotionModel | None, sensor: SensorModel | None) -> Stretch:
    """The motions and sightings of a log."""
    check_type(MotionModel, motion=motion)
    check_type(SensorModel, sensor=sensor)
    if isinstance(log, Stretch):
        return log
    check_is_log(log)
    return Stretch.of(log, motion, sensor)


def _check_not_empty(log: Stretch, landmarks: LandmarkMap) -> None:
    if not landmarks:
        raise GraphError("the map has no landmarks, so that the robot cannot be found in the map")
    if not len(log.steps):
        missing = f"{log.name} has no sightings of range and bearing, so that the robot cannot be found in the map"
        raise GraphError(f"{missing}; ranges or bearings alone need its first pose: OnlineSolver(start, map=map)")


def _rows(log: Stretch, landmarks: LandmarkMap) -> np.ndarray:
    """The rows of the sightings of landmarks of the map."""
    _check_not_empty(log, landmarks)
    rows = np.flatnonzero(np.isin(log.landmarks, list(landmarks)))
    if len(rows) == 0:
        seen, known = (listed("landmark", sorted(ids), most=4) for ids in (set(log.landmarks.tolist()), landmarks))
        cause = "is it the map of another place, or are the ids numbered otherwise?"
        raise GraphError(f"{log.name} sees no landmark of the map: it sees {seen}, and the map has {known}; {cause}")
    return rows


def odds_of(matches: Sequence[Match], k: int = 0) -> float:
    """The odds of hypothesis k against the others and none; 0 where there is none."""
    if not matches:
        return 0.0
    evidence = [match.evidence for match in matches]
    others = log_sum([0.0, *evidence[:k], *evidence[k + 1 :]])
    return float(np.exp(np.clip(evidence[k] - others, -700.0, 700.0)))


def _no_fix(
    log: Stretch, landmarks: LandmarkMap, points: Points, matches: list[Match], found: list[Weighed]
) -> GraphError:
    """The reason why no place in the map fits, with the likely cause."""
    count = len(np.unique(points.ids))
    if count == 1 and not points.oriented.any():
        return GraphError(
            f"{log.name} sees only landmark {points.ids[0]} of the map, and one landmark without a heading does not say "
            "where the robot is: two are needed"
        )
    what = f"{len(points.ids)} sightings of {listed('landmark', np.unique(points.ids).tolist(), most=4)} of the map"
    cause = _cause(log, landmarks, found)
    if not cause and matches and matches[0].covariance[2, 2] >= OPEN**2 and odds_of(matches) > LEAST:
        wide = np.degrees(matches[0].covariance[2, 2] ** 0.5)
        heading = f"leave open where {log.name} heads at its first pose (standard deviation {wide:.0f} degrees)"
        return GraphError(f"{what} {heading}; more sightings of other landmarks are needed")
    if not cause and len(matches) > 1 and odds_of(matches[:1]) > SURE > odds_of(matches):
        places = " and ".join(f"({m.pose[0]:.2f}, {m.pose[1]:.2f}) m" for m in matches[:2])
        alike = f"fit several first poses of {log.name} alike, such as {places}"
        return GraphError(f"{what} {alike}; more sightings are needed")
    if not cause and found and found[0].fits > found[0].contradict and found[0].evidence < 0:
        odds = f"{what} fit it no better than that of another place (odds {np.exp(found[0].evidence):.2g})"
        return GraphError(f"{odds}: is it that, or are more sightings of other landmarks needed?")
    best = int(np.sum(matches[0].agree)) if matches else 0
    cause = cause or "; is it the map of another place, are ids misread, or has the noise of the sensor another size?"
    return GraphError(f"{what} fit no first pose of {log.name}: at the best place {best} of them agree{cause}")


def _corrected(landmarks: LandmarkMap) -> Iterator[tuple[str, LandmarkMap]]:
    """The common mistakes in maps, each with the map without it."""
    changes, middle = dict(CHANGES), np.mean([place[:2] for place in landmarks.values()], axis=0)
    if abs(middle[0]) <= 180 and abs(middle[1]) <= 90:
        # metres of a degree, of the ellipsoid WGS 84
        n = np.cos(np.radians(middle[1]) * np.array([1, 3, 2, 4]))
        changes[DEGREES] = float(111_412.8 * n[0] - 93.5 * n[1]), float(111_132.9 - 559.8 * n[2] + 1.2 * n[3])
    for name, (x, y) in changes.items():
        places, squares = {j: place[:2] * (x, y) for j, place in landmarks.items()}, np.outer((x, y), (x, y))
        yield name, LandmarkMap(places, {j: C[:2, :2] * squares for j, C in landmarks.covariances.items()})


def _numbered(landmarks: LandmarkMap) -> Iterator[tuple[str, LandmarkMap]]:
    """The map with ids that count from another number, as those of the log may, and what is said of it."""
    for step, way in ((1, "higher"), (-1, "lower")):
        places = {j + step: place[:2] for j, place in landmarks.items() if j + step >= 0}
        of_places = {j + step: C[:2, :2] for j, C in landmarks.covariances.items() if j + step >= 0}
        yield (
            f"with ids one {way}: do the ids of one count from 0, and of the other from 1?",
            LandmarkMap(places, of_places),
        )


def _cause(log: Stretch, landmarks: LandmarkMap, found: list[Weighed]) -> str:
    """The change with which the map surely fits better than as it is: mirrored, another unit, or ids; "" without any.

    All sightings are used, because the first few may agree with the landmarks of a map in a wrong unit by chance.
    """
    drift = Drift(log)
    likely, most = "", max((float(np.mean(each.agree)) for each in found[:1]), default=0.0)
    for name, changed in (*_corrected(landmarks), *_numbered(landmarks)):
        rows = np.flatnonzero(np.isin(log.landmarks, list(changed)))
        fix = _searched(log, changed, rows, drift, first=len(rows))[0] if len(rows) else None
        if fix is None or fix.odds <= SURE or len(np.unique(log.landmarks[fix.agree])) <= 2:
            continue
        # in a joined log, whose drives may begin anywhere, a wrong unit may fit some of them
        share = len(fix.agree) / (len(fix.agree) + len(fix.disagree))
        if share > most:
            likely, most = f"; they would with the map {name}", share
        if share > SURE_SHARE:
            break
    return likely
