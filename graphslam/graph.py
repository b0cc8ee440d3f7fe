"""A graph: nodes with initial values, and the families of edges that tie them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from .checks import check_choice, check_positive, listed
from .edges import (
    ANCHOR_INFORMATION,
    AnchorEdges,
    EdgeFamily,
    LandmarkSightings,
    MarginalEdges,
    ObservationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
    motion_edges,
)
from .edges.robust import Kernel, kernel_of
from .errors import GraphError, OptionError
from .formats.pose_graph import PoseGraphFile, read_pose_graph, write_g2o
from .linear.information import BlockSystem
from .log import Log
from .mapping import estimate_map
from .models import MotionModel, SensorModel
from .se2 import Array

EDGES = ("virtual", "virtual+motion", "landmark+motion")
FRAMES = ("world", "body")
WEIGHTS = ("pairs", "tempered", "marginal")


def _none() -> np.ndarray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Graph:
    """Nodes 0 to n-1 with initial values, and edges. Build one with `from_log` or `from_g2o`.

    The first P nodes are poses, the other L landmarks.

    Attributes:
        initial: (n, 3) initial values of the nodes; a landmark without heading uses the first two columns.
        families: the edges, family by family.
        steps: (P,) the row of the trajectory that each pose node belongs to, increasing.
        trajectory: (T+1, 3) the initial guess of all poses, also of those that are no nodes.
        pose_ids: (P,) how the user calls the poses: the steps of a log, the ids of a file.
        landmark_ids: (L,) how the user calls the landmarks.
        landmark_dimension: 2, or 3 where landmarks have a heading.
        fixed: (F,) nodes that do not move.
        log, sensor: what the graph was made from, where it was made from a log.
        notes: what the user should know, one sentence each.
        sighting_rows: (M,) the row of the log's sightings that each sighting of the edges comes from.
    """

    initial: Array
    families: tuple[EdgeFamily, ...]
    steps: np.ndarray
    trajectory: Array
    pose_ids: np.ndarray
    landmark_ids: np.ndarray = field(default_factory=_none)
    landmark_dimension: int = 2
    fixed: np.ndarray = field(default_factory=_none)
    log: Log | None = None
    sensor: SensorModel | None = None
    notes: tuple[str, ...] = ()
    sighting_rows: np.ndarray = field(default_factory=_none)

    @classmethod
    def from_log(
        cls,
        log: Log,
        *,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        edges: str = "virtual+motion",
        frame: str = "body",
        weight: str = "pairs",
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        dimensions: int | None = None,
    ) -> Graph:
        """The graph of a log: an anchor at the first node, edges from the sightings, and perhaps motion edges.

        Args:
            log: what the robot did and saw.
            motion, sensor: the noise models; default: those of the log, else the book's.
            edges: "virtual" (poses that saw nothing are left out), "virtual+motion", or "landmark+motion", in which
                landmarks are nodes and every sighting is one edge.
            frame: "world" (the lectures: information re-evaluated at every step) or "body" (constant information).
            weight: of virtual edges: "pairs" (the book: each of K sightings enters K-1 edges, so a landmark weighs up
                to K/2 times what it should), "tempered" (each pair times 2/K: exact where sightings are alike) or
                "marginal" (the landmark eliminated: each sighting counts once, exactly).
            motion_weight: lambda, the factor on the motion edges.
            kernel: against wrong sightings, `robust.Huber`, `Cauchy`, `GemanMcClure` or their names; on every pair of
                "pairs" and "tempered", on every sighting elsewhere. See also `solve_gnc`.
            dimensions: 2 ignores psi, 3 insists on it; default: what the log has.

        Raises:
            GraphError: the log has not what is asked for, or the edges cannot determine the poses; the message says
                which poses, and what would help.
            OptionError: an option has an impossible value.
        """
        check_choice("edges", edges, EDGES)
        check_choice("frame", frame, FRAMES)
        check_choice("weight", weight, WEIGHTS)
        check_positive(motion_weight=motion_weight)
        kernel = kernel_of(kernel)
        log = _with_dimensions(log, dimensions)
        motion, sensor = motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel()
        with_motion = edges.endswith("+motion")
        if len(log.steps) == 0:
            raise GraphError(f"{log.name} has no sightings at all, so there is nothing to correct dead reckoning with")
        if not log.identified:
            raise GraphError(
                f"{log.name} has sightings that do not tell their landmark, and a graph needs to know: use FastSLAM with "
                "association='maximum-likelihood'"
            )
        if with_motion and log.controls is None:
            raise GraphError(f"{log.name} has no controls for motion edges; use edges='virtual'")

        notes: list[str] = []
        order = np.argsort(log.landmarks, kind="stable")  # by landmark, and by step within one
        ids, starts = np.unique(log.landmarks[order], return_index=True)
        starts = np.append(starts, len(order))
        steps_seen = [np.unique(log.steps[order[a:b]]) for a, b in zip(starts[:-1], starts[1:])]
        with_landmarks = edges.startswith("landmark")
        lonely = [] if with_landmarks else [int(j) for j, seen in zip(ids, steps_seen) if len(seen) == 1]
        if lonely:
            notes.append(f"no edge comes from {listed('landmark', lonely)}, seen in one step only")
        if with_motion:
            steps = np.arange(log.num_poses)
        else:
            tied = [seen for seen in steps_seen if len(seen) > 1]
            if not tied:
                raise GraphError(
                    f"{log.name} has no landmark that was seen twice, so there are no virtual-motion edges"
                )
            steps = np.unique(np.concatenate(tied))
            left_out = np.setdiff1d(np.arange(log.num_poses), steps).tolist()
            if left_out:
                notes.append(
                    f"{listed('pose', left_out)} shared no sighting with any other and stayed out of the graph"
                )
        node_of = np.full(log.num_poses, -1)
        node_of[steps] = np.arange(len(steps))

        initial = log.initial_poses[steps].copy()
        anchor = AnchorEdges(np.zeros(1, dtype=int), initial[:1].copy(), ANCHOR_INFORMATION[None])
        driven: list[EdgeFamily] = []
        if with_motion:
            assert log.controls is not None and log.dt is not None
            driven = [
                motion_edges(
                    steps, log.controls, log.dt, motion, starts=log.control_starts,
                    control_variances=log.control_variances, frame=frame, weight=motion_weight,
                )
            ]  # fmt: skip
        common: dict[str, Any] = {
            "steps": steps,
            "pose_ids": steps,
            "trajectory": log.initial_poses,
            "log": log,
            "sensor": sensor,
        }
        if with_landmarks:
            node_of_landmark = log.num_poses + np.searchsorted(ids, log.landmarks)
            seen = ObservationEdges(log.steps, node_of_landmark, log.sightings, sensor, kernel)
            start = np.zeros((len(ids), 3))
            start[:, : log.sightings.shape[1]] = list(estimate_map(log, log.initial_poses, sensor=sensor).values())
            return cls(
                np.concatenate([initial, start]), (anchor, seen, *driven), notes=tuple(notes), landmark_ids=ids,
                landmark_dimension=log.sightings.shape[1], sighting_rows=np.arange(len(log.steps)), **common,
            )  # fmt: skip

        # a sighting from a pose that is no node is a landmark's only one, and pairs with nothing
        kept = order[node_of[log.steps[order]] >= 0]
        ids, starts = np.unique(log.landmarks[kept], return_index=True)
        starts = np.append(starts, len(kept))
        sightings: dict[str, Any] = {
            "starts": starts, "nodes": node_of[log.steps[kept]], "sightings": log.sightings[kept],
            "sensor": sensor, "frame": frame, "kernel": kernel,
        }  # fmt: skip
        virtual = (
            MarginalEdges(**sightings)
            if weight == "marginal"
            else VirtualMotionEdges(**sightings, tempered=weight == "tempered")
        )
        if not with_motion:
            _check_determined(virtual, steps, log.has_orientation)
        return cls(initial, (anchor, virtual, *driven), notes=tuple(notes), sighting_rows=kept, **common)

    @classmethod
    def from_g2o(cls, path: str | PathLike[str], format: str | None = None, unknown: str = "error") -> Graph:
        """The pose graph of a g2o, TORO or iSAM text file; see `formats.pose_graph` for the dialects.

        Nodes named in FIX lines are held; without any, the pose with the lowest id is. The cost is g2o's chi2.

        Args:
            path: the file.
            format: "g2o", "toro" or "isam"; default: by the file's tags.
            unknown: "error" refuses unknown tags, "skip" leaves them out with a warning that counts them.

        Raises:
            FormatError: the file breaks its format's rules.
            GraphError: the graph falls into several pieces.
        """
        data = read_pose_graph(Path(path), format, unknown)
        num_poses, num_landmarks = len(data.pose_ids), len(data.landmark_ids)
        first, second = (np.searchsorted(data.pose_ids, data.pose_edges[:, k]) for k in (0, 1))
        seer = np.searchsorted(data.pose_ids, data.point_edges[:, 0])
        seen = num_poses + np.searchsorted(data.landmark_ids, data.point_edges[:, 1])
        families: list[EdgeFamily] = []
        if len(first):
            families.append(RelativePoseEdges(first, second, data.pose_measured, data.pose_information))
        if len(seer):
            families.append(RelativePointEdges(seer, seen, data.point_measured, data.point_information))
        graph = cls(
            np.concatenate([data.poses, np.column_stack([data.landmarks, np.zeros(num_landmarks)])]),
            tuple(families),
            steps=np.arange(num_poses),
            trajectory=data.poses,
            pose_ids=data.pose_ids,
            landmark_ids=data.landmark_ids,
            fixed=np.searchsorted(data.pose_ids, data.fixed) if data.fixed else np.zeros(1, dtype=np.int64),
        )
        _check_connected(graph, Path(path))
        return graph

    def save_g2o(self, path: str | PathLike[str], state: Array | None = None) -> None:
        """Write the graph as a g2o file, with its initial values or those of a state (n, 3); whole or not at all.

        An anchor becomes a FIX line. Motion edges in the body frame are relative-pose edges and can be written; for
        other graphs of logs see `graphslam.relative`. In g2o's files all nodes share one row of ids: landmarks with ids
        that poses have get new ones above them.

        Raises:
            GraphError: the graph has edges that g2o has no line for.
            OptionError: the state is no (n, 3) finite numbers.
            FormatError: the place cannot be written.
        """
        state = self.initial if state is None else np.asarray(state, dtype=float)
        if state.shape != self.initial.shape or not np.isfinite(state).all():
            raise OptionError(f"state must be finite numbers of shape {self.initial.shape}, not {state.shape}")
        landmark_ids = self.landmark_ids
        if len(np.intersect1d(self.pose_ids, landmark_ids)):
            landmark_ids = int(self.pose_ids.max()) + 1 + np.arange(len(landmark_ids))
        num_poses = len(self.steps)
        poses, points, fixed = [], [], set(self.fixed.tolist())
        for family in self.families:
            if isinstance(family, AnchorEdges):
                fixed |= set(family.nodes.tolist())
            elif isinstance(family, RelativePoseEdges) and not family.frozen_information:
                poses.append(family)
            elif isinstance(family, RelativePointEdges):
                points.append(family)
            else:
                raise GraphError(
                    f"g2o has no line for {type(family).__name__} with state-dependent or angular residuals; "
                    "graphslam.relative.relative_graph makes relative poses of them where that is possible"
                )
        none = [np.zeros((0, 2), dtype=np.int64)]
        ids = np.concatenate([self.pose_ids, landmark_ids])
        write_g2o(
            PoseGraphFile(
                pose_ids=self.pose_ids,
                poses=state[:num_poses],
                landmark_ids=landmark_ids,
                landmarks=state[num_poses:, :2],
                fixed=[int(ids[k]) for k in sorted(fixed)],
                pose_edges=np.concatenate(none + [ids[np.column_stack([f.first, f.second])] for f in poses]),
                pose_measured=np.concatenate([np.zeros((0, 3))] + [f.measured for f in poses]),
                pose_information=np.concatenate([np.zeros((0, 3, 3))] + [f.information for f in poses]),
                point_edges=np.concatenate(none + [ids[np.column_stack([f.first, f.second])] for f in points]),
                point_measured=np.concatenate([np.zeros((0, 2))] + [f.measured for f in points]),
                point_information=np.concatenate([np.zeros((0, 2, 2))] + [f.information for f in points]),
            ),
            Path(path),
        )

    def with_initial(self, initial: Array) -> Graph:
        """The same graph with other initial values (n, 3)."""
        if np.shape(initial) != self.initial.shape:
            raise OptionError(f"initial must have shape {self.initial.shape}, not {np.shape(initial)}")
        return replace(self, initial=np.array(initial, dtype=float))

    @property
    def num_nodes(self) -> int:
        """The number n of nodes."""
        return len(self.initial)

    @property
    def num_edges(self) -> int:
        """The number of edges, anchors not counted."""
        return sum(family.count for family in self.families if not isinstance(family, AnchorEdges))

    @property
    def frozen_information(self) -> bool:
        """Whether some information depends on the state, so that it has to be re-evaluated between linear solves."""
        return any(family.frozen_information for family in self.families)

    @property
    def reweighted(self) -> bool:
        """Whether some edges have a robust kernel, which re-weights them at every step."""
        return any(getattr(family, "kernel", None) is not None for family in self.families)

    @cached_property
    def system(self) -> BlockSystem:
        """Omega and xi: the pattern is made at the first use, the numbers by `linearize`."""
        return BlockSystem.from_cliques(self.num_nodes, [family.cliques() for family in self.families])

    def cost(self, state: Array, reference: Array | None = None) -> float:
        """J = the sum of e' Omega e at a state (n, 3), with state-dependent information taken at ``reference``."""
        reference = state if reference is None else reference
        return sum(family.cost(state, reference) for family in self.families)

    def linearize(self, state: Array, reference: Array | None = None) -> tuple[BlockSystem, float]:
        """Omega and xi at a state (n, 3), written into `system`, and the cost J."""
        reference = state if reference is None else reference
        self.system.clear()
        total = 0.0
        for family in self.families:
            total += family.accumulate(state, reference, self.system)
        if len(self.landmark_ids) and self.landmark_dimension == 2:
            self.system.rest(np.arange(len(self.steps), self.num_nodes), 2)
        if len(self.fixed):
            self.system.hold(self.fixed)
        return self.system, total

    def names(self, nodes: np.ndarray) -> str:
        """The names of nodes in a sentence: 'poses 3 and 4', 'landmark 7', 'pose 2 and landmark 5'."""
        poses = [int(self.pose_ids[k]) for k in nodes.tolist() if k < len(self.steps)]
        landmarks = [int(self.landmark_ids[k - len(self.steps)]) for k in nodes.tolist() if k >= len(self.steps)]
        return " and ".join(listed(noun, ids) for noun, ids in (("pose", poses), ("landmark", landmarks)) if ids)

    def trajectory_of(self, state: Array) -> tuple[Array, np.ndarray]:
        """All poses (T+1, 3) of a state, with the initial guess where a pose is no node, and which ones are (T+1,)."""
        poses, estimated = self.trajectory.copy(), np.zeros(len(self.trajectory), dtype=bool)
        poses[self.steps] = state[: len(self.steps)]
        estimated[self.steps] = True
        return poses, estimated


