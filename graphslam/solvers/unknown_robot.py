"""`estimate_robot` for all logs, also those of robots that see ranges or bearings alone, such as radio beacons or a camera.

A single number does not tell where its landmark is. So the log is solved with other noise first, and from there poses,
places, biases and variances together, as those of whole sightings (`identification.unknowns`). Ids are taken as they are,
errors of successive numbers as independent, and the odometry of robots with few ranges or none as that which tells lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..identification.restricted_likelihood import fit, hold_needless
from ..identification.result import ESTIMATE, LeftOut, RobotEstimate, without_found
from ..identification.robot import FEWEST, check_robot_options, estimate_from_sightings, too_few
from ..identification.sighting_errors import Ids
from ..identification.unknowns import PRIORS, Unknowns
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .solve import solve

#: what bearings with few ranges hardly tell: lengths, and turns apart from them
UNTOLD = ("wheel_scale", "turn_scale", "range_bias", "sensor_ahead", "sensor_left")
#: fewer ranges than this, or for each pose less than this, leave lengths untold: a shorter drive needs less noise of the
#: odometry at every pose, and few ranges count as wrong beside that (one among 940 bearings: a wheel scale of 1.12 for 1)
FEWEST_RANGES, FOR_EACH_POSE = 20, 0.1
#: the most numbers that are used, from the beginning of the log; rounds of solving and improving the variances
MOST, ROUNDS = 6000, 12


def estimate_robot(
    log: Log,
    *,
    sensor: SensorModel | None = None,
    given: tuple[MotionModel, SensorModel] | None = None,
    seed: int = 0,
    single_landmarks: bool = True,
) -> RobotEstimate:
    """Estimate noise, biases and misread ids of a log from nothing but its odometry and its sightings.

    From whole sightings, the estimate is compared with dead reckoning and with the noise of the book: which predicts
    sightings best that are left out (`RobotEstimate.left_out`)? The best counts. A log of ranges or bearings alone is solved
    with the noise of the book first. Its ids are not checked, and with few ranges biases in lengths are not estimated.

    Args:
        log: with controls and ids. Sightings without an id are corrected like the others, but not used. Ranges and bearings
            alone are used where there are no whole sightings.
        sensor: where the sensor is believed to be, and what it can see; default: that of the log, else at the robot's pose;
            for ranges and bearings alone first of all that of ``given``.
        given: noise to compare with in place of the book's, or to solve with first.
        seed: of the random signs with which expectations are computed.
        single_landmarks: whether to look for ranges that are off for single landmarks, and to correct them by the ids.

    Raises:
        LogError: the log has too few sightings with ids, or no controls.
        GraphError: the sightings do not determine noise and biases.
        OptionError: an option has an impossible value.
    """
    check_robot_options(log, sensor, given, seed)
    partial = log.partial_sightings
    if len(log.steps) or partial is None or log.controls is None:
        return estimate_from_sightings(log, sensor, given, seed, single_landmarks)
    if len(partial) < FEWEST["sightings"] or log.num_poses < FEWEST["poses"]:
        raise too_few(log, f"{len(partial)} ranges and bearings alone")
    sensor = sensor or (given[1] if given else log.sensor) or SensorModel()
    motion, seen = given or (MotionModel(), sensor)
    first = solve(Graph.from_log(log, motion=motion, sensor=replace(seen, offset=sensor.offset)))
    try:
        return _from_solution(log, sensor, first.poses, first.landmarks)
    except np.linalg.LinAlgError:
        raise GraphError(f"{log.name}: its ranges and bearings alone do not determine noise and biases") from None


def _from_solution(log: Log, sensor: SensorModel, poses: Array, landmarks: Mapping[int, Array]) -> RobotEstimate:
    """The estimate from a solution of the log: poses (T+1, 3), and {id: (2,)} of the landmarks that have a place."""
    partial = log.partial_sightings
    assert partial is not None
    # in the order of time, as `Unknowns` takes them
    order = np.argsort(partial.steps, kind="stable")[:MOST]
    order = order[np.isin(partial.landmarks[order], list(landmarks))]
    if not len(order):
        message = f"{log.name}: its ranges and bearings alone give no landmark a place, so that nothing tells the noise"
        raise GraphError(message)
    steps = np.unique([0, *partial.steps[order]])
    few = log.replace(partial_sightings=partial.among(order)).at_steps(steps)
    assert few.partial_sightings is not None
    unknowns = Unknowns(few, few.partial_sightings.landmarks, sensor, places=landmarks)
    unknowns.state[: len(steps)] = poses[steps]
    ranged = few.partial_sightings.ranged[unknowns.used]
    # two numbers do no more than place their landmark
    telling = np.count_nonzero(ranged & (np.bincount(unknowns.seen)[unknowns.seen] > 2))
    enough = telling >= max(FEWEST_RANGES, FOR_EACH_POSE * len(steps))
    untold = dict[str, float]() if enough else {name: PRIORS[name] for name in UNTOLD}
    untested = ("sensor_delay", *(["bearing_bias"] if ranged.all() else []), *untold)
    unknowns.hold(untested)
    _, errors = fit(unknowns, ROUNDS)
    held = hold_needless(unknowns, ROUNDS) | untold
    motion, seen = unknowns.models
    corrected, estimate = without_found(unknowns, log, held, motion, seen)
    none = np.zeros(len(partial), dtype=bool)
    return RobotEstimate(
        log=corrected, motion=motion, sensor=seen, parameters=estimate, errors=errors,
        ids=Ids(partial.landmarks, none, none, ~none), left_out=LeftOut(0, {ESTIMATE: 0.0}), untested=untested,
    )  # fmt: skip
