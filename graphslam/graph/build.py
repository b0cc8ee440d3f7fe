"""The parts of a `Graph` (see there for their names) from a log or a pose-graph file, and back into a file."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from ..edges import (
    AnchorEdges,
    BearingEdges,
    CartesianObservationEdges,
    EdgeFamily,
    LandmarkPriors,
    LandmarkSightings,
    MarginalEdges,
    PartialEdges,
    PolarObservationEdges,
    PositionEdges,
    PriorEdges,
    RangeEdges,
    RelationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
    motion_edges,
)
from ..edges.base import PairEdges
from ..edges.robust import Kernel
from ..errors import GraphError, OptionError, quoted
from ..errors.checks import listed
from ..io.pose_graph import KINDS, FileEdges, PoseGraphFile
from ..linear.precision import LARGEST, check_magnitudes, check_size, inverses
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .defaults import anchors, position_edges
from .landmark_map import LandmarkMap
from .mapping import estimate_map
from .trilateration import edges_of_single_numbers, placed_single_numbers


def parts_of_log(
    log: Log,
    *,
    motion: MotionModel,
    sensor: SensorModel,
    edges: str,
    frame: str,
    weight: str,
    scale: float,
    kernel: Kernel | None,
    residual: str,
    landmark_map: LandmarkMap | None = None,
) -> dict[str, Any]:
    """The parts of the graph of a log; arguments and errors as in `Graph.from_log`, ``scale`` for the motion edges.

    With a map the log is in its frame already, and the map takes the place of the anchor.
    """
    with_motion = edges.endswith("+motion")
    _check_log(log, with_motion)
    if log.partial_sightings is not None and len(log.steps) == 0:
        log = log.without_orientation()
    if log.partial_sightings is not None and not edges.startswith("landmark"):
        raise GraphError("ranges or bearings alone need their landmarks as nodes: use edges='landmark+motion'")
    check_magnitudes(log, motion, sensor)
    sighted: EdgeFamily
    parts: dict[str, Any] = {"trajectory": log.initial_poses, "log": log, "sensor": sensor}
    if edges.startswith("landmark"):
        steps = np.arange(log.num_poses)
        d = log.sightings.shape[1]
        known = _usable(landmark_map, d, set(log.landmark_ids.tolist()))
        partial, single, remarks = placed_single_numbers(log, sensor, kernel, known)
        ids = np.union1d(log.landmark_ids, np.array([*known, *single], dtype=np.int64))
        nodes = log.num_poses + np.searchsorted(ids, log.landmarks)
        seen = (log.steps, nodes, log.sightings, sensor)
        if residual == "polar":
            sighted = PolarObservationEdges(*seen, kernel=kernel)
        else:
            sighted = CartesianObservationEdges(*seen, kernel=kernel, frame=frame)
        landmarks = np.zeros((len(ids), 3))
        whole = estimate_map(log, log.initial_poses, sensor=sensor) if len(log.steps) else {}
        for j, place in (single | whole | known).items():
            landmarks[np.searchsorted(ids, j), : min(len(place), d)] = place[:d]
        parts |= {"landmark_ids": ids, "landmark_dimension": d, "sighting_rows": np.arange(len(log.steps))}
        parts["notes"] = remarks
    else:
        steps, notes = _tied_steps(log, with_motion)
        rows, starts, nodes = _grouped(log, steps)
        grouped = (starts, nodes, log.sightings[rows], sensor)
        if weight == "marginal":
            sighted = MarginalEdges(*grouped, frame=frame, kernel=kernel)
        else:
            sighted = VirtualMotionEdges(*grouped, frame=frame, kernel=kernel, tempered=weight == "tempered")
        landmarks = np.zeros((0, 3))
        parts |= {"sighting_rows": rows, "notes": tuple(notes)}
        if not with_motion:
            _check_determined(sighted, steps, _measured_edges(log, steps, kernel))
    poses = log.initial_poses[steps]
    initial = np.concatenate([poses, landmarks])
    measured = _measured_edges(log, steps, kernel)
    families: list[EdgeFamily]
    if landmark_map is None:
        families = [*anchors(poses[0], measured)]
    else:
        families, parts["fixed"] = _priors(landmark_map, known, ids, initial, d)
        parts["map"] = landmark_map
    families.append(sighted)
    if with_motion:
        assert log.controls is not None and log.dt is not None
        families.append(
            motion_edges(
                steps, log.controls, log.dt, motion, starts=log.control_starts,
                control_variances=log.control_variances, recorded_dt=log.recorded_dt, frame=frame, scale=scale,
            )
        )  # fmt: skip
    families += measured
    if edges.startswith("landmark"):
        families += edges_of_single_numbers(
            partial, log.num_poses + np.searchsorted(ids, partial.landmarks), sensor, kernel
        )
    return parts | {"initial": initial, "families": tuple(families), "steps": steps, "pose_ids": steps}


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


def _priors(
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
        information = landmark_map.joint_information(uncertain, d)
        return [PriorEdges(nodes, initial[nodes], information)], fixed
    information = np.array([landmark_map.own_information(j, d) for j in uncertain])
    return [LandmarkPriors(nodes, initial[nodes], information)], fixed


def _check_log(log: Log, with_motion: bool) -> None:
    if len(log.steps) == 0 and not any(map(len, log.measured.values())):
        raise GraphError(
            f"{log.name} has no sightings at all, and no relations or positions: nothing corrects dead reckoning"
        )
    if not log.identified:
        raise GraphError(
            f"{log.name} has sightings of unidentified landmarks, and a graph needs the identities; find them with "
            "graphslam.associate, or use FastSLAM, which finds them itself"
        )
    if with_motion and log.controls is None:
        raise GraphError(f"{log.name} has no controls for motion edges; use edges='virtual'")


def _tied_steps(log: Log, with_motion: bool) -> tuple[np.ndarray, list[str]]:
    """The steps whose poses are nodes of a graph without landmarks, and notes on what is left out."""
    ids, group = np.unique(log.landmarks, return_inverse=True)
    seen = np.unique(np.column_stack([group, log.steps]), axis=0)
    often = np.bincount(seen[:, 0]) > 1
    notes = []
    if not np.all(often):
        notes.append(f"no edge comes from {listed('landmark', ids[~often].tolist())}, seen in one step only")
    if with_motion:
        return np.arange(log.num_poses), notes
    steps = np.unique(
        np.concatenate(
            [seen[often[seen[:, 0]], 1], *(getattr(each, end) for each in log.measured.values() for end in each.ENDS)]
        )
    )
    if not len(steps):
        raise GraphError(f"{log.name} has no landmark that was seen twice, so there are no virtual-motion edges")
    left_out = np.setdiff1d(np.arange(log.num_poses), steps).tolist()
    if left_out:
        notes.append(f"{listed('pose', left_out)} shared no sighting with any other and stayed out of the graph")
    return steps, notes


def _grouped(log: Log, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sightings from given steps by landmark, and by step within one: rows (M,), starts (G+1,), nodes (M,)."""
    node_of = np.full(log.num_poses, -1)
    node_of[steps] = np.arange(len(steps))
    rows = np.argsort(log.landmarks, kind="stable")
    # a sighting from a pose that is no node is a landmark's only one, and has no partner
    rows = rows[node_of[log.steps[rows]] >= 0]
    _, starts = np.unique(log.landmarks[rows], return_index=True)
    return rows, np.append(starts, len(rows)), node_of[log.steps[rows]]


