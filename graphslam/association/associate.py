"""`associate_from`: ids for sightings without; `Verdict`: whether they can be trusted; `score`: compared with true ids.

`known_noise` finds ids and the noise of the robot in turn. The verdict separates good maps from bad ones, calibrated on
simulated logs: a map is good where the ATE is at most 1.5 times that of the same graph with the true ids. The criterion is
how much more likely the map is than any other one with another trajectory that the search has met, and whether several starts
found it. `docs/beyond/association.md` has the shares of errors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import GraphError, LogError, OptionError, quoted
from ..errors.checks import array_of, check_choice, check_known, check_type, singular
from ..identification.declared import ParameterEstimate, parsed
from ..identification.known import (
    AUTO,
    BOOK,
    enough_ids,
    known_robot,
    unknown_noise,
    with_book,
    with_findings,
)
from ..identification.result import RobotEstimate
from ..linear.precision import check_magnitudes
from ..log import UNIDENTIFIED, Log, check_is_log
from ..log.measurements import MEASURED
from ..metrics import ate
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..solvers.unknown_robot import estimate_robot
from .adapting import Competition, Robot, Start, compete, spread, tolerance
from .ambiguity import Ambiguity, ambiguities, readable
from .front_end import run_front_end
from .map_solution import Problem
from .problem import AssociationOptions
from .problem import names as names_of
from .refining import TRIAL_ROUNDS
from .repair import Leap, repaired, with_unknown_motions

#: the evidence for a reliable map over that for any other one [nats]; with 30, one of 42 maps called good was bad
MIN_LEAD = 40.0
#: the fewest starts of a reliable map that have to end alike
ALIKE = 2
#: the most ambiguities that become notes of their own, and the most leaps that become reasons
MOST_NOTES = 3


@dataclass(frozen=True)
class Verdict:
    """Whether the map of an association can be relied on, and why not.

    Attributes:
        reliable: whether the ids are unlikely to have led to a wrong trajectory.
        reasons: why not, one sentence each; empty where it is reliable.
        lead: the logarithm of the evidence over that for the best rival with another trajectory; infinite for none.
        starts, agreeing: how many starts of the search were used, and how many ended with this trajectory.
        deviation: the standard deviation of the positions of the aligned trajectory, root mean square [m].
    """

    reliable: bool
    reasons: tuple[str, ...]
    lead: float
    starts: int
    agreeing: int
    deviation: float

    def __str__(self) -> str:
        if self.reliable:
            ended = f"{self.agreeing} starts of the search ended in its trajectory"
            return f"the map can be relied on: {ended}, and no other that was found is nearly as likely"
        return f"do not rely on the map without a check: {'; '.join(self.reasons)}"


def verdict(competition: Competition, problem: Problem, leaps: tuple[Leap, ...]) -> Verdict:
    """The verdict on the best end of a competition, with these leaps."""
    k = competition.best
    best = competition.ends[k].refined.solution
    near = tolerance(best, problem.field)
    gaps, agreeing = [np.inf], 0
    for value, end in zip(competition.values, competition.ends, strict=True):
        behind = competition.values[k] - value
        found: list[tuple[float, Array]] = [(0.0, end.refined.solution.poses), *end.rivals]
        agreeing += ate(best.poses, end.refined.solution.poses) <= near
        gaps += [behind + gap for gap, poses in found if ate(best.poses, poses) > near]
    lead = float(min(gaps))
    reasons: list[str] = []
    if len(competition.ends) < ALIKE:
        reasons.append("only one start of the search was tried, so that nothing tells whether it ended in the best map")
    elif agreeing < ALIKE:
        reasons.append(f"only one of {len(competition.ends)} starts of the search ended in its trajectory")
    if lead <= 0:
        reasons.append("another map that was tried is as likely")
    elif lead < MIN_LEAD:
        by = f"by a factor of {readable(lead)}, and {readable(MIN_LEAD)} is needed"
        reasons.append(f"another map that was tried is less likely {by}")
    reasons += [str(each) for each in leaps[:MOST_NOTES]]
    return Verdict(not reasons, tuple(reasons), lead, len(competition.ends), agreeing, spread(best))


#: a function that finds a start when it is needed
Begin = Callable[[], Start]
#: one start or several; None stands for the drive
Starts = Start | Begin | Sequence[Start | Begin | None] | None


@dataclass(frozen=True, eq=False, repr=False)
class Association:
    """Which landmark each sighting of a log is of.

    Attributes:
        of: the log that was associated; its own ids were not used, unless only some sightings have one.
        ids: (M,) the landmark of each sighting, numbered from 0 in the order of discovery; `UNIDENTIFIED` for clutter. Ids
            of the log that were kept stay, and other landmarks have higher numbers, also than those of `partial_sightings`.
        margins: (M,) the logarithm of the evidence for the landmark over that for the best other one, or for clutter;
            infinite for clutter, and where an id of the log was kept.
        poses: (T+1, 3) the trajectory of the graph in which the ids were found.
        rounds, settled: how often sightings were assigned again, and whether the last time changed nothing.
        cost_per_dof: J of that graph per degree of freedom: about 1 where noise models and ids are right, far above it
            where one of them is wrong.
        motion: the noise model of the graph, with the slip that the log shows, where it does (`association.adapting`).
        parameters: the estimated parameters of vehicle and sensor, or None. ``poses`` are those of the corrected log.
        ambiguities: places that may have been taken for others, the most doubtful first.
        verdict: whether the map can be relied on, and why not.
        repaired: motions that odometry missed, and that are unknown ones in the graph and in `log` (`association.repair`).
        evidence: E of `association.assignment.evidence`, the logarithm of the evidence for these ids, to compare associations
            of one log.
        options: what was used.
        seconds: the time it took [s].
        notes: what the user should know, one sentence each.
    """

    of: Log
    ids: np.ndarray
    margins: Array
    poses: Array
    rounds: int
    settled: bool
    cost_per_dof: float
    motion: MotionModel
    parameters: ParameterEstimate | None
    ambiguities: tuple[Ambiguity, ...]
    verdict: Verdict
    repaired: tuple[Leap, ...]
    evidence: float
    options: AssociationOptions
    seconds: float
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        which = "reliable" if self.verdict.reliable else "not reliable"
        counts = singular(f"{self.landmarks} landmarks, {self.clutter} of {len(self.ids)} sightings")
        return f"<Association of {self.of.name}: {counts} are clutter, {which}, {self.seconds:.3g} s>"

    @property
    def landmarks(self) -> int:
        """The number of landmarks."""
        return len(np.setdiff1d(self.ids, [UNIDENTIFIED]))

    @property
    def clutter(self) -> int:
        """The number of sightings that are of no landmark."""
        return int(np.count_nonzero(self.ids == UNIDENTIFIED))

    @property
    def kept(self) -> np.ndarray:
        """Whether each sighting (M,) kept the id that the log gives it."""
        if self.of.identified or not self.options.keep_ids:
            return np.zeros(len(self.ids), dtype=bool)
        return np.asarray(self.of.landmarks != UNIDENTIFIED)

    @property
    def doubtful(self) -> np.ndarray:
        """Whether the landmark of each sighting (M,) may be another: by its margin, or because a return to it is in doubt."""
        doubtful = np.asarray(self.margins < np.log(self.options.factor))
        for each in self.ambiguities:
            doubtful |= (self.of.steps >= each.step) & np.isin(self.ids, each.landmarks)
        return doubtful & ~self.kept

    @property
    def ambiguous(self) -> int:
        """The number of doubtful sightings."""
        return int(np.count_nonzero(self.doubtful))

    @cached_property
    def log(self) -> Log:
        """The log with these ids, from ``poses`` on, without clutter, with ``motion`` and the variances of `repaired`."""
        kept, log = self.ids != UNIDENTIFIED, with_unknown_motions(self.of, self.repaired)
        changes: dict[str, Any] = {"initial_poses": self.poses, "motion": self.motion}
        return log.with_sightings(kept, landmarks=self.ids[kept], notes=(*log.notes, *self.notes), **changes)


def associate_from(
    log: Log,
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    options: AssociationOptions | None = None,
    start: Starts = None,
    estimate: str | Mapping[str, float | None] | tuple[str, ...] | list[str] | None = None,
    **changes: Any,
) -> Association:
    """Find out which sightings are of the same landmark, from the log alone.

    `fastslam.associate` calls this with the starts of its front ends.

    The robot drives along the log once: a local Kalman filter joins sightings of neighbouring scans to tracks, and every
    ``window`` steps the graph of the drive so far is solved, and tracks are joined to landmarks that were seen before by
    the best joint hypothesis under their covariance. Then association and solving take turns (`association.refining`).
    Where alternatives are not much less likely, they are tried (`association.refining`), and the one with the
    highest evidence as a whole is the result.

    Args:
        log: with controls.
        motion, sensor: the noise models; default: those of the log, else the book's.
        options: the options; ``changes`` replace single fields of `AssociationOptions`.
        start: (ids (M,), poses (T+1, 3)) that another front end found, such as a particle filter; instead of the drive.
            Of a list of such starts, or functions that find them, with None for the drive, the one that ends with the
            highest evidence is the result. Once ``agreeing`` of them end alike the others are not used.
        estimate: parameters of vehicle and sensor to estimate on the way, as in `Graph.from_log`; sightings are then
            assigned in the corrected log.

    Raises:
        LogError: the log has no controls.
        GraphError: the log has no sightings, or no landmark was seen twice: all sightings may be clutter; or it does not
            tell the parameters.
        OptionError: an option has an impossible value.
    """
    begin = time.perf_counter()
    check_is_log(log)
    check_type(AssociationOptions, options=options)
    check_known("associate", changes, [each.name for each in fields(AssociationOptions)])
    options = replace(options or AssociationOptions(), **changes)
    motion, sensor = log.noise_models(motion, sensor)
    if log.controls is None:
        raise LogError(f"{log.name} has no controls, so nothing tells where sightings without ids were made")
    if len(log.steps) == 0:
        raise GraphError(f"{log.name} has no sightings at all, so there is nothing to associate")
    check_magnitudes(log, motion, sensor)
    recorded = log
    # the ids are found without other sensors, whose frame may be another one
    log = log.replace(**dict.fromkeys(MEASURED))
    if log.identified or not options.keep_ids:
        log = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    names, robot = parsed(() if estimate is None else estimate), Robot(log, motion, sensor)
    problem = Problem.of(log, motion, sensor, options)

    def driven() -> Start:
        return run_front_end(problem, motion, sensor)

    competition = compete(robot, _starts(log, start, driven), names, problem)
    if competition is None:
        all_of_them = singular(f"all its {len(log.steps)} sightings may be clutter")
        raise GraphError(f"no landmark of {log.name} was seen often enough to be one: {all_of_them}")
    competition, missed, leaps = repaired(competition, robot, names, problem)
    return _report(recorded, robot, competition, options, missed, leaps, time.perf_counter() - begin)


def _starts(log: Log, start: Starts, driven: Begin) -> list[Start | Begin]:
    """The given starts, ``driven`` for None; what functions return is checked when they are called."""

    def checked(each: Start) -> Start:
        if not isinstance(each, tuple) or len(each) != 2:
            raise OptionError(f"a start must be a pair (ids, poses), not {quoted(each)}")
        labels, poses = array_of("the ids of a start", each[0]), array_of("the poses of a start", each[1])
        if labels.shape != log.steps.shape or poses.shape != log.initial_poses.shape:
            raise OptionError(f"start must be {len(log.steps)} ids and poses of shape {log.initial_poses.shape}")
        if not np.array_equal(labels, labels.astype(np.int64)) or not np.isfinite(poses).all():
            raise OptionError("the ids of a start must be whole numbers, and its poses finite")
        return labels.astype(np.int64), poses

    def later(each: Begin) -> Begin:
        return lambda: checked(each())

    if not (start is None or callable(start) or isinstance(start, Sequence)):
        message = f"start must be a pair (ids, poses), a function that finds one, or a list, not {quoted(start)}"
        raise OptionError(message)
    found: list[Start | Begin] = []
    # a tuple is one start
    for each in [start] if start is None or callable(start) or isinstance(start, tuple) else start:
        found.append(driven if each is None else later(each) if callable(each) else checked(each))
    if not found:
        raise OptionError("start holds no start; leave it out for the drive")
    return found


def _report(
    log: Log, given: Robot, competition: Competition, options: AssociationOptions, missed: tuple[Leap, ...],
    leaps: tuple[Leap, ...], seconds: float,
) -> Association:  # fmt: skip
    """The association of the log as it was recorded, found with another robot."""
    robot, values, end = competition.robot, competition.values, competition.ends[competition.best]
    refined, graph = end.refined, end.refined.solution.graph
    name = np.append(names_of(refined.labels, given.log.landmarks, log.partial_sightings), UNIDENTIFIED)
    found = Association(
        of=log, ids=name[refined.labels],
        margins=np.where(refined.labels < 0, np.inf, refined.margins), poses=refined.solution.poses, rounds=refined.rounds,
        settled=refined.settled, cost_per_dof=refined.solution.cost / max(graph.degrees_of_freedom, 1), motion=robot.motion,
        parameters=robot.estimate, ambiguities=ambiguities(end.alternatives, options.factor, name),
        verdict=verdict(competition, Problem.of(robot.log, robot.motion, robot.sensor, options), leaps), repaired=missed,
        evidence=max(values), options=options, seconds=seconds, notes=(),
    )  # fmt: skip
    kept = int(np.count_nonzero(found.kept))
    which = "of which some have no id" if kept else "without ids"
    clutter = f"{found.clutter} of {len(log.steps)} sightings are of no landmark (clutter)"
    counts = singular(f"found {found.landmarks} landmarks in sightings {which}; {clutter}")
    notes = [f"{counts}, J per degree of freedom is {found.cost_per_dof:.2f}"]
    if kept:
        notes.append(f"{kept} of {len(log.steps)} sightings kept the ids that they have")
    if robot.motion.slip != given.motion.slip:
        raised = f"for the graph slip is raised from {given.motion.slip:.2g} to {robot.motion.slip:.2g} m/√m"
        notes.append(f"over long ways the robot slips sideways more than its noise model allows: {raised}")
    if found.parameters is not None:
        notes.append(f"ids were found with estimated parameters: {found.parameters.sentence}")
    notes += [f"{each.missed}: the odometry is not used there" for each in found.repaired]
    notes.append(str(found.verdict))
    if len(values) > 1:
        ends = ", ".join(str(round(value - max(values))) for value in values)
        taken = f"of {len(values)} starts the best by evidence was taken"
        notes.append(f"{taken}; all of them, relative to it [nats]: {ends}")
    notes += [str(each) for each in found.ambiguities[:MOST_NOTES]]
    if (more := len(found.ambiguities) - MOST_NOTES) > 0:
        which = "return is" if more == 1 else "returns are"
        notes.append(f"{more} further {which} ambiguous by a factor of {options.factor:g}")
    if found.clutter > len(found.ids) / 2:
        notes.append("most sightings are of no landmark that was seen again: the few landmarks may be there by chance")
    if found.landmarks == 1:
        notes.append("one landmark alone cannot tell a wrong association from drift")
    if not found.settled:
        notes.append(singular(f"the association had not settled after {found.rounds} rounds"))
    if end.unsettled:
        which = singular(f"when they were compared, after {min(options.rounds, TRIAL_ROUNDS)} rounds")
        count = f"{end.unsettled} of {end.tried}; their evidence may be higher"
        notes.append(f"alternatives that had not settled {which}: {count}")
    if end.left:
        which = f"were not tried because of the limit on tries ({options.tries}): {end.left}"
        better = "with a higher limit one of them may prove better"
        notes.append(f"alternatives that are not much less likely, but {which}; {better}")
    return replace(found, notes=tuple(notes))


@dataclass(frozen=True)
class AssociationScore:
    """The comparison of an association with the true ids.

    Each landmark of the association is matched with at most one true landmark, so that as many sightings as possible have
    the right id; these are the correct ones.

    Attributes:
        precision: correct sightings over sightings that were given a landmark.
        recall: correct sightings over sightings that truly are of a landmark.
        found: true landmarks that are matched.
        missed: true landmarks without a match.
        doubled: further landmarks that consist mostly of sightings of a true landmark that another one has been matched to.
        invented: landmarks that consist mostly of clutter.
        matches: the true landmark of each landmark that is matched, {id: true id}.
    """

    precision: float | None
    recall: float | None
    found: int
    missed: int
    doubled: int
    invented: int
    matches: Mapping[int, int]


def score(ids: np.ndarray, true_ids: np.ndarray) -> AssociationScore:
    """Compare ids (M,) with true ids (M,); `UNIDENTIFIED` is clutter in both.

    Raises:
        OptionError: the shapes differ.
    """
    from scipy.optimize import linear_sum_assignment

    ids, true_ids = np.asarray(ids), np.asarray(true_ids)
    if ids.shape != true_ids.shape or ids.ndim != 1:
        raise OptionError(f"ids and true_ids must be arrays of one shape (M,), not {ids.shape} and {true_ids.shape}")
    names, which = np.unique(ids, return_inverse=True)
    truths, truth = np.unique(true_ids, return_inverse=True)
    table = np.zeros((len(names), len(truths)), dtype=np.int64)
    np.add.at(table, (which, truth), 1)
    given = names != UNIDENTIFIED
    clutter = table[given][:, truths == UNIDENTIFIED].sum(axis=1)
    among = table[given][:, truths != UNIDENTIFIED]
    rows, columns = linear_sum_assignment(among, maximize=True)
    matched = among[rows, columns] > 0
    rows, columns = rows[matched], columns[matched]
    correct = int(among[rows, columns].sum())
    assigned, seen = int(np.sum(ids != UNIDENTIFIED)), int(np.sum(true_ids != UNIDENTIFIED))
    most = among.max(axis=1, initial=0)
    matches = dict(zip(names[given][rows].tolist(), truths[truths != UNIDENTIFIED][columns].tolist(), strict=True))
    unmatched = np.setdiff1d(np.arange(len(among)), rows)
    return AssociationScore(
        precision=correct / assigned if assigned else None,
        recall=correct / seen if seen else None,
        found=len(rows),
        missed=among.shape[1] - len(rows),
        doubled=int(np.sum(most[unmatched] >= np.maximum(clutter[unmatched], 1))),
        invented=int(np.sum(most[unmatched] < clutter[unmatched])),
        matches=matches,
    )


def known_noise(
    log: Log, noise: str | None = None, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> tuple[Log, RobotEstimate | None]:
    """`known_robot` for all logs: where too few sightings have ids, ids and robot are found in turn (`robot_of`).

    The log keeps its sightings without ids; they are corrected by the biases that were found.

    Args:
        noise: as for `known_robot`.
        motion, sensor: the noise with which ids are found first; default: that of the log, else the book's.

    Raises:
        OptionError: there is no such choice of ``noise``.
        LogError, GraphError: the log does not determine its noise, and ``noise`` is "auto".
    """
    if noise is not None:
        check_choice("noise", noise, (AUTO, BOOK))
    if noise == BOOK or (noise is None and not unknown_noise(log)) or enough_ids(log):
        return known_robot(log, noise)
    try:
        found, notes = robot_of(log, motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel())
    except (GraphError, LogError) as error:
        if noise == AUTO:
            raise
        return with_book(log, error), None
    return with_findings(log, found.corrected(log), found, *notes), found


def robot_of(log: Log, motion: MotionModel, sensor: SensorModel) -> tuple[RobotEstimate, tuple[str, ...]]:
    """`estimate_robot`, and notes; where too few sightings have ids, ids and robot are found in turn.

    Noise models that are too wide hide wrong ids, and wrong ids change the noise. So ids are found with the noise to begin
    with, then the robot, then ids in the corrected log with the noise that was found, and then the robot again.

    Args:
        log: with controls.
        motion, sensor: the noise with which ids are found first, and where the sensor is believed to be.

    Raises:
        LogError, GraphError: no ids can be found, or the log does not tell the noise.
    """
    if enough_ids(log):
        return estimate_robot(log, sensor=sensor), ()
    named, note = _with_found_ids(log, log, motion, sensor)
    # what belongs to an id that was found cannot be corrected in the log, which does not have it
    found = estimate_robot(named, sensor=sensor, single_landmarks=False)
    try:
        named, again = _with_found_ids(log, found.corrected(log), found.motion, found.sensor)
        return estimate_robot(named, sensor=sensor, single_landmarks=False), (again,)
    except (LogError, GraphError) as error:
        return found, (note, f"ids were found only once, because with the noise that was found {error}")


def _with_found_ids(log: Log, corrected: Log, motion: MotionModel, sensor: SensorModel) -> tuple[Log, str]:
    """The log with the ids that `associate_from` finds in the corrected log, without clutter, and a note."""
    found = associate_from(corrected, motion=motion, sensor=sensor)
    kept = found.ids != UNIDENTIFIED
    repaired, ids = with_unknown_motions(log, found.repaired), found.ids[kept]
    # landmarks that were found are not those of the true map
    named = repaired.with_sightings(kept, landmarks=ids, initial_poses=found.poses, true_landmarks=None)
    note = f"noise and biases were estimated with {found.landmarks} landmarks that were found in sightings without ids"
    return named, note
