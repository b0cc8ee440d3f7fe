"""`estimate_robot` for all logs, also those of robots that see ranges or bearings alone, such as radio beacons or a camera.

A single number does not tell where its landmark is. So the log is solved with other noise first, and from there poses,
places, biases and variances together, as those of whole sightings (`identification.unknowns`). Ids are taken as they are,
errors of successive numbers as independent, and the odometry of robots with few ranges or none as that which tells lengths.

**In a map.** Noise is estimated from the log alone. A map tells biases that a log hardly does, such as that of all ranges. So
the log is solved in its map together with its biases p. Without the map, and from this solution on, one Gauss-Newton step
leads to what the log alone says of them, p + d with the covariance C. If the map is right, d' C^-1 d is at most chi-square
with as many degrees of freedom as there are biases. A map of another scale, whose error biases would explain, has more; then
the log's own biases stay.

Source: Hausman, *Specification tests in econometrics*, Econometrica 46(6), 1978.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike

import numpy as np

from ..edges import LandmarkPriors, PriorEdges
from ..errors import GraphError
from ..graph import Graph
from ..graph.defaults import anchors
from ..identification.declared import PLACE, ParameterEstimate, one_after_the_other
from ..identification.restricted_likelihood import fit, hold_needless, numbers_on_motion
from ..identification.result import ESTIMATE, LeftOut, RobotEstimate, without_found
from ..identification.robot import FEWEST, check_robot_options, estimate_from_sightings, too_few
from ..identification.sighting_errors import Ids
from ..identification.unknowns import PRIORS, Unknowns
from ..log import Log
from ..maps.landmark_map import LandmarkMap, as_map
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .joint import JointGraph
from .solution import Solution
from .solve import solve

#: what bearings with few ranges hardly tell: scales, and what ranges have in common. They tell the place of the sensor on a
#: robot that turns, in metres of the odometry: 15 cm that were held at 0 made the ATE two to three times as large
UNTOLD = ("wheel_scale", "turn_scale", "range_bias")
#: fewer ranges than this, or for each pose less than this, leave lengths untold: a shorter drive needs less noise of the
#: odometry at every pose, and few ranges count as wrong beside that (one among 940 bearings: a wheel scale of 1.12 for 1)
FEWEST_RANGES, FOR_EACH_POSE = 20, 0.1
#: the most numbers that are used, from the beginning of the log; rounds of solving and improving the variances
MOST, ROUNDS = 6000, 12
#: the quantile of chi-square above which the map contradicts the biases that a log shows. Of 24 drives in the right map the
#: largest number was 7.3 for nine biases; in maps of 1.02 times the size that no other test had found, 11 to 38
SURELY = 0.95
#: what Omega's diagonal is raised by where pieces of the drive are free
FREE = 1e-9


def estimate_robot(
    log: Log,
    *,
    sensor: SensorModel | None = None,
    given: tuple[MotionModel, SensorModel] | None = None,
    seed: int = 0,
    single_landmarks: bool = True,
    map: LandmarkMap | Mapping[int, Array] | str | PathLike[str] | None = None,
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
        map: of landmarks, as for `Graph.from_log`: whole sightings in it tell the biases, too, unless it contradicts what
            the log says of them (`RobotEstimate.against_map`).

    Raises:
        LogError: the log has too few sightings with ids, or no controls.
        GraphError: the sightings do not determine noise and biases.
        OptionError: an option has an impossible value.
    """
    check_robot_options(log, sensor, given, seed)
    partial = log.partial_sightings
    if len(log.steps) or partial is None or log.controls is None:
        found = estimate_from_sightings(log, sensor, given, seed, single_landmarks)
        return found if map is None else _in_map(found, log, as_map(map))
    if len(partial) < FEWEST["sightings"] or log.num_poses < FEWEST["poses"]:
        raise too_few(log, f"{len(partial)} ranges and bearings alone")
    sensor = sensor or (given[1] if given else log.sensor) or SensorModel()
    motion, seen = given or (MotionModel(), sensor)
    first = solve(Graph.from_log(log, motion=motion, sensor=replace(seen, offset=sensor.offset)))
    try:
        return _from_solution(log, sensor, first.poses, first.landmarks)
    except np.linalg.LinAlgError:
        raise GraphError(f"{log.name}: its ranges and bearings alone do not determine noise and biases") from None


def _in_map(found: RobotEstimate, log: Log, known: LandmarkMap) -> RobotEstimate:
    """The estimate from a log with the biases that its map tells, too.

    Without a fix in the map, or where the log shows no biases and no noise of its own, it stays as it is.
    """
    from scipy.special import gammaincinv

    # positions may be in another frame than the map
    sighted = found.log.replace(partial_sightings=None, relations=None, positions=None)
    try:
        graph = Graph.from_log(sighted, motion=found.motion, sensor=found.sensor, map=known, edges="landmark+motion")
        alone = solve(graph)
        held = None if alone.graph is None else alone.graph.held
        if alone.graph is None or held is None or not alone.converged:
            return found
        biased = replace(alone.graph, parameters=held, held=None, initial=alone.state.copy())
        solution = solve(biased, initialize="given")
        if not solution.converged or solution.parameters is None:
            return found
        p = solution.parameters
        away, covariance = _without_map(solution)
    except (GraphError, np.linalg.LinAlgError):
        return found
    of_log = dict(zip(found.parameters.names, found.parameters.values.tolist()))
    both = one_after_the_other(of_log, dict(zip(p.names, p.values.tolist())))
    values = np.array([p[name] if name in PLACE else both[name] for name in p.names])
    if away @ np.linalg.solve(covariance, away) > 2 * gammaincinv(len(away) / 2, SURELY):
        apart = np.abs(away) / np.sqrt(np.diag(covariance))
        k = int(np.argmax(apart))
        doubt = (
            f"with the map, {p.names[k]} would be {values[k]:.4g}, {apart[k]:.1f} standard deviations from what the log says "
            "without it: the map or the ranges have a wrong scale, landmarks have moved, or ids are wrong. Biases are those "
            "of the log without the map"
        )
        return replace(found, against_map=doubt)
    priors = dict(zip(p.names, zip(held.means.tolist(), held.deviations.tolist())))
    of_both = ParameterEstimate(p.names, values, p.covariance, priors | dict(found.parameters.priors))
    ahead, left = (p[name] if name in p.names else here for name, here in zip(PLACE, found.sensor.offset))
    found = replace(found, parameters=of_both, sensor=replace(found.sensor, offset=(ahead, left)), in_map=True)
    return replace(found, log=found.corrected(found.ids.correct(log)))


def _without_map(solution: Solution) -> tuple[Array, Array]:
    """How the log alone would change the parameters of a solution in a map, (K,), and their covariance without it (K, K).

    Raises:
        GraphError: the log alone does not determine them.
    """
    graph = solution.graph
    assert graph is not None and graph.log is not None
    measured = [family for family in graph.families if not isinstance(family, (LandmarkPriors, PriorEdges))]
    nodes = len(graph.steps) + np.flatnonzero(~np.isin(graph.landmark_ids, graph.log.landmarks))
    families = (*anchors(solution.state[0], measured), *measured)
    joint = JointGraph(replace(graph, families=families, fixed=nodes, map=None))
    state = joint.joined(solution.state, graph.estimated.values)
    joint.linearize(state)
    try:
        joint.factorize()
    except GraphError:
        # where the robot was lifted, the map alone holds what follows, whose place tells nothing of the parameters
        joint.factorize(FREE)
    return joint.parted(joint.solve())[1], joint.parameter_covariance


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
        on_motion=numbers_on_motion(unknowns),
    )  # fmt: skip
