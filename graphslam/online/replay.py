"""A log through the online solver, one step after the other."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from inspect import signature
from typing import Any

import numpy as np

from ..edges import (
    ANCHOR_INFORMATION,
    AnchorEdges,
    BearingEdges,
    CartesianObservationEdges,
    PartialEdges,
    PositionEdges,
    RelationEdges,
    RelativePoseEdges,
)
from ..edges.robust import DoubtedEdges, Kernel
from ..edges.sightings import SightingEdges
from ..errors import GraphError, OptionError, quoted
from ..errors.checks import check_known
from ..graph import Graph
from ..graph.defaults import suitable_for_isam2
from ..graph.trilateration import places_of_rows
from ..log import Log, check_is_log
from ..maps.tracker import Tracker, unlocated
from ..models import SensorModel
from ..se2 import Array, difference
from ..solvers.initialize import image_notes, partial_edges
from ..solvers.iteration import Run
from ..solvers.joint import motion_edges
from ..solvers.minimize import AT_MEASURED, takes_estimated_ranges
from ..solvers.solution import Solution, doubted, make_solution
from .backend import FREE_START
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
    value that they had. Together with later ones they are no minimum of J, so that ``cost`` is NaN; `OnlineSolver.cost` is
    that of the poses that are not final.
    """
    graph, steps = _replayed(log, backend, options)
    begin = time.perf_counter()
    for solver in steps:
        if callback is not None:
            callback(solver)
    _place_the_rest(solver)
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
        if id in landmarks:
            state[row, : graph.landmark_dimension] = landmarks[id]
    state[graph.fixed] = graph.initial[graph.fixed]
    run = Run(state, 0.0, converged=solver.converged, reason=reason)
    notes, cost = image_notes(graph, state) if partial_edges(graph) else (), None
    if takes_estimated_ranges(graph, "auto"):
        notes = (*notes, AT_MEASURED)
    if solver.num_final:
        cost = np.nan
        notes = (
            *notes,
            "J is not given with a lag: poses that are final do not follow later measurements",
            "covariances are those without the lag, with which the errors of final poses are larger",
            *filter(None, [solver._backend.misfit]),
        )
    name = "online" if backend == "own" else backend
    return doubted(make_solution(graph, run, name, seconds, notes=notes, cost=cost))


def _place_the_rest(solver: OnlineSolver) -> None:
    """Let landmarks that still wait enter where the cost of their single numbers is lowest, and try other places."""
    for id, rows in list(solver._backend.waiting.items()):
        found = places_of_rows(id, rows, solver.sensor, solver.poses)
        if not found.determined:
            continue
        try:
            solver._backend.place(id, found.places[0])
        except GraphError as error:
            raise GraphError(f"landmark {id}, whose place was open until the last step: {error}") from error
    solver._backend.look_again()


def _replayed(log: Log | Graph, backend: str, options: dict[str, Any]) -> tuple[Graph, Iterator[OnlineSolver]]:
    """The graph of a log, and its steps."""
    if not isinstance(log, Graph):
        check_is_log(log)
    own = {name: options[name] for name in backend_options(backend) if name in options}
    of_graph = {name: value for name, value in options.items() if name not in own}
    known = [name for name in signature(Graph.from_log).parameters if name != "log"]
    check_known(f"the backend {backend} of solve_online and replay", of_graph, [*known, *backend_options(backend)])
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
    graph, kernel = _kernel_of(graph)
    return graph, _by_own(graph, kernel, own)


