"""The estimators that can be compared: each takes a `Log` and `RunOptions` and returns an `EstimatorResult`.

Add one by writing its function and naming it in `ESTIMATORS`; tables, figures and the command line follow.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, ParticleFilter
from graphslam import (
    Graph,
    GraphError,
    Log,
    OptionError,
    SensorModel,
    Solution,
    estimate_map,
    solve,
    solve_gnc,
    solve_online,
    solve_with_gtsam,
    textbook,
)
from graphslam.graph import EDGES
from graphslam.se2 import Array, wrap
from graphslam.solvers.solve import starting_state

from .estimator import Estimator, EstimatorResult, RunOptions

#: where the book's program stops, by the edges it has [norm of the whole correction]
TEXTBOOK_THRESHOLD = {"virtual": 0.01, "virtual+motion": 0.02}


def default_edges(log: Log) -> str:
    """The edges of the graph unless told otherwise: motion edges wherever the log has controls.

    Without psi a virtual-motion edge has no constant information, and landmarks as nodes serve better.
    """
    if log.controls is None:
        return "virtual"
    return "virtual+motion" if log.has_orientation or "landmark+motion" not in EDGES else "landmark+motion"


def make_graph(log: Log, options: RunOptions) -> Graph:
    """The one graph that ``graph`` and ``gtsam`` solve.

    Raises:
        GraphError: the log does not determine it.
    """
    return Graph.from_log(
        log,
        motion=options.motion,
        sensor=options.sensor,
        edges=options.edges or default_edges(log),
        frame=options.frame,
        weight=options.weight,
        motion_weight=options.motion_weight,
        kernel=options.kernel,
    )


def dead_reckoning(log: Log, options: RunOptions) -> EstimatorResult:
    """x_t = f(x_{t-1}, u_t) without noise; the log's own initial poses where it has no controls."""
    notes: tuple[str, ...] = ()
    begin = time.perf_counter()
    if log.controls is None or log.dt is None:
        poses, notes = log.initial_poses, ("the log has no controls: these are its own initial poses",)
    else:
        poses = log.dead_reckoning(options.motion)
    seconds = time.perf_counter() - begin
    return _with_map("dead-reckoning", log, options.sensor, poses, seconds=seconds, notes=notes)


def textbook_estimator(log: Log, options: RunOptions) -> EstimatorResult:
    """The lectures' program as it stands, with the book's threshold; J is the world-frame one that it works on."""
    edges = options.edges
    if edges not in TEXTBOOK_THRESHOLD:
        # unless told otherwise, or told of edges that the lectures have not
        edges = "virtual" if log.controls is None else "virtual+motion"
    threshold = TEXTBOOK_THRESHOLD[edges]
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    begin = time.perf_counter()
    result = textbook.solve(log, edges=edges, threshold=threshold, **models)
    seconds = time.perf_counter() - begin
    last = f"{result.step_norms[-1]:.1e}" if len(result.step_norms) else "none"
    return _with_map(
        "textbook",
        log,
        options.sensor,
        result.poses,
        seconds=seconds,
        estimated=np.asarray(result.estimated, dtype=bool),
        converged=result.converged,
        iterations=result.iterations,
        step_norms=np.asarray(result.step_norms, dtype=float),
        cost=_world_cost(log, edges, result.poses, models),
        costs=np.asarray(result.costs, dtype=float),
        options={"edges": edges, "frame": "world", "weight": "pairs", "motion_weight": 1.0, "threshold": threshold},
        reason=f"last step norm {last}, the book's threshold is {threshold:g}",
    )


def graph_estimator(log: Log, options: RunOptions) -> EstimatorResult:
    """The hand-written solver on the log's graph."""
    graph = make_graph(log, options)
    # once ahead of the clock: whatever compiles at its first use compiles now
    solve(graph, max_iterations=1, initialize=options.initialize)
    if options.robust == "gnc":
        return _of_solution("graph", log, options, solve_gnc(graph, initialize=options.initialize))
    return _of_solution("graph", log, options, solve(graph, initialize=options.initialize))


