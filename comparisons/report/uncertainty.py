"""The covariance of every pose of a result, where it is known: of graphs, and of dead reckoning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphslam import Graph, GraphError, Log, MotionModel
from graphslam.se2 import Array, compose, rotation
from graphslam.uncertainty import Uncertainty

from ..estimator import EstimatorResult, RunOptions
from ..estimators import make_graph
from ..plots import DRIFTING


def pose_covariances(result: EstimatorResult, log: Log, options: RunOptions) -> Array | None:
    """The covariances (T+1, 3, 3) of a result's poses in its world axes; NaN where a pose is not estimated.

    Of solvers of a graph (the lectures' program too) they are the diagonal blocks of Omega^-1, linearised where the
    solver ended. None where they are not known: the particle filters keep one path, not a spread at every past step,
    and graduated non-convexity keeps its trust in the sightings to itself.
    """
    if result.name == DRIFTING:
        return None if log.controls is None else dead_reckoning_covariances(log, options.motion)
    graph = graph_of(result, log, options)
    if graph is None:
        return None
    try:
        blocks = Uncertainty(graph, state_of(result, graph)).diagonal[: len(graph.steps)]
    except GraphError:
        return None  # the edges do not determine the poses
    covariances = np.full((log.num_poses, 3, 3), np.nan)
    covariances[graph.steps] = blocks
    return covariances


def graph_of(result: EstimatorResult, log: Log, options: RunOptions) -> Graph | None:
    """The graph that a result was solved on, made anew; None where there was none, or it is not known."""
    told = {"robust": "none"} | {k: result.options[k] for k in ("edges", "frame", "weight", "motion_weight", "robust")
                                 if k in result.options}  # fmt: skip
    if "frame" not in told or told["robust"] == "gnc":
        return None
    return make_graph(log, replace(options, **told))


def state_of(result: EstimatorResult, graph: Graph) -> Array:
    """The values (n, 3) of a graph's nodes at a result."""
    state = np.zeros((graph.num_nodes, 3))
    state[: len(graph.steps)] = result.poses[graph.steps]
    d = graph.landmark_dimension
    for node, landmark in enumerate(graph.landmark_ids.tolist(), start=len(graph.steps)):
        state[node, :d] = result.landmarks[landmark][:d]
    return state


def dead_reckoning_covariances(log: Log, motion: MotionModel | None = None) -> Array:
    """How the motion noise adds up along the drive, (T+1, 3, 3), from a start that is known exactly.

    Sigma_{t+1} = F Sigma F' + J Q J', where m is the motion seen from pose t, Q its covariance,
    F = d compose(x, m) / dx and J = d compose(x, m) / dm.
    """
    motions, noise = log.motions(motion)
    pose, covariance = log.initial_poses[0], np.zeros((3, 3))
    covariances = [covariance]
    for m, Q in zip(motions, noise):
        after = compose(pose, m)
        F = np.array([[1, 0, pose[1] - after[1]], [0, 1, after[0] - pose[0]], [0, 0, 1]])
        J = np.eye(3)
        J[:2, :2] = rotation(pose[2])
        pose, covariance = after, F @ covariance @ F.T + J @ Q @ J.T
        covariances.append(covariance)
    return np.array(covariances)
