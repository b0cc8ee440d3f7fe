"""Maps that are there twice, because odometry missed a motion: how they are found (`leaps`), and repaired (`repaired`).

A bump, wheels that spin, or hands that lift the robot move it without its odometry. What it sees from there on fits no
landmark of its map, and becomes a second map beside the first one. The evidence prefers it: a few dozen landmarks cost less
than a motion of twenty standard deviations, and no alternative that is solved with the same odometry is likelier.

So it is looked for by itself (`leaps`). At a step t the map begins again where

- of the landmarks seen in the moment from t on hardly any had been seen before (`NEW`),
- landmarks of before should have been in view then, or those of afterwards before t, and were not seen; with n such views the
  evidence against it is -n log(1 - P_D) > log(`SURE`),
- and the landmarks from t on are a constellation of those before (`maps.constellation`): with a rigid motion T at least
  `FEWEST` coincide within their covariances, and the evidence for T over none is above log(`SURE`).

The covariances are those given the pose at t, and given the last pose with sightings before it, so that the drift of the
odometry up to there, which all landmarks share, does not blur the constellation.

**Repair.** Such a motion becomes one that is not known. A leap is tried as another solution. Landmarks from its step on that
repeat older ones get their labels, the poses from there on are moved, and the controls of the gap before the step have an
additional variance: together that of a motion as far as the sensor sees, with any turn. From there association and solving
compete as before, and both ends are compared by

    E + 1/2 sum over motions of log det(W / 2 pi) - n log(`SURE`),

E of `assignment.evidence`, W the information of a motion, and n the number of repairs: a motion that is not known is paid by
its wide density, and by the odds against it. The repaired one is taken where it is likelier by more than `SURE`.

Two rooms that look alike, each hidden from the other by a wall, look like a map that is there twice. What tells them apart
is where the landmarks are: between two rooms there is a straight wall, and a map that is there twice overlaps (`_overlap`).
Where it does not, the map stays as it is, and the verdict doubts it; except across a motion that the log itself says is not
known (`_free`): that may have put the copies anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..edges import ANCHOR_INFORMATION, AnchorEdges
from ..engine import engine
from ..errors import GraphError
from ..identification.odometry import ordinary
from ..log import Log
from ..maps.constellation import Constellations, Merged, match
from ..maps.landmark_map import LandmarkMap
from ..maps.localization import FEWEST, SURE
from ..maps.registration import GATE
from ..models import additional_variances
from ..se2 import Array, between, chained, compose, difference, in_frame, inverse
from ..solvers.uncertainty import Uncertainty
from .adapting import Competition, Robot, Start, compete
from .assignment import evidence
from .map_solution import MapSolution, Problem
from .problem import HELD, INSIDE, Densities, id_of_each
from .refining import Refined, assigned

#: the least share of the landmarks seen in the moment after a step that are new
NEW = 0.75
#: the most steps of a log that are examined
EXAMINED = 8


@dataclass(frozen=True)
class Leap:
    """A step from which on landmarks repeat those before it, moved.

    Attributes:
        step: the first one.
        last: the last step before it with sightings.
        again: how many landmarks coincide with older ones.
        of: how many landmarks are new from the step on, or in the moment after it.
        motion: what odometry missed, in the axes of the robot at ``step`` [m, m, rad].
        evidence: its logarithm, for the constellation over none.
        pairs: the labels of the landmarks that coincide, (new, older) each.
    """

    step: int
    last: int
    again: int
    of: int
    motion: tuple[float, float, float]
    evidence: float
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def missed(self) -> str:
        """The motion in words."""
        x, y, theta = self.motion
        way = f"{x:.2f} m forward, {y:.2f} m to the left, {theta:.2f} rad"
        return f"odometry missed a motion between steps {self.last} and {self.step} ({way})"

    def __str__(self) -> str:
        return (
            f"from step {self.step} on hardly any landmark of before is seen again, and {self.again} of the {self.of} new "
            f"ones repeat older ones: either {self.missed}, so that the map is there twice, or two places look alike"
        )


def leaps(problem: Problem, solution: MapSolution) -> tuple[Leap, ...]:
    """The steps from which on the landmarks of a solved graph repeat those before, by decreasing evidence."""
    of_each = solution.seen(problem.log.steps)
    first = np.array([each[0] for each in of_each])
    found = []
    for step, last in _beginnings(problem, of_each):
        unseen = -_views_missed(problem, solution, of_each, step) * problem.densities.missed
        if unseen < np.log(SURE):
            continue
        # those of later on may be of other places, or those of the moment too few
        soon, new = (np.flatnonzero((first >= step) & (first < end)) for end in (step + problem.moment, np.inf))
        old = np.flatnonzero(first < step)
        each = [_repeated(problem, solution, old, group, last, step) for group in (soon, new)]
        found += sorted((leap for leap in each if leap), key=lambda leap: -leap.evidence)[:1]
    return tuple(sorted(found, key=lambda leap: -leap.evidence))


def _beginnings(problem: Problem, of_each: list[np.ndarray]) -> list[tuple[int, int]]:
    """Steps where nearly all that is seen is new, the best of each half moment, with the last scan before them."""
    moment, scans = problem.moment, np.unique(problem.log.steps)
    ends = np.concatenate([np.unique(each) for each in of_each])
    before = np.concatenate([np.append(-1, np.unique(each)[:-1]) for each in of_each])
    at_first, count = before < 0, problem.log.num_poses
    first = np.sort(ends[at_first])
    # a landmark is seen soon from the step after it was last seen on, and at most a moment before it is seen again
    begins = np.maximum(before + 1, ends - moment + 1)
    soon, fresh = _counts(begins, ends, count), _counts(begins[at_first], ends[at_first], count)
    old = np.searchsorted(first, scans)
    enough = np.minimum(old, len(first) - old) >= FEWEST
    share = np.where(enough, fresh[scans] / np.maximum(soon[scans], 1), 0.0)
    # where few had been seen before, or few new ones follow, a step says little
    weight = np.where(share >= NEW, share * np.minimum(fresh[scans], old), 0.0)
    found: list[tuple[int, int]] = []
    for k in np.argsort(-weight, kind="stable").tolist():
        if weight[k] == 0 or len(found) == EXAMINED:
            break
        if all(abs(scans[k] - other) > moment / 2 for other, _ in found):
            found.append((int(scans[k]), int(scans[k - 1])))
    return found


def _counts(begins: np.ndarray, ends: np.ndarray, count: int) -> np.ndarray:
    """How many of the intervals, with their ends, contain each of the steps 0 to count - 1."""
    change = np.bincount(begins, minlength=count + 1) - np.bincount(ends + 1, minlength=count + 1)
    return np.asarray(np.cumsum(change)[:count])


def _views_missed(problem: Problem, solution: MapSolution, of_each: list[np.ndarray], step: int) -> int:
    """How often landmarks of one side of a step should have been in view in the moment on the other side, and were not."""
    scans, moment = np.unique(problem.log.steps), problem.moment
    field, origin = problem.field, np.array(problem.backbone.origin)
    cosine = np.cos(min(field.bearing * INSIDE, np.pi))
    limits = np.array([[field.nearest / INSIDE, field.farthest * INSIDE, cosine]])
    count = 0
    for begin, end, other in ((step, step + moment, True), (step - moment, step, False)):
        inside = scans[(scans >= begin) & (scans < end)]
        absent = [np.searchsorted(each, begin) == np.searchsorted(each, end) for each in of_each]
        side = [bool(each[0] < step) == other for each in of_each]
        chosen = np.flatnonzero(np.array(absent) & np.array(side))
        if len(chosen) and len(inside):
            count += int(engine.count_views(solution.poses[inside], solution.landmarks[chosen], origin, limits).sum())
    return count


def _repeated(
    problem: Problem, solution: MapSolution, old: np.ndarray, new: np.ndarray, last: int, step: int
) -> Leap | None:
    """The leap if landmarks ``new`` from a step on are a constellation of ``old`` ones, up to the ``last`` scan before it."""
    if len(new) < FEWEST:
        return None
    C, places = _given_pose(solution, last), solution.landmarks
    known = LandmarkMap({int(j): places[j] for j in old}, {int(j): C[j] for j in old})
    own = LandmarkMap({int(j): places[j] for j in new}, dict(zip(new.tolist(), _given_pose(solution, step)[new])))
    counts = np.bincount(solution.which, minlength=len(places))[new]
    constellation = Constellations.of(known, problem.field.farthest)
    if not len(constellation.pairs):
        return None
    found = match(Merged(*own.arrays(own), counts, np.zeros(0, dtype=int)), constellation)
    if not found:
        return None
    best, where = found[0]
    agree = np.flatnonzero(best.agree & (where >= 0))
    a, b = new[agree], old[where[agree]]
    ids = id_of_each(solution.which, problem.backbone.known[solution.rows], len(places))
    one = (ids[a] < 0) | (ids[b] < 0) | (ids[a] == ids[b])
    shown = problem.classes.sums(solution.which, solution.rows, len(places))
    total = best.evidence + float(problem.classes.together(shown[a], shown[b]).sum())
    if one.sum() < FEWEST or total < np.log(SURE):
        return None
    x, y, theta = between(solution.poses[step], compose(best.pose, solution.poses[step])).tolist()
    pairs = tuple(zip(solution.labels[a[one]].tolist(), solution.labels[b[one]].tolist()))
    return Leap(step, last, len(pairs), len(new), (x, y, theta), total, pairs)


def _given_pose(solution: MapSolution, step: int) -> Array:
    """The covariances (L, d, d) of the landmarks where the pose of a step is known."""
    graph, d = solution.graph, solution.graph.landmark_dimension
    anchor = AnchorEdges(np.full(1, step), solution.poses[step : step + 1].copy(), ANCHOR_INFORMATION[None])
    held = graph.with_families((anchor, *graph.families[1:]))
    return Uncertainty(held, solution.state).diagonal[len(graph.steps) :, :d, :d]


#: the most motions of a log that are repaired
MOST = 4
#: two sets of landmarks overlap where they do when drawn in to this share of their size
MIDDLE = 0.7


def repaired(
    competition: Competition, robot: Robot, names: dict[str, float], problem: Problem
) -> tuple[Competition, tuple[Leap, ...], tuple[Leap, ...]]:
    """The competition after motions that odometry missed are taken for unknown ones; these, and the leaps that remain.

    Args:
        competition: of the starts of a log.
        robot: its log and its noise models as they were given, and the ``problem`` of these.
        names: parameters to estimate.
    """
    done: tuple[Leap, ...] = ()
    while True:
        own, best = competition.robot.applied(problem), competition.ends[competition.best].refined
        found = leaps(replace(own, densities=best.densities), best.solution)
        for leap in found if len(done) < MOST else ():
            if not (_overlap(best.solution, leap) or _free(own, best.solution, leap)):
                continue
            starts = [_moved(own, end.refined, leap) for end in competition.ends]
            if (trial := _tried(competition, robot, names, own, leap, starts)) is not None:
                trial = _wider(competition, robot, names, own, trial)
                competition, robot, done = trial.competition, trial.robot, (*done, trial.leap)
                break
        else:
            return competition, done, found


@dataclass(frozen=True, eq=False)
class Trial:
    """A competition with a leap, the robot whose log has it, and by how much its evidence is higher than without [nats]."""

    competition: Competition
    robot: Robot
    leap: Leap
    gain: float


def with_unknown_motions(log: Log, found: tuple[Leap, ...]) -> Log:
    """The log with the variance of a motion as far as the sensor sees, with any turn, in the gap before each leap."""
    if not found:
        return log
    assert log.controls is not None and log.dt is not None
    variances = additional_variances(log.control_variances, len(log.controls))
    reach = float(np.quantile(log.sightings[:, 0], HELD))
    for leap in found:
        gap = slice(log.control_starts[leap.last], log.control_starts[leap.step])
        speeds = 1 / (log.dt[gap] ** 2 * len(log.dt[gap]))
        variances[gap] += speeds[:, None] * [reach**2, np.pi**2, reach**2]
    return log.replace(control_variances=variances)


def _tried(
    before: Competition, robot: Robot, names: dict[str, float], problem: Problem, leap: Leap, starts: list[Start]
) -> Trial | None:
    """The competition of starts with a leap, None where it is not sure to be better than the one ``before``.

    The ends of that are rivals of its best end.
    """
    freed = replace(robot, log=with_unknown_motions(robot.log, (leap,)))
    try:
        other = compete(freed, starts, names, freed.applied(problem))
    except GraphError:
        return None
    if other is None:
        return None
    end = other.ends[other.best]
    with_it, without = other.robot.applied(problem), before.ends[before.best].refined
    shared = Densities.mean([without.densities, end.refined.densities])
    total = _evidence(replace(with_it, densities=shared), end.refined.solution) - np.log(SURE)
    rivals = [
        (total - _evidence(replace(problem, densities=shared), each.refined.solution), each.refined.solution.poses)
        for each in before.ends
    ]
    gain = min(gain for gain, _ in rivals)
    if gain < np.log(SURE):
        return None
    ends = [replace(each, rivals=[*each.rivals, *rivals]) if each is end else each for each in other.ends]
    x = end.refined.solution.poses
    expected = chained(x[leap.last], with_it.backbone.motions.measured[leap.last : leap.step])[-1]
    forward, left, turn = between(expected, x[leap.step]).tolist()
    return Trial(replace(other, ends=ends), freed, replace(leap, motion=(forward, left, turn)), gain)


def _wider(before: Competition, robot: Robot, names: dict[str, float], problem: Problem, trial: Trial) -> Trial:
    """The trial with a gap that contains the scans beside it that hardly fit the map, where that is better.

    Wheels may spin during several scans, or the first ones after a motion have been taken for some from before it.
    """
    own, best = trial.robot.applied(problem), trial.competition.ends[trial.competition.best].refined
    scans, which = np.unique(problem.log.steps, return_inverse=True)
    fits = np.bincount(which, best.labels >= 0) > np.bincount(which) / 2
    before_it, after = scans[fits & (scans <= trial.leap.last)], scans[fits & (scans >= trial.leap.step)]
    if not len(before_it) or not len(after):
        return trial
    leap = replace(trial.leap, last=int(before_it[-1]), step=int(after[0]))
    if leap == trial.leap:
        return trial
    starts = [_across(own, end.refined, leap) for end in trial.competition.ends]
    wider = _tried(before, robot, names, problem, leap, starts)
    return trial if wider is None or wider.gain < trial.gain else wider


def _across(problem: Problem, refined: Refined, leap: Leap) -> Start:
    """Labels and poses where the robot stood still in the gap of a leap, or moved as odometry says before or after it.

    Whichever explains most sightings.
    """
    x, (last, step) = refined.solution.poses, (leap.last, leap.step)
    moved = problem.backbone.motions.measured[last:step]
    ahead = chained(x[last], moved)[:-1]
    steps = problem.log.steps
    inside = (steps > last) & (steps < step)
    found = []
    # the poses from which these motions lead to the origin, one after the other
    back = chained(np.zeros(3), inverse(moved[::-1]))[:0:-1]
    for way in (np.repeat(x[last : last + 1], step - last, axis=0), ahead, in_frame(x[step], back)):
        poses = np.concatenate([x[: last + 1], way[1:], x[step:]])
        labels, _ = assigned(problem, problem.backbone.places.seen_at(poses[steps]), refined.solution)
        found.append((np.where(inside, labels, refined.labels), poses))
    return max(found, key=lambda each: np.count_nonzero(each[0] >= 0))


def _moved(problem: Problem, refined: Refined, leap: Leap) -> Start:
    """Labels and poses with the leap, as this end has it; those of the end where it has none."""
    labels, poses = refined.labels, refined.solution.poses
    for own in leaps(replace(problem, densities=refined.densities), refined.solution):
        if abs(own.step - leap.step) <= problem.moment / 2:
            merged = np.arange(-1, labels.max(initial=-1) + 1)
            new, old = np.array(own.pairs).T
            merged[new + 1] = old
            # across a free motion some may have been joined to older landmarks by chance; they are assigned again
            later = problem.log.steps >= own.step
            joined = later & np.isin(labels, labels[~later])
            begin = poses[own.step]
            after = compose(compose(begin, np.array(own.motion)), between(begin, poses[own.step :]))
            return np.where(joined, -1, merged[labels + 1]), np.concatenate([poses[: own.step], after])
    return labels, poses


def _evidence(problem: Problem, solution: MapSolution) -> float:
    """The evidence for a solved graph with the densities of its motions, whose noise may be another one; see the module."""
    return evidence(problem, solution) + 0.5 * float(np.linalg.slogdet(problem.backbone.motions.information)[1].sum())


def _overlap(solution: MapSolution, leap: Leap) -> bool:
    """Whether the landmarks of a leap and the older ones that they repeat overlap, so that no straight wall is between them.

    For no direction n is the lowest n'a of one set above the highest n'b of the other, each drawn in by `MIDDLE`.
    """
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    n = np.array([np.cos(angles), np.sin(angles)])
    new, old = (solution.landmarks[np.searchsorted(solution.labels, each), :2] for each in np.array(leap.pairs).T)
    a, b = ((m.mean(axis=0) + MIDDLE * (m - m.mean(axis=0))) @ n for m in (new, old))
    return bool(np.all(a.min(axis=0) < b.max(axis=0)))


def _free(problem: Problem, solution: MapSolution, leap: Leap) -> bool:
    """Whether the log says by itself that a motion in the gap of a leap is not known, so widely that the leap agrees."""
    gap, x = slice(leap.last, leap.step), solution.poses
    if ordinary(problem.log)[gap].all():
        return False
    motions = problem.backbone.motions
    after = compose(x[leap.step], np.array(leap.motion))
    off = difference(between(x[leap.last], after), chained(np.zeros(3), motions.measured[gap])[-1])
    return bool(off @ np.linalg.solve(np.linalg.inv(motions.information[gap]).sum(axis=0), off) <= GATE)