def parts_of_file(data: PoseGraphFile, path: Path) -> dict[str, Any]:
    """The parts of the graph that a pose-graph file holds; see `Graph.from_g2o`.

    Raises:
        GraphError: the graph falls into several pieces, or a number is too large.
    """
    for name in ("poses", "landmarks"):
        check_size(f"{path}: {name}", getattr(data, name))
    for kind, edges in data.edges.items():
        check_size(f"{path}: {kind} measured", edges.measured)
        check_size(f"{path}: {kind} information", edges.information, most=LARGEST**2)
    families = [_family(kind, edges, data) for kind, edges in data.edges.items() if len(edges.ids)]
    positions = [family for family in families if isinstance(family, PositionEdges)]
    ids = np.concatenate([data.pose_ids, data.landmark_ids])
    fixed, held = np.flatnonzero(np.isin(ids, data.fixed)), list[EdgeFamily]()
    if not data.fixed and not positions:
        fixed = np.zeros(1, dtype=np.int64)
    elif not data.fixed:
        held += anchors(data.poses[0], positions)
    num_nodes = len(ids)
    pairs = [family for family in families if isinstance(family, PairEdges)]
    # priors and FIX lines tie nodes to the world, one more node
    to_world = np.concatenate([fixed, *(family.nodes for family in positions)])
    ends = ([family.first for family in pairs], [family.second for family in pairs])
    label = _pieces(num_nodes + 1, [*ends[0], to_world], [*ends[1], np.full(len(to_world), num_nodes)])
    loose = np.flatnonzero(label[:-1] != label[-1])
    if len(loose):
        names, tied = (node_names(nodes, data.pose_ids, data.landmark_ids) for nodes in (loose, to_world[:1]))
        raise GraphError(
            f"{path}: the graph falls into several pieces: nothing ties {names} to {tied}; add the edge that ties them, "
            "or a FIX line for a pose of each piece"
        )
    return {
        "initial": np.concatenate([data.poses, np.pad(data.landmarks, ((0, 0), (0, 1)))]),
        "families": (*held, *families), "steps": np.arange(len(data.pose_ids)), "trajectory": data.poses,
        "pose_ids": data.pose_ids, "landmark_ids": data.landmark_ids, "fixed": fixed, "notes": data.notes,
    }  # fmt: skip


