"""Graphs as factors of GTSAM, its own types where they are exactly equal, else those of this package; states as its values.

A factor of this package is a Python function that GTSAM calls, with a copy of all values of the graph at each call of an
optimiser. Therefore edges that share nodes share factors where that leaves the cost and its derivatives as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, pairwise
from typing import Any

import gtsam
import numpy as np

from .. import edges
from .. import factors as factor_types
from ..edges.robust import Kernel
from ..errors import GraphError, checks
from ..graph import Graph
from ..se2 import Array, wrap

#: how edges become factors
FACTORS = ("fastest", "per-edge")
#: the motions of so many consecutive poses, and what these poses see, share a factor
TOGETHER = 16

_Part = tuple[edges.RelativePoseEdges | edges.RelativePointEdges, np.ndarray]


def to_gtsam(graph: Graph, reference: Array | None = None, *, factors: str = "fastest") -> gtsam.NonlinearFactorGraph:
    """The factors of a graph, keyed by node number.

    Args:
        graph: what to translate.
        reference: the state (n, 3) at which state-dependent information is frozen; default: the initial values.
        factors: see `solve_with_gtsam`.

    Marginal edges with a robust kernel get landmark nodes of their own, after the graph's; see `eliminated_landmarks`.

    Raises:
        GraphError: an edge has information without an inverse.
    """
    checks.check_choice("factors", factors, FACTORS)
    for family in graph.families:
        if isinstance(family, edges.RelativePoseEdges | edges.RelativePointEdges | edges.PositionEdges):
            _check_information(graph, family)
    reference = without_turns(graph.initial if reference is None else reference)
    made = gtsam.NonlinearFactorGraph()
    joined, families = _joined(graph, reference) if factors == "fastest" else ([], graph.families)
    each = (factors_of(family, graph, reference, factors) for family in families)
    for factor in chain(*each, joined, held_nodes(graph)):
        made.add(factor)
    return made


def held_nodes(graph: Graph) -> Iterator[gtsam.NonlinearFactor]:
    """What keeps the fixed nodes where they are."""
    for node in graph.fixed.tolist():
        if node in graph.without_heading:
            yield gtsam.NonlinearEqualityPoint2(node, gtsam.Point2(*graph.initial[node, :2]))
        else:
            yield gtsam.NonlinearEqualityPose2(node, gtsam.Pose2(*graph.initial[node]))


def without_turns(poses: Array) -> Array:
    """Poses (n, 3) with headings in [-pi, pi): those of drives count turns, and factors take many for degrees."""
    return np.column_stack([poses[:, :2], wrap(poses[:, 2])])


def _check_information(
    graph: Graph, family: edges.RelativePoseEdges | edges.RelativePointEdges | edges.PositionEdges
) -> None:
    """Raise `GraphError` where information is not positive definite, by its leading minors."""
    signs = [np.linalg.slogdet(family.information[:, :k, :k])[0] for k in range(1, family.measured.shape[1] + 1)]
    if (singular := np.any(np.array(signs) <= 0, axis=0)).any():
        k = int(np.argmax(singular))
        if isinstance(family, edges.PositionEdges):
            which = f"the position of {graph.names(family.nodes[[k]])}"
        else:
            which = f"the edge between {graph.names(np.array([family.first[k], family.second[k]]))}"
        raise GraphError(
            f"{which} has information without an inverse, for which GTSAM has no noise model: give what it "
            "does not measure a small information, such as 1e-6, or use graphslam.solve"
        )


def _prior_factor(
    graph: Graph, nodes: np.ndarray, values: Array, information: Array, pivot: Array | None = None
) -> gtsam.NonlinearFactor:
    """The factor of a prior of landmarks with information (3K, 3K), zero for coordinates without a prior."""
    known = np.diagonal(information).reshape(-1, 3) > 0
    rows = known.ravel()
    return factor_types.PriorFactor(
        nodes.tolist(), values, information[np.ix_(rows, rows)], coordinates=known.sum(axis=1).tolist(),
        points=len(nodes) if graph.landmark_dimension == 2 else 0, pivot=pivot,
    )  # fmt: skip


def _joined(graph: Graph, reference: Array) -> tuple[list[gtsam.NonlinearFactor], Sequence[edges.EdgeFamily]]:
    """One factor for the motions of `TOGETHER` poses and what they see, and the families of all other edges.

    Edges between poses that do not follow each other stay alone: in one factor they would connect all its poses with all
    their other ends, and so fill the factorisation.
    """
    poses = len(graph.steps)
    seen = [family for family in graph.families if isinstance(family, edges.CartesianObservationEdges)]
    # a factor has one kernel for its edges; so does every graph of a log
    kernel = next((family.kernel for family in seen if family.kernel is not None), None)
    rest: list[edges.EdgeFamily] = []
    parts: dict[str, list[_Part]] = {}
    for family in graph.families:
        relative, robust = family, False
        if isinstance(family, edges.SingleEdges):
            rest.append(family)
            continue
        if isinstance(family, edges.CartesianObservationEdges) and family.kernel in (None, kernel):
            relative, robust = family.relative, family.kernel is not None
        if not isinstance(relative, (edges.RelativePoseEdges, edges.RelativePointEdges)):
            rest.append(family)
            continue
        near = (relative.first < poses) & ((relative.second == relative.first + 1) | (relative.second >= poses))
        if not near.all():
            rest.append(relative.among(~near))
        if near.any():
            parts.setdefault(relative.frame, []).append((relative.among(near), np.full(int(near.sum()), robust)))
    made: list[gtsam.NonlinearFactor] = []
    for frame, members in parts.items():
        made += _stacked(members, graph, reference, frame, kernel)
    return made, rest


def _stacked(
    parts: list[_Part], graph: Graph, reference: Array, frame: str, kernel: Kernel | None
) -> Iterator[factor_types.RelativeEdgesFactor]:
    """The edges of several families, those from `TOGETHER` consecutive poses in one factor each."""
    first, second, robust = map(np.concatenate, zip(*((f.first, f.second, robust) for f, robust in parts)))
    measured, information = np.zeros((len(first), 3)), np.tile(np.eye(3), (len(first), 1, 1))
    start = 0
    for f, _ in parts:
        end, d = start + f.count, f.measured.shape[1]
        measured[start:end, :d], information[start:end, :d, :d] = f.measured, f.information
        start = end
    group = first // TOGETHER
    order = np.argsort(group, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        keys, places = np.unique(np.concatenate([first[rows], second[rows]]), return_inverse=True)
        i, j = places.reshape(2, -1)
        points = 0 if graph.landmark_dimension == 3 else int(np.sum(keys >= len(graph.steps)))
        yield factor_types.RelativeEdgesFactor(
            keys.tolist(), i, j, without_turns(measured[rows]), information[rows], points=points, frame=frame,
            at=reference[first[rows], 2], edge_kernel=kernel, robust=robust[rows],
        )  # fmt: skip


def factors_of(family: edges.EdgeFamily, graph: Graph, reference: Array, factors: str) -> Iterator[Any]:
    """The factors of the edges of a family; the arguments are those of `to_gtsam`."""
    if isinstance(family, edges.PriorEdges):
        yield _prior_factor(graph, family.nodes, family.values, family.information, family.pivot)
    elif isinstance(family, edges.LandmarkPriors):
        for node, value, information in zip(family.nodes[:, None], family.values[:, None], family.information):
            yield _prior_factor(graph, node, value, information)
    elif isinstance(family, edges.AnchorEdges):
        for i, x, information in _rows(family.nodes, without_turns(family.values), family.information):
            if information[:2].any():
                yield factor_types.AnchorFactor(i, x, information)
            else:
                # of the heading alone, beside positions that determine no direction
                noise = gtsam.noiseModel.Isotropic.Precision(1, information[2, 2])
                yield gtsam.PoseRotationPrior2D(i, gtsam.Rot2(x[2]), noise)
    elif isinstance(family, edges.PositionEdges):
        for i, z, information, lever in _rows(family.nodes, family.measured, family.weighed, family.levers):
            position = factor_types.PositionFactor(i, z, information, lever=lever, kernel=family.kernel)
            yield position.fastest() if factors == "fastest" else position
    elif isinstance(family, edges.PartialEdges):
        yield from factors_of_single_numbers(family)
    elif isinstance(family, edges.RelativePoseEdges):
        kernel = getattr(family, "kernel", None)
        for i, j, z, omega in _rows(family.first, family.second, without_turns(family.measured), family.weighed):
            yield factor_types.RelativePoseFactor(i, j, z, omega, frame=family.frame, at=reference[i], kernel=kernel)
    elif isinstance(family, edges.RelativePointEdges):
        kernel = getattr(family, "kernel", None)
        for i, j, z, information in _rows(family.first, family.second, family.measured, family.weighed):
            yield factor_types.RelativePointFactor(i, j, z, information, kernel=kernel)
    elif isinstance(family, edges.CartesianObservationEdges):
        yield from inverse_observations(family, family.first, family.second, reference)
    elif isinstance(family, edges.PolarObservationEdges):
        for i, j, z, noisy, trust in _rows(family.first, family.second, *_seen(family)):
            factor = factor_types.ObservationFactor(
                i, j, z, family.sensor, residual="polar", scale=trust, kernel=family.kernel, noise_at=noisy
            )
            yield factor.fastest()
    elif isinstance(family, edges.MarginalEdges) and family.kernel is not None:
        yield from inverse_observations(family, family.nodes, graph.num_nodes + family.group, reference)
    elif isinstance(family, edges.MarginalEdges):
        yield from _landmark_factors(family, reference, "marginal")
    elif isinstance(family, edges.VirtualMotionEdges) and family.kernel is None and factors == "fastest":
        yield from _landmark_factors(family, reference, "tempered" if family.tempered else "pairs")
    elif isinstance(family, edges.VirtualMotionEdges):
        a, b, group = family.pairs()
        tempering = family.group_weights[group]
        scales = tempering * family.trusted[a] * family.trusted[b]
        z, noisy, nodes = family.sightings, family.noisy, family.nodes
        both = np.stack([noisy[a], noisy[b]], axis=1)
        for i, j, z_1, z_2, noise_at, scale, factor in _rows(nodes[a], nodes[b], z[a], z[b], both, scales, tempering):
            yield factor_types.VirtualMotionFactor(
                i, j, z_1, z_2, family.sensor,
                frame=family.frame, at=(reference[i], reference[j]), scale=scale,
                kernel=family.kernel and family.kernel.scaled(factor),
                noise_at=None if family.noise_at is None else noise_at,
            )  # fmt: skip
    else:
        raise GraphError(f"no gtsam factor is known for {type(family).__name__}")


def inverse_observations(
    family: edges.CartesianObservationEdges | edges.MarginalEdges, poses: np.ndarray, landmarks: np.ndarray,
    reference: Array,
) -> Iterator[factor_types.InverseObservationFactor]:  # fmt: skip
    """The factors of sightings from poses (M,) of landmarks that are nodes (M,)."""
    for i, j, z, noisy, trust in _rows(poses, landmarks, *_seen(family)):
        yield factor_types.InverseObservationFactor(
            i, j, z, family.sensor,
            frame=family.frame, at=reference[i], scale=trust, kernel=family.kernel, noise_at=noisy,
        )  # fmt: skip


def _seen(family: edges.SightingEdges) -> tuple[Array, Array, Array]:
    """The sightings (M, d), those at which the noise is evaluated, or M times None, and the trust (M,)."""
    z = family.sightings
    return z, np.full(len(z), None) if family.noise_at is None else family.noise_at, family.trusted


def _rows(*columns: Array) -> Iterator[tuple]:
    """The rows of several columns, one per edge; numbers as Python's own."""
    return zip(*(column.tolist() if column.ndim == 1 else column for column in columns))


