"""Several logs as one: drives of one place, which their common landmarks tie, and robots that see each other.

**Drives.** Each keeps its own odometry. Between the end of a drive and the start of the next, the robot may have gone
anywhere. The log has a control there that says nothing, with the variances `ANYWHERE`, so that all solvers of graphs and all
checks take it like any other log, and it knows its `Log.sessions`. The start values matter: each drive is put where its first
sightings fit the map of those before (`first_fix`).

**Without ids.** Each log is associated alone, and their maps are matched:

1. Each log gets ids, a trajectory and a map of its own (`associate_from`).
2. The map of each log is a constellation that is looked for in the map of those before (`maps.constellation.match`), and the
   log is followed through that map (`maps.tracking`). Landmarks that agree get one id.
3. From both starts the graph of all logs so far is solved, and association and solving take turns
   (`association.refining`), which merges landmarks that the drift of a log had held apart. The end with more evidence counts.

**Robots** with a common clock. A sighting of another robot is a measured relation of two poses at one instant, whose heading
is not measured: from the pose x_a of the robot that sees, range and bearing give the place of the other one,

    e = R(theta_a)' (p_b - p_a) - o - l (cos phi, sin phi),

with the covariance of a sighting of a landmark (`SensorModel.places`); o is the place of the sensor. With psi the heading is
measured, too. The other robot gets a pose at that instant, by cutting its controls (`continuous_time.with_poses_at`).

In a log such a sighting has the class "robot N", N the number of the other robot, and no id: whatever works with landmarks
does not use it, and corrects it like the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..association import AssociationOptions, associate_from, known_noise
from ..association.assignment import evidence
from ..association.map_solution import Problem
from ..association.map_states import AGREES, MOVED, MapStates, map_states
from ..association.problem import names as names_of
from ..association.refining import refine
from ..errors import GraphError, LogError, OptionError, named, quoted
from ..errors.checks import listed
from ..graph import Graph
from ..identification.known import known_robot
from ..log import UNIDENTIFIED, Log
from ..log.cells import MOVED_BETWEEN, Doubt
from ..log.continuous_time import CLOCK, nearest_of, with_poses_at
from ..log.geometry import with_datum
from ..log.join import end_to_end, joined_rows
from ..log.measurements import PartialSightings, PoseRelations, length_of
from ..log.rows import robot_class
from ..maps.constellation import Constellations, Merged, match
from ..maps.landmark_map import LandmarkMap
from ..maps.localization import SURE, first_fix, odds_of
from ..maps.tracking import follow
from ..models import MotionModel, SensorModel
from ..se2 import Array, begun_at, between, compose, in_frame
from ..solvers.contradictions import MEDIANS
from ..solvers.solve import solve

#: a log is said whose single sightings have so much less noise than those of another one: of 44 pairs of drives of one sensor
#: none, and all of 44 of which one has three times the noise
UNLIKE = 2.0
#: a variance that is as good as zero
TINY = 1e-300
#: the same where the noise contains an unknown factor for correlated errors, which differs between drives of one sensor
UNLIKE_WITH_CORRELATIONS = 4.0
#: a landmark has surely moved from this square of its shift on, and where both logs saw it so often
SURELY, FEWEST_SEEN = 60.0, 3


@dataclass(frozen=True, eq=False)
class Sessions:
    """Drives that were joined.

    Attributes:
        log: all of them, in the frame of the first.
        starts: the step at which each drive starts, and after them the number of poses.
        states: of the landmarks of each drive but the first in the map of those before; empty where they were not compared.
    """

    log: Log
    starts: tuple[int, ...]
    states: tuple[MapStates, ...] = ()

    def split(self, rows: Array) -> list[Array]:
        """Rows (T+1, ...) that belong to the poses, one array for each drive.

        Raises:
            OptionError: there is another number of rows.
        """
        if length_of(rows) != self.starts[-1]:
            message = f"split takes an array of {self.starts[-1]} rows, such as solution.poses, not {quoted(rows)}"
            raise OptionError(message)
        return np.split(np.asarray(rows), self.starts[1:-1])


def join_logs(logs: Sequence[Log], *, mean_noise: bool = False, placed: bool = False) -> Sessions:
    """One log of several drives in one place; ``Graph.from_log(join_logs(logs).log)`` solves them together.

    Args:
        logs: with controls, and ids that mean the same landmarks in all of them. Where one has sightings without ids, each
            log is associated, and their maps are matched. Noise models must be the same in all,
            or be given to `Graph.from_log`. Their ground truth is in one frame, and unknown where a log has none.
        mean_noise: the noise of each log is found by `known_noise`, and all get the means (`with_common_noise`).
        placed: the initial poses of all are in one frame already, so that none is looked for.

    Raises:
        OptionError: there is no log, or something else than logs.
        LogError: a log has no controls, or logs differ in their noise models, their sightings, or the point of their truth.
        GraphError: a log shares no landmarks with those before, or its first sightings fit no place among them.
    """
    if isinstance(logs, Log) or not isinstance(logs, Sequence) or not all(isinstance(each, Log) for each in logs):
        raise OptionError("join_logs takes a list of logs: join_logs([first, second])")
    if not logs:
        raise OptionError("join_logs needs at least one log")
    if mean_noise:
        logs, estimates = zip(*map(known_noise, logs))
        logs = with_common_noise(logs, [None if each is None else each.inflation for each in estimates])
    for each in logs:
        _check(each, logs[0])
    datum = next((d for each in logs if each.positions and (d := each.positions.datum) is not None), None)
    logs = [with_datum(each, datum, "the first fix of an earlier log") for each in logs]
    if len(logs) > 1 and not all(each.identified for each in logs):
        joined, starts = joined_without_ids(logs)
        return Sessions(joined, (*starts, joined.num_poses))
    joined, starts = logs[0], [0]
    known = known_robot(logs[0])[0] if len(logs) > 1 and not placed else logs[0]
    models: dict[str, Any] = {"motion": known.motion or MotionModel(), "sensor": known.sensor or SensorModel()}
    states = list[MapStates]()
    # the same with the poses that the map of the next log comes from
    solved = joined
    for k, each in enumerate(logs[1:]):
        starts.append(joined.num_poses)
        if not placed:
            graph = Graph.from_log(solved, edges="landmark+motion", **models)
            solution = solve(graph, initialize="given" if k else "auto")
            each = _placed(each, joined, solution.map, models)
            with suppress(GraphError):
                states.append(map_states(each, solution.map, **models))
                each = each.replace(doubts=(*each.doubts, *_moved_before(states[-1], each, joined)))
            solved = end_to_end(solved.replace(initial_poses=solution.poses), each)
        joined = end_to_end(joined, each)
    return Sessions(joined, (*starts, joined.num_poses), tuple(states) if len(states) == len(logs) - 1 else ())


def _moved_before(states: MapStates, log: Log, before: Log) -> tuple[Doubt, ...]:
    """A doubt where landmarks surely have moved between the logs before and this one.

    Squared shifts count in units of the median of those that agree, because correlated errors of a sensor make all of them
    larger. Ids that were read once or twice may be misread.
    """
    shifted = [(each, each.chi_square, each.shift) for each in states.landmarks]
    agreeing = [square for each, square, _ in shifted if each.state == AGREES and square is not None]
    least = SURELY * max(1.0, float(np.median(agreeing)) / MEDIANS[log.sightings.shape[1]] if agreeing else 1.0)
    moved = {
        each.id: float(np.hypot(*shift[:2]))
        for each, square, shift in shifted
        if square is not None and shift is not None and each.state == MOVED and square > least
        if min(each.seen, np.sum(before.landmarks == each.id)) >= FEWEST_SEEN
    }
    if not moved:
        return ()
    text = (
        f"probably moved before {log.name}, but taken for one place in all logs: {listed('landmark', [*moved])}, by up to "
        f"{max(moved.values()):.2g} m. Moved landmarks pull the poses along, which are less exact than their covariances "
        "say. Give them other ids in the logs after the move (Log.replace(landmarks=...)), or solve these alone in the "
        "map of the logs before (map=), which leaves them out"
    )
    return ((MOVED_BETWEEN, text),)


def from_logs(logs: Sequence[Log], **options: Any) -> Graph:
    """The graph of several logs of one place, as `join_logs` joins them, with the ``options`` of `Graph.from_log`."""
    return Graph.from_log(join_logs(logs, mean_noise=True).log, **options)


Graph.from_logs = staticmethod(from_logs)


def with_common_noise(logs: Sequence[Log], inflations: Sequence[float | None] = ()) -> list[Log]:
    """The logs with noise models that are the same in all, as one graph needs them.

    Variances are the means of those of the logs, of which the ones that bring no models count with the book's; so are those
    of the biases that were taken out of them (`Log.uncertain`), zero where there are none. Where the sensors sit in
    different places, sightings are given as from the mean of these. Ranges or bearings alone cannot be moved so: where
    there are any, the place is the mean of those of the logs that have them.

    Args:
        logs: of one place.
        inflations: the factors on the variances of each log's sensor for correlated errors (`RobotEstimate.inflation`),
            which tell the noise of single sightings; without them it is known less well whether one sensor is better.
    """
    motions, sensors = [each.motion or MotionModel() for each in logs], [each.sensor or SensorModel() for each in logs]
    taken_out = [each.uncertain or {} for each in logs]
    if len(set(motions)) <= 1 and len(set(sensors)) <= 1 and all(each == taken_out[0] for each in taken_out):
        return list(logs)

    def squares(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
        """The square roots of the means of all variances, which are zero where a row has none."""
        names = dict.fromkeys(name for row in rows for name in row if name not in (*SensorModel.GEOMETRY, "epsilon"))
        return {name: float(np.sqrt(np.mean([row.get(name, 0.0) ** 2 for row in rows]))) for name in names}

    motion = MotionModel(**squares([*map(vars, motions)]), epsilon=float(np.mean([each.epsilon for each in motions])))
    alone = [own.offset for log, own in zip(logs, sensors) if log.partial_sightings]
    ahead, left = np.mean(alone or [each.offset for each in sensors], axis=0).tolist()
    least, most, views = zip(*(each.limits for each in sensors))
    sensor = SensorModel(**squares([*map(vars, sensors)]), offset=(ahead, left))
    sensor = sensor.with_limits(min(least), max(most), max(views))
    uncertain = squares(taken_out)
    mean, common = f"its noise models are the means of those of {len(logs)} logs", []
    known = len(inflations) > 0 and None not in inflations
    factors = np.array(inflations if known else np.ones(len(logs)), dtype=float)
    limit = UNLIKE if known else UNLIKE_WITH_CORRELATIONS
    for k, (log, own) in enumerate(zip(logs, sensors)):
        if log.partial_sightings:
            _check_single_numbers(log, log.partial_sightings, own, sensor)
        robot = np.zeros((len(log.sightings), 3))
        seen = log.sightings if own.offset == sensor.offset else sensor.h(robot, own.h_inverse(robot, log.sightings))
        variances = [np.diagonal(model.Q(log.sightings), axis1=1, axis2=2) for model in sensors]
        ratios = [np.median(V / np.maximum(variances[k], TINY)) if len(V) else 1.0 for V in variances]
        times = np.sqrt(np.array(ratios) * factors[k] / factors)
        worst = int(np.argmax(times))
        unlike = (
            f"; single sightings of {logs[worst].name} have {times[worst]:.1f} times the noise of its own ones, which have "
            "too little weight: join the logs without that one, and solve it in the map of the others (map=)"
        )
        models = {"motion": motion, "sensor": sensor, "uncertain": uncertain or None}
        notes = (*log.notes, mean + unlike * bool(times[worst] > limit))
        common.append(log.replace(**models, sightings=seen, notes=notes))
    return common


def _check_single_numbers(log: Log, single: PartialSightings, own: SensorModel, common: SensorModel) -> None:
    """Raise `LogError` where the places differ by more than the noise of the ranges, or than 1 mm where there is none."""
    ranges = np.append(log.sightings[:, 0], single.ranges[single.ranged])
    noise = float(np.median(np.hypot(own.range_rate * ranges, own.range_std))) if len(ranges) else 1e-3
    if (apart := float(np.hypot(*np.subtract(own.offset, common.offset)))) > noise:
        raise LogError(
            f"{log.name} has ranges or bearings alone, which cannot be given as from another place of the sensor: its own is "
            f"{apart:.2g} m from the mean of the logs. Solve it in the map of the others (map=)"
        )


def _check(log: Log, first: Log) -> None:
    """Raise `LogError` where a log cannot be joined to the first one."""
    if log.controls is None:
        raise LogError(f"{log.name} has no controls, and drives are joined by their odometry and their landmarks")
    if log.sightings.shape[1] != first.sightings.shape[1]:
        numbers = f"{log.sightings.shape[1]} numbers and {first.name} of {first.sightings.shape[1]}"
        advice = "leave psi out: dimensions=2, or Log.without_orientation of the one that has it"
        raise LogError(f"{log.name} has sightings of {numbers}; {advice}")
    for name in ("motion", "sensor", "truth_offset"):
        if getattr(log, name) != getattr(first, name):
            differ = f"{log.name} and {first.name} differ in {name}: {getattr(log, name)} and {getattr(first, name)}"
            means = ", or join_logs(logs, mean_noise=True) takes the means" if name != "truth_offset" else ""
            raise LogError(f"{differ}. One graph has one; make them the same with Log.replace({name}=...){means}")


def _placed(log: Log, before: Log, known: LandmarkMap, models: dict[str, Any]) -> Log:
    """The log with its initial poses in the frame of those before, by the map that these give."""
    if not set(log.landmark_ids.tolist()) & set(before.landmark_ids.tolist()):
        names = [*([each.name for each in before.sessions] or [before.name]), log.name]
        if len(set(names)) < len(names):
            names = [f"{name} ({number})" for number, name in enumerate(names, start=1)]
        which = f"{names[-1]} and {named(names[:-1])} share no landmark"
        if log.partial_sightings is not None or before.partial_sightings is not None:
            which += " that both have seen with range and bearing"
            raise GraphError(
                f"{which}, which put a log where it belongs: give poses of one frame, and join with placed=True"
            )
        raise GraphError(f"{which}: do the ids mean the same ones in all of them?")
    fix = first_fix(log, known, **models)
    notes = (*log.notes, f"joined where {fix.sentence}")
    return log.replace(initial_poses=begun_at(fix.pose, log.initial_poses), notes=notes)


#: the fewest landmarks of two maps that have to agree
FEWEST_SHARED = 5


def joined_without_ids(logs: Sequence[Log]) -> tuple[Log, list[int]]:
    """The log of all, with ids and without clutter, in the frame of the first, and the first step of each.

    Args:
        logs: with controls and the same noise models. Ids that a log has are used within this log.

    Raises:
        GraphError: a log has no landmarks that were seen twice, or its map surely is at no place in that of those before.
    """
    models: dict[str, Any] = {"motion": logs[0].motion or MotionModel(), "sensor": logs[0].sensor or SensorModel()}
    joined, starts = _associated(logs[0], models), [0]
    for each in logs[1:]:
        starts.append(joined.num_poses)
        ends = []
        for placed in _in_map_of(joined, _associated(each, models), models):
            both = end_to_end(joined, placed)
            ends.append(_refined(both.replace(initial_poses=solve(_graph(both, models)).poses), models))
        joined = max(ends, key=lambda end: end[1])[0]
    clutter = joined.landmarks == UNIDENTIFIED
    note = f"{len(joined.landmark_ids)} landmarks were found in all logs together, and {clutter.sum()} sightings are clutter"
    return joined.with_sightings(~clutter, notes=(*joined.notes, note)), starts


def _associated(log: Log, models: dict[str, Any]) -> Log:
    """The log with ids, `UNIDENTIFIED` for clutter, and its trajectory."""
    if log.identified:
        return log.replace(initial_poses=solve(_graph(log, models)).poses)
    found = associate_from(log, **models)
    return log.replace(landmarks=found.ids, initial_poses=found.poses, notes=(*log.notes, *found.notes))


def _graph(log: Log, models: dict[str, Any]) -> Graph:
    return Graph.from_log(log.with_sightings(log.landmarks != UNIDENTIFIED), edges="landmark+motion", **models)


def _in_map_of(before: Log, log: Log, models: dict[str, Any]) -> list[Log]:
    """The log with initial poses in the frame of those before and with their ids, by its map and by following it.

    Raises:
        GraphError: its map surely is at no place in that of those before, and neither are its sightings.
    """
    known, own = solve(_graph(before, models)).map, solve(_graph(log, models)).map
    reach = float(np.quantile(np.concatenate([before.sightings[:, 0], log.sightings[:, 0]]), 0.98))
    alone = [int(each.partial_sightings.landmarks.max()) for each in (before, log) if each.partial_sightings]
    fresh = max([*known, *alone], default=-1) + 1
    if (single := log.partial_sightings) is not None:
        # what this log has single numbers of alone is another landmark than that which the map has by its id
        numbers, taken = single.landmarks, np.isin(single.landmarks, np.setdiff1d([*known], [*own]))
        log = log.replace(partial_sightings=replace(single, landmarks=np.where(taken, numbers + fresh, numbers)))
        fresh = 2 * fresh
    names = {j: fresh + k for k, j in enumerate(own)} | {UNIDENTIFIED: UNIDENTIFIED}
    ways = list[Log]()
    counts = np.array([np.count_nonzero(log.landmarks == j) for j in own])
    found = match(Merged(*own.arrays(own), counts, np.zeros(0, dtype=int)), Constellations.of(known, reach))
    if found and odds_of([each for each, _ in found]) > SURE and np.sum(found[0][0].agree) >= FEWEST_SHARED:
        best, where = found[0]
        ids = np.array(list(known))
        partners = {j: int(ids[where[k]]) for k, j in enumerate(own) if best.agree[k]}
        how = f"its map has {len(partners)} landmarks of those before"
        ids = np.array([partners.get(j, names[j]) for j in log.landmarks.tolist()])
        ways.append(_in_frame(log, ids, best.pose, how))
    try:
        along = follow(log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)), known, **models)
    except GraphError:
        if not ways:
            raise
        return ways
    seen = np.isin(along.landmarks, list(known))
    if along.lifted or len(np.unique(along.landmarks[seen])) < FEWEST_SHARED:
        if not ways:
            earlier = " and ".join(each.name for each in before.sessions) or before.name
            shared = f"no {FEWEST_SHARED} landmarks in common"
            raise GraphError(f"{log.name} and {earlier} have {shared}: are they logs of one place?")
        return ways
    # what the map does not have keeps its own id, where most sightings of that are not in the map
    mostly = {j: 2 * np.sum(seen[log.landmarks == j]) > np.sum(log.landmarks == j) for j in own}
    others = [UNIDENTIFIED if mostly.get(j, True) else names[j] for j in log.landmarks.tolist()]
    fix = along.fixes[0]
    frame = compose(fix.pose, between(log.initial_poses[0], np.zeros(3)))
    how = f"it was followed through their map, where {fix.sentence}"
    return [*ways, _in_frame(log, np.where(seen, along.landmarks, others), frame, how)]


def _in_frame(log: Log, ids: np.ndarray, frame: Array, how: str) -> Log:
    """The log with ids, and initial poses in another frame."""
    notes = (*log.notes, f"joined without ids: {how}")
    return _with_ids(log, ids).replace(initial_poses=in_frame(frame, log.initial_poses), notes=notes)


def _with_ids(log: Log, ids: np.ndarray) -> Log:
    """The log with other ids. Single ranges and bearings get that of most sightings of their landmark, where it has some."""
    single, known = log.partial_sightings, ids != UNIDENTIFIED
    if single is not None:
        numbers = single.landmarks.copy()
        for j in np.intersect1d(numbers, log.landmarks[known]):
            given, counts = np.unique(ids[known & (log.landmarks == j)], return_counts=True)
            numbers[single.landmarks == j] = given[np.argmax(counts)]
        single = replace(single, landmarks=numbers)
    return log.replace(landmarks=ids, partial_sightings=single)


def _refined(joined: Log, models: dict[str, Any]) -> tuple[Log, float]:
    """The joined log after association and solving in turn, and its evidence."""
    bare = joined.replace(landmarks=np.full(len(joined.steps), UNIDENTIFIED), relations=None, positions=None)
    _, labels = np.unique(joined.landmarks, return_inverse=True)
    # the smallest name is that of clutter
    labels = labels - int(np.any(joined.landmarks == UNIDENTIFIED))
    problem = Problem.of(bare, models["motion"], models["sensor"], AssociationOptions())
    found = refine(problem, labels, joined.initial_poses)
    if found is None:
        return joined, -np.inf
    ids = np.append(names_of(found.labels, bare.landmarks, joined.partial_sightings), UNIDENTIFIED)[found.labels]
    return _with_ids(joined, ids).replace(initial_poses=found.solution.poses), evidence(problem, found.solution)


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
    finer = {}
    for b, log in logs.items():
        instants = [_times(logs[a])[rows] for (a, c), rows in met.items() if c == b]
        finer[b] = with_poses_at(log, np.concatenate([np.zeros(0), *instants]))
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
        when = "from times at which these did not drive"
        notes.append(f"{others:,} sightings of other robots are {when}, and are not used")
    log = joined.log
    return replace(joined, log=log.replace(relations=joined_rows(log.relations, relations), notes=(*log.notes, *notes)))


def relations_of(first: np.ndarray, second: np.ndarray, sightings: Array, sensor: SensorModel) -> PoseRelations:
    """Sightings (R, 2 or 3) of the poses at steps ``second`` from those at ``first``, as relations."""
    motions, covariances, d = np.full((len(first), 3), np.nan), np.zeros((len(first), 3, 3)), sightings.shape[1]
    motions[:, :d], covariances[:, :d, :d] = sensor.places(sightings)
    return PoseRelations(first=first, second=second, motions=motions, covariances=covariances)


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
    ends = {n: _known(log)[[0, -1]] for n, log in logs.items()}
    spans = ", ".join(f"robot {n} from {first:.1f} to {last:.1f} s" for n, (first, last) in ends.items())
    return f"the clocks of the robots do not overlap where they see each other: {spans}; are they in one time?"
