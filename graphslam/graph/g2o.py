"""`Graph.from_g2o` and `Graph.save_g2o`: pose graphs from text files, and into them."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..edges import (
    ANCHOR_INFORMATION,
    AnchorEdges,
    BearingEdges,
    CartesianObservationEdges,
    EdgeFamily,
    LandmarkPriors,
    PartialEdges,
    PositionEdges,
    RangeEdges,
    RelativePointEdges,
    RelativePoseEdges,
)
from ..edges.base import PairEdges
from ..edges.robust import Kernel, kernel_of
from ..errors import GraphError, OptionError, checks
from ..files import path_of
from ..linear.precision import LARGEST, check_size
from ..se2 import Array
from .build import node_names, pieces
from .defaults import anchors
from .graph import Graph
from .pose_graph import KINDS, FileEdges, PoseGraphFile, read_pose_graph, write_g2o


def from_g2o(
    path: str | PathLike[str],
    *,
    format: str | None = None,
    unknown: str = "error",
    kernel: Kernel | str | None = None,
) -> Graph:
    """The pose graph of a g2o, TORO or iSAM text file; see `graph.pose_graph` for the dialects.

    Nodes named in FIX lines are held; without any, and without priors, the pose with the lowest id is. The cost is g2o's
    chi2.

    Args:
        path: the file.
        format: "g2o", "toro" or "isam"; default: by the file's tags.
        unknown: "error" refuses unknown tags, "skip" leaves them out with a warning that counts them.
        kernel: a robust kernel on the loop closures, as `with_closures` has them; default: none.

    Raises:
        FormatError: the file breaks its format's rules.
        GraphError: the graph falls into several pieces.
    """
    path = path_of(path)
    graph = _graph_of_file(read_pose_graph(path, dialect=format, unknown=unknown), path)
    kernel = kernel_of(kernel)
    return graph if kernel is None else graph.with_closures(kernel)


def save_g2o(graph: Graph, path: str | PathLike[str], *, state: Array | None = None) -> None:
    """Write the graph as a g2o file, with its initial values or those of a state (n, 3).

    A write that fails leaves no file behind. An anchor becomes a FIX line. Positions without a lever become priors,
    EDGE_PRIOR_SE2 or EDGE_PRIOR_SE2_XY; g2o has no line for those with one. Motion edges in the body frame are
    relative-pose edges and can be written; for other graphs of logs see `graphslam.graph.transform`. In g2o files poses
    and landmarks share one set of ids: where the two overlap, the landmarks get new ids above those of the poses.

    Raises:
        GraphError: the graph has edges that g2o has no line for.
        OptionError: the state has another shape or is not finite.
        FormatError: the file cannot be written.
    """
    state = graph.initial if state is None else checks.array_of("state", state)
    if state.shape != graph.initial.shape or not np.isfinite(state).all():
        raise OptionError(f"state must be finite numbers of shape {graph.initial.shape}, not {state.shape}")
    write_g2o(_file_of_graph(graph, state), path_of(path))


Graph.from_g2o = staticmethod(from_g2o)
Graph.save_g2o = save_g2o


def _graph_of_file(data: PoseGraphFile, path: Path) -> Graph:
    """The graph that a pose-graph file holds; see `from_g2o`.

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
    label = pieces(num_nodes + 1, [*ends[0], to_world], [*ends[1], np.full(len(to_world), num_nodes)])
    loose = np.flatnonzero(label[:-1] != label[-1])
    if len(loose):
        names, tied = (node_names(nodes, data.pose_ids, data.landmark_ids) for nodes in (loose, to_world[:1]))
        raise GraphError(
            f"{path}: the graph falls into several pieces: nothing ties {names} to {tied}; add the edge that ties them, "
            "or a FIX line for a pose of each piece"
        )
    return Graph(
        np.concatenate([data.poses, np.pad(data.landmarks, ((0, 0), (0, 1)))]),
        families=(*held, *families), steps=np.arange(len(data.pose_ids)), trajectory=data.poses,
        pose_ids=data.pose_ids, landmark_ids=data.landmark_ids, fixed=fixed, notes=data.notes,
    )  # fmt: skip


