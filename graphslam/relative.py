"""The graph of a log with the edges that pose-graph files have: relative poses and relative points.

Two sightings of a landmark with psi measure the relative pose z_ab = T_a T_b^-1, T = h^-1(0, z) the landmark as a pose
seen from the robot; one sighting measures T itself. The noise C that the landmark has in its own axes is carried over
to the residual of `edges.relative`, to first order: with J = de_virtual / de_relative at e = 0,

    Omega_ab = J' (C_a + C_b)^-1 J,   J = R(-gamma_a) [I, R(theta_ab) (-T_b,y, T_b,x); 0, 1],  gamma_a = phi_a - psi_a.

So both graphs have the same Omega where the sightings are free of noise, and optima that differ by second order of it
elsewhere. Motion edges already are relative poses, and sightings of landmark nodes with the Cartesian residual relative
poses or points; polar ones become these.

A robust kernel becomes the weight w(r) that it gives each edge at a state, with r of the graph's own edge. At the
optimum of the graph Omega and xi are the same with these weights as with the kernel, so the solution stays one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from .checks import array_of
from .edges import (
    AnchorEdges,
    CartesianObservationEdges,
    DoubtedEdges,
    EdgeFamily,
    LandmarkPriors,
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
from .errors import GraphError
from .graph import Graph
from .se2 import Array, between, inverse, perpendicular, rotation, turn_matrix

_Relative = TypeVar("_Relative", RelativePoseEdges, RelativePointEdges, RelativePoseEdges | RelativePointEdges)


def relative_graph(graph: Graph, *, state: Array | None = None) -> Graph:
    """The graph with every edge as a relative pose or relative point, for `Graph.save_g2o`.

    Poses keep their ids. Landmarks with a heading become poses, with ids above the others'. Files hold no robust
    kernels, so a kernel becomes a factor on the information of each edge: its weight at the state.

    Args:
        graph: made by `Graph.from_log`, or a pose graph, which is returned unchanged.
        state: (n, 3) the initial values of the result, at which kernels are evaluated: give the solution's state for a
            graph with a kernel. Default: the initial values of the graph.

    Raises:
        GraphError: the edges measure no relative pose: virtual-motion edges without psi, or ``weight="marginal"``.
    """
    initial = graph.initial if state is None else array_of("state", state).copy()
    families = tuple(_relative(family, initial) for family in graph.families)
    if graph.log is None or graph.landmark_dimension == 2:
        return replace(graph, initial=initial, families=families, log=None, sensor=None, notes=())
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
        return _weighted(replace(seen.relative, frame="body"), family, state)
    if isinstance(family, PartialEdges):
        weights = family.kernel_weights(state)[:, None, None]
        return replace(family, information=family.weighed * weights, kernel=None, trust=None)
    if isinstance(family, RelationEdges):
        return _weighted(replace(family.relative, kernel=None), family, state)
    if isinstance(family, PositionEdges):
        weights = family.kernel_weights(state)[:, None, None]
        return replace(family, information=family.weighed * weights, kernel=None, trust=None)
    if isinstance(family, RelativePoseEdges):
        return replace(family, frame="body")
    if isinstance(family, (LandmarkPriors, PriorEdges)):
        raise GraphError("pose-graph files have no line for the priors of a map; use it as fixed (map_use fixed)")
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
    J = np.tile(np.eye(3), (len(a), 1, 1))
    J[:, :2, 2] = np.einsum("eij,ej->ei", rotation(measured[:, 2]), perpendicular(landmark[b, :2]))
    J = turn_matrix(-landmark[a, 2]) @ J
    information = np.swapaxes(J, 1, 2) @ np.linalg.inv(own[a] + own[b]) @ J * factor[:, None, None]
    return RelativePoseEdges(family.nodes[a], family.nodes[b], measured, _symmetric(information))


def _symmetric(matrices: Array) -> Array:
    return (matrices + np.swapaxes(matrices, 1, 2)) / 2
