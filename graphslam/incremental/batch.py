"""The batch solution of an online system, for steps from which undamped passes do not converge."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from scipy.linalg import block_diag

from ..edges import EdgeFamily, PriorEdges
from ..edges.relative import RobustPointEdges, RobustPoseEdges
from ..edges.robust import Kernel
from ..errors import GraphError
from ..graph import Graph
from ..se2 import Array
from ..solvers.gauss_newton import gauss_newton
from ..solvers.iteration import Run
from ..solvers.levenberg_marquardt import levenberg_marquardt
from .arrays import Edges, Nodes
from .lag import Prior


def _prior_edges(prior: Prior, nodes: Nodes, number: np.ndarray) -> PriorEdges:
    """A prior in world axes, with its nodes in ascending order."""
    order = np.argsort(number[prior.members])
    at, k = prior.members[order], len(order)
    turn = np.tile(np.eye(3), (k, 1, 1))
    centre, pose = prior.centre[order], nodes["point"][at] == 0
    c, s = np.cos(centre[:, 2]), np.sin(centre[:, 2])
    turn[pose, :2, :2] = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)[pose]
    parts = (3 * order[:, None] + np.arange(3)).ravel()
    information, T = prior.information[np.ix_(parts, parts)], block_diag(*turn)
    return PriorEdges(number[at], centre, T.T @ information @ T, T.T @ prior.rhs[parts])


def batch_state(
    nodes: Nodes, edges: Edges, kept: np.ndarray, live: np.ndarray, priors: list[Prior], kernel: Kernel | None
) -> Array | None:
    """The values (n, 3) of all nodes after Gauss-Newton, damped where necessary, over the edges ``live`` of nodes ``kept``.

    None if the batch solver finds no state with a lower cost.
    """
    n, point = len(kept), nodes["point"][kept]
    order = kept[np.argsort(point, kind="stable")]
    number = np.zeros(len(nodes), dtype=np.int64)
    number[order] = np.arange(n)
    families: list[EdgeFamily] = [_prior_edges(prior, nodes, number) for prior in priors]
    edges = edges[live]
    rows, robust = edges["rows"], edges["robust"]
    for d, kind in ((3, RobustPoseEdges), (2, RobustPointEdges)):
        for weighed in (False, True):
            k = np.flatnonzero((rows == d) & (robust == weighed))
            if len(k):
                information = edges["information"][k][:, [0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(-1, 3, 3)[:, :d, :d]
                ends = number[edges["ends"][k]]
                families.append(
                    kind(
                        ends[:, 0],
                        ends[:, 1],
                        edges["measured"][k, :d],
                        information,
                        kernel=kernel if weighed else None,
                    )
                )
    x, poses = nodes["x"][order], int(n - point.sum())
    graph = Graph(
        x, families=tuple(families), steps=np.arange(poses), trajectory=x[:poses], pose_ids=np.arange(poses),
        landmark_ids=np.arange(n - poses),
    )  # fmt: skip
    # plain steps from far away may end in a much higher minimum, and damped ones do not
    for iterate in (gauss_newton, levenberg_marquardt):
        run = Run(x, tolerance=1e-9, cost_tolerance=1e-9)
        with suppress(GraphError):
            iterate(graph, run)
            if graph.cost(run.state) <= graph.cost(x):
                state = nodes["x"].copy()
                state[order] = run.state
                return state[: kept[-1] + 1]
    return None
