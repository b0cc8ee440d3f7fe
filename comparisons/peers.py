"""Pose graphs through other optimisers: GTSAM with its native factors, and g2o.

Each peer gets the nodes, edges and initial values of a `Graph` and returns the state at the end. The between factors are
GTSAM's own (C++). Their residual is the logarithm of g2o's error, which is the same close to the optimum but not far from
it, so a peer may end at a slightly different point. The cost of every state is computed by `Graph.cost`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import gtsam
import numpy as np

from graphslam import Graph, OptionError
from graphslam.edges import RelativePointEdges, RelativePoseEdges
from graphslam.factors import RelativePointFactor
from graphslam.se2 import Array, rotation
from graphslam.solvers.gtsam_solver import from_values, to_values


@dataclass(frozen=True)
class PeerRun:
    """One optimisation: the state (n, 3) at the end, iterations, seconds, how it ended, chi2 before and after steps.

    ``native`` is False where factors are evaluated in Python.
    """

    state: Array
    iterations: int
    seconds: float
    converged: bool
    reason: str
    costs: tuple[float, ...] = ()
    native: bool = True


#: a peer prepares a graph, before the time is measured, and returns a function that optimises it from the start at each call
Peer = Callable[[Graph, float, int], Callable[[], PeerRun]]


def information_of_g2o(edges: RelativePoseEdges) -> Array:
    """The information (E, 3, 3) for the residual z^-1 (x_i^-1 x_j), which is our residual rotated by R(theta_z)'."""
    turn = np.broadcast_to(np.eye(3), (edges.count, 3, 3)).copy()
    turn[:, :2, :2] = rotation(-edges.measured[:, 2])
    return turn @ edges.information @ np.swapaxes(turn, 1, 2)


def native_gtsam_graph(graph: Graph) -> gtsam.NonlinearFactorGraph:
    """The graph in GTSAM's own factors: BetweenFactorPose2, a stiff prior per fixed node, our factor for points.

    Raises:
        OptionError: the graph has edges that are not those of a pose graph.
    """
    factors = gtsam.NonlinearFactorGraph()
    for family in graph.families:
        if isinstance(family, RelativePoseEdges) and not family.state_dependent_information:
            for i, j, z, omega in zip(
                family.first.tolist(), family.second.tolist(), family.measured, information_of_g2o(family)
            ):
                noise = gtsam.noiseModel.Gaussian.Information(omega)
                factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z), noise))
        elif isinstance(family, RelativePointEdges):
            for i, j, z, omega in zip(
                family.first.tolist(), family.second.tolist(), family.measured, family.information
            ):
                factors.add(RelativePointFactor(i, j, z, omega))
        else:
            raise OptionError(f"{type(family).__name__} do not belong to a pose graph")
    stiff = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    for node in graph.fixed.tolist():
        factors.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*graph.initial[node]), stiff))
    return factors


def gtsam_peer(damped: bool) -> Peer:
    """GTSAM's Levenberg-Marquardt (damped) or Gauss-Newton."""

    def prepare(graph: Graph, cost_tolerance: float, max_iterations: int) -> Callable[[], PeerRun]:
        factors, values = native_gtsam_graph(graph), to_values(graph, graph.initial)
        parameters: Any = gtsam.LevenbergMarquardtParams() if damped else gtsam.GaussNewtonParams()
        if damped:
            parameters.setVerbosityLM("SILENT")
        parameters.setMaxIterations(max_iterations)
        parameters.setRelativeErrorTol(cost_tolerance)
        parameters.setAbsoluteErrorTol(0.0)
        kind: Any = gtsam.LevenbergMarquardtOptimizer if damped else gtsam.GaussNewtonOptimizer
        # GTSAM has no factor of its own for a point in Cartesian coordinates
        native = not any(isinstance(family, RelativePointEdges) for family in graph.families)
        costs = _gtsam_costs(kind(factors, values, parameters), graph, cost_tolerance, max_iterations)

        def run() -> PeerRun:
            begin = time.perf_counter()
            optimizer = kind(factors, values, parameters)
            try:
                end = optimizer.optimize()
            except RuntimeError as error:
                seconds = time.perf_counter() - begin
                reason = f"gave up: {str(error).strip().splitlines()[0]}"
                return PeerRun(graph.initial * np.nan, 0, seconds, False, reason, native=native)
            seconds = time.perf_counter() - begin
            state, iterations = from_values(graph, end), int(optimizer.iterations())
            if iterations >= max_iterations:
                reason = f"max_iterations = {max_iterations} reached"
                return PeerRun(state, iterations, seconds, False, reason, costs, native)
            moved = float(np.abs(state - graph.initial).max())
            if moved < 1e-12:
                return PeerRun(state, iterations, seconds, False, "returned the initial values", native=native)
            reason = f"the cost changed by less than {cost_tolerance:g} of it"
            return PeerRun(state, iterations, seconds, True, reason, costs, native)

        return run

    return prepare


