"""Repair of maps that are there twice: a motion that odometry missed (`association.leaps`) becomes one that is not known.

A leap is tried as another solution. Landmarks from its step on that repeat older ones get their labels, the poses from there
on are moved, and the controls of the gap before the step have an additional variance: together that of a motion as far as
the sensor sees, with any turn. From there association and solving compete as before, and both ends are compared by

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

from ..errors import GraphError
from ..graph.localization import SURE
from ..graph.registration import GATE
from ..identification.odometry import ordinary
from ..log import Log
from ..models import additional_variances
from ..se2 import Array, between, chained, compose, difference, in_frame, inverse
from .adapting import Competition, Robot, Start, compete
from .assignment import evidence
from .leaps import Leap, leaps
from .map_solution import MapSolution, Problem
from .problem import HELD, Densities
from .refining import Refined, assigned

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
            trial = _tried(competition, robot, names, own, leap, starts)
            if trial is not None:
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
    for way in (np.repeat(x[last : last + 1], step - last, axis=0), ahead, in_frame(x[step], _back(moved))):
        poses = np.concatenate([x[: last + 1], way[1:], x[step:]])
        labels, _ = assigned(problem, problem.backbone.places.seen_at(poses[steps]), refined.solution)
        found.append((np.where(inside, labels, refined.labels), poses))
    return max(found, key=lambda each: np.count_nonzero(each[0] >= 0))


def _back(motions: Array) -> Array:
    """The poses (T, 3) from which motions (T, 3) lead to the origin, one after the other."""
    return chained(np.zeros(3), inverse(motions[::-1]))[:0:-1]


def _moved(problem: Problem, refined: Refined, leap: Leap) -> Start:
    """Labels and poses with the leap, as this end has it; those of the end where it has none."""
    labels, poses = refined.labels, refined.solution.poses
    found = leaps(replace(problem, densities=refined.densities), refined.solution)
    for own in found:
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
