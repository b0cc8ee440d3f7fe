"""What a first association tells: the slip of the robot sideways, and parameters; and a competition of several starts.

**Slip.** The noise of motions is independent from one motion to the next, but slip on grass or on a slope lasts for minutes.
In a single motion it is small, and over long ways it adds up to far more than the model allows. Then odometry bends the map.
So motions are compared with the sightings over long ways. The graph is solved with motions that hardly hold the robot
sideways, with the variance c; r_t is what remains sideways of motion t, in the axes of its start, less the mean. R are the
sums of r over windows of N motions, V their variances by the solution. If sightings alone give a sum the variance s²,
then R = k (slip + error) with k = N c / (N c + s²) and V = k s². Therefore

    k = 1 - V / (N c),    variance of a motion = mean of (R² / k² - V / k) / N.

Motions across gaps in the odometry do not count: their noise says nothing about the slip of the others.

**Competition.** Several starts of an association compete by evidence until two of them end alike (`compete`). One start may
end in a wrong association that no single change improves. Another one, with other random numbers or by another method, then
ends elsewhere. Starts that end alike are the cheapest sign that the search did not fail.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..graph import Graph
from ..identification.corrections import corrected_log, corrected_sensor
from ..identification.declared import ParameterEstimate
from ..identification.odometry import ordinary
from ..log import Log
from ..maps.registration import evenly
from ..metrics import ate
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..solvers.solve import solve
from ..solvers.uncertainty import Uncertainty
from .assignment import evidence
from .map_solution import Backbone, MapSolution, Problem
from .problem import Densities, Field
from .refining import PROMISING, Refined, SearchResult, refine, search

#: the number of windows of a log over which slip is looked for, and the fewest motions of such a window
WINDOWS, SHORTEST = 30, 10
#: the standard deviation sideways of motions that hardly hold the robot, over the median distance of a motion
LOOSE = 0.1
#: the noise model is changed where the variance of the slip is more than this many times that of the model
MIN_VARIANCE_RATIO = 10.0
#: the least k of a window that counts: the share of the sum that the sightings determine
MIN_DETERMINED = 0.5
#: parameters have settled where they change by less than this [standard deviations]
FINE = 0.3
#: the most times that parameters are estimated from the ids, and ids found in the corrected log
FITS = 5
#: the parameters are solved for to this step norm per square root of the number of poses
ROUGH = 1e-4


@dataclass(frozen=True, eq=False)
class Robot:
    """A log and its noise models, given or corrected by a first association."""

    log: Log
    motion: MotionModel
    sensor: SensorModel
    estimate: ParameterEstimate | None = None

    @property
    def backbone(self) -> Backbone:
        """The motions and sightings as they enter graphs."""
        return Backbone.of(self.log, self.sensor, self.motion)

    def applied(self, problem: Problem) -> Problem:
        """A problem with this log and this noise."""
        return replace(problem, log=self.log, backbone=self.backbone, field=Field.of(self.log, self.sensor))

    def settled(self, before: ParameterEstimate | None) -> bool:
        """Whether the parameters are within `FINE` standard deviations of those before."""
        if before is None or self.estimate is None:
            return False
        deviations = np.array(list(self.estimate.deviations.values()))
        return bool(np.all(np.abs(self.estimate.values - before.values) < FINE * deviations))


def slipping(robot: Robot, labels: np.ndarray, poses: Array) -> Robot:
    """The robot with the slip of its log in its noise model, from labels (M,) and poses (T+1, 3)."""
    T = len(poses) - 1
    N = T // WINDOWS
    if N < SHORTEST or len(t := np.flatnonzero(ordinary(robot.log)[: T // N * N])) == 0:
        return robot
    usual = robot.backbone.motions
    far = np.hypot(*usual.measured[:, :2].T)
    loose = LOOSE * float(np.median(far[far > 0])) if np.any(far > 0) else 0.0
    if loose**2 <= robot.motion.epsilon:
        return robot
    free = replace(robot, motion=replace(robot.motion, epsilon=loose**2))
    solution = MapSolution.of(free.backbone, labels, poses)
    motions = solution.graph.families[-1]
    ends = motions.linearize(solution.state, solution.state)
    window, r = t // N, ends.residuals[t, 1]
    n = np.bincount(window, minlength=T // N)
    sums = np.bincount(window, r - r.mean(), len(n))
    rows = np.zeros((*solution.state.shape, len(n)))
    for nodes, B in zip(ends.nodes, ends.jacobians):
        # no node begins, or ends, two motions
        rows[nodes[t], :, window] += B[t, 1]
    V = np.einsum("nic,nic->c", rows, Uncertainty(solution.graph, solution.state).solve(rows))
    k = 1 - V / (np.maximum(n, 1) * loose**2)
    informed = (n > N / 2) & (k > MIN_DETERMINED)
    if np.count_nonzero(informed) < len(n) / 2:
        return robot
    n, k, V = n[informed], k[informed], V[informed]
    variance = float(np.mean((sums[informed] ** 2 / k**2 - V / k) / n))
    allowed = float(np.mean(np.linalg.inv(usual.information)[t, 1, 1]))
    if variance <= MIN_VARIANCE_RATIO * allowed:
        return robot
    slip = np.sqrt(robot.motion.slip**2 + (variance - allowed) / float(np.mean(far)))
    return replace(robot, motion=replace(robot.motion, slip=float(slip)))


def fitted(
    robot: Robot, recorded: Log, sensor: SensorModel, labels: np.ndarray, poses: Array, estimate: Mapping[str, float],
) -> tuple[Robot, Array]:  # fmt: skip
    """The robot with its log corrected by estimated parameters, and the poses that go with them.

    Args:
        robot: its noise of motion is used.
        recorded, sensor: the log as it was recorded, and the nominal sensor.
        labels, poses: (M,) and (T+1, 3).
        estimate: as `Graph.from_log` takes it.

    Raises:
        GraphError: the log does not determine the parameters.
    """
    kept = labels >= 0
    log = recorded.with_sightings(kept, landmarks=labels[kept], initial_poses=poses)
    graph = Graph.from_log(
        log, motion=robot.motion, sensor=sensor, edges="landmark+motion", kernel="none", estimate=estimate
    )
    solution = solve(graph, initialize="given", tolerance=ROUGH * len(poses) ** 0.5)
    assert solution.graph is not None and solution.graph.parameters is not None
    whole = replace(solution.graph.parameters, recorded=recorded)
    found = replace(robot, log=corrected_log(whole), sensor=corrected_sensor(whole), estimate=solution.parameters)
    return found, solution.poses


def adapted(robot: Robot, refined: Refined, estimate: Mapping[str, float], problem: Problem) -> Robot:
    """The robot with its slip, where the options ask for it, and with estimated parameters; the same if neither is found.

    Parameters and ids are found in turn until the parameters settle, at most `FITS` times.

    Raises:
        GraphError: the log does not determine the parameters.
    """
    given = robot
    if problem.options.slip:
        robot = slipping(robot, refined.labels, refined.solution.poses)
    poses = refined.solution.poses
    for _ in range(FITS if estimate else 0):
        before = robot.estimate
        robot, poses = fitted(robot, given.log, given.sensor, refined.labels, poses, estimate)
        if robot.settled(before) or (end := again(robot.applied(problem), refined, poses)) is None:
            break
        refined, poses = end, end.solution.poses
    return robot


def again(problem: Problem, refined: Refined, poses: Array) -> Refined | None:
    """Association and solving in turn with another robot, from labels that were found before, and poses (T+1, 3)."""
    return refine(replace(problem, densities=refined.densities), refined.labels, poses)


#: two aligned trajectories differ where the root mean square of their distance is above this [standard deviations of the
#: trajectory], and above this share of the greatest range
APART, LEAST = 0.5, 1e-3
#: the fewest sightings with a landmark of an association in which most are clutter; one more for each parameter
LEAST_SEEN = 3
#: the most poses from which the standard deviation of a trajectory is computed
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


def spread(solution: MapSolution) -> float:
    """The standard deviation of the positions of a solved graph beside moves of the whole, root mean square [m].

    With C the joint covariance of the positions of some poses, and P the projection that takes rigid motions out, it is the
    root of tr(P C P) per pose.
    """
    graph, chosen = solution.graph, evenly(len(solution.graph.steps), EXAMINED)
    K = len(chosen)
    right = np.zeros((*solution.state.shape, 2 * K))
    for axis in (0, 1):
        right[chosen, axis, axis * K + np.arange(K)] = 1.0
    C = Uncertainty(graph, solution.state).solve(right)[chosen, :2].transpose(1, 0, 2).reshape(2 * K, 2 * K)
    x, y = (solution.poses[chosen, :2] - solution.poses[chosen, :2].mean(axis=0)).T
    one, none = np.ones(K), np.zeros(K)
    rigid = np.linalg.qr(np.array([[*one, *none], [*none, *one], [*-y, *x]]).T)[0]
    return float(np.sqrt(max(np.trace(C) - np.trace(rigid.T @ C @ rigid), 0.0) / K))


def tolerance(solution: MapSolution, field: Field) -> float:
    """The distance [m] up to which two trajectories count as the same."""
    return max(APART * spread(solution), LEAST * field.farthest)


def compete(
    robot: Robot, starts: Iterable[Start | Callable[[], Start]], names: dict[str, float], problem: Problem
) -> Competition | None:
    """Compare starts by evidence, the first two in any case; None where all sightings may be clutter.

    Args:
        robot: the log and its noise models.
        starts: given, or functions that find them, which are called only where a start is needed.
        names: parameters to estimate.
        problem: of this robot; once ``options.agreeing`` starts end alike the others are skipped.

    Raises:
        GraphError: the log does not determine the parameters.
    """
    waiting, options = list(starts), problem.options

    def first(start: Start | Callable[[], Start]) -> Refined | None:
        # the noise and the parameters of the robot are by then those of the first starts
        labels, poses = start() if callable(start) else start
        return refine(problem, labels, poses)

    tried = min(options.agreeing or len(waiting), len(waiting))
    firsts = [end for start in waiting[:tried] if (end := first(start)) is not None]
    waiting = waiting[tried:]
    # where a start finds no landmark, another one may find a few by chance
    if len(firsts) < tried and all(np.mean(end.labels < 0) > 0.5 for end in firsts):
        return None
    # the robot's parameters from the best of them are used for all
    shared = Densities.mean([end.densities for end in firsts])
    likely = int(np.argmax([evidence(replace(problem, densities=shared), end.solution) for end in firsts]))
    given, robot = robot, adapted(robot, firsts[likely], names, problem)
    if robot is not given:
        problem = robot.applied(problem)
        firsts = [end for each in firsts if (end := again(problem, each, each.solution.poses)) is not None] or firsts
    ends: list[SearchResult] = []
    begun: list[Refined] = []
    while True:
        for each in firsts:
            # the same labels lead to the same end
            same = [k for k, other in enumerate(begun) if np.array_equal(other.labels, each.labels)]
            ends.append(ends[same[0]] if same else search(problem, each))
            begun.append(each)
        shared = Densities.mean([end.refined.densities for end in ends])
        values = [evidence(replace(problem, densities=shared), end.refined.solution) for end in ends]
        best = ends[int(np.argmax(values))].refined.solution
        near = tolerance(best, problem.field)
        likely_ends = [end for value, end in zip(values, ends, strict=True) if value > max(values) - PROMISING]
        alike = sum(ate(best.poses, end.refined.solution.poses) <= near for end in likely_ends)
        if alike >= options.agreeing > 0 or not waiting:
            labels = ends[int(np.argmax(values))].refined.labels
            if np.count_nonzero(labels >= 0) < LEAST_SEEN + len(names) and np.mean(labels < 0) > 0.5:
                # a pair among many sightings that agree with none may agree by chance
                return None
            return Competition(robot, ends, values, len(waiting))
        end = first(waiting.pop(0))
        firsts = [] if end is None else [end]