def _gtsam_costs(optimizer: Any, graph: Graph, cost_tolerance: float, max_iterations: int) -> tuple[float, ...]:
    """The chi2 before and after each iteration, from a run of its own, for the figure."""
    costs, before = [graph.cost(graph.initial)], optimizer.error()
    try:
        while len(costs) <= max_iterations:
            optimizer.iterate()
            costs.append(graph.cost(from_values(graph, optimizer.values())))
            if abs(before - optimizer.error()) <= cost_tolerance * before:
                break
            before = optimizer.error()
    except RuntimeError:
        return tuple(costs)
    return tuple(costs)


def g2o_peer(damped: bool) -> Peer:
    """g2o's Levenberg-Marquardt (damped) or Gauss-Newton, with its sparse Cholesky on Eigen, from the package g2opy.

    It has no stop rule here: it executes the smallest number of iterations that reaches its final cost.
    """

    def prepare(graph: Graph, cost_tolerance: float, max_iterations: int) -> Callable[[], PeerRun]:
        g2o = _import_g2o()
        costs, reaches = _smallest_number(g2o, graph, damped, cost_tolerance, max_iterations)

        def run() -> PeerRun:
            optimizer = _g2o_optimizer(g2o, graph, damped)
            begin = time.perf_counter()
            optimizer.initialize_optimization()
            optimizer.optimize(reaches)
            seconds = time.perf_counter() - begin
            state = _g2o_state(optimizer, graph)
            if not np.isfinite(costs[-1]):
                return PeerRun(state, reaches, seconds, False, "diverged", costs)
            if reaches >= max_iterations:
                return PeerRun(state, reaches, seconds, False, f"still moving after {max_iterations} iterations", costs)
            return PeerRun(state, reaches, seconds, True, f"{reaches} iterations reach its final cost", costs)

        return run

    return prepare


def _import_g2o() -> Any:
    try:
        return import_module("g2opy")
    except ImportError:
        raise OptionError("the backend g2o needs the package g2opy: pip install -e '.[peers]' in the clone") from None


def _smallest_number(
    g2o: Any, graph: Graph, damped: bool, cost_tolerance: float, max_iterations: int
) -> tuple[tuple[float, ...], int]:
    """The chi2 before and after each iteration, and the number of iterations after which the stop rule is met."""
    optimizer = _g2o_optimizer(g2o, graph, damped)
    optimizer.set_compute_batch_statistics(True)
    optimizer.initialize_optimization()
    optimizer.optimize(max_iterations)
    costs = [graph.cost(graph.initial), *(float(step.chi2) for step in optimizer.batch_statistics())]
    for count in range(1, len(costs)):
        if not np.isfinite(costs[count]):
            return tuple(costs[: count + 1]), count
        if abs(costs[count - 1] - costs[count]) <= cost_tolerance * costs[count - 1]:
            # the step before the one that changed nothing had already reached it
            return tuple(costs[:count]), max(count - 1, 1)
    return tuple(costs), max_iterations


def _g2o_optimizer(g2o: Any, graph: Graph, damped: bool) -> Any:
    optimizer = g2o.SparseOptimizer()
    solver = g2o.BlockSolverX(g2o.LinearSolverEigenX())
    algorithm = g2o.OptimizationAlgorithmLevenberg if damped else g2o.OptimizationAlgorithmGaussNewton
    optimizer.set_algorithm(algorithm(solver))
    optimizer.set_verbose(False)
    fixed = set(graph.fixed.tolist())
    poses = len(graph.steps)
    for node, (x, y, theta) in enumerate(graph.initial.tolist()):
        if node < poses:
            vertex = g2o.VertexSE2()
            vertex.set_estimate(g2o.SE2(x, y, theta))
        else:
            vertex = g2o.VertexPointXY()
            vertex.set_estimate(np.array([x, y]))
        vertex.set_id(node)
        vertex.set_fixed(node in fixed)
        optimizer.add_vertex(vertex)
    for family in graph.families:
        if isinstance(family, RelativePoseEdges):
            kind, measured, omegas = g2o.EdgeSE2, [g2o.SE2(*z) for z in family.measured], information_of_g2o(family)
        elif isinstance(family, RelativePointEdges):
            kind, measured, omegas = g2o.EdgeSE2PointXY, list(family.measured), family.information
        else:
            raise OptionError(f"{type(family).__name__} do not belong to a pose graph")
        for i, j, z, omega in zip(family.first.tolist(), family.second.tolist(), measured, omegas):
            edge = kind()
            edge.set_vertex(0, optimizer.vertex(i))
            edge.set_vertex(1, optimizer.vertex(j))
            edge.set_measurement(z)
            edge.set_information(omega)
            optimizer.add_edge(edge)
    return optimizer


def _g2o_state(optimizer: Any, graph: Graph) -> Array:
    state = np.zeros((graph.num_nodes, 3))
    poses = len(graph.steps)
    for node in range(graph.num_nodes):
        estimate = optimizer.vertex(node).estimate()
        state[node] = estimate.to_vector() if node < poses else [*estimate, 0.0]
    return state


PEERS: dict[str, Peer] = {
    "gtsam-lm": gtsam_peer(damped=True),
    "gtsam-gn": gtsam_peer(damped=False),
    "g2o-gn": g2o_peer(damped=False),
    "g2o-lm": g2o_peer(damped=True),
}
