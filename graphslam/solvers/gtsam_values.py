"""States of graphs as values of GTSAM, and back."""

from __future__ import annotations

import gtsam
import numpy as np

from .. import edges
from ..graph import Graph
from ..se2 import Array


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
    return graph.num_nodes if graph.landmark_dimension == 3 else len(graph.steps)
