"""Motions that odometry did not measure: a map that begins again at a step, and repeats what was there before.

A bump, wheels that spin, or hands that lift the robot move it without its odometry. What it sees from there on fits no
landmark of its map, and becomes a second map beside the first one. The evidence prefers it: a few dozen landmarks cost less
than a motion of twenty standard deviations, and no alternative that is solved with the same odometry is likelier.

So it is looked for by itself (`leaps`). At a step t the map begins again where

- of the landmarks seen in the moment from t on hardly any had been seen before (`NEW`),
- landmarks of before should have been in view then, or those of afterwards before t, and were not seen; with n such views the
  evidence against it is -n log(1 - P_D) > log(`SURE`),
- and the landmarks from t on are a constellation of those before (`graph.constellation`): with a rigid motion T at least
  `FEWEST` coincide within their covariances, and the evidence for T over none is above log(`SURE`).

The covariances are those given the pose at t, and given the last pose with sightings before it, so that the drift of the
odometry up to there, which all landmarks share, does not blur the constellation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..edges import ANCHOR_INFORMATION, AnchorEdges
from ..engine import engine
from ..graph.constellation import Constellations, Merged, match
from ..graph.landmark_map import LandmarkMap
from ..graph.localization import FEWEST, SURE
from ..se2 import Array, between, compose
from ..solvers.uncertainty import Uncertainty
from .map_solution import MapSolution, Problem
from .problem import INSIDE, id_of_each

#: the least share of the landmarks seen in the moment after a step that are new
NEW = 0.75
#: the most steps of a log that are examined
MOST = 8


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
        return (
            f"odometry missed a motion between steps {self.last} and {self.step} ({x:.2f} m forward, {y:.2f} m to the left, "
            f"{theta:.2f} rad)"
        )

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
        if weight[k] == 0 or len(found) == MOST:
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
