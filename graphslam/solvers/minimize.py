"""Least squares from the best start: choose a start, iterate by Gauss-Newton or Levenberg-Marquardt, return a `Solution`.

A graph with parameters of vehicle and sensor is solved for its nodes first, at the given parameters, then for both together.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import isfinite

import numpy as np

from ..engine import engine
from ..errors import GraphError, SlamError
from ..graph import Graph
from ..se2 import Array, difference, wrap
from .auto import best_end
from .initialize import image_notes, starting_state
from .iteration import METHODS, Iteration, Run
from .joint import JointGraph, check_observable, corrected, finished, negative_information
from .solution import Solution, make_solution

#: the nodes are first solved to this tolerance, at the given parameters
FIRST = 1e-4
#: the parameters that are angles, and what is added to them for other starts: a sensor may be mounted backwards or sideways
ANGLES, TURNS = ("bearing_bias",), (np.pi, np.pi / 2, -np.pi / 2)
#: the further ones where J is beyond so many times the expected one with all of these
OBLIQUE, DOUBTFUL = (np.pi / 4, -np.pi / 4, 3 * np.pi / 4, -3 * np.pi / 4), 3.0


def best_of_starts(
    graph: Graph, solved: Callable[[Graph], Array], search: Callable[[JointGraph, Run], None], begun: Callable[[], Run]
) -> tuple[Graph, Run]:
    """The graph at the estimated parameters and its run, the lowest one among some starts of the parameters.

    The cost has other minima about a part of a turn of an angle away. So the nodes are also solved at other values of the
    angles, and where their J is below that at the given values, nodes and parameters are solved from there, too.

    Args:
        graph: with parameters.
        solved: the nodes (n, 3) of a graph without parameters, solved roughly.
        search: an iteration of `graphslam.solvers`, for nodes and parameters together.
        begun: gives a run with its rules.

    Raises:
        GraphError: the log does not determine the nodes or the parameters.
    """
    names, values = graph.estimated.names, graph.estimated.values
    first = solved(replace(graph, parameters=None))
    starts = [(graph, first)]
    lowest = graph.cost(first)
    for name, turn in product(ANGLES, (*TURNS, *OBLIQUE)):
        if name not in names or (turn in OBLIQUE and lowest <= DOUBTFUL * graph.expected_cost):
            continue
        changed = values.copy()
        changed[names.index(name)] = wrap(changed[names.index(name)] + turn)
        there = corrected(graph, changed, first)
        try:
            nodes = solved(replace(there, parameters=None))
        except GraphError:
            continue
        if (cost := there.cost(nodes)) < lowest:
            starts[1:], lowest = [(there, nodes)], cost
    ends: list[tuple[Graph, Run]] = []
    error: SlamError | None = None
    for start, nodes in starts:
        try:
            run = begun()
            ends.append((solve_jointly(start, nodes, search, run), run))
        except SlamError as failure:
            # a wrong start may take a range below zero, or leave a parameter undetermined
            error = error or failure
    if not ends:
        assert error is not None
        raise error
    return min(ends, key=lambda end: (not end[1].converged, end[0].cost(end[1].state)))


def solve_jointly(graph: Graph, start: Array, search: Callable[[JointGraph, Run], None], run: Run) -> Graph:
    """Nodes and parameters together, from nodes (n, 3); the end of ``run`` becomes that of the nodes.

    Args:
        graph: with parameters.
        start: (n, 3) the nodes solved at the given parameters.
        search: an iteration of `graphslam.solvers`.
        run: its rules; the state is replaced.

    Returns:
        The graph at the estimated parameters.

    Raises:
        GraphError: the log does not determine the parameters.
        LogError: an estimated parameter takes a range below zero.
    """
    joint = JointGraph(graph.with_initial(start))
    check_observable(joint, start, joint.parameters.values)
    run.state = joint.joined(start, joint.parameters.values)
    if (report := run.callback) is not None:
        callback = report
        run.callback = lambda step: callback(replace(step, state=joint.parted(step.state)[0]))
    search(joint, run)
    nodes, values = joint.parted(run.state)
    if np.isfinite(run.state).all():
        check_observable(joint, nodes, values)
    run.state = nodes.copy()
    return finished(graph, values, nodes)


#: the most passes to the noise at the sightings that the solution predicts, the move [m, rad] below which these are found,
#: and the part of the move before it to which a pass is exact
PASSES, SAME, PART = 100, 1e-7, 3e-3


#: what a solver says that cannot do this, where `solve` does
AT_MEASURED = "the noise of ranges is taken at the measured ones, and by solve at the estimated ones, so that J differs"


def takes_estimated_ranges(graph: Graph, range_noise: str) -> bool:
    """Whether a graph is solved with its noise at estimated ranges: "auto" does so where the noise was estimated from it.

    Graphs with parameters do it in any case, and by themselves.
    """
    log, sensor = graph.log, graph.sensor
    if range_noise != "auto" or graph.parameters is not None or log is None or sensor is None:
        return range_noise == "estimated" and graph.parameters is None
    grows = sensor.range_rate > 0 and len(log.steps) > 0
    return grows and log.uncertain is not None and log.partial_sightings is None


#: from this part of the range on, its noise at the measured range is said: it shortens lengths by 0.2 % or more, and with
#: noise of 5 % the ATE is 1.28 times what it is at the estimated ranges
WIDE = 0.03


def shortened_ranges(graph: Graph) -> tuple[str, ...]:
    """What noise that grows with the range does where it is taken at the measured ranges; nothing where it is small."""
    rate = 0.0 if graph.sensor is None or graph.log is None else graph.sensor.range_rate
    if rate < WIDE or graph.parameters is not None or not len(graph.sighting_rows):
        return ()
    return (
        f"the noise of a range, {rate:.0%} of it, is taken at the measured range, as in the lectures, which alone makes "
        f"lengths up to {2 * rate**2:.1%} too short; range_noise='estimated' does not",
    )


def at_estimated_ranges(
    graph: Graph, initialize: str, tolerance: float, solved: Callable[[Graph, str, float], Solution], *, required: bool
) -> Solution:
    """The solution of a graph with the noise of its sensor at the sightings that this solution predicts.

    It is the fixed point of the passes state -> solution with the noise at that state, mixed by Anderson acceleration.

    Args:
        graph: with the noise at the measured sightings, from which the first solution comes.
        initialize: of the first solution; the others go on from it.
        tolerance: of the last solution.
        solved: the solution of a graph from such a start to a tolerance.
        required: whether a solution that the noise still moves is returned as not converged; if not, the first one is
            returned with a note.
    """
    solution = first = solved(graph, initialize, tolerance)
    # the first pass moves nodes by centimetres
    seconds, moved, at, mixing = solution.seconds, 0.01, solution.state, engine.AndersonAcceleration()
    for _ in range(PASSES):
        asked = max(tolerance, PART * moved)
        there = graph.with_families(graph.with_noise_at(at).families, initial=solution.state)
        solution = solved(there, "given", asked)
        change = difference(solution.state, at)
        seconds, moved = seconds + solution.seconds, float(np.abs(change).max())
        if (moved < SAME and asked == tolerance) or not solution.converged:
            break
        at = mixing.next(at, change)
    if moved < SAME or not solution.converged:
        return replace(solution, seconds=seconds)
    reason = f"the noise of the ranges still moved the solution by {moved:.1g} after {PASSES} passes"
    if required:
        return replace(solution, seconds=seconds, converged=False, reason=reason)
    note = f"{reason}, so that it is taken at the measured ranges"
    return replace(first, seconds=seconds, notes=(*first.notes, note))


def minimize(
    graph: Graph,
    initialize: str,
    tolerance: float,
    *,
    method: str = "gauss-newton",
    max_iterations: int = 100,
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
) -> Solution:
    """Minimise J by Gauss-Newton or Levenberg-Marquardt; arguments and errors as of `solve`, which checks them."""
    begin, cost, certificate = time.perf_counter(), None, None

    def run_from(start: Array, search: str, descend: bool = False) -> Run:
        run = Run(start.copy(), tolerance, max_iterations, cost_tolerance, descend=descend)
        if callback is not None:
            run.callback = run.recorded.append if initialize == "auto" else callback
        METHODS[search](graph, run)
        return run

    if graph.parameters is not None:

        def solved(nodes: Graph) -> Array:
            return minimize(nodes, initialize, max(FIRST, tolerance), method=method).state

        def begun() -> Run:
            run = Run(graph.initial, tolerance, max_iterations, cost_tolerance)
            run.callback = None if callback is None else run.recorded.append
            return run

        graph, run = best_of_starts(graph, solved, METHODS[method], begun)
    elif initialize == "auto":
        end = best_end(graph, run_from, method)
        run, cost = end.run, end.cost if isfinite(end.cost) else None
        certificate = end.known_certificate
    else:
        run = run_from(starting_state(graph, initialize), method)
    if callback is not None:
        for step in run.recorded:
            callback(step)
    cost = graph.cost(run.state) if cost is None else cost
    if cost < 0 and (text := negative_information(graph)) is not None:
        raise GraphError(text)
    notes = image_notes(graph, run.state)
    seconds = time.perf_counter() - begin
    return make_solution(graph, run, "graphslam", seconds, cost=cost, notes=notes, certificate=certificate)
