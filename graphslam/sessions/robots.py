"""Several robots that see each other, with a common clock, as one log.

A sighting of another robot is a measured relation of two poses at one instant, whose heading is not measured: from the
pose x_a of the robot that sees, range and bearing give the place of the other one,

    e = R(theta_a)' (p_b - p_a) - o - l (cos phi, sin phi),

with the covariance of a sighting of a landmark (`SensorModel.places`); o is the place of the sensor. With psi the heading is
measured, too. The other robot gets a pose at that instant, by cutting its controls (`continuous_time.with_poses_at`).

In a log such a sighting has the class "robot N", N the number of the other robot, and no id: whatever works with landmarks
does not use it, and corrects it like the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import LogError, OptionError, named
from ..log import Log
from ..log.continuous_time import CLOCK, nearest_of, with_poses_at
from ..log.join import joined_rows
from ..log.measurements import PoseRelations
from ..log.rows import robot_class
from ..models import SensorModel
from ..se2 import Array
from .drives import Sessions, join_logs, with_common_noise


def join_robots(robots: Mapping[int, Log], *, placed: bool = False) -> Sessions:
    """One log of several robots with a common clock, which see landmarks and each other.

    ``Graph.from_log(join_robots(robots).log)`` solves them together. The robots are put into one frame by the landmarks that
    they share (`join_logs`), and their sightings of each other become relations.

    Args:
        robots: {number: log}; sightings of robot N have the class "robot N". Logs differ in their noise models as robots do,
            and have the means in the joined one (`sessions.with_common_noise`). Their clocks are the same, or made so
            by `graphslam.sessions.clock_offsets`.
        placed: as in `join_logs`.

    Raises:
        OptionError: these are no logs by their numbers.
        LogError: the robots never saw each other while both drove: their clocks do not overlap, or no sighting has the class
            of a robot.
        GraphError: a robot shares no landmarks with those before, or its first sightings fit no place among them.
    """
    if not isinstance(robots, Mapping) or not all(isinstance(each, Log) for each in robots.values()):
        raise OptionError("join_robots takes logs by the numbers of their robots: join_robots({1: first, 2: second})")
    logs = dict(zip(robots, with_common_noise(list(robots.values()))))
    met = {(a, b): rows for a in logs for b in logs if a != b and len(rows := _meetings(logs[a], logs[b], b))}
    if len(logs) > 1 and not met:
        raise LogError(_never(logs))
    # a pose of each robot at the instants at which the others saw it
    finer = {
        b: with_poses_at(
            log, np.concatenate([np.zeros(0), *(_times(logs[a])[rows] for (a, c), rows in met.items() if c == b)])
        )
        for b, log in logs.items()
    }
    landmarks = {n: log.with_sightings(not_of_robots(log)) for n, log in finer.items()}
    joined = join_logs(list(landmarks.values()), placed=placed)
    start = dict(zip(logs, joined.starts))
    found = []
    for (a, b), rows in met.items():
        at = _times(logs[a])[rows]
        ends = [start[n] + nearest_of(_known(finer[n]), at) for n in (a, b)]
        found.append((*ends, logs[a].sightings[rows]))
    if not found:
        return joined
    first, second, sightings = (np.concatenate(column) for column in zip(*found))
    relations = relations_of(first, second, sightings, joined.log.sensor or SensorModel())
    notes = [f"{len(first):,} sightings of other robots are relations between two poses of one instant"]
    others = sum(len(meetings(logs[a], b)) for a in logs for b in logs if a != b) - len(first)
    if others:
        notes.append(
            f"{others:,} sightings of other robots are from times at which these did not drive, and are not used"
        )
    log = joined.log
    return replace(joined, log=log.replace(relations=joined_rows(log.relations, relations), notes=(*log.notes, *notes)))


def relations_of(first: np.ndarray, second: np.ndarray, sightings: Array, sensor: SensorModel) -> PoseRelations:
    """Sightings (R, 2 or 3) of the poses at steps ``second`` from those at ``first``, as relations."""
    places, covariances = sensor.places(sightings)
    if sightings.shape[1] == 3:
        return PoseRelations(first=first, second=second, motions=places, covariances=covariances)
    motions, full = np.full((len(first), 3), np.nan), np.zeros((len(first), 3, 3))
    motions[:, :2], full[:, :2, :2] = places, covariances
    return PoseRelations(first=first, second=second, motions=motions, covariances=full)


def not_of_robots(log: Log) -> np.ndarray:
    """Which sightings are of no robots, (M,) bool."""
    if log.classes is None or log.classes.dtype.kind != "U":
        return np.ones(len(log.steps), dtype=bool)
    return ~np.char.startswith(log.classes, robot_class(0)[:-1])


def meetings(log: Log, number: int) -> np.ndarray:
    """The rows of the sightings of robot ``number``."""
    if log.classes is None or log.classes.dtype.kind != "U":
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(log.classes == robot_class(number))


def _meetings(log: Log, other: Log, number: int) -> np.ndarray:
    """The rows of the sightings of robot ``number`` while it drove."""
    rows = meetings(log, number)
    if not len(rows):
        return rows
    at, known = _times(log)[rows], _known(other)
    return rows[(at >= known[0] - CLOCK) & (at <= known[-1] + CLOCK)]


def _known(log: Log) -> Array:
    if log.times is None:
        raise LogError(f"{log.name} has no controls, and robots are joined by the times of their poses")
    return log.times


def _times(log: Log) -> Array:
    """The time of each sighting (M,) [s]."""
    return _known(log)[log.steps]


def _never(logs: Mapping[int, Log]) -> str:
    """Why no robot saw another one."""
    if all(not_of_robots(log).all() for log in logs.values()):
        classes = ", ".join(repr(robot_class(number)) for number in list(logs)[:2])
        return f"no sighting has the class of another robot ({classes}, ...): join_logs joins logs by their landmarks alone"
    if not any(len(meetings(log, number)) for log in logs.values() for number in logs):
        seen = sorted({str(name) for log in logs.values() for name in np.asarray(log.classes)[~not_of_robots(log)]})
        return f"the robots saw {named(map(repr, seen))} only, and the logs are of robots {named(logs)}"
    spans = ", ".join(
        f"robot {n} from {log.times[0]:.1f} to {log.times[-1]:.1f} s"
        for n, log in logs.items()
        if log.times is not None
    )
    return f"the clocks of the robots do not overlap where they see each other: {spans}; are they in one time?"
