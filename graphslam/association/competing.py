"""Several starts of an association compete by evidence, until two of them end alike.

One start may end in a wrong association that no single change improves. Another one, with other random numbers or by
another method, then ends elsewhere. Starts that end alike are the cheapest sign that the search did not fail.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..metrics import ate
from ..se2 import Array
from ..uncertainty import Uncertainty
from .adapting import Robot, adapted, again
from .classes import Classes
from .densities import Densities, Field
from .evidence import evidence
from .map_solution import MapSolution
from .options import AssociationOptions
from .refining import Refined, refine
from .search import PROMISING, SearchResult, search

#: a trajectory is another one if, aligned, it is this much of its standard deviation away, root mean square, but at least
#: this part of the greatest range
APART, LEAST = 0.5, 1e-3
#: fewer sightings with a landmark, and one more for each parameter, are no association where most are clutter
LEAST_SEEN = 3
#: the standard deviation is that of at most so many poses
EXAMINED = 24

#: ids (M,) and poses (T+1, 3)
Start = tuple[np.ndarray, Array]


@dataclass(frozen=True, eq=False)
class Competition:
    """The ends of all starts, with the evidence for each, by the same densities.

    Attributes:
        robot: with the slip and the parameters that the best first association showed.
        ends, values: of each start that was used; starts that were alike before alternatives were tried share an end.
        skipped: how many starts were not used, because others ended alike.
    """

    robot: Robot
    ends: list[SearchResult]
    values: list[float]
    skipped: int

    @property
    def best(self) -> int:
        """The end with the highest evidence."""
        return int(np.argmax(self.values))


def spread(solved: MapSolution) -> float:
    """The standard deviation of the positions of a solved graph beside moves of the whole, root mean square [m].

    With C the joint covariance of the positions of some poses, and P the projection that takes rigid motions out, it is the
    root of tr(P C P) per pose.
    """
    graph, count = solved.graph, min(EXAMINED, len(solved.graph.steps))
    chosen = np.unique(np.linspace(0, len(graph.steps) - 1, count).round().astype(int))
    K = len(chosen)
    right = np.zeros((*solved.state.shape, 2 * K))
    for axis in (0, 1):
        right[chosen, axis, axis * K + np.arange(K)] = 1.0
    C = Uncertainty(graph, solved.state).solve(right)[chosen, :2].transpose(1, 0, 2).reshape(2 * K, 2 * K)
    x, y = (solved.poses[chosen, :2] - solved.poses[chosen, :2].mean(axis=0)).T
    one, none = np.ones(K), np.zeros(K)
    rigid = np.linalg.qr(np.array([[*one, *none], [*none, *one], [*-y, *x]]).T)[0]
    return float(np.sqrt(max(np.trace(C) - np.trace(rigid.T @ C @ rigid), 0.0) / K))


def tolerance(solved: MapSolution, field: Field) -> float:
    """The distance [m] up to which two trajectories count as the same."""
    return max(APART * spread(solved), LEAST * field.farthest)


def compete(
    robot: Robot, starts: Iterable[Start | Callable[[], Start]], names: dict[str, float | None], densities: Densities,
    classes: Classes, options: AssociationOptions,
) -> Competition | None:  # fmt: skip
    """Compare starts by evidence, the first two in any case; None where all sightings may be clutter.

    Args:
        robot: the log and its noise models.
        starts: given, or functions that find them, which are called only where a start is needed.
        names: parameters to estimate.
        densities, classes: before the log is known.
        options: the options; once ``options.agreeing`` starts end alike the others are skipped.

    Raises:
        GraphError: the log does not determine the parameters.
    """
    waiting = list(starts)
    backbone, field = robot.backbone, Field.of(robot.log, robot.sensor)

    def first(start: Start | Callable[[], Start]) -> Refined | None:
        # the noise and the parameters of the robot are by then those of the first starts
        labels, poses = start() if callable(start) else start
        return refine(robot.log, backbone, labels, poses, field, densities, classes, options)

    firsts: list[Refined] = []
    used = min(options.agreeing or len(waiting), len(waiting))
    tried = used
    while waiting and used > 0:
        used -= 1
        if (end := first(waiting.pop(0))) is not None:
            firsts.append(end)
    # where a start finds no landmark, another one may find a few by chance
    if len(firsts) < tried and all(np.mean(end.labels < 0) > 0.5 for end in firsts):
        return None
    # the robot's parameters from the best of them are used for all
    shared = Densities.mean([end.densities for end in firsts])
    likely = int(np.argmax([evidence(robot.log, backbone, end.solved, field, shared) for end in firsts]))
    given, robot = robot, adapted(robot, firsts[likely], names, classes, options)

    log = robot.log
    if robot is not given:
        backbone, field = robot.backbone, Field.of(log, robot.sensor)
        firsts = [end for each in firsts if (end := again(robot, each, classes, options)) is not None] or firsts
    ends: list[SearchResult] = []
    begun: list[Refined] = []
    while True:
        for each in firsts:
            # the same labels lead to the same end
            same = [k for k, other in enumerate(begun) if np.array_equal(other.labels, each.labels)]
            ends.append(ends[same[0]] if same else search(log, backbone, each, field, classes, options))
            begun.append(each)
        shared = Densities.mean([end.refined.densities for end in ends])
        values = [evidence(log, backbone, end.refined.solved, field, shared) for end in ends]
        best = ends[int(np.argmax(values))].refined.solved
        near = tolerance(best, field)
        alike = [
            value > max(values) - PROMISING and ate(best.poses, end.refined.solved.poses) <= near
            for value, end in zip(values, ends, strict=True)
        ]
        if sum(alike) >= options.agreeing > 0 or not waiting:
            labels = ends[int(np.argmax(values))].refined.labels
            if np.count_nonzero(labels >= 0) < LEAST_SEEN + len(names) and np.mean(labels < 0) > 0.5:
                # a pair among many sightings that agree with none may agree by chance
                return None
            return Competition(robot, ends, values, len(waiting))
        end = first(waiting.pop(0))
        firsts = [] if end is None else [end]
