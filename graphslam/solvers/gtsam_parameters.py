"""Parameters of vehicle and sensor as one more node of a GTSAM graph, a vector of K numbers.

Each factor of a motion or of a sighting gets the key of this node. With the residual e(x) of the factor at the parameters
p_0 where the graph is frozen, and J = de/dp there, its residual is e(x) + J (p - p_0). An outer loop freezes the graph at the
result, until nothing moves. The hand-written solver eliminates the parameters by a Schur complement instead; both have in
common the corrections of measurements, and how a sighting moves (`graphslam.parameters.corrections`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np

from .. import edges
from .. import factors as factor_types
from ..engine import engine
from ..errors import GraphError
from ..factors.base import POSE, Factor, noise_model, turned
from ..graph import Graph
from ..parameters.corrected import predictions
from ..parameters.corrections import corrected_controls, motion_slopes, moves
from ..parameters.joint import JointGraph
from ..se2 import Array, rotation, turn_matrix, wrap
from .gtsam_factors import to_gtsam
from .gtsam_values import eliminated_landmarks, from_values, to_values
from .iteration import Run

#: the most steps between two freezings
STEPS = 10
#: each freezing changes the problem, so it is solved to this part of the last move
FINER = 0.1


def solve_jointly_with_gtsam(joint: JointGraph, run: Run) -> None:
    """Freeze, minimise over nodes and parameters, and freeze again, from ``run.state`` until it moves no more."""
    mixing = engine.AndersonMixing()
    while len(run.step_norms) < run.max_iterations:
        inner = max(run.tolerance / 10, FINER * run.step_norms[-1] if run.step_norms else FINER)
        move = _minimum(joint, run.state, inner) - run.state
        nodes, _ = joint.parted(move)
        nodes[:, 2] = wrap(nodes[:, 2])
        run.step_norms.append(float(np.linalg.norm(move)))
        run.state = mixing.next(run.state, move)
        if not np.isfinite(run.step_norms[-1]):
            run.reason = f"diverged after {len(run.step_norms)} steps"
            return
        if run.step_norms[-1] < run.tolerance:
            run.converged = True
            run.reason = f"step norm {run.step_norms[-1]:.1e} below the tolerance {run.tolerance:g}"
            return
    run.reason = f"max_iterations = {run.max_iterations} reached"


def _minimum(joint: JointGraph, state: Array, tolerance: float) -> Array:
    """The minimum of the graph frozen at a state (n + r, 3), as such a state."""
    graph, (nodes, values) = joint.at(state), joint.parted(state)
    key = 2 * graph.num_nodes + len(graph.sighting_rows)
    made, start = _factors(graph, nodes, key), to_values(graph, nodes)
    start.insert(eliminated_landmarks(graph, nodes, always=True))
    start.insert(key, np.array(values))
    plain = gtsam.GaussNewtonParams()
    plain.setLinearSolverType("MULTIFRONTAL_QR")
    optimizer = gtsam.GaussNewtonOptimizer(made, start, plain)
    reached = state
    for _ in range(STEPS):
        try:
            optimizer.iterate()
        except RuntimeError as error:
            raise GraphError(f"gtsam failed: {str(error).strip().splitlines()[0]}") from None
        found = optimizer.values()
        before, reached = reached, joint.joined(from_values(graph, found), found.atVector(key))
        step = reached - before
        step[: graph.num_nodes, 2] = wrap(step[: graph.num_nodes, 2])
        if np.linalg.norm(step) < tolerance:
            break
    return reached


def _factors(graph: Graph, nodes: Array, key: int) -> gtsam.NonlinearFactorGraph:
    """All factors of a graph frozen at its nodes (n, 3), with the parameters at ``key``."""
    parameters = graph.parameters
    assert parameters is not None
    made = gtsam.NonlinearFactorGraph()
    for family in graph.families:
        if isinstance(family, edges.SightingEdges):
            for factor in _of_sightings(graph, family, nodes, key):
                made.add(factor)
        elif isinstance(family, edges.RelativePoseEdges) and not isinstance(family, edges.RelationEdges):
            _, slopes = motion_slopes(parameters, corrected_controls(parameters))
            behind = -slopes
            behind[:, :2] = rotation(nodes[family.first, 2]) @ behind[:, :2]
            ends = zip(family.first.tolist(), family.second.tolist(), family.measured, family.information, behind)
            for i, j, z, information, X in ends:
                base = factor_types.RelativePoseFactor(i, j, z, information, frame=family.frame, at=nodes[i])
                noise = noise_model({"kernel": None}, information=information)
                if family.frame == "world":
                    turn = turn_matrix(nodes[i, 2])
                    noise = noise_model({"kernel": None}, information=turn @ information @ turn.T)
                made.add(_with_parameters(base, noise, key, (nodes[i], nodes[j]), (None, X), parameters.values))
        else:
            for factor in _plain(graph, family, nodes):
                made.add(factor)
    priors = np.isfinite(parameters.deviations)
    if priors.any():
        root, means = np.diag(1 / parameters.deviations)[priors], parameters.means

        def prior(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
            if jacobians is not None:
                jacobians[0] = np.asfortranarray(root)
            return root @ (values.atVector(key) - means)

        made.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(int(priors.sum())), [key], prior))
    return made


def _plain(graph: Graph, family: edges.EdgeFamily, nodes: Array) -> Iterator[gtsam.NonlinearFactor]:
    """The factors of a family that the parameters do not touch."""
    alone = to_gtsam(replace(graph, families=(family,), fixed=graph.fixed[:0]), nodes, factors="per-edge")
    yield from (alone.at(k) for k in range(alone.size()))


def _of_sightings(graph: Graph, family: edges.SightingEdges, nodes: Array, key: int) -> Iterator[gtsam.NonlinearFactor]:
    """The factors of sightings, one for each edge."""
    parameters = graph.parameters
    assert parameters is not None and graph.log is not None
    z, noisy, trust, sensor = family.sightings, family.noisy, family.trusted.tolist(), family.sensor
    X = moves(parameters, predictions(family, nodes), graph.log.steps[graph.sighting_rows])
    if isinstance(family, edges.VirtualMotionEdges):
        X = _turned(X, nodes[family.nodes, 2])
        a, b, group = family.pairs()
        covariance = family.covariances(nodes)
        for one, two, g in zip(a.tolist(), b.tolist(), group.tolist()):
            i, j, tempering = int(family.nodes[one]), int(family.nodes[two]), float(family.group_weights[g])
            ends = (nodes[i], nodes[j])
            base = factor_types.VirtualMotionFactor(i, j, z[one], z[two], sensor, frame=family.frame, at=ends)
            C = covariance[one] + covariance[two]
            if family.frame == "body" and family.oriented:
                # from the landmark's axes to those of the first sighting, which comes from direction psi
                turn = turn_matrix(-z[one, 2])
                C = turn @ C @ turn.T
            kernel = family.kernel and family.kernel.scaled(tempering)
            noise = noise_model({"kernel": kernel, "scale": tempering * trust[one] * trust[two]}, covariance=C)
            yield _with_parameters(base, noise, key, ends, (X[one], X[two]), parameters.values)
        return
    if isinstance(family, edges.MarginalEdges):
        first, second = family.nodes, graph.num_nodes + family.group
        means, frame = family.landmarks(nodes, nodes), family.frame
        landmarks = means[family.group]
    else:
        assert isinstance(family, edges.CartesianObservationEdges)
        first, second, frame = family.first, family.second, family.frame
        landmarks = nodes[second]
    X = _turned(X, nodes[first, 2])
    at_pose = nodes[first] if frame == "world" else np.zeros((len(z), 3))
    covariance = sensor.landmark_covariance(at_pose, noisy)
    d = z.shape[1]
    for k, (i, j) in enumerate(zip(first.tolist(), second.tolist())):
        other = factor_types.InverseObservationFactor(i, j, z[k], sensor, frame=frame, at=nodes[i])
        noise = noise_model({"kernel": family.kernel, "scale": trust[k]}, covariance=covariance[k])
        at = (nodes[i], landmarks[k][:d])
        yield _with_parameters(other, noise, key, at, (X[k], None), parameters.values)


def _turned(X: Array, headings: Array) -> Array:
    """Moves (M, 3, K) in the axes of poses, in world axes."""
    X = X.copy()
    X[:, :2] = rotation(headings) @ X[:, :2]
    return X


def _with_parameters(
    base: Factor, noise: gtsam.noiseModel.Base, key: int, at: Sequence[Array], X: Sequence[Array | None], values: Array
) -> gtsam.CustomFactor:
    """A factor with the parameters at another key: e + J (p - p_0), J the sum of the Jacobians at ``at`` times X (3, K)."""
    residual, own, poses = base.residual, base.in_own_axes, [kind == POSE for kind in base.kinds]
    _, jacobians_at = residual(*at)
    J, p_0 = np.zeros((noise.dim(), len(values))), np.array(values)
    for B, x, move in zip(jacobians_at, at, X):
        if move is not None:
            J += np.asarray(B) @ (turn_matrix(-x[2]) @ move if own else move)
    slope, nodes = np.asfortranarray(J), list(zip(base.keys(), poses))

    def callback(_: gtsam.CustomFactor, estimate: gtsam.Values, jacobians: Any) -> Array:
        where: list[Any] = []
        for node, is_pose in nodes:
            if is_pose:
                pose = estimate.atPose2(node)
                where.append((pose.x(), pose.y(), pose.theta()))
            else:
                where.append(estimate.atPoint2(node))
        e, by = residual(*where)
        if jacobians is not None:
            for k, (B, x, is_pose) in enumerate(zip(by, where, poses)):
                free = own or not is_pose
                jacobians[k] = np.asarray(B if free else turned(B, x[2]), dtype=float, order="F")
            jacobians[len(nodes)] = slope
        return np.asarray(e, dtype=float) + J @ (estimate.atVector(key) - p_0)

    return gtsam.CustomFactor(noise, [*base.keys(), key], callback)