def _family(kind: str, edges: FileEdges, data: PoseGraphFile) -> EdgeFamily:
    """The edges of one kind of `io.pose_graph.KINDS`, between numbers of nodes."""
    first, measured = np.searchsorted(data.pose_ids, edges.ids[:, 0]), (edges.measured, edges.information)
    if KINDS[kind][0] == 1:
        return PositionEdges(first, *measured, np.zeros((len(first), 2)))
    if kind == "pose":
        return RelativePoseEdges(first, np.searchsorted(data.pose_ids, edges.ids[:, 1]), *measured)
    ends = first, len(data.pose_ids) + np.searchsorted(data.landmark_ids, edges.ids[:, 1])
    if kind == "point":
        return RelativePointEdges(*ends, *measured)
    return (RangeEdges if kind == "range" else BearingEdges)(*ends, *measured, np.zeros(2))


def with_closures(families: Sequence[EdgeFamily], kernel: Kernel | None) -> tuple[EdgeFamily, ...]:
    """The edges of a pose graph with its loop closures as relations that may be wrong; see `Graph.with_closures`."""
    found: list[EdgeFamily] = []
    for f in families:
        if not isinstance(f, RelativePoseEdges) or isinstance(f, RelationEdges) or f.state_dependent_information:
            found.append(f)
            continue
        closes = np.abs(f.second - f.first) != 1
        steps, closures = (
            (f.first[rows], f.second[rows], f.measured[rows], f.information[rows]) for rows in (~closes, closes)
        )
        if not closes.all():
            found.append(RelativePoseEdges(*steps))
        if closes.any():
            found.append(RelationEdges(*closures, kernel=kernel))
    return tuple(found)


def file_of_parts(
    state: Array,
    *,
    families: Sequence[EdgeFamily],
    pose_ids: np.ndarray,
    landmark_ids: np.ndarray,
    fixed: np.ndarray,
) -> PoseGraphFile:
    """The contents of the g2o file of a graph whose nodes have the values ``state`` (n, 3); see `Graph.save_g2o`.

    Raises:
        GraphError: the graph has edges that g2o has no line for.
    """
    if len(np.intersect1d(pose_ids, landmark_ids)):
        landmark_ids = int(pose_ids.max()) + 1 + np.arange(len(landmark_ids))
    ids, held = np.concatenate([pose_ids, landmark_ids]), [fixed]
    groups: dict[str, list[Any]] = {kind: [] for kind in KINDS}
    for family in families:
        if isinstance(family, AnchorEdges) and not isinstance(family, LandmarkPriors):
            if np.all(np.linalg.matrix_rank(family.information) == 3):
                held.append(family.nodes)
                continue
            family = PositionEdges(family.nodes, family.values, family.information, np.zeros((family.count, 2)))
        groups[_kind(family)].append(family)

    def rows(kind: str, chosen: list[Any]) -> FileEdges:
        num_ids, d = KINDS[kind]
        ends = [np.column_stack([f.first, f.second] if num_ids == 2 else [f.nodes]) for f in chosen]
        return FileEdges(
            ids[np.concatenate([np.zeros((0, num_ids), dtype=np.int64), *ends])],
            np.concatenate([np.zeros((0, d)), *(f.measured for f in chosen)]),
            np.concatenate([np.zeros((0, d, d)), *(getattr(f, "weighed", f.information) for f in chosen)]),
        )

    return PoseGraphFile(
        pose_ids, state[: len(pose_ids)], landmark_ids, state[len(pose_ids) :, :2],
        ids[np.unique(np.concatenate(held))].tolist(), {kind: rows(kind, chosen) for kind, chosen in groups.items()},
    )  # fmt: skip