def gtsam_estimator(log: Log, options: RunOptions) -> EstimatorResult:
    """GTSAM's Levenberg-Marquardt on the very same graph, made of our factor types, from the same start."""
    _no_gnc(options)
    graph = make_graph(log, options)
    graph = graph.with_initial(starting_state(graph, options.initialize))
    return _of_solution("gtsam", log, options, solve_with_gtsam(graph))


def isam2(log: Log, options: RunOptions) -> EstimatorResult:
    """ISAM2 on our factor types, step by step through the log, as a robot that drives could."""
    _no_gnc(options)
    edges = options.edges or default_edges(log)
    if options.frame != "body":
        raise GraphError("isam2 cannot re-evaluate the information of the world frame; use --frame body")
    solution = solve_online(
        log, motion=options.motion, sensor=options.sensor, edges=edges, weight=options.weight,
        motion_weight=options.motion_weight, kernel=options.kernel,
    )  # fmt: skip
    result = _of_solution("isam2", log, options, solution)
    return replace(result, converged=None, reason=solution.reason)


def _no_gnc(options: RunOptions) -> None:
    if options.robust == "gnc":
        raise GraphError("gtsam's graduated non-convexity cannot clone Python factors; the estimator graph has its own")


def mcl(log: Log, options: RunOptions) -> EstimatorResult:
    """Monte Carlo localisation on the true map: what a robot could know that need not map. It estimates no map.

    Raises:
        OptionError: the log does not have the map.
    """
    if log.true_landmarks is None:
        raise OptionError(
            f"mcl localises on the true map of the landmarks, which {log.name} does not have: leave mcl out of the "
            "estimators, or let fastslam1 or fastslam2 make a map"
        )
    return _particle_filter("mcl", MonteCarloLocalization, log, options)


def fastslam1(log: Log, options: RunOptions) -> EstimatorResult:
    """FastSLAM 1.0; trajectory and map of the best particle."""
    return _particle_filter("fastslam1", FastSLAM1, log, options, association=options.association)


def fastslam2(log: Log, options: RunOptions) -> EstimatorResult:
    """FastSLAM 2.0, whose proposal is corrected by the sightings; trajectory and map of the best particle."""
    return _particle_filter("fastslam2", FastSLAM2, log, options, association=options.association)


