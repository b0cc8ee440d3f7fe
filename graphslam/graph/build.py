"""The nodes and edges of the `Graph` of a log, and `estimate_map`: the map from a log and a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import chain
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..edges import (
    CartesianObservationEdges,
    EdgeFamily,
    LandmarkPriors,
    LandmarkSightings,
    MarginalEdges,
    PolarObservationEdges,
    PositionEdges,
    PriorEdges,
    RelationEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
    freest_turn,
    motion_edges,
)
from ..edges.robust import Kernel, kernel_of
from ..errors import GraphError, LogError, OptionError, checks, quoted
from ..identification.declared import Parameters
from ..identification.known import AUTO, BOOK, enough_ids, noise_of, unknown_noise
from ..identification.result import RobotEstimate
from ..linear.precision import check_magnitudes, inverses
from ..log import UNIDENTIFIED, Log
from ..maps.landmark_map import LandmarkMap
from ..maps.tracking import follow
from ..models import EdgeOptions, MotionModel, SensorModel
from ..se2 import Array
from .defaults import anchors, position_edges
from .trilateration import edges_of_single_numbers, placed_single_numbers

if TYPE_CHECKING:
    from .graph import Graph

#: the parts of the book's noise of motion and sensor by which the log of an unknown robot is looked for in a map
PARTS = ((0.1, 0.3), (0.3, 0.3), (1.0, 1.0))


def noise_in_map(
    log: Log, landmarks: LandmarkMap | None, motion: MotionModel | None, sensor: SensorModel | None, noise: str | None
) -> tuple[Log, MotionModel, SensorModel, RobotEstimate | None]:
    """`noise_of` a log that is solved in a map, if any.

    Where sightings have no ids, noise that is not known is estimated with those that the map gives, by the part of the
    book's noise with which it gives most, or by the robot that association finds where it gives none. The log keeps its ids:
    the map gives the others again by the noise that was found.
    """
    free = (motion is None, sensor is None)
    unknown = any(free) and noise != BOOK and (noise == AUTO or unknown_noise(log))
    if landmarks is None or not unknown or enough_ids(log):
        return noise_of(log, motion, sensor, noise, landmarks)
    known, ids, most, nowhere = log.noise_models(motion, sensor), log.landmarks, 0, None
    for parts in PARTS:
        moves, sees = (_scaled(model, part if each else 1.0) for model, part, each in zip(known, parts, free))
        try:
            found = follow(log, landmarks, motion=moves, sensor=sees).landmarks
        except GraphError as error:
            nowhere = error
            continue
        if (count := int(np.isin(found, list(landmarks)).sum())) > most:
            ids, most = found, count
        if most == len(ids):
            break
    if most == 0 and nowhere is not None:
        # it solves graphs, so it is looked up at the call: ids and robot in turn, without the map
        from .. import calibrate

        try:
            ids = follow(calibrate(log, source="residuals", sensor=sensor).apply(log), landmarks).landmarks
        except (GraphError, LogError):
            if noise == AUTO:
                raise nowhere from None
    named, motion, sensor, robot = noise_of(log.replace(landmarks=ids), motion, sensor, noise, landmarks)
    if robot is not None:
        # ranges are corrected by ids, too
        log = robot.corrected(log.replace(landmarks=ids)).replace(landmarks=log.landmarks)
    # ids that do not fit are no longer those of the log
    notes = tuple(note for note in named.notes if robot is None or note != robot.ids.sentence)
    return log.replace(notes=notes, doubts=named.doubts), motion, sensor, robot


def _scaled(model: Any, part: float) -> Any:
    """A noise model whose deviations are a part of its own."""
    names = {each.name for each in fields(model)} - {*SensorModel.GEOMETRY, "epsilon"}
    return replace(model, **{name: part * getattr(model, name) for name in names})


def graph_of_log(
    make: type[Graph],
    log: Log,
    *,
    motion: MotionModel,
    sensor: SensorModel,
    options: EdgeOptions,
    kernel: Kernel | None,
    landmark_map: LandmarkMap | None,
    notes: Sequence[str],
    **declared: Parameters | None,
) -> Graph:
    """The graph of a log; arguments and errors as in `Graph.from_log`.

    With a map the log is in its frame already, and the map takes the place of the anchor. ``declared`` are the parameters.
    """
    with_motion, frame = options.with_motion, options.frame
    _check_log(log, with_motion)
    if log.partial_sightings is not None and len(log.steps) == 0:
        log = log.without_orientation()
    if log.partial_sightings is not None and not options.landmark_nodes:
        raise GraphError("ranges or bearings alone need their landmarks as nodes: use edges='landmark+motion'")
    check_magnitudes(log, motion, sensor)
    sighted: EdgeFamily
    ids, d, fixed = np.zeros(0, dtype=np.int64), 2, np.zeros(0, dtype=np.int64)
    if options.landmark_nodes:
        steps = np.arange(log.num_poses)
        d = log.sightings.shape[1]
        known = _usable(landmark_map, d, set(log.landmark_ids.tolist()))
        partial, single, remarks = placed_single_numbers(log, sensor, kernel, known)
        ids = np.union1d(log.landmark_ids, np.array([*known, *single], dtype=np.int64))
        nodes = log.num_poses + np.searchsorted(ids, log.landmarks)
        seen = (log.steps, nodes, log.sightings, sensor)
        if options.residual == "polar":
            sighted = PolarObservationEdges(*seen, kernel=kernel)
        else:
            sighted = CartesianObservationEdges(*seen, kernel=kernel, frame=frame)
        landmarks = np.zeros((len(ids), 3))
        whole = estimate_map(log, log.initial_poses, sensor=sensor) if len(log.steps) else {}
        for j, place in (single | whole | known).items():
            landmarks[np.searchsorted(ids, j), : min(len(place), d)] = place[:d]
        rows = np.arange(len(log.steps))
    else:
        steps, remarks = _tied_steps(log, with_motion)
        rows, starts, nodes = _grouped(log, steps)
        grouped = (starts, nodes, log.sightings[rows], sensor)
        if options.weight == "marginal":
            sighted = MarginalEdges(*grouped, frame=frame, kernel=kernel)
        else:
            sighted = VirtualMotionEdges(*grouped, frame=frame, kernel=kernel, tempered=options.weight == "tempered")
        landmarks = np.zeros((0, 3))
        if not with_motion:
            _check_determined(sighted, steps, _measured_edges(log, steps, kernel))
    poses = log.initial_poses[steps]
    initial = np.concatenate([poses, landmarks])
    measured = _measured_edges(log, steps, kernel)
    families: list[EdgeFamily]
    if landmark_map is None:
        families = [*anchors(poses[0], measured)]
    else:
        families, fixed = priors_of_map(landmark_map, known, ids, initial, d)
    families.append(sighted)
    if with_motion:
        assert log.controls is not None and log.dt is not None
        families.append(
            motion_edges(
                steps, log.controls, log.dt, motion, starts=log.control_starts,
                control_variances=log.control_variances, recorded_dt=log.recorded_dt, frame=frame,
                scale=options.motion_weight,
            )
        )  # fmt: skip
    families += measured
    if options.landmark_nodes:
        nodes = log.num_poses + np.searchsorted(ids, partial.landmarks)
        families += edges_of_single_numbers(partial, nodes, sensor, kernel)
    return make(
        initial, families=tuple(families), steps=steps, trajectory=log.initial_poses, pose_ids=steps, landmark_ids=ids,
        landmark_dimension=d, fixed=fixed, log=log, motion=motion, sensor=sensor, notes=(*remarks, *notes),
        sighting_rows=rows, map=landmark_map, **declared,
    )  # fmt: skip


def _measured_edges(log: Log, steps: np.ndarray, kernel: Kernel | None) -> list[RelationEdges | PositionEdges]:
    """The edges of the relations and the absolute positions of a log, whose nodes are at ``steps``."""
    families: list[RelationEdges | PositionEdges] = []
    if (relations := log.relations) is not None and len(relations):
        ends = np.searchsorted(steps, relations.first), np.searchsorted(steps, relations.second)
        information = inverses(relations.covariances, "relation", "check its covariance")
        families.append(RelationEdges(*ends, relations.motions, information, kernel=kernel))
    if log.positions is not None and len(log.positions):
        families += position_edges(log.positions, np.searchsorted(steps, log.positions.steps), kernel)
    return families


def _usable(landmark_map: LandmarkMap | None, d: int, seen: set[int]) -> dict[int, Array]:
    """The landmarks of a map that can be nodes with d coordinates: the map, or sightings, must determine them all."""
    if landmark_map is None:
        return {}
    uncertain = landmark_map.covariances
    return {j: place for j, place in landmark_map.items() if len(place) >= d or (j in uncertain and j in seen)}


def priors_of_map(
    landmark_map: LandmarkMap, known: dict[int, Array], ids: np.ndarray, initial: Array, d: int
) -> tuple[list[EdgeFamily], np.ndarray]:
    """The edges of a map, and its nodes that are held, in a graph with the landmarks ``ids`` in the last rows of initial."""
    poses = len(initial) - len(ids)
    uncertain = [j for j in known if j in landmark_map.covariances]
    fixed = poses + np.searchsorted(ids, [j for j in known if j not in landmark_map.covariances])
    nodes = poses + np.searchsorted(ids, uncertain)
    if not uncertain:
        return [], fixed
    if landmark_map.joint is not None:
        information = landmark_map.information(uncertain, d)
        return [PriorEdges(nodes, initial[nodes], information, pivot=freest_turn(initial[nodes], information))], fixed
    information = np.array([landmark_map.own_information(j, d) for j in uncertain])
    return [LandmarkPriors(nodes, initial[nodes], information)], fixed


def _check_log(log: Log, with_motion: bool) -> None:
    if len(log.steps) == 0 and not any(map(len, log.measured.values())):
        message = f"{log.name} has no sightings at all, and no relations or positions: nothing corrects dead reckoning"
        raise GraphError(message)
    if not log.identified:
        raise GraphError(
            f"{log.name} has {np.sum(log.landmarks == UNIDENTIFIED)} of {len(log.steps)} sightings without an id, and a "
            "graph needs the ids: find them with fastslam.associate, use FastSLAM, which finds them itself, or leave these "
            "sightings out: log.with_sightings(log.landmarks != graphslam.log.UNIDENTIFIED)"
        )
    if with_motion and log.controls is None:
        raise GraphError(f"{log.name} has no controls for motion edges; use edges='virtual'")


def _tied_steps(log: Log, with_motion: bool) -> tuple[np.ndarray, tuple[str, ...]]:
    """The steps whose poses are nodes of a graph without landmarks, and notes on what is left out."""
    ids, group = np.unique(log.landmarks, return_inverse=True)
    seen = np.unique(np.column_stack([group, log.steps]), axis=0)
    often = np.bincount(seen[:, 0]) > 1
    notes = []
    if not np.all(often):
        notes.append(f"no edge comes from {checks.listed('landmark', ids[~often].tolist())}, seen in one step only")
    if with_motion:
        return np.arange(log.num_poses), tuple(notes)
    ends = [getattr(each, end) for each in log.measured.values() for end in each.ENDS]
    steps = np.unique(np.concatenate([seen[often[seen[:, 0]], 1], *ends]))
    if not len(steps):
        raise GraphError(f"{log.name} has no landmark that was seen twice, so there are no virtual-motion edges")
    if left_out := np.setdiff1d(np.arange(log.num_poses), steps).tolist():
        notes.append(f"{checks.listed('pose', left_out)} shared no sighting with any other and stayed out of the graph")
    return steps, tuple(notes)


def _grouped(log: Log, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sightings from given steps by landmark, and by step within one: rows (M,), starts (G+1,), nodes (M,)."""
    node_of = np.full(log.num_poses, -1)
    node_of[steps] = np.arange(len(steps))
    rows = np.argsort(log.landmarks, kind="stable")
    # a sighting from a pose that is no node is a landmark's only one, and has no partner
    rows = rows[node_of[log.steps[rows]] >= 0]
    _, starts = np.unique(log.landmarks[rows], return_index=True)
    return rows, np.append(starts, len(rows)), node_of[log.steps[rows]]


