"""A log through the online solver, one step after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..edges import CartesianObservationEdges, EdgeFamily, PartialEdges, PositionEdges, RelationEdges
from ..errors import GraphError, OptionError, quoted
from ..graph import Graph
from ..graph.defaults import suitable_for_isam2
from ..graph.integrity import unlocated
from ..graph.tracker import Tracker
from ..log import Log
from ..models import MotionModel
from ..solvers.corrected import motion_edges
from ..solvers.solution import Solution, make_solution
from .backend import ANYWHERE
from .solver import OnlineSolver, backend_options


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
    if isinstance(log, Log) and log.partial_sightings is not None and len(log.steps):
        log.replace(relations=None, positions=None).warn_of_unused("the solver step by step")
        log = log.replace(partial_sightings=None)
    if log.partial_sightings is not None if isinstance(log, Log) else any(map(_alone, log.families)):
        raise GraphError("step by step there is no start for ranges or bearings alone; use solve or solve_with_gtsam")
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
    graph = _plain_relations(graph)
    return graph, _by_own(graph, own)


def _alone(family: EdgeFamily) -> bool:
    return isinstance(family, PartialEdges)


def _by_own(graph: Graph, options: dict[str, Any]) -> Iterator[OnlineSolver]:
    graph.check_no_parameters("the solver step by step")
    if any(isinstance(family, PositionEdges) for family in graph.families):
        raise GraphError("the solver step by step takes no absolute positions; isam2 does: backend='isam2'")
    sighted = next((family for family in graph.families if isinstance(family, CartesianObservationEdges)), None)
    motions = motion_edges(graph)
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
    relations = _Arriving.of(graph)

    log, noise = graph.log, np.linalg.inv(motions.information)
    tracker: Tracker | None = None
    if known and log is not None and graph.sensor is not None:
        backend.tracker = tracker = unlocated(known, graph.sensor, graph.initial[0])

    def add(step: int, now: np.ndarray) -> None:
        motion = (step - 1, step, motions.measured[step - 1], motions.information[step - 1]) if step else None
        if tracker is not None:
            if motion:
                tracker.pose = backend.pose
                tracker.move(motion[2], noise[step - 1])
            if len(now) and log is not None:
                tracker.see(step, now, ids[now], log.sightings[graph.sighting_rows[now]])
        backend.update(motion, step, ids[now].tolist(), seen.measured[now], seen.information[now])
        for edges, row in relations.at(step):
            ends = int(edges.first[row]), int(edges.second[row])
            backend.relate((*ends, edges.measured[row], edges.information[row]))

    return _steps(solver, total, add, rows, bounds)


class _Arriving:
    """The relations and positions of a graph, each at the last step that it needs."""

    def __init__(self, families: Sequence[RelationEdges | PositionEdges]) -> None:
        self._rows: dict[int, list[tuple[RelationEdges | PositionEdges, int]]] = {}
        for family in families:
            last = family.nodes if isinstance(family, PositionEdges) else np.maximum(family.first, family.second)
            for row, step in enumerate(last.tolist()):
                self._rows.setdefault(step, []).append((family, row))

    @classmethod
    def of(cls, graph: Graph) -> _Arriving:
        """Those of a graph whose nodes are all steps."""
        return cls([family for family in graph.families if isinstance(family, RelationEdges | PositionEdges)])

    def at(self, step: int) -> list[tuple[Any, int]]:
        """The edges and the rows that arrive at a step."""
        return self._rows.get(step, [])


def _plain_relations(graph: Graph) -> Graph:
    """The graph without a robust kernel on its relations, which the solver step by step does not have, and a note."""
    robust = [f for f in graph.families if isinstance(f, RelationEdges) and f.kernel is not None]
    if not robust:
        return graph
    note = "step by step, relations count without the robust kernel"
    families = tuple(replace(f, kernel=None) if isinstance(f, RelationEdges) else f for f in graph.families)
    return replace(graph, families=families, notes=(*graph.notes, note))


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
    if log.positions is not None:
        # they alone hold the first pose, which Cholesky finds indeterminate
        own = {"start_covariance": np.diag(ANYWHERE), "factorization": "qr"} | own
    solver = OnlineSolver(
        graph.trajectory[0], backend="isam2", motion=motion, sensor=graph.sensor, kernel=options["kernel"], **own
    )
    backend: Any = solver._backend
    information = weight * np.linalg.inv(covariances)
    measured = _Arriving.of(graph)

    def add(step: int, now: np.ndarray) -> None:
        if step:
            backend.add_relation((step - 1, step, motions[step - 1], information[step - 1]))
        backend.add_sightings(step, log.landmarks[now].tolist(), sightings[now])
        for edges, row in measured.at(step):
            z, known = edges.measured[row], edges.information[row]
            if isinstance(edges, PositionEdges):
                backend.add_position(step, z, known, edges.levers[row], edges.kernel)
            else:
                ends = int(edges.first[row]), int(edges.second[row])
                backend.add_relation((*ends, z, known), edges.kernel)
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