def _by_own(graph: Graph, kernel: Kernel | None, options: dict[str, Any]) -> Iterator[OnlineSolver]:
    graph.check_no_parameters("the solver step by step")
    sighted = next((family for family in graph.families if isinstance(family, CartesianObservationEdges)), None)
    motions, numbers = motion_edges(graph), _single_numbers(graph)
    if (
        motions is None
        or (sighted is not None and sighted.frame != "body")
        or (sighted is None and not numbers and not any(isinstance(f, PositionEdges) for f in graph.families))
    ):
        needed = "edges='landmark+motion' with residual='cartesian' and frame='body'"
        raise GraphError(f"the solver step by step needs a graph of {needed}")
    total, known, d = len(graph.steps), graph.map, graph.landmark_dimension
    relations, positions = _arriving(graph, motions)
    held, release = _first_held(graph), None
    if held and (known or positions) and "start_covariance" not in options:
        # a free start has so little information that it is lost in rounding errors of precise odometry, until a position or a
        # landmark of the map is seen
        held, release = {}, _anchored(graph)
    start = difference(graph.initial[0], np.zeros(3))  # without full turns, which look like degrees
    solver = OnlineSolver(start, sensor=graph.sensor, kernel=kernel or "none", **(held | options))
    backend: Any = solver._backend
    if known is not None:
        if any(len(known[j]) < d for j in graph.landmark_ids.tolist() if j in known):
            message = "the solver step by step needs the headings of all landmarks of the map where sightings have psi"
            raise GraphError(f"{message}; use dimensions=2")
        backend.begin_with(known.among(graph.landmark_ids.tolist()), d)
    if sighted is None:
        none = np.zeros(0, dtype=np.int64)
        sighted = CartesianObservationEdges(none, none, np.zeros((0, d)), graph.sensor or SensorModel())
    rows, bounds = _rows_of_steps(total, sighted.first)
    ids, seen = graph.landmark_ids[sighted.second - total][rows].tolist(), sighted.relative
    measured, information = seen.measured[rows], seen.information[rows]

    log, noise = graph.log, np.linalg.inv(motions.information)
    tracker: Tracker | None = None
    if known and log is not None and graph.sensor is not None:
        backend.tracker = tracker = unlocated(known, graph.sensor, graph.initial[0])

    def put(call: Callable[[], None], holds: bool) -> None:
        """Add something, which may hold the first pose."""
        nonlocal release
        if release is None or not holds:
            call()
        else:
            backend.release(np.zeros(3), call, release)
            release = None

    def add(step: int) -> None:
        now, arriving = slice(bounds[step], bounds[step + 1]), relations[step]
        for ends, _ in arriving:
            solver._check_pose(min(ends[:2]), "a relation from")
        if tracker is not None:
            if step:
                tracker.pose = backend.pose
                tracker.move(motions.measured[step - 1], noise[step - 1])
            if len(here := rows[now]) and log is not None:
                tracker.see(step, here, np.array(ids[now]), log.sightings[graph.sighting_rows[here]])
        whole = ids[now], measured[now], information[now]
        related, doubted = [relation for relation, _ in arriving], [kernel is not None for _, kernel in arriving]
        follow = partial(backend.update, related, step, *whole, numbers[step], doubted=doubted)
        put(follow, known is not None and any(id in known for id in [*whole[0], *(id for id, _ in numbers[step])]))
        for z, kernel in positions[step]:
            put(partial(backend.locate, step, *z, doubted=kernel is not None), True)

    return _steps(solver, total, add)


def _first_held(graph: Graph) -> dict[str, Array]:
    """The option that holds the first pose as the graph does, where that is not an anchor of all of it.

    With a map, its landmarks hold the first pose, and positions may hold all of it or its place alone (`defaults.anchors`).
    """
    anchor = np.diag(1 / np.array(FREE_START)) + _anchored(graph)
    return {"start_covariance": np.linalg.inv(anchor)} if np.any(anchor < ANCHOR_INFORMATION) else {}


def _anchored(graph: Graph) -> Array:
    """The information (3, 3) of the anchors of the first pose; none in a map."""
    held = np.zeros((3, 3))
    for family in graph.families if graph.map is None else ():
        if type(family) is AnchorEdges:
            held += family.information[family.nodes == 0].sum(axis=0)
    return held


def _arriving(graph: Graph, motions: RelativePoseEdges) -> tuple[dict[int, list[Any]], dict[int, list[Any]]]:
    """Motions and relations of a graph by the last step that they need, positions by their step, each with its kernel."""
    relations, positions = defaultdict[int, list[Any]](list), defaultdict[int, list[Any]](list)
    for step, motion in enumerate(zip(motions.measured, motions.information), start=1):
        relations[step].append(((step - 1, step, *motion), None))
    for family in graph.families:
        if isinstance(family, RelationEdges):
            for a, b, *z in zip(family.first.tolist(), family.second.tolist(), family.measured, family.information):
                relations[max(a, b)].append(((a, b, *z), family.kernel))
        elif isinstance(family, PositionEdges):
            for step, *z in zip(family.nodes.tolist(), family.measured, family.information, family.levers):
                positions[step].append((z, family.kernel))
    return relations, positions


