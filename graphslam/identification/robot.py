"""Noise, biases and misread ids of a robot that nobody has calibrated, from the sightings of one log without ground truth.

It starts locally. Over some seconds the odometry is nearly exact, so the sightings of one landmark without a longer pause
are taken for a landmark of their own (an episode). Such a problem has no loop closures and therefore hardly a wrong minimum,
and a single misread id stands alone in its episode, where it has no influence. The solution gives the first noise and
biases, and the sightings that contradict their episode. Then:

1. the landmarks by their ids, from the trajectory of the first problem;
2. ids that contradict their place get the id of the landmark that fits, or count as clutter (`sighting_errors`);
3. the noise again from few sightings of each landmark, so far apart that their errors are hardly correlated, and whether
   there are biases and noise of the odometry at all; from all other sightings the correlation of the errors, and from this
   how much a sighting counts;
4. this estimate, dead reckoning and the noise of the book (or noise that was given) predict sightings that are left out
   (`left_out`), and the best of the three counts;
5. the noise once more from as many sightings as are nearly independent.

The equations are those of `identification.unknowns` and `identification.restricted_likelihood`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..errors import GraphError, LogError, OptionError, quoted
from ..errors.checks import check_count, check_type, singular
from ..log import UNIDENTIFIED, Log, check_is_log
from ..models import MotionModel, SensorModel
from .declared import KINDS, ParameterEstimate
from .odometry import Odometry, sighting_times
from .restricted_likelihood import better_start, fit, gain_over, hold_needless, numbers_on_motion, solved_with
from .result import (
    BOOK_NOISE,
    DEAD_RECKONING,
    ESTIMATE,
    GIVEN_NOISE,
    MANY_MISREAD,
    LeftOut,
    RobotEstimate,
    Systematic,
    apart_from_scans,
    left_out,
    without_found,
)
from .sensor_errors import MOST as MOST_TURNS
from .sensor_errors import lens_of, range_errors_of, turn_of
from .sighting_errors import (
    LAGS,
    ROUNDING,
    SHORT,
    Ids,
    RangeErrors,
    checked_ids,
    correlations,
    errors_last,
    evened,
    inflation,
    smoothed,
)
from .slips import MOST as MOST_SLIPS
from .slips import Slip, slip_of_drive, uneven_of, without_contradicted, without_slips
from .unknowns import Unknowns

#: sightings of a landmark with a longer pause between them [s] belong to two episodes; the second where sightings are rare
PAUSES = (2.0, 10.0)
#: where more than this part of the sightings stands alone in its episode, single ones are normal
RARE = 0.3
#: a squared Mahalanobis distance beyond which a sighting contradicts its episode
CONTRADICTS = 30.0
#: times between the sightings of a landmark [s] that are tried first, and the fewest sightings that are enough
INTERVALS, ENOUGH = (5.0, 2.0, 1.0, 0.5, 0.2), 100
#: rounds of solving and improving the variances
ROUNDS = (8, 4, 8, 8)
#: sightings correlated by more than this are thinned for the last round, and by less than that are all kept
DEPENDENT, HARDLY = 0.2, 0.15
#: where errors of a landmark are correlated in time, those of several landmarks have parts in common, which do not show in
#: residuals, because the trajectory follows them: sightings count less by this factor (docs/decisions.md)
COMMON = 2.0
#: below this gain of the log likelihood, divided by the sightings that count as one, odometry counts as nearly exact; and the
#: seconds for one sighting of each landmark in the second test
NEEDED, MORE = 8.0, 1.0
#: where fewer numbers would show typical noise of the motion, a log cannot say that its odometry is better; see decisions.md
SHOWN = 40.0
#: dead reckoning has this part of the standard deviations of typical noise; sums of log densities that differ by less than
#: this are alike
HARDLY_ANY, CLEARLY = 1 / 100, 2.0
#: places are seen again where more than this part of the landmarks is; else dead reckoning has the second number for
#: `HARDLY_ANY`: at single poses of a corridor NEES / 3 is up to 5 instead of 21 (docs/decisions.md)
RETURNS, WITHOUT_RETURN = 0.1, 1 / 30
#: how often errors of ranges are found more exactly, with the sightings that did not fit before
MOST_IMPROVED = 3
#: the fewest sightings and motions from which noise and biases are estimated
FEWEST = {"sightings": 60, "poses": 20}
#: the most sightings of a log that are used at once where this is enough; for correlations; and, of the few that are far
#: apart, to compare candidates
MOST, MOST_CORRELATED, MOST_COMPARED = 6000, 12_000, 500


def estimate_from_sightings(
    log: Log, sensor: Any = None, given: Any = None, seed: int = 0, single_landmarks: bool = True
) -> RobotEstimate:
    """`solvers.unknown_robot.estimate_robot` for logs with whole sightings, whose arguments it has checked."""
    _check(log)
    try:
        rng, believed = np.random.default_rng(seed), sensor or log.sensor or SensorModel()
        return _estimate(log, believed, given, rng, MOST_IMPROVED if single_landmarks else 0, Systematic())
    except np.linalg.LinAlgError:
        raise GraphError(f"{log.name}: the sightings do not determine noise and biases together") from None


def check_robot_options(log: Any, sensor: Any, given: Any, seed: Any) -> None:
    """Raise the errors of `estimate_robot` for impossible arguments."""
    check_is_log(log)
    check_type(SensorModel, sensor=sensor)
    check_count(seed=seed)
    if given is not None:
        if not isinstance(given, tuple) or len(given) != 2:
            raise OptionError(f"given must be a MotionModel and a SensorModel, not {quoted(given)}")
        check_type(MotionModel, given=given[0])
        check_type(SensorModel, given=given[1])


def _estimate(
    recorded: Log,
    sensor: SensorModel,
    given: tuple[MotionModel, SensorModel] | None,
    rng: np.random.Generator,
    improvements: int,
    known: Systematic,
    improved: int = 0,
) -> RobotEstimate:
    """The estimate from a log that has enough sightings, and whose robot has the errors that are known.

    Args:
        improvements: how often the errors of the ranges are found, each time more exactly than before.
        improved: how often they were.
    """
    again, off = partial(_estimate, recorded, sensor, given, rng, improvements), known.ranges
    log = known.undone(recorded)
    drive, first, ids, slips = _with_ids(evened(log, off), sensor, rng)
    log = log.replace(control_variances=drive.control_variances)
    measured = ids.correct(drive)
    ids = ids.within(log.landmarks)
    # by the ids that are right
    measured = measured.replace(sightings=log.sightings[ids.identified & ~ids.dropped])
    named, right = evened(measured, off), evened(ids.correct(log), off)
    sparse, used = _sparse(named)
    second = _joined(sparse, sensor, first, ROUNDS[2])[0]
    if len(known.uneven) < 2 and (one := uneven_of(second)) is not None:
        return again(Systematic(uneven=(*known.uneven, one)))
    if known.lens is None and (lens := lens_of(second)) is not None:
        # turns that were found before belong to bearings with another axis
        return again(Systematic(uneven=known.uneven, lens=lens))
    if improved < improvements:

        def count_as_one(solved: Unknowns, errors: RangeErrors) -> float:
            every, few = (evened(each, errors) for each in (measured, measured.with_sightings(used)))
            return inflation(few, _correlations(every, few, used, solved, rng))

        few = _of_sightings(measured.with_sightings(used))
        found = range_errors_of(second, few, off, count_as_one)
        if found is not None and found is not off:
            return again(replace(known, ranges=found), improved + 1)
    if len(known.turns) < MOST_TURNS and (turn := turn_of(second, lambda few: _everywhere(few, named))) is not None:
        return again(replace(known, turns=(*known.turns, turn)), improved)
    exact = fit(second.with_nearly_exact_odometry(), ROUNDS[2])[0]
    held_first, held_with_exact = hold_needless(second, ROUNDS[2]), hold_needless(exact, ROUNDS[2])
    held = held_first
    place = {name: getattr(sensor, name) for name in SensorModel.GEOMETRY}
    other = (GIVEN_NOISE, given) if given else (BOOK_NOISE, (MotionModel(), SensorModel(**place)))
    part = _beginning(sparse, MOST_COMPARED)
    begun = second if part is sparse else Unknowns(part, part.landmarks, sensor, second)
    # where no place is seen again, errors of the odometry that add up do not show, so that it is not called exact
    size = HARDLY_ANY if _seen_again(named) > RETURNS else WITHOUT_RETURN
    dead_reckoning = fit(_with_dead_reckoning(begun, size), ROUNDS[1])[0]
    compared = _compared(part, second, dead_reckoning, *other, rng)
    on_motion = numbers_on_motion(second)
    nearly_exact = _is_exact(named, sparse, used, second, exact, on_motion, rng)
    if nearly_exact:
        second, held = exact, held_with_exact
        compared = _compared(part, second, dead_reckoning, *other, rng)
    # few sightings are predicted well from odometry with biases, too: dead reckoning counts only where the log shows neither
    # biases nor noise
    exact_and_unbiased = nearly_exact and set(KINDS["odometry"]) <= set(held)
    basis = ESTIMATE
    if exact_and_unbiased and compared.count and compared.gain(ESTIMATE, DEAD_RECKONING) < CLEARLY:
        basis = DEAD_RECKONING
    elif compared.count >= ENOUGH and compared.gain(other[0], ESTIMATE) > CLEARLY:
        nothing, (motion, seen) = ParameterEstimate((), np.zeros(0), np.zeros((0, 0)), {}), other[1]
        return RobotEstimate(
            log=right.replace(motion=motion, sensor=seen), motion=motion, sensor=seen, parameters=nothing, ids=ids,
            left_out=compared, basis=other[0], slips=slips, **vars(known),
        )  # fmt: skip
    if basis == DEAD_RECKONING:
        # this problem holds what the first one held, too
        second, held = dead_reckoning, held_first | held
    rho = _correlations(named, sparse, used, second, rng)
    factor = COMMON * inflation(named, rho) if rho[:SHORT].max() >= HARDLY else 1.0
    if factor > 1:
        below = np.flatnonzero(rho < DEPENDENT)
        chosen = _thinned(named, LAGS[below[0]] if len(below) else LAGS[-2])[0]
    else:
        chosen, rho = _at_most(named, MOST), np.zeros_like(rho)
    last, errors = _joined(chosen, sensor, second, ROUNDS[3])
    # exactly, without the rounding of the last step
    last.hold(held)
    motion, seen = last.models
    wider: dict[str, Any] = {name: getattr(seen, name) * factor**0.5 for name in last.sensor_parts}
    seen = replace(seen, **wider)
    motion, seen, of_scans = apart_from_scans(last, log, motion, seen)
    unknown = held if off is None else held | off.uncertain
    corrected, estimate = without_found(last, right, unknown, motion, seen)
    return RobotEstimate(
        log=corrected, motion=motion, sensor=seen, parameters=estimate, errors=errors, ids=ids, correlations=rho,
        inflation=factor, nearly_exact=nearly_exact, left_out=compared, basis=basis, on_motion=on_motion, of_scans=of_scans,
        slips=slips, **vars(known),
    )  # fmt: skip


def _compared(
    sparse: Log,
    fitted: Unknowns,
    dead_reckoning: Unknowns,
    name: str,
    noise: tuple[MotionModel, SensorModel],
    rng: np.random.Generator,
) -> LeftOut:
    """How well the estimate, dead reckoning and other noise predict sightings of a log that are left out."""
    other = Unknowns(sparse, sparse.landmarks, fitted.sensor, fitted)
    other.hold_noise(*noise)
    return left_out(sparse, {ESTIMATE: fitted, DEAD_RECKONING: dead_reckoning, name: other}, rng)


def _with_dead_reckoning(fitted: Unknowns, size: float) -> Unknowns:
    """The same problem with its trajectory by odometry whose noise has this part of typical standard deviations."""
    exact = fitted.with_nearly_exact_odometry()
    exact.logarithms |= {name: exact.centres[name] + 2 * float(np.log(size)) for name in exact.motion_parts}
    exact.hold(KINDS["odometry"])
    exact.take_noise()
    poses = exact.dead_reckoning()
    exact.state = np.concatenate([poses, exact.places(poses)])
    return exact


def _with_ids(
    log: Log,
    sensor: SensorModel,
    rng: np.random.Generator,
    motion: MotionModel | None = None,
    start: Unknowns | None = None,
) -> tuple[Log, Unknowns, Ids, tuple[Slip, ...]]:
    """The log with only its sightings with ids, the solution with the landmarks by their ids, these ids checked, and slips.

    Controls of slips have more noise in this log.

    Args:
        motion: the noise of the motion is this, and that of the sensor that of ``sensor``. Default: both are estimated.
        start: begin from this solution of the drive, and with its priors.
    """
    drive = _of_sightings(log.with_sightings(log.landmarks != UNIDENTIFIED))
    drive, local, doubtful, alone, slips = _local(drive, sensor, motion, start)
    fewer = _at_most(drive.with_sightings(~doubtful), MOST)
    first = _joined(fewer, sensor, local, ROUNDS[1])[0]
    if motion is None and start is None:
        # before the ids are checked, because a wrong place makes right ids look wrong
        start = better_start(_of_sightings(_sparse(fewer)[0]), first)
        if start is not None:
            drive, first, ids, more = _with_ids(drive, sensor, rng, start=start)
            return drive, first, ids, slips + more
    return drive, first, checked_ids(drive, _everywhere(first, fewer), alone, rng), slips


def with_checked_ids(log: Log, motion: MotionModel, sensor: SensorModel) -> Log:
    """The log of a robot that is known, with the ids that contradict their place replaced or left out, and a note.

    Args:
        log: without biases.
        motion, sensor: the noise.

    Raises:
        LogError: the log has too few sightings with ids, or no controls.
        GraphError: the sightings do not determine the poses, or so many ids contradict that the noise is probably wrong.
    """
    count = np.count_nonzero(log.landmarks != UNIDENTIFIED)
    if log.controls is None or count < FEWEST["sightings"] or log.num_poses < FEWEST["poses"]:
        sizes = singular(f"{count} sightings with ids from {log.num_poses} poses")
        raise LogError(
            f"{log.name} has {sizes}; that takes odometry, {FEWEST['sightings']} sightings and {FEWEST['poses']} poses"
        )
    try:
        drive, _, ids, slips = _with_ids(log, sensor, np.random.default_rng(0), motion)
    except np.linalg.LinAlgError:
        raise GraphError(f"{log.name}: the sightings do not determine the poses") from None
    ids = ids.within(log.landmarks)
    if ids.share > MANY_MISREAD:
        raise GraphError(
            f"{ids.share:.0%} of the sightings contradict their id by this noise, more than sensors misread; is it the noise "
            "of this robot?"
        )
    of_ids = (each for each in (ids.sentence, ids.sentence_on_moved) if each is not None)
    notes = (*(slip.sentence(log) for slip in slips), *of_ids)
    if not notes:
        return log
    return ids.correct(log).replace(notes=(*log.notes, *notes), control_variances=drive.control_variances)


def _check(log: Log) -> None:
    """Raise `LogError` where a log does not determine noise and biases."""
    if log.controls is None:
        raise LogError(f"{log.name} has no odometry, without which sightings do not tell the noise; give it by hand")
    count = int(np.count_nonzero(log.landmarks != UNIDENTIFIED))
    if count == 0 < len(log.steps):
        raise LogError(f"{log.name} has sightings without ids; find them first, for example with fastslam.associate")
    if count < FEWEST["sightings"] or log.num_poses < FEWEST["poses"]:
        with_ids = "" if log.identified else " with ids"
        with_ids += " of range and bearing" if log.partial_sightings is not None else ""
        raise too_few(log, f"{count} sightings{with_ids}")


def too_few(log: Log, sightings: str) -> LogError:
    """The error for a log with so few sightings, "7 sightings", or so few poses that noise and biases cannot be estimated."""
    sizes = singular(f"{sightings} from {log.num_poses} poses")
    return LogError(
        f"{log.name} has {sizes}; noise and biases are estimated from at least {FEWEST['sightings']} sightings and "
        f"{FEWEST['poses']} poses"
    )


def _local(
    log: Log, sensor: SensorModel, motion: MotionModel | None, start: Unknowns | None
) -> tuple[Log, Unknowns, np.ndarray, np.ndarray, tuple[Slip, ...]]:
    """The log with more noise of the controls of slips, and the problem of episodes, solved; (M,) bool which sightings stand
    alone in time or contradict their episode, and which stand alone; and the slips."""
    for pause in PAUSES:
        episodes = _episodes(log, pause)
        alone = np.bincount(episodes)[episodes] == 1
        if np.mean(alone) <= RARE:
            break
    else:
        # single sightings are normal
        alone = np.zeros(len(log.steps), dtype=bool)
    if len(log.steps) <= MOST:
        local = fit(_begun(log, episodes, sensor, motion, start), ROUNDS[0])[0]
    else:
        # noise and biases from the beginning, and with them all poses
        beginning = _beginning(log, MOST)
        begun = _begun(beginning, episodes[: len(beginning.steps)], sensor, motion, start)
        part = fit(begun, ROUNDS[0])[0]
        local = Unknowns(log, episodes, sensor, part)
        local.iterate(4)

    def again(solved: Unknowns, noisier: Log) -> Unknowns:
        start = copy(solved)
        start.odometry = Odometry(noisier)
        return fit(Unknowns(noisier, episodes, sensor, start), ROUNDS[1])[0]

    local, log, slips, _ = without_slips(local, log, slip_of_drive, again, gain_over)
    local, log, more = without_contradicted(local, log, again, MOST_SLIPS - len(slips))
    slips += more
    doubtful = alone.copy()
    doubtful[np.flatnonzero(local.used)] |= local.linearized().edges[1].squares > CONTRADICTS
    return log, local, doubtful, alone, slips


def _begun(
    log: Log, groups: np.ndarray, sensor: SensorModel, motion: MotionModel | None, start: Unknowns | None
) -> Unknowns:
    """The first problem of a log; where the noise is known, it is held, and there are no biases."""
    unknowns = Unknowns(log, groups, sensor, start)
    if motion is not None:
        unknowns.hold_noise(motion, sensor)
    return unknowns


def _episodes(log: Log, pause: float) -> np.ndarray:
    """The number (M,) of the episode of each sighting."""
    t = sighting_times(log)
    order = np.lexsort((np.arange(len(t)), log.landmarks))
    new = np.ones(len(t), dtype=bool)
    new[1:] = (np.diff(log.landmarks[order]) != 0) | (np.diff(t[order]) > pause)
    episodes = np.empty(len(t), dtype=np.int64)
    episodes[order] = np.cumsum(new) - 1
    return episodes


def _seen_again(log: Log) -> float:
    """The part of the landmarks that are seen again after the longer of `PAUSES`."""
    _, first = np.unique(_episodes(log, PAUSES[1]), return_index=True)
    return float(np.mean(np.unique(log.landmarks[first], return_counts=True)[1] > 1)) if len(first) else 0.0


def _of_sightings(log: Log) -> Log:
    """The log with only its first and last pose and those from which something was seen; motions between are joined."""
    return log.at_steps(np.unique([0, *log.steps, log.num_poses - 1]))


def _joined(log: Log, sensor: SensorModel, start: Unknowns, rounds: int) -> tuple[Unknowns, dict[str, float]]:
    """`fit` with the landmarks by their ids, and only with the poses from which they were seen."""
    few = _of_sightings(log)
    return fit(Unknowns(few, few.landmarks, sensor, start), rounds)


def _everywhere(fitted: Unknowns, log: Log) -> Unknowns:
    """The solution of `_joined` with all poses of its log."""
    return fitted if fitted.poses == log.num_poses else solved_with(fitted, log, log.landmarks)


def _correlations(log: Log, sparse: Log, used: np.ndarray, fitted: Unknowns, rng: np.random.Generator) -> np.ndarray:
    """The `smoothed` correlations (B,) of errors, from the solution of few sightings ``sparse``, (M,) bool ``used``.

    All are zero where not even all sightings show that `errors_last`.
    """
    part = _beginning(log, MOST_CORRELATED)
    # with numbers of its own, so that it changes none of the others
    if not errors_last(solved_with(fitted, part, part.landmarks, (2, 1)), rng.spawn(1)[0]):
        return np.zeros(len(LAGS) - 1)
    whole = _everywhere(fitted, sparse.at_steps(np.arange(part.num_poses)))
    return smoothed(correlations(part, whole, used[: len(part.steps)], rng))


def _is_exact(
    log: Log,
    sparse: Log,
    used: np.ndarray,
    fitted: Unknowns,
    exact: Unknowns,
    on_motion: float,
    rng: np.random.Generator,
) -> bool:
    """Whether the log does not show that the odometry is noisy.

    Both problems are those of few sightings ``sparse``, (M,) bool ``used``: ``fitted`` with the noise of the motion that was
    found, and ``exact`` with a small part of it. Such noise follows errors of the sightings that are correlated, which then
    do not show. So the gain of the log likelihood is divided by the number of sightings that count as one where there is
    hardly any noise. It must be small with few sightings, and with one of each landmark in `MORE` seconds, where these are
    more. A log with fewer than `ENOUGH` such sightings shows too little, and so does a short drive or a poor sensor.

    Args:
        on_motion: the `numbers_on_motion` of ``fitted``.
    """
    few = len(fitted.log.steps)
    if few < ENOUGH or on_motion < SHOWN:
        return False
    rho = _correlations(log, sparse, used, exact, rng)
    if gain_over(fitted, exact) >= NEEDED * inflation(sparse, rho):
        return False
    more = _at_most(_thinned(log, MORE)[0], MOST)
    if len(more.steps) <= few:
        return True
    fitted, exact = (_joined(more, fitted.sensor, each, ROUNDS[1])[0] for each in (fitted, exact))
    return gain_over(fitted, exact) < NEEDED * inflation(more, rho)


def _thinned(log: Log, interval: float) -> tuple[Log, np.ndarray]:
    """The log with one sighting of each landmark in each interval [s], and which those are, (M,) bool."""
    # the numbers of the landmarks: large ids do not fit floating point
    landmarks = np.unique(log.landmarks, return_inverse=True)[1].ravel()
    slots = np.unique(np.floor((sighting_times(log) + ROUNDING) / max(interval, 1e-9)), return_inverse=True)[1].ravel()
    _, groups, count = np.unique(landmarks * (len(slots) + 1) + slots, return_inverse=True, return_counts=True)
    order = np.argsort(groups, kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    used = np.zeros(len(log.steps), dtype=bool)
    # the middle one of each interval
    used[order[starts + count // 2]] = True
    return log.with_sightings(used), used


def _beginning(log: Log, count: int) -> Log:
    """The first poses of a log, with so many sightings, or a few more from the last one."""
    return log if len(log.steps) <= count else log.at_steps(np.arange(log.steps[count] + 1))


def _at_most(log: Log, count: int) -> Log:
    """The log with so many sightings at most, `_thinned` by the shortest of `INTERVALS` that is enough, or the longest."""
    for interval in (0.0, *reversed(INTERVALS)):
        fewer = log if interval == 0 else _thinned(log, interval)[0]
        if len(fewer.steps) <= count:
            break
    return fewer


def _sparse(log: Log) -> tuple[Log, np.ndarray]:
    """`_thinned` by the longest of `INTERVALS` that leaves enough sightings."""
    for interval in INTERVALS:
        sparse, used = _thinned(log, interval)
        if len(sparse.steps) >= min(ENOUGH, len(log.steps) / 3):
            break
    return sparse, used