def with_closures(families: Sequence[EdgeFamily], kernel: Kernel | None) -> tuple[EdgeFamily, ...]:
    """The edges of a pose graph with its loop closures as relations that may be wrong; see `Graph.with_closures`."""
    found: list[EdgeFamily] = []
    for f in families:
        if not isinstance(f, RelativePoseEdges) or isinstance(f, RelationEdges) or f.state_dependent_information:
            found.append(f)
            continue
        closes = np.abs(f.second - f.first) != 1
        if not closes.all():
            found.append(f.among(~closes))
        if closes.any():
            closures = f.among(closes)
            ends, measured = (closures.first, closures.second), (closures.measured, closures.information)
            found.append(RelationEdges(*ends, *measured, kernel=kernel))
    return tuple(found)


def node_names(nodes: np.ndarray, pose_ids: np.ndarray, landmark_ids: np.ndarray) -> str:
    """The names of nodes in a sentence: 'poses 3 and 4', 'landmark 7', 'pose 2 and landmark 5'."""
    pose = nodes < len(pose_ids)
    named = (("pose", pose_ids[nodes[pose]]), ("landmark", landmark_ids[nodes[~pose] - len(pose_ids)]))
    return " and ".join(checks.listed(noun, ids.tolist()) for noun, ids in named if len(ids))