def _single_numbers(graph: Graph) -> dict[int, list[tuple[int, Array]]]:
    """The ranges and bearings alone, {step: (landmark, (range, bearing)) of each}, one of the two NaN."""
    found: dict[int, list[tuple[int, Array]]] = defaultdict(list)
    for family in partial_edges(graph):
        ids, z = graph.landmark_ids[family.second - len(graph.steps)], np.full((family.count, 2), np.nan)
        z[:, int(isinstance(family, BearingEdges))] = family.measured[:, 0]
        for step, id, row in zip(family.first.tolist(), ids.tolist(), z):
            found[step].append((id, row))
    return found


def _kernel_of(graph: Graph) -> tuple[Graph, Kernel | None]:
    """The kernel of the sightings, or else of what may be wrong, and the graph without other kernels."""
    doubted = [f for f in graph.families if isinstance(f, DoubtedEdges)]
    seen = [f for f in doubted if isinstance(f, SightingEdges | PartialEdges)]
    kernel = next((_without_width(f) for f in seen or doubted if f.kernel is not None), None)
    robust = [f for f in doubted if f.kernel is not None]
    other = [f for f in robust if kernel is None or f.kernel != kernel.of_dimension(f.dimension)]
    if not other:
        return graph, kernel
    note = "step by step, relations and positions count without a robust kernel that is not that of the sightings"
    families = tuple(replace(f, kernel=None) if f in other else f for f in graph.families)
    return replace(graph, families=families, notes=(*graph.notes, note)), kernel


def _without_width(family: DoubtedEdges) -> Kernel | None:
    """The kernel of a family, without a width that is the default one."""
    kernel = family.kernel
    plain = None if kernel is None else type(kernel)()
    return plain if plain is None or plain.of_dimension(family.dimension) == kernel else kernel


def _by_isam2(log: Log | Graph, own: dict[str, Any], options: dict[str, Any]) -> tuple[Graph, Iterator[OnlineSolver]]:
    from .isam2 import EDGES

    if not isinstance(log, Log):
        raise OptionError("isam2 goes through a log, not through a graph")
    models = options.get("motion"), options.get("sensor")
    own["edges"], options["kernel"] = suitable_for_isam2(log, own.get("edges"), options.get("kernel"), *models)
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
    motions = motion_edges(graph)
    assert motions is not None
    sightings = log.sightings[:, :2] if options.get("dimensions") == 2 else log.sightings
    own, numbers = _first_held(graph) | own, _single_numbers(graph)
    solver = OnlineSolver(
        difference(graph.trajectory[0], np.zeros(3)), backend="isam2", motion=options.get("motion") or log.motion,
        sensor=graph.sensor, kernel=options["kernel"] or "none", **own,
    )  # fmt: skip
    backend: Any = solver._backend
    relations, positions = _arriving(graph, motions)
    rows, bounds = _rows_of_steps(log.num_poses, log.steps)

    def add(step: int) -> None:
        now = rows[bounds[step] : bounds[step + 1]]
        for relation, kernel in relations[step]:
            backend.add_relation(relation, kernel)
        backend.add_sightings(step, log.landmarks[now].tolist(), sightings[now])
        for landmark, z in numbers[step]:
            backend.add_sightings(step, [landmark], z[None])
        for z, kernel in positions[step]:
            backend.add_position(step, *z, kernel)
        backend.update()

    return graph, _steps(solver, log.num_poses, add)


def _rows_of_steps(total: int, seen_from: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """The rows of sightings from ``total`` steps in the order of these, and where those of each begin and the last end."""
    rows = np.argsort(seen_from, kind="stable")
    return rows, np.searchsorted(seen_from[rows], np.arange(total + 1)).tolist()


def _steps(solver: OnlineSolver, total: int, add: Callable[[int], None]) -> Iterator[OnlineSolver]:
    """Add the motion to each step and the sightings from there, and yield the solver.

    Raises:
        GraphError: a step cannot be added; with its number.
    """
    for step in range(total):
        try:
            add(step)
        except GraphError as error:
            raise GraphError(f"step {step} of {total - 1}: {error}") from error
        yield solver