def _family(kind: str, edges: FileEdges, data: PoseGraphFile) -> EdgeFamily:
    """The edges of one kind of `pose_graph.KINDS`, between numbers of nodes."""
    first, measured = np.searchsorted(data.pose_ids, edges.ids[:, 0]), (edges.measured, edges.information)
    if KINDS[kind][0] == 1:
        return PositionEdges(first, *measured, np.zeros((len(first), 2)))
    if kind == "pose":
        return RelativePoseEdges(first, np.searchsorted(data.pose_ids, edges.ids[:, 1]), *measured)
    ends = first, len(data.pose_ids) + np.searchsorted(data.landmark_ids, edges.ids[:, 1])
    if kind == "point":
        return RelativePointEdges(*ends, *measured)
    return (RangeEdges if kind == "range" else BearingEdges)(*ends, *measured, np.zeros(2))


#: anchors of less information [1/m², 1/rad²] beside others are measurements, and the values of their nodes are not exact
HARD = 0.99 * ANCHOR_INFORMATION[0, 0]


def _file_of_graph(graph: Graph, state: Array) -> PoseGraphFile:
    """The contents of the g2o file of a graph whose nodes have the values ``state`` (n, 3); see `save_g2o`.

    Raises:
        GraphError: the graph has edges that g2o has no line for.
    """
    pose_ids, landmark_ids = graph.pose_ids, graph.landmark_ids
    if len(np.intersect1d(pose_ids, landmark_ids)):
        landmark_ids = int(pose_ids.max()) + 1 + np.arange(len(landmark_ids))
    ids, held = np.concatenate([pose_ids, landmark_ids]), [graph.fixed]
    groups: dict[str, list[Any]] = {kind: [] for kind in KINDS}
    anchored = [f for f in graph.families if isinstance(f, AnchorEdges) and not isinstance(f, LandmarkPriors)]
    others = [len(graph.fixed), *(f.count for f in graph.families if isinstance(f, PositionEdges) or f in anchored)]
    alone = sum(others) == 1
    for family in graph.families:
        if family in anchored:
            # where one node is anchored and nothing else ties the graph to the world, its information does not matter
            least = np.linalg.eigvalsh(family.information)[:, 0]
            if np.all(least > 0 if alone else least >= HARD):
                held.append(family.nodes)
                continue
            family = PositionEdges(family.nodes, family.values, family.information, np.zeros((family.count, 2)))
        if isinstance(family, CartesianObservationEdges) and family.kernel is None and not family.oriented:
            family = family.relative
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
    """The kind of line of `pose_graph.KINDS` that a family has.

    Raises:
        GraphError: it has none.
    """
    if isinstance(family, PositionEdges) and family.levers.any():
        raise GraphError(
            "g2o has no line for the position of a point beside the pose: positions with a lever cannot be written"
        )
    if isinstance(family, PartialEdges) and family.offset.any():
        raise GraphError(
            "g2o has no line for ranges or bearings of a sensor beside the pose: those with an offset cannot be written"
        )
    kernel = getattr(family, "kernel", None)
    if kernel is None and not family.state_dependent_information:
        if isinstance(family, PositionEdges):
            return "prior" if family.dimension == 3 else "place"
        if isinstance(family, PartialEdges):
            return "range" if isinstance(family, RangeEdges) else "bearing"
        if isinstance(family, (RelativePoseEdges, RelativePointEdges)):
            return "pose" if isinstance(family, RelativePoseEdges) else "point"
    what = "with state-dependent or angular residuals" if kernel is None else f"with the robust kernel {kernel.name}"
    raise GraphError(
        f"g2o has no line for {type(family).__name__} {what}; relative_graph(graph, state=solution.state) of "
        "graphslam.graph.transform makes edges of them that g2o has, with the weights of a kernel at that state: save that"
    )