def pieces(num_nodes: int, first: Sequence[np.ndarray], second: Sequence[np.ndarray]) -> np.ndarray:
    """The number (n,) of the connected piece that each node belongs to."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([np.zeros(0, dtype=int), *first]), np.concatenate([np.zeros(0, dtype=int), *second])
    ties = coo_matrix((np.ones(len(ends[0])), ends), shape=(num_nodes, num_nodes))
    return connected_components(ties, directed=False)[1]


def _check_determined(
    virtual: LandmarkSightings, steps: np.ndarray, measured: Sequence[RelationEdges | PositionEdges]
) -> None:
    """Raise `GraphError` where the pattern alone shows that virtual edges and measured poses leave poses undetermined."""
    num_nodes, num_groups = len(steps), len(virtual.starts) - 1
    # positions tie poses to the world, one more node
    world, ends = num_nodes + num_groups, [(virtual.nodes, num_nodes + virtual.group)]
    for f in measured:
        both = (f.first, f.second) if isinstance(f, RelationEdges) else (f.nodes, np.full(f.count, world))
        ends.append(both)
    label = pieces(world + 1, *zip(*ends))
    loose = steps[label[:num_nodes] != label[0]].tolist()
    if loose:
        raise GraphError(
            f"the graph falls into several pieces: nothing ties {checks.listed('pose', loose)} to pose {steps[0]}; "
            "use edges='virtual+motion', or a log in which they share a landmark"
        )
    if virtual.oriented:
        return
    shared = np.unique(np.column_stack([virtual.nodes, virtual.group]), axis=0)
    ties = np.bincount(shared[:, 1], minlength=num_groups) > 1
    landmarks_of = np.bincount(shared[ties[shared[:, 1]], 0], minlength=num_nodes)
    held = np.isin(np.arange(num_nodes), np.concatenate([[], *chain(*ends[1:])]))
    loose = steps[(landmarks_of < 2) & ~held].tolist()
    if loose:
        share = "shares" if len(loose) == 1 else "share"
        raise GraphError(
            f"without psi one landmark does not fix a pose: {checks.listed('pose', loose)} {share} only one with the rest; "
            "use edges='virtual+motion' or a sensor with psi"
        )


def with_dimensions(log: Log, dimensions: int | None) -> Log:
    """The log whose sightings have so many numbers; None for those that it has."""
    if dimensions is not None and (not isinstance(dimensions, Integral) or dimensions not in (2, 3)):
        raise OptionError(f"dimensions must be 2 or 3, not {quoted(dimensions)}")
    if dimensions == 3 and not log.has_orientation:
        message = f"{log.name} has sightings without psi, but 3-D sensor values were asked for; use dimensions=2"
        raise GraphError(message)
    return log.without_orientation() if dimensions == 2 and log.has_orientation else log


def estimate_map(
    log: Log,
    poses: ArrayLike,
    *,
    sensor: SensorModel | None = None,
    kernel: Kernel | str | None = None,
    trust: ArrayLike | None = None,
    noise_at: ArrayLike | None = None,
) -> LandmarkMap:
    """m_j = argmin over m of the sum of w (m - y)' Omega (m - y), y = h^-1(x_t, z), Omega^-1 = R Q R', for each landmark.

    The weight w of a sighting is its trust times the weight of the kernel, 1 where there is neither.

    Headings are compared with that of the landmark itself, so the result does not depend on the order of the sightings.

    Args:
        log: whose sightings are used; those without a landmark id are left out.
        poses: the trajectory (T+1, 3), or anything with such an attribute ``poses``. A `Solution` of this log also gives
            the defaults of sensor, kernel, trust and noise_at, those of its graph, and the sightings where biases were
            taken out of them.
        sensor: the noise model; default: that of the solution's graph, else the log's, else the book's.
        kernel: a robust kernel on each sighting, as in `Graph.from_log`; the map is then the robust mean.
        trust: (M,) a factor from 0 to 1 on the information of each sighting, such as `Solution.trust`; NaN counts as 1.
        noise_at: (M, 2 or 3) the sightings at which Q and R are evaluated; default: the measured ones.

    Returns:
        The map, with the covariance of each landmark given the trajectory: (sum of w Omega)^-1, and with a kernel that of
        the robust mean (`Kernel.information_per_weight`).

    Raises:
        OptionError: the poses, the trust or noise_at do not fit the log, or there is no such kernel.
        GraphError: numbers of the log or the sensor are outside of what double precision can hold.

    Source: the lectures, section 9.1.2.
    """
    graph = getattr(poses, "graph", None)
    if graph is not None and graph.log is not None:
        own_kernel, own_trust, own_noise = graph.verdict
        sensor, kernel, trust = sensor or graph.sensor, kernel or own_kernel, own_trust if trust is None else trust
        if own_noise.shape == log.sightings.shape and np.array_equal(log.steps, graph.log.steps):
            noise_at = own_noise if noise_at is None else noise_at
            if graph.parameters is not None or graph.log.uncertain is not None:
                # the log as it was recorded has the biases that were taken out of that of the graph
                log = log.replace(sightings=graph.log.sightings)
    sensor = sensor or log.sensor or SensorModel()
    trajectory = checks.array_of("poses", getattr(poses, "poses", poses))
    if trajectory.shape != (log.num_poses, 3):
        raise OptionError(f"poses must have shape ({log.num_poses}, 3) for this log, not {trajectory.shape}")
    trusted = np.ones(len(log.steps)) if trust is None else np.nan_to_num(checks.array_of("trust", trust), nan=1.0)
    if trusted.shape != log.steps.shape or np.any((trusted < 0) | (trusted > 1)):
        raise OptionError(f"trust must be {len(log.steps)} numbers from 0 to 1, one for each sighting of this log")
    noisy = log.sightings if noise_at is None else checks.finite_numbers("noise_at", noise_at, log.sightings.shape)
    known = np.flatnonzero(log.landmarks != UNIDENTIFIED)
    if len(known) == 0:
        return LandmarkMap({}, {})
    check_magnitudes(log, None, sensor)
    rows = known[np.argsort(log.landmarks[known], kind="stable")]
    ids, starts = np.unique(log.landmarks[rows], return_index=True)
    edges = MarginalEdges(
        np.append(starts, len(rows)), log.steps[rows], log.sightings[rows], sensor,
        kernel=kernel_of(kernel), trust=trusted[rows], noise_at=noisy[rows],
    )  # fmt: skip
    means, covariances = edges.map(trajectory)
    return LandmarkMap.of_estimate(dict(zip(ids.tolist(), means)), dict(zip(ids.tolist(), covariances)))