def _kind(family: EdgeFamily) -> str:
    """The kind of line of `io.pose_graph.KINDS` that a family has.

    Raises:
        GraphError: it has none.
    """
    if isinstance(family, PositionEdges) and family.levers.any():
        raise GraphError(
            "g2o has no line for the position of a point beside the pose: positions with a lever cannot be written"
        )
    if getattr(family, "kernel", None) is None and not family.state_dependent_information:
        if isinstance(family, PositionEdges):
            return "prior" if family.dimension == 3 else "place"
        if isinstance(family, PartialEdges) and not family.offset.any():
            return "range" if isinstance(family, RangeEdges) else "bearing"
        if isinstance(family, (RelativePoseEdges, RelativePointEdges)):
            return "pose" if isinstance(family, RelativePoseEdges) else "point"
    raise GraphError(
        f"g2o has no line for {type(family).__name__} with state-dependent or angular residuals, or with a robust "
        "kernel; graphslam.graph.transform.relative_graph makes relative poses of them where that is possible"
    )


def node_names(nodes: np.ndarray, pose_ids: np.ndarray, landmark_ids: np.ndarray) -> str:
    """The names of nodes in a sentence: 'poses 3 and 4', 'landmark 7', 'pose 2 and landmark 5'."""
    pose = nodes < len(pose_ids)
    named = (("pose", pose_ids[nodes[pose]]), ("landmark", landmark_ids[nodes[~pose] - len(pose_ids)]))
    return " and ".join(listed(noun, ids.tolist()) for noun, ids in named if len(ids))


def _pieces(num_nodes: int, first: list[np.ndarray], second: list[np.ndarray]) -> np.ndarray:
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
    first, second, held = [virtual.nodes], [num_nodes + virtual.group], np.zeros(num_nodes, dtype=bool)
    for family in measured:
        if isinstance(family, RelationEdges):
            first, second = [*first, family.first], [*second, family.second]
            held[family.first] = held[family.second] = True
        else:
            # positions tie poses to the world, one more node
            first, second = [*first, family.nodes], [*second, np.full(family.count, num_nodes + num_groups)]
            held[family.nodes] = True
    label = _pieces(num_nodes + num_groups + 1, first, second)
    loose = steps[label[:num_nodes] != label[0]].tolist()
    if loose:
        raise GraphError(
            f"the graph falls into several pieces: nothing ties {listed('pose', loose)} to pose {steps[0]}; "
            "use edges='virtual+motion', or a log in which they share a landmark"
        )
    if virtual.oriented:
        return
    shared = np.unique(np.column_stack([virtual.nodes, virtual.group]), axis=0)
    ties = np.bincount(shared[:, 1], minlength=num_groups) > 1
    landmarks_of = np.bincount(shared[ties[shared[:, 1]], 0], minlength=num_nodes)
    loose = steps[(landmarks_of < 2) & ~held].tolist()
    if loose:
        share = "shares" if len(loose) == 1 else "share"
        raise GraphError(
            f"without psi one landmark does not fix a pose: {listed('pose', loose)} {share} only one with the rest; "
            "use edges='virtual+motion' or a sensor with psi"
        )


def with_dimensions(log: Log, dimensions: int | None) -> Log:
    """The log whose sightings have so many numbers; None for those that it has."""
    if dimensions is not None and (not isinstance(dimensions, Integral) or dimensions not in (2, 3)):
        raise OptionError(f"dimensions must be 2 or 3, not {quoted(dimensions)}")
    if dimensions == 3 and not log.has_orientation:
        raise GraphError(
            f"{log.name} has sightings without psi, but 3-D sensor values were asked for; use dimensions=2"
        )
    return log.without_orientation() if dimensions == 2 and log.has_orientation else log