def _landmark_factors(
    family: edges.LandmarkSightings, reference: Array, weight: str
) -> Iterator[factor_types.LandmarkFactor]:
    for start, end in pairwise(family.starts.tolist()):
        nodes = family.nodes[start:end]
        if len(np.unique(nodes)) > 1 or weight == "marginal":
            yield factor_types.LandmarkFactor(
                nodes.tolist(), family.sightings[start:end], family.sensor,
                frame=family.frame, weight=weight, at=reference[nodes], trust=family.trusted[start:end],
                noise_at=None if family.noise_at is None else family.noise_at[start:end],
            )  # fmt: skip


def factors_of_single_numbers(family: edges.PartialEdges) -> Iterator[gtsam.NonlinearFactor]:
    """GTSAM's own factors of ranges and bearings, and ours where a sensor is off the robot's pose or there is a kernel."""
    ranged, native = isinstance(family, edges.RangeEdges), not family.offset.any() and family.kernel is None
    for k, (i, j, z, information) in enumerate(_rows(family.first, family.second, family.measured, family.weighed)):
        if native:
            noise = gtsam.noiseModel.Isotropic.Precision(1, information[0, 0])
            if ranged:
                yield gtsam.RangeFactor2D(i, j, z[0], noise)
            else:
                yield gtsam.BearingFactor2D(i, j, gtsam.Rot2(z[0]), noise)
        else:
            ends, kinds = (np.array([0]), np.array([1])), ["pose", "point"]
            one = type(family)(*ends, family.measured[k : k + 1], information[None], family.offset)
            yield factor_types.ResidualFactor([i, j], _residual(one), information, kinds=kinds, kernel=family.kernel)


