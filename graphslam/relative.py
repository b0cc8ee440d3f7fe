"""A log's graph in the edges that pose-graph files know: relative poses and relative points.

Two sightings of a landmark with psi measure the relative pose z_ab = T_a T_b^-1, T = h^-1(0, z) the landmark as a pose
seen from the robot; one sighting measures T itself. The noise C that the landmark has in its own axes is carried over
to the residual of `edges.relative_pose`, to first order: with J = de_virtual / de_relative at e = 0,

    Omega_ab = J' (C_a + C_b)^-1 J,   J = R(-gamma_a) [I, R(theta_ab) (-T_b,y, T_b,x); 0, 1],  gamma_a = phi_a - psi_a.

So both graphs have the same Omega where the sightings are free of noise, and optima that differ by second order of it
elsewhere. Motion edges are relative poses as they stand.
"""

from __future__ import annotations

import numpy as np

from .edges.anchor import AnchorEdges
from .edges.base import EdgeFamily
from .edges.landmark import ObservationEdges, RelativePointEdges
from .edges.relative_pose import RelativePoseEdges
from .edges.sightings import trusted
from .edges.virtual_motion import VirtualMotionEdges
from .errors import GraphError
from .graph import Graph
from .models import SensorModel
from .se2 import Array, between, inverse, rotation


def relative_graph(graph: Graph, state: Array | None = None) -> Graph:
    """The graph with every edge as a relative pose or relative point, for `Graph.save_g2o`.

    Poses keep their ids. Landmarks with a heading become poses, with ids above the others'. Robust kernels stay behind:
    the files have no place for them.

    Args:
        graph: made by `Graph.from_log`, or a pose graph, which comes back as it is.
        state: (n, 3) the initial values of the result; default: those of the graph.

    Raises:
        GraphError: the edges measure no relative pose: virtual-motion edges without psi, or ``weight="marginal"``.
    """
    families = [_relative(family) for family in graph.families]
    initial = graph.initial if state is None else np.array(state, dtype=float)
    if graph.log is None or graph.landmark_dimension == 2:
        return Graph(
            initial, tuple(families), graph.steps, graph.trajectory, graph.pose_ids, graph.landmark_ids,
            graph.landmark_dimension, graph.fixed,
        )  # fmt: skip
    above = int(graph.pose_ids.max()) + 1
    ids = above + np.arange(len(graph.landmark_ids))
    every = np.arange(graph.num_nodes)
    return Graph(initial, tuple(families), every, initial, np.concatenate([graph.pose_ids, ids]), fixed=graph.fixed)


def _relative(family: EdgeFamily) -> EdgeFamily:
    if isinstance(family, VirtualMotionEdges) and family.sightings.shape[1] == 3:
        return _of_pairs(family)
    if isinstance(family, ObservationEdges):
        return _of_sightings(family)
    if isinstance(family, RelativePoseEdges):
        return RelativePoseEdges(family.first, family.second, family.measured, family.information)
    if isinstance(family, (AnchorEdges, RelativePointEdges)):
        return family
    if isinstance(family, VirtualMotionEdges):
        raise GraphError(
            "two sightings without psi measure no relative pose, so that their virtual-motion edges cannot be written as "
            'one; take edges="landmark+motion"'
        )
    raise GraphError(
        f'{type(family).__name__} are no sum of edges between two nodes; take weight="pairs" or "tempered"'
    )


def _of_pairs(family: VirtualMotionEdges) -> RelativePoseEdges:
    seen = _from_robot(family.sensor, family.sightings)
    a, b, group = family.pairs()
    measured = between(inverse(seen[a]), inverse(seen[b]))
    # in the landmark's own axes, as `VirtualMotionEdges` has it for "body"; at e = 0 "world" says the same
    looking = np.zeros((len(family.nodes), 3))
    looking[:, 2] = family.sightings[:, 2] - family.sightings[:, 1]
    own = family.sensor.landmark_covariance(looking, family.sightings)
    trust = trusted(family.trust, len(family.nodes))
    factor = family.group_weights[group] * trust[a] * trust[b]
    by = np.broadcast_to(np.eye(3), (len(a), 3, 3)).copy()
    lever = np.column_stack([-seen[b, 1], seen[b, 0]])
    by[:, :2, 2] = np.einsum("eij,ej->ei", rotation(measured[:, 2]), lever)
    turn = np.broadcast_to(np.eye(3), (len(a), 3, 3)).copy()
    turn[:, :2, :2] = rotation(-seen[a, 2])
    by = turn @ by
    information = np.swapaxes(by, 1, 2) @ np.linalg.inv(own[a] + own[b]) @ by * factor[:, None, None]
    return RelativePoseEdges(family.nodes[a], family.nodes[b], measured, _symmetric(information))


def _of_sightings(family: ObservationEdges) -> RelativePoseEdges | RelativePointEdges:
    at_zero = np.zeros((len(family.sightings), 3))
    measured = family.sensor.h_inverse(at_zero, family.sightings)
    covariance = family.sensor.landmark_covariance(at_zero, family.sightings)
    trust = trusted(family.trust, len(measured))
    information = _symmetric(np.linalg.inv(covariance)) * trust[:, None, None]
    edges = RelativePointEdges if family.sightings.shape[1] == 2 else RelativePoseEdges
    return edges(family.first, family.second, measured, information)


def _from_robot(sensor: SensorModel, sightings: Array) -> Array:
    """The landmark as a pose (M, 3) in the robot's frame."""
    return sensor.h_inverse(np.zeros((len(sightings), 3)), sightings)


def _symmetric(matrices: Array) -> Array:
    return (matrices + np.swapaxes(matrices, 1, 2)) / 2
