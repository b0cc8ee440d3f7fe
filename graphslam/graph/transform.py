"""Graphs made from graphs: with and without landmark nodes, coarser, and of the first poses only.

`without_landmarks` replaces landmark nodes by virtual-motion edges between the poses that saw them, `with_landmark_nodes` the
other way round.

A coarse graph (`coarse`) keeps every N-th pose and joins the motions between them. Where dead reckoning has drifted for
kilometres, Gauss-Newton takes a dozen steps to straighten the trajectory, each over all poses. Starting from the solution of
a coarse graph, it takes few.

`relative_graph` gives the graph of a log the edges that pose-graph files have: relative poses and relative points. Two
sightings of a landmark with psi measure the relative pose z_ab = T_a T_b^-1, T = h^-1(0, z) the landmark as a pose seen from
the robot; one sighting measures T itself. The noise C that the landmark has in its own axes is carried over to the residual
of `edges.relative`, to first order: with J = de_virtual / de_relative at e = 0,

    Omega_ab = J' (C_a + C_b)^-1 J,   J = R(-gamma_a) [I, R(theta_ab) (-T_b,y, T_b,x); 0, 1],  gamma_a = phi_a - psi_a.

So both graphs have the same Omega where the sightings are free of noise, and optima that differ by second order of it
elsewhere. Motion edges already are relative poses, and sightings of landmark nodes with the Cartesian residual relative
poses or points; polar ones become these.

A robust kernel becomes the weight w(r) that it gives each edge at a state, with r of the graph's own edge. At the
optimum of the graph Omega and xi are the same with these weights as with the kernel, so the solution stays one, except for
edges in the world frame: they get the body frame, whose optimum differs from theirs where residuals are not zero.
"""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import TypeVar

import numpy as np

