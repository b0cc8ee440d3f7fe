"""Estimates from a first association: the slip of the robot sideways, and parameters of vehicle and sensor.

The noise of motions is independent from one motion to the next, but slip on grass or on a slope lasts for minutes. In a
single motion it is small, and over long ways it adds up to far more than the model allows. Then odometry bends the map. So
motions are compared with the sightings over long ways. The graph is solved with motions that hardly hold the robot
sideways, with the variance c; r_t is what remains sideways of motion t, in the axes of its start, less the mean. R are the
sums of r over windows of N motions, V their variances by the solution. If sightings alone give a sum the variance s²,
then R = k (slip + error) with k = N c / (N c + s²) and V = k s². Therefore

    k = 1 - V / (N c),    variance of a motion = mean of (R² / k² - V / k) / N.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..graph import Graph
from ..log import Log
from ..models import MotionModel, SensorModel
from ..parameters.corrections import corrected_log, corrected_sensor
from ..parameters.declared import ParameterEstimate, parsed
from ..se2 import Array
from ..solvers.solve import solve
from ..uncertainty import Uncertainty
from .classes import Classes
from .densities import Field
from .map_solution import Backbone, MapSolution
from .options import AssociationOptions
from .refining import Refined, refine

#: slip is looked for over windows of one part in so many of the log, where such a window has at least so many motions
WINDOWS, SHORTEST = 30, 10
#: the standard deviation sideways of motions that hardly hold the robot, over the median distance of a motion
LOOSE = 0.1
#: the noise model stays unless the slip has more than so many times its variance
CLEAR = 10.0
#: windows are left out where the sightings determine less than this part of the sum
MIN_INFORMATION = 0.5
#: parameters that change by less than this part of their standard deviations have settled
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
    if N < SHORTEST:
        return robot
    usual = robot.backbone.motions
    far = np.hypot(*usual.measured[:, :2].T)
    loose = LOOSE * float(np.median(far[far > 0])) if np.any(far > 0) else 0.0
    if loose**2 <= robot.motion.epsilon:
        return robot
    free = replace(robot, motion=replace(robot.motion, epsilon=loose**2))
    solved = MapSolution.of(free.backbone, labels, poses)
    motions = solved.graph.families[-1]
    ends = motions.linearize(solved.state, solved.state)
    count = T // N
    window, r = np.arange(count * N) // N, ends.residuals[: count * N, 1]
    sums = np.bincount(window, r - r.mean())
    rows = np.zeros((*solved.state.shape, count))
    for nodes, B in zip(ends.nodes, ends.jacobians):
        # no node begins, or ends, two motions
        rows[nodes[: count * N], :, window] += B[: count * N, 1]
    V = np.einsum("nic,nic->c", rows, Uncertainty(solved.graph, solved.state).solve(rows))
    k = 1 - V / (N * loose**2)
    informed = k > MIN_INFORMATION
    if np.count_nonzero(informed) < count / 2:
        return robot
    variance = float(np.mean(sums[informed] ** 2 / k[informed] ** 2 - V[informed] / k[informed])) / N
    allowed = float(np.mean(np.linalg.inv(usual.information)[:, 1, 1]))
    if variance <= CLEAR * allowed:
        return robot
    slip = np.sqrt(robot.motion.slip**2 + (variance - allowed) / float(np.mean(far)))
    return replace(robot, motion=replace(robot.motion, slip=float(slip)))


def fitted(
    robot: Robot, recorded: Log, sensor: SensorModel, labels: np.ndarray, poses: Array,
    estimate: Mapping[str, float | None],
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


def wanted(estimate: str | Mapping[str, float | None] | tuple[str, ...] | list[str] | None) -> dict[str, float | None]:
    """The parameters to estimate, as `Graph.from_log` takes them.

    Raises:
        OptionError: there is no such parameter, or its prior is impossible.
    """
    return {
        name: None if np.isinf(value) else value for name, value in parsed(() if estimate is None else estimate).items()
    }


def adapted(
    robot: Robot, refined: Refined, estimate: Mapping[str, float | None], classes: Classes, options: AssociationOptions
) -> Robot:  # fmt: skip
    """The robot with its slip, where the options ask for it, and with estimated parameters; the same if neither is found.

    Parameters and ids are found in turn until the parameters settle, at most `FITS` times.

    Raises:
        GraphError: the log does not determine the parameters.
    """
    given = robot
    if options.slip:
        robot = slipping(robot, refined.labels, refined.solved.poses)
    poses = refined.solved.poses
    for _ in range(FITS if estimate else 0):
        before = robot.estimate
        robot, poses = fitted(robot, given.log, given.sensor, refined.labels, poses, estimate)
        if robot.settled(before) or (end := again(robot, refined, classes, options, poses)) is None:
            break
        refined, poses = end, end.solved.poses
    return robot


def again(
    robot: Robot, refined: Refined, classes: Classes, options: AssociationOptions, poses: Array | None = None
) -> Refined | None:  # fmt: skip
    """Association and solving in turn with another robot, from labels that were found before, and poses (T+1, 3)."""
    poses, field = refined.solved.poses if poses is None else poses, Field.of(robot.log, robot.sensor)
    return refine(robot.log, robot.backbone, refined.labels, poses, field, refined.densities, classes, options)