def _with_dimensions(log: Log, dimensions: int | None) -> Log:
    if dimensions not in (None, 2, 3):
        raise OptionError(f"dimensions must be 2 or 3, not {dimensions!r}")
    if dimensions == 3 and not log.has_orientation:
        raise GraphError(
            f"{log.name} has sightings without psi, but 3-D sensor values were asked for; use dimensions=2"
        )
    return log.without_orientation() if dimensions == 2 and log.has_orientation else log


def _check_connected(graph: Graph, path: Path) -> None:
    """Raise `GraphError` where nodes hang together with no node that is held."""
    pairs = [np.column_stack([f.first, f.second]) for f in graph.families if not isinstance(f, AnchorEdges)]  # type: ignore[attr-defined]
    ends = np.concatenate(pairs)
    ties = sp.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(graph.num_nodes,) * 2)
    _, label = connected_components(ties, directed=False)
    apart = np.flatnonzero(~np.isin(label, label[graph.fixed]))
    if len(apart):
        names = graph.names(apart)
        raise GraphError(
            f"{path}: the graph falls into several pieces: nothing ties {names} to "
            f"{graph.names(graph.fixed[:1])}; add the edge that ties them, or a FIX line for a pose of each piece"
        )


def _check_determined(virtual: LandmarkSightings, steps: np.ndarray, oriented: bool) -> None:
    """Raise `GraphError` where virtual edges alone leave poses undetermined in a way that the pattern shows."""
    num_nodes, num_groups = len(steps), len(virtual.starts) - 1
    group = np.repeat(np.arange(num_groups), np.diff(virtual.starts))
    sees = sp.coo_matrix((np.ones(len(group)), (virtual.nodes, num_nodes + group)), shape=(num_nodes + num_groups,) * 2)
    _, label = connected_components(sees, directed=False)
    apart = steps[label[:num_nodes] != label[0]].tolist()
    if apart:
        raise GraphError(
            f"the graph falls into several pieces: nothing ties {listed('pose', apart)} to pose {steps[0]}; "
            "use edges='virtual+motion', or a log in which they share a landmark"
        )
    if not oriented:
        shared = np.unique(np.column_stack([virtual.nodes, group]), axis=0)
        ties = np.bincount(shared[:, 1], minlength=num_groups) > 1
        landmarks_of = np.bincount(shared[ties[shared[:, 1]], 0], minlength=num_nodes)
        loose = steps[landmarks_of < 2].tolist()
        if loose:
            raise GraphError(
                f"without psi one landmark does not fix a pose: {listed('pose', loose)} share"
                f"{'s' if len(loose) == 1 else ''} only one with the rest; "
                "use edges='virtual+motion' or a sensor with psi"
            )