def pair_count(log: Log) -> int:
    """The number of virtual-motion edges of a log: over its landmarks, the sum of K (K-1) / 2."""
    _, sightings = np.unique(log.landmarks, return_counts=True)
    return int(np.sum(sightings * (sightings - 1) // 2))


def _textbook_seconds(log: Log) -> float:
    # 50 us of plain Python per edge; the dense solve at some 10 GFLOP/s
    return 5e-5 * (pair_count(log) + log.num_poses) + 2 / 3 * (3.0 * log.num_poses) ** 3 / 1e10


def _gtsam_seconds(log: Log) -> float:
    # 15 us to linearise a Python factor, and its cost; a pair in a landmark's factor 0.3 us; a clique K³
    _, seen = np.unique(log.landmarks, return_counts=True)
    return 3e-5 * log.num_poses + 3e-7 * pair_count(log) + 3e-9 * float(np.sum((3.0 * seen) ** 3))


def _isam2_seconds(log: Log) -> float:
    # some ten milliseconds a step, and the landmarks' factors made anew as they grow; "per iteration" is per step here
    return 1e-3 * log.num_poses + _gtsam_seconds(log)


_OF_GRAPHS = ("edges", "frame", "weight", "motion_weight", "robust", "initialize")
_OF_FILTERS = ("particles", "resampling")

#: the estimators by name, in the order in which they run and are shown
ESTIMATORS: dict[str, Estimator] = {
    "dead-reckoning": Estimator(dead_reckoning, uses=()),
    "textbook": Estimator(textbook_estimator, _textbook_seconds, uses=("edges",)),
    "graph": Estimator(graph_estimator, uses=_OF_GRAPHS),
    "gtsam": Estimator(gtsam_estimator, _gtsam_seconds, uses=_OF_GRAPHS),
    "isam2": Estimator(isam2, _isam2_seconds, uses=tuple(name for name in _OF_GRAPHS if name != "initialize")),
    "mcl": Estimator(mcl, uses=_OF_FILTERS),
    "fastslam1": Estimator(fastslam1, uses=(*_OF_FILTERS, "association")),
    "fastslam2": Estimator(fastslam2, uses=(*_OF_FILTERS, "association")),
}


def _graph_options(log: Log, options: RunOptions) -> dict[str, Any]:
    return {
        "edges": options.edges or default_edges(log),
        "frame": options.frame,
        "weight": options.weight,
        "robust": options.robust,
        "motion_weight": options.motion_weight,
        "initialize": options.initialize,
    }


def _of_solution(name: str, log: Log, options: RunOptions, solution: Solution) -> EstimatorResult:
    return EstimatorResult(
        name=name,
        poses=solution.poses,
        estimated=np.asarray(solution.estimated, dtype=bool),
        seconds=solution.seconds,
        converged=solution.converged,
        iterations=solution.iterations,
        step_norms=np.asarray(solution.step_norms, dtype=float),
        cost=solution.cost,
        costs=np.asarray(solution.costs, dtype=float),
        landmarks=solution.landmarks,
        landmark_covariances=solution.landmark_covariances,
        options=_graph_options(log, options),
        reason=solution.reason,
        notes=tuple(solution.notes),
    )


def _with_map(
    name: str, log: Log, sensor: SensorModel | None, poses: Array, *, estimated: np.ndarray | None = None, **rest: Any
) -> EstimatorResult:
    """A result whose map is put where the poses see it, the same way for every estimator that has none of its own."""
    poses = np.array(poses, dtype=float)
    poses[:, 2] = wrap(poses[:, 2])
    estimated = np.ones(len(poses), dtype=bool) if estimated is None else estimated
    landmarks = estimate_map(log, poses, sensor=sensor)
    return EstimatorResult(
        name=name,
        poses=poses,
        estimated=estimated,
        landmarks=dict(landmarks),
        landmark_covariances=landmarks.covariances,
        **rest,
    )


def _world_cost(log: Log, edges: str, poses: Array, models: Mapping[str, Any]) -> float:
    """J of the lectures' graph at a trajectory, by the graph's own evaluator."""
    graph = Graph.from_log(log, edges=edges, frame="world", **models)
    return float(graph.cost(np.asarray(poses, dtype=float)[graph.steps]))


def _particle_filter(
    name: str, kind: type[ParticleFilter], log: Log, options: RunOptions, **more: Any
) -> EstimatorResult:
    told: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor, "resampling": options.resampling}
    told |= more
    association = more.get("association")
    if (head := _head(log)) is not None:
        # the kernels compile at their first call; a few steps with two particles keep that out of the time
        kind(head, particles=2, seed=0, **told).run()
    begin = time.perf_counter()
    result = kind(log, particles=options.particles, seed=options.seed, **told).run()
    seconds = time.perf_counter() - begin
    # a filter that ignores the ids numbers its landmarks itself
    named = association != "maximum-likelihood"
    return EstimatorResult(
        name=name,
        poses=result.poses,
        estimated=np.ones(log.num_poses, dtype=bool),
        seconds=seconds,
        # on a known map there is none to estimate
        landmarks=dict(result.landmarks) if association is not None else {},
        landmark_covariances=dict(result.landmark_covariances) if association is not None else {},
        named=named,
        notes=() if named else ("landmarks are numbered by discovery, and matched to true ones by their places",),
        options={"particles": options.particles, "seed": options.seed, "resampling": options.resampling} | more,
        reason=f"went over the log once with {options.particles} particles",
    )


def _head(log: Log) -> Log | None:
    """The log up to the first landmark seen again, or None where none is."""
    first_of = np.unique(log.landmarks, return_index=True, return_inverse=True)
    again = np.flatnonzero(log.steps > log.steps[first_of[1][first_of[2]]]) if len(log.steps) else np.empty(0, int)
    if len(again) == 0 or log.controls is None:
        return None
    return log.at_steps(np.arange(int(log.steps[again[0]]) + 1)).replace(true_poses=None)