from ..edges import (
    AnchorEdges,
    CartesianObservationEdges,
    DoubtedEdges,
    EdgeFamily,
    LandmarkPriors,
    LandmarkSightings,
    ObservationEdges,
    PartialEdges,
    PolarObservationEdges,
    PositionEdges,
    PriorEdges,
    RelationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from ..errors import GraphError, checks
from ..se2 import Array, between, chained, inverse, joined_motions, lever_matrix, perpendicular, rotation, turn_matrix
from .defaults import anchors
from .graph import Graph


def without_landmarks(graph: Graph) -> Graph | None:
    """The graph with its landmark nodes replaced by virtual-motion edges between the poses that saw them.

    Only consecutive sightings of a landmark are paired: there are as many edges as sightings, and hardly more fill than
    with landmark nodes. The cost is much closer to a quadratic than that of landmark nodes, whose bearings turn quickly
    near a landmark that starts in the wrong place. None where there are no sightings of landmark nodes.
    """

    def paired(edges: ObservationEdges) -> VirtualMotionEdges:
        order = np.lexsort((edges.first, edges.second))
        landmark = edges.second[order]
        here = np.flatnonzero(landmark[1:] == landmark[:-1])
        rows = order[np.column_stack([here, here + 1]).ravel()]
        starts = np.arange(0, len(rows) + 1, 2)
        return VirtualMotionEdges(starts, edges.first[rows], edges.sightings[rows], edges.sensor)

    families = [paired(f) if isinstance(f, ObservationEdges) else f for f in graph.families]
    return None if families == [*graph.families] else poses_only(graph, families)


def with_cartesian_sightings(graph: Graph) -> Graph | None:
    """The graph with the Cartesian residual for its sightings of landmark nodes; None where none of them is polar.

    Both write Omega and xi into one `Graph.system`.
    """
    if not any(isinstance(family, PolarObservationEdges) for family in graph.families):
        return None
    return graph.with_changed(PolarObservationEdges, attrgetter("cartesian"))


def with_landmark_nodes(graph: Graph) -> Graph | None:
    """The graph with landmark nodes and Cartesian residuals in place of its edges from sightings; these keep their order.

    A robust kernel of pairs acts on each sighting then. New landmarks are numbered from 0, and at the origin. None where
    there are no sightings.
    """
    if (sighted := graph.sighted) is None:
        return None
    if isinstance(sighted, ObservationEdges):
        parts, first, second = {}, sighted.first, sighted.second
    else:
        assert isinstance(sighted, LandmarkSightings)
        count, first, second = len(sighted.starts) - 1, sighted.nodes, graph.num_nodes + sighted.group
        parts = {
            "initial": np.concatenate([graph.initial, np.zeros((count, 3))]), "landmark_ids": np.arange(count),
            "landmark_dimension": sighted.sightings.shape[1],
        }  # fmt: skip
    edges = CartesianObservationEdges(
        first, second, sighted.sightings, sighted.sensor,
        kernel=sighted.kernel, trust=sighted.trust, noise_at=sighted.noise_at,
    )  # fmt: skip
    return replace(graph, families=tuple(edges if f is sighted else f for f in graph.families), **parts)


def poses_only(graph: Graph, families: list[EdgeFamily]) -> Graph:
    """The graph of the poses alone, with these edges but for those of landmarks; an anchor takes the place of a map."""
    count = len(graph.steps)
    of_landmarks = (RelativePointEdges, LandmarkPriors, PriorEdges, PartialEdges)
    kept = [family for family in families if not isinstance(family, of_landmarks)]
    if graph.map is not None and not any(isinstance(family, PositionEdges) for family in kept):
        kept += anchors(graph.initial[0], ())
    return replace(
        graph, initial=graph.initial[:count], landmark_ids=graph.landmark_ids[:0], log=None, map=None,
        families=tuple(kept), fixed=graph.fixed[graph.fixed < count],
    )  # fmt: skip


def without_positions(graph: Graph) -> Graph:
    """The graph without absolute positions; the first pose is anchored in their place, unless a map or a fixed node is."""
    if not any(isinstance(family, PositionEdges) for family in graph.families):
        return graph
    families = [f for f in graph.families if not isinstance(f, PositionEdges) and type(f) is not AnchorEdges]
    if graph.map is None and not len(graph.fixed):
        families = [*anchors(graph.initial[0], ()), *families]
    return replace(graph, families=tuple(families))


def coarse(graph: Graph, every: int) -> tuple[Graph, np.ndarray] | None:
    """The graph of every N-th pose and all landmarks they see, and the nodes of the whole graph that it keeps.

    None where the poses are not one chain of motion edges with sightings of landmark nodes. The last pose is always kept.
    """
    chain = _chain(graph)
    if chain is None:
        return None
    poses = len(graph.steps)
    kept = np.unique(np.append(np.arange(0, poses, every), poses - 1))
    used = np.zeros(graph.num_nodes, dtype=bool)
    used[kept] = True
    for family in graph.families:
        if isinstance(family, ObservationEdges):
            used[family.second[used[family.first]]] = True
    piece, nodes = of_nodes(graph, used)
    families = [_joined(chain, kept) if isinstance(f, RelativePoseEdges) else f for f in piece.families]
    return replace(piece, families=tuple(families), steps=np.arange(len(kept))), nodes


def first_poses(graph: Graph, count: int) -> tuple[Graph, np.ndarray]:
    """The graph of the first poses and of the landmarks that they see, and the nodes of the whole graph that it keeps."""
    return of_nodes(graph, first_seen(graph) < count)


def first_seen(graph: Graph) -> np.ndarray:
    """The first pose (n,) that sees each landmark; 0 where a joint prior gives it; poses themselves; n where none does."""
    seen = np.full(graph.num_nodes, graph.num_nodes)
    for family in graph.families:
        if isinstance(family, ObservationEdges | RelativePointEdges | PartialEdges):
            np.minimum.at(seen, family.second, family.first)
        elif isinstance(family, PriorEdges):
            seen[family.nodes] = 0
    seen[: len(graph.steps)] = np.arange(len(graph.steps))
    return seen


def of_nodes(graph: Graph, used: np.ndarray) -> tuple[Graph, np.ndarray]:
    """The graph of the nodes that are used (n,) and of the edges between them, and these nodes."""
    nodes, poses = np.flatnonzero(used), len(graph.steps)
    number = np.full(graph.num_nodes, -1)
    number[nodes] = np.arange(len(nodes))
    kept, landmarks = nodes[nodes < poses], nodes[nodes >= poses] - poses
    return replace(
        graph, initial=graph.initial[nodes], families=tuple(_divided(family, number) for family in graph.families),
        steps=graph.steps[kept], trajectory=graph.initial[kept], pose_ids=graph.pose_ids[kept],
        landmark_ids=graph.landmark_ids[landmarks], fixed=number[graph.fixed[used[graph.fixed]]], log=None,
    ), nodes  # fmt: skip


def _divided(family: EdgeFamily, number: np.ndarray) -> EdgeFamily:
    """The edges between the nodes that have a new number (n,), not -1.

    Raises:
        GraphError: they cannot be divided.
    """
    if (kept := family.renumbered(number)) is None:
        raise GraphError(f"{type(family).__name__} cannot be divided: only families with a method renumbered can")
    return kept


def filled(graph: Graph, kept: np.ndarray, poses: Array) -> Array:
    """All poses (P, 3) from those kept (k,): each other pose follows from the kept one before it by the motions."""
    chain = _chain(graph)
    assert chain is not None
    driven = chained(np.zeros(3), chain.measured)
    before = np.searchsorted(kept, np.arange(len(graph.steps)), side="right") - 1
    offset, turned = driven - driven[kept[before]], turn_matrix(poses[before, 2] - driven[kept[before], 2])
    return poses[before] + np.einsum("kij,kj->ki", turned, offset)


def _chain(graph: Graph) -> RelativePoseEdges | None:
    """The motion edges, where they lead from each pose to the next and all other edges are sightings and anchors."""
    chains = [family for family in graph.families if isinstance(family, RelativePoseEdges)]
    known = (RelativePoseEdges, AnchorEdges, ObservationEdges)
    if len(chains) != 1 or not all(isinstance(family, known) for family in graph.families):
        return None
    first = np.arange(len(graph.steps) - 1)
    whole = np.array_equal(chains[0].first, first) and np.array_equal(chains[0].second, first + 1)
    return chains[0] if whole and any(isinstance(family, ObservationEdges) for family in graph.families) else None


def _joined(chain: RelativePoseEdges, kept: np.ndarray) -> RelativePoseEdges:
    """The relative poses between kept nodes, with the covariances sum of L C L' of the motions that they join."""
    (measured, L), number = joined_motions(chain.measured, kept), np.arange(len(kept))
    covariance = np.add.reduceat(L @ np.linalg.inv(chain.information) @ np.swapaxes(L, 1, 2), kept[:-1], axis=0)
    return RelativePoseEdges(number[:-1], number[1:], measured, _symmetric(np.linalg.inv(covariance)))


_Relative = TypeVar("_Relative", RelativePoseEdges, RelativePointEdges, RelativePoseEdges | RelativePointEdges)


def relative_graph(graph: Graph, *, state: Array | None = None) -> Graph:
    """The graph with every edge as a relative pose or relative point, for `Graph.save_g2o`.

    Poses keep their ids. Landmarks with a heading become poses, with ids above the others'. Files hold no robust
    kernels, so a kernel becomes a factor on the information of each edge: its weight at the state. They hold no parameters
    of the robot either, which keep the values that they have in the graph.

    Args:
        graph: made by `Graph.from_log`, or a pose graph, which is returned unchanged.
        state: (n, 3) the initial values of the result, at which kernels are evaluated: give the solution's state for a
            graph with a kernel. Default: the initial values of the graph.

    Raises:
        GraphError: the edges measure no relative pose: virtual-motion edges without psi, or ``weight="marginal"``.
    """
    initial = graph.initial if state is None else checks.array_of("state", state).copy()
    families = tuple(_relative(family, initial) for family in graph.families)
    if graph.log is None or graph.landmark_dimension == 2:
        # edges of a file know nothing of the robot's parameters
        return replace(
            graph, initial=initial, families=families, log=None, sensor=None, parameters=None, held=None, notes=()
        )
    landmarks = int(graph.pose_ids.max()) + 1 + np.arange(len(graph.landmark_ids))
    ids = np.concatenate([graph.pose_ids, landmarks])
    steps = np.arange(graph.num_nodes)
    return Graph(initial, families=families, steps=steps, trajectory=initial, pose_ids=ids, fixed=graph.fixed)


def _relative(family: EdgeFamily, state: Array) -> EdgeFamily:
    if isinstance(family, VirtualMotionEdges) and family.oriented:
        return _weighted(_of_pairs(family), family, state)
    if isinstance(family, ObservationEdges):
        # a polar residual becomes the Cartesian one
        seen = family.cartesian if isinstance(family, PolarObservationEdges) else family
        assert isinstance(seen, CartesianObservationEdges)
        kind = RelativePoseEdges if seen.oriented else RelativePointEdges
        relative = kind(seen.first, seen.second, seen.relative.measured, seen.relative.information)
        return _weighted(relative, family, state)
    if isinstance(family, RelationEdges):
        return _weighted(RelativePoseEdges(family.first, family.second, family.measured, family.weighed), family, state)
    if isinstance(family, PartialEdges | PositionEdges):
        weights = family.kernel_weights(state)[:, None, None]
        return replace(family, information=family.weighed * weights, kernel=None, trust=None)
    if isinstance(family, RelativePoseEdges):
        return replace(family, frame="body")
    if isinstance(family, (LandmarkPriors, PriorEdges)):
        raise GraphError("pose-graph files have no line for the priors of a map; use it as fixed (map_use='fixed')")
    if isinstance(family, (AnchorEdges, RelativePointEdges)):
        return family
    if isinstance(family, VirtualMotionEdges):
        raise GraphError(
            "two sightings without psi measure no relative pose, so that their virtual-motion edges cannot be written as "
            'one; use edges="landmark+motion"'
        )
    raise GraphError(f'{type(family).__name__} are no sum of edges between two nodes; use weight="pairs" or "tempered"')


def _weighted(edges: _Relative, family: DoubtedEdges, state: Array) -> _Relative:
    """The edges with the weights that the kernel of the family they come from has at a state."""
    if family.kernel is None:
        return edges
    return replace(edges, information=edges.information * family.kernel_weights(state)[:, None, None])


def _of_pairs(family: VirtualMotionEdges) -> RelativePoseEdges:
    a, b, group = family.pairs()
    # the landmark as a pose in the robot's frame
    landmark = family.sensor.h_inverse(np.zeros((len(family.nodes), 3)), family.sightings)
    measured = between(inverse(landmark[a]), inverse(landmark[b]))
    # at e = 0 the information of the world frame is the same
    own = replace(family, frame="body").covariances(np.zeros((0, 3)))
    factor = family.group_weights[group] * family.trusted[a] * family.trusted[b]
    lever = np.einsum("eij,ej->ei", rotation(measured[:, 2]), perpendicular(landmark[b, :2]))
    J = turn_matrix(-landmark[a, 2]) @ lever_matrix(lever)
    information = np.swapaxes(J, 1, 2) @ np.linalg.inv(own[a] + own[b]) @ J * factor[:, None, None]
    return RelativePoseEdges(family.nodes[a], family.nodes[b], measured, _symmetric(information))


def _symmetric(matrices: Array) -> Array:
    return (matrices + np.swapaxes(matrices, 1, 2)) / 2