def _residual(edge: edges.PartialEdges) -> Callable[[Array, Array], tuple[Array, list[Array]]]:
    """The residual of one edge and its derivatives, from a pose (3,) and a point (2,)."""

    def residual(pose: Array, point: Array) -> tuple[Array, list[Array]]:
        state = np.array([pose, [*point, 0.0]])
        found = edge.linearize(state, state)
        return found.residuals[0], [found.jacobians[0][0], found.jacobians[1][0][:, :2]]

    return residual


def eliminated_landmarks(graph: Graph, state: Array, *, always: bool = False) -> gtsam.Values:
    """The values of the landmark nodes added for marginal edges with a kernel, or ``always``: their robust means."""
    values = gtsam.Values()
    for family in graph.families:
        if isinstance(family, edges.MarginalEdges) and (always or family.kernel is not None):
            for key, (x, y, heading) in enumerate(family.landmarks(state, state).tolist(), start=graph.num_nodes):
                oriented = family.sightings.shape[1] == 3
                values.insert(key, gtsam.Pose2(x, y, heading) if oriented else gtsam.Point2(x, y))
    return values


def to_values(graph: Graph, state: Array) -> gtsam.Values:
    """The values of all nodes (n, 3), keyed by node number: `gtsam.Pose2`, or `gtsam.Point2` for a point landmark."""
    values, poses = gtsam.Values(), _count_poses(graph)
    for node, (x, y, theta) in enumerate(state.tolist()):
        values.insert(node, gtsam.Pose2(x, y, theta) if node < poses else gtsam.Point2(x, y))
    return values


def from_values(graph: Graph, values: gtsam.Values) -> Array:
    """The state (n, 3) of values that `to_values` made and an optimiser moved."""
    state, poses = np.zeros((graph.num_nodes, 3)), _count_poses(graph)
    # the landmarks of `eliminated_landmarks` follow the graph's own nodes
    state[:poses] = gtsam.utilities.extractPose2(values)[:poses]
    if poses < len(state):
        state[poses:, :2] = gtsam.utilities.extractPoint2(values)[: len(state) - poses]
    return state


def _count_poses(graph: Graph) -> int:
    """The number of nodes that are `gtsam.Pose2`: poses, and landmarks with a heading."""
    return graph.num_nodes - len(graph.without_heading)
