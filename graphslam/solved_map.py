"""The map that a solved graph leaves for others, with the joint covariance of its landmarks.

Its inverse is the Schur complement of all poses in Omega: all that the log says about the landmarks, at the linearisation
of the solution. A graph of another log with this prior has the same solution as one of both logs together, as far as they are
linear.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from .edges import CartesianObservationEdges, MarginalEdges, SightingEdges
from .errors import OptionError
from .graph import Graph
from .landmark_map import LandmarkMap
from .log import Log
from .se2 import Array, wrap
from .transform import with_landmark_nodes
from .uncertainty import Uncertainty

#: above so many numbers of the solves that joint covariances take (400 MB), each landmark has only its own
MOST = 50_000_000


def solved_map(graph: Graph, state: Array, uncertainty: Uncertainty) -> LandmarkMap:
    """The map at a solution (n, 3), in the frame of the graph.

    Landmarks of the graph's own map that are exact stay so. Graphs without landmark nodes get them: their covariances then
    count each sighting once, also where the weight "pairs" counts it more often.

    Raises:
        OptionError: the graph has no landmarks. GraphError: its edges do not determine them.
    """
    log = graph.log
    if not len(graph.landmark_ids):
        if log is None:
            raise OptionError("a graph without a log and without landmark nodes has no map")
        graph, state = _with_nodes(graph, log, state)
        uncertainty = Uncertainty(graph, state)
    poses, d = len(graph.steps), graph.landmark_dimension
    free = np.setdiff1d(np.arange(poses, graph.num_nodes), graph.fixed)
    places = state[:, :d].copy()
    places[:, 2:] = wrap(places[:, 2:])
    ids = graph.landmark_ids[free - poses].tolist()
    means_of_nodes = dict(zip(graph.landmark_ids.tolist(), places[poses:]))
    means = means_of_nodes | dict(graph.map or {}) | dict(zip(ids, places[free]))
    classes = (graph.map.classes if graph.map is not None else {}) | _classes(log)
    # landmarks of the graph's map that are no nodes are as they were
    others = {
        j: C for j, C in (graph.map.covariances if graph.map is not None else {}).items() if j not in means_of_nodes
    }
    if 9 * len(free) * graph.num_nodes > MOST or not len(free):
        covariances = dict(zip(ids, uncertainty.diagonal[free, :d, :d]))
        return LandmarkMap(means, others | covariances, classes=classes)
    kept = np.tile(np.arange(3) < d, len(free))
    joint = block_diag(uncertainty.joint(free)[np.ix_(kept, kept)], *others.values())
    # by increasing id
    places = np.repeat([*ids, *others], [d] * len(ids) + [len(C) for C in others.values()])
    order = np.argsort(places, kind="stable")
    joint = joint[np.ix_(order, order)]
    return LandmarkMap(means, classes=classes, joint=(joint + joint.T) / 2, joint_ids=[*ids, *others])


def _with_nodes(graph: Graph, log: Log, state: Array) -> tuple[Graph, Array]:
    """The graph with landmark nodes in place of virtual-motion or marginal edges, and a state of all its nodes."""
    sighted = next(family for family in graph.families if isinstance(family, SightingEdges))
    nodes = with_landmark_nodes(graph)
    assert nodes is not None
    families = tuple(
        replace(f, kernel=sighted.kernel) if isinstance(f, CartesianObservationEdges) else f for f in nodes.families
    )
    ids = np.unique(log.landmarks[graph.sighting_rows])
    by_landmark = sighted.starts, sighted.nodes, sighted.sightings, sighted.sensor  # type: ignore[attr-defined]
    marks = MarginalEdges(*by_landmark, kernel=sighted.kernel, trust=sighted.trust).landmarks(state, state)
    changed = replace(nodes, families=families, landmark_ids=ids, parameters=None, held=None)
    return changed, np.concatenate([state, marks])


def _classes(log: Log | None) -> dict[int, str | int]:
    """The class that most sightings of each landmark have, where the log has classes."""
    if log is None or log.classes is None:
        return {}
    seen: dict[int, Counter[str | int]] = {}
    known = log.classified
    for j, kind in zip(log.landmarks[known].tolist(), log.classes[known].tolist()):
        seen.setdefault(j, Counter())[kind] += 1
    return {j: kinds.most_common(1)[0][0] for j, kinds in seen.items()}
