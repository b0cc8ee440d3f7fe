"""A log through the online solver, one step after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..defaults import suitable_for_isam2
from ..edges import CartesianObservationEdges, RelativePoseEdges
from ..errors import GraphError, OptionError, quoted
from ..graph import Graph
from ..log import Log
from ..models import MotionModel
from ..solution import Solution, make_solution
from .solver import OnlineSolver, backend_options

#: the variances [m², m², rad²] of a first pose that only a map holds
ANYWHERE = (1e4, 1e4, 1e2)


def replay(log: Log | Graph, *, backend: str = "own", **options: Any) -> Iterator[OnlineSolver]:
    """Go through a log as a robot that drives, and yield the same `OnlineSolver` after every step.

    Args:
        log: with controls. For the backend "own" also a graph of a log with landmark nodes, motion edges and Cartesian
            residuals in the body frame.
        backend: see `OnlineSolver`.
        options: those of the backend, and those of `Graph.from_log`. Edges and kernel that are not named are those of
            `Graph.from_log`, for ISAM2 those of `suitable_for_isam2`.

    Raises:
        GraphError: the log lacks what the graph needs, or the backend cannot do what an option asks for.
        OptionError: an option has an impossible value.
    """
    return _replayed(log, backend, options)[1]


def solve_online(
    log: Log | Graph,
    *,
    backend: str = "own",
    relinearize: bool = False,
    callback: Callable[[OnlineSolver], None] | None = None,
    **options: Any,
) -> Solution:
    """Go through a log step by step, and return the estimate after the last one.

    Args:
        log, backend, options: as for `replay`.
        relinearize: linearise everything at the end, which gives the batch solution with ISAM2, too.
        callback: called with the `OnlineSolver` after each step.

    Raises:
        GraphError, OptionError: as `replay`.

    The solution has converged if the last step has; see `OnlineSolver.converged`. With a lag, final poses have the last
    value that they had.
    """
    graph, steps = _replayed(log, backend, options)
    begin = time.perf_counter()
    for solver in steps:
        if callback is not None:
            callback(solver)
    reason = "went through the log once, step by step"
    if relinearize:
        solver.relinearize()
        reason += ", and linearised everything again at the end"
    if solver.num_final:
        reason += f"; the first {solver.num_final} poses are older than the lag, and final"
    if not solver.converged:
        reason += ", and did not converge at the end"
    seconds, state, landmarks = time.perf_counter() - begin, graph.initial.copy(), solver.landmarks
    state[: len(graph.steps)] = solver.poses
    for row, id in enumerate(graph.landmark_ids.tolist(), start=len(graph.steps)):
        state[row, : graph.landmark_dimension] = landmarks[id]
    state[graph.fixed] = graph.initial[graph.fixed]
    return make_solution(
        graph, state, step_norms=[], costs=[], converged=solver.converged, reason=reason, seconds=seconds,
        solver="online" if backend == "own" else backend,
    )  # fmt: skip


def _replayed(log: Log | Graph, backend: str, options: dict[str, Any]) -> tuple[Graph, Iterator[OnlineSolver]]:
    """The graph of a log, and its steps."""
    own = {name: options[name] for name in backend_options(backend) if name in options}
    of_graph = {name: value for name, value in options.items() if name not in own}
    if backend == "isam2":
        return _by_isam2(log, own, of_graph)
    graph = log
    if isinstance(log, Log):
        if "map" in own:
            of_graph["map"] = own.pop("map")
        graph = Graph.from_log(log, **({"edges": "landmark+motion"} | of_graph))
    elif of_graph:
        raise OptionError(f"a graph has its own {', '.join(of_graph)}: give these to Graph.from_log")
    assert isinstance(graph, Graph)
    return graph, _by_own(graph, own)


def _by_own(graph: Graph, options: dict[str, Any]) -> Iterator[OnlineSolver]:
    graph.check_no_parameters("the solver step by step")
    sighted = next((family for family in graph.families if isinstance(family, CartesianObservationEdges)), None)
    motions = next((family for family in graph.families if isinstance(family, RelativePoseEdges)), None)
    if sighted is None or motions is None or sighted.frame != "body":
        raise GraphError(
            "the solver step by step needs a graph of edges='landmark+motion' with residual='cartesian' and frame='body'"
        )
    total, known, d = len(graph.steps), graph.map, graph.landmark_dimension
    # with a map, its landmarks hold the first pose
    held = {} if known is None else {"start_covariance": np.diag(ANYWHERE)}
    solver = OnlineSolver(graph.initial[0], sensor=graph.sensor, kernel=sighted.kernel, **(held | options))
    backend: Any = solver._backend
    if known is not None:
        if any(len(known[j]) < d for j in graph.landmark_ids.tolist() if j in known):
            raise GraphError(
                "the solver step by step needs the headings of all landmarks of the map where sightings have psi; use "
                "dimensions=2"
            )
        backend.begin_with(known.among(graph.landmark_ids.tolist()), d)
    rows = np.argsort(sighted.first, kind="stable")
    bounds = np.searchsorted(sighted.first[rows], np.arange(total + 1))
    ids = graph.landmark_ids[sighted.second - total]
    seen = sighted.relative
    return _steps(
        solver, total,
        lambda step, now: backend.update(
            (step - 1, step, motions.measured[step - 1], motions.information[step - 1]) if step else None,
            step, ids[now].tolist(), seen.measured[now], seen.information[now],
        ),
        rows, bounds,
    )  # fmt: skip


def _by_isam2(log: Log | Graph, own: dict[str, Any], options: dict[str, Any]) -> tuple[Graph, Iterator[OnlineSolver]]:
    from .isam2 import EDGES

    if not isinstance(log, Log):
        raise OptionError("isam2 goes through a log, not through a graph")
    own["edges"], options["kernel"] = suitable_for_isam2(log, own.get("edges"), options.get("kernel"))
    if own["edges"] not in EDGES:
        raise GraphError(f"isam2 needs motion edges: edges must be {' or '.join(EDGES)}, not {quoted(own['edges'])}")
    if options.get("frame", "body") == "world":
        raise GraphError("isam2 cannot re-evaluate the information of the world frame; use frame='body'")
    if options.get("map") is not None:
        raise GraphError("isam2 does not use a map; the backend 'own' does")
    shared = {name: own[name] for name in ("edges", "weight", "residual") if name in own}
    graph = Graph.from_log(log, **shared, **options)
    graph.check_no_parameters("ISAM2")
    assert graph.log is not None
    # with the noise, the ids and without the biases that were estimated, where the noise of the robot was not known
    log = graph.log
    motion, weight = options.get("motion") or log.motion or MotionModel(), options.get("motion_weight", 1.0)
    motions, covariances = log.motions(motion)
    sightings = log.sightings[:, :2] if options.get("dimensions") == 2 else log.sightings
    solver = OnlineSolver(
        log.initial_poses[0], backend="isam2", motion=motion, sensor=graph.sensor, kernel=options["kernel"], **own
    )
    backend: Any = solver._backend
    information = weight * np.linalg.inv(covariances)

    def add(step: int, now: np.ndarray) -> None:
        if step:
            backend.add_relation((step - 1, step, motions[step - 1], information[step - 1]))
        backend.add_sightings(step, log.landmarks[now].tolist(), sightings[now])
        backend.update()

    order = np.argsort(log.steps, kind="stable")
    return graph, _steps(
        solver, log.num_poses, add, order, np.searchsorted(log.steps[order], np.arange(log.num_poses + 1))
    )


def _steps(
    solver: OnlineSolver, total: int, add: Callable[[int, np.ndarray], None], rows: np.ndarray, bounds: np.ndarray
) -> Iterator[OnlineSolver]:
    """Add the motion to each step and its sightings, and yield the solver."""
    for step in range(total):
        add(step, rows[bounds[step] : bounds[step + 1]])
        yield solver
