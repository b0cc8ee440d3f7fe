"""A graph: nodes with initial values, and the families of edges that tie them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from .edges import ANCHOR_INFORMATION, AnchorEdges, EdgeFamily, VirtualMotionEdges, motion_edges
from .errors import GraphError, OptionError, check_choice, check_positive, listed
from .information import BlockSystem
from .log import Log
from .models import MotionModel, SensorModel
from .se2 import Array

EDGES = ("virtual", "virtual+motion")
FRAMES = ("world", "body")
WEIGHTS = ("pairs", "tempered")


@dataclass(frozen=True, eq=False)
class Graph:
    """Nodes 0 to n-1 with initial values, and edges. Build one with `from_log`.

    Attributes:
        initial: (n, 3) initial values of the nodes.
        families: the edges, family by family.
        steps: (P,) the step of the log that each pose node belongs to, increasing.
        trajectory: (T+1, 3) the initial guess of all poses, also of those that are no nodes.
        landmark_ids: (L,) the landmark that each node after the poses belongs to.
        log, sensor: what the graph was made from, where it was made from a log.
        notes: what the user should know, one sentence each.
    """

    initial: Array
    families: tuple[EdgeFamily, ...]
    steps: np.ndarray
    trajectory: Array
    log: Log | None = None
    sensor: SensorModel | None = None
    landmark_ids: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    notes: tuple[str, ...] = ()

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
        dimensions: int | None = None,
    ) -> Graph:
        """The graph of a log: an anchor at the first node, virtual-motion edges and perhaps motion edges.

        Args:
            log: what the robot did and saw.
            motion, sensor: the noise models; default: the book's.
            edges: "virtual" (poses that saw nothing are left out) or "virtual+motion".
            frame: "world" (the lectures: information re-evaluated at every step) or "body" (constant information).
            weight: "pairs" (the book: each of K sightings enters K-1 edges) or "tempered" (each pair times 2/K).
            motion_weight: lambda, the factor on the motion edges.
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
        log = _with_dimensions(log, dimensions)
        motion, sensor = motion or MotionModel(), sensor or SensorModel()
        with_motion = edges.endswith("+motion")
        if len(log.steps) == 0:
            raise GraphError(f"{log.name} has no sightings at all, so there is nothing to correct dead reckoning with")
        if with_motion and log.controls is None:
            raise GraphError(f"{log.name} has no controls for motion edges; use edges='virtual'")

        notes: list[str] = []
        order = np.argsort(log.landmarks, kind="stable")  # by landmark, and by step within one
        ids, starts = np.unique(log.landmarks[order], return_index=True)
        starts = np.append(starts, len(order))
        steps_seen = [np.unique(log.steps[order[a:b]]) for a, b in zip(starts[:-1], starts[1:])]
        lonely = [int(j) for j, seen in zip(ids, steps_seen) if len(seen) == 1]
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

        # a sighting from a pose that is no node is a landmark's only one, and pairs with nothing
        kept = order[node_of[log.steps[order]] >= 0]
        ids, starts = np.unique(log.landmarks[kept], return_index=True)
        starts = np.append(starts, len(kept))
        weights = 2.0 / np.diff(starts) if weight == "tempered" else np.ones(len(ids))
        virtual = VirtualMotionEdges(starts, node_of[log.steps[kept]], log.sightings[kept], sensor, frame, weights)
        initial = log.initial_poses[steps].copy()
        families: list[EdgeFamily] = [AnchorEdges(np.zeros(1, dtype=int), initial[:1].copy(), ANCHOR_INFORMATION[None])]
        families.append(virtual)
        if with_motion:
            assert log.controls is not None and log.dt is not None
            families.append(motion_edges(steps, log.controls, log.dt, motion, frame=frame, weight=motion_weight))
        else:
            _check_determined(virtual, steps, log.has_orientation)
        return cls(initial, tuple(families), steps, log.initial_poses, log, sensor, notes=tuple(notes))

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
        return self.system, total

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


def _check_determined(virtual: VirtualMotionEdges, steps: np.ndarray, oriented: bool) -> None:
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
