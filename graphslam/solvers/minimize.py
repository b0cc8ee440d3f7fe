"""Least squares from the best start: choose a start, iterate by Gauss-Newton or Levenberg-Marquardt, return a `Solution`."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite
from typing import Any

from ..graph import Graph
from ..se2 import Array
from ..solution import Solution, make_solution
from .auto import best_end
from .gauss_newton import gauss_newton
from .initialize import starting_state
from .iteration import Iteration, Run
from .levenberg_marquardt import levenberg_marquardt
from .mirror_images import image_notes, partial_edges
from .with_parameters import FIRST, best_of_starts, solve_jointly

METHODS: dict[str, Callable[[Any, Run], Any]] = {
    "gauss-newton": gauss_newton,
    "levenberg-marquardt": levenberg_marquardt,
}


def minimize(
    graph: Graph,
    *,
    method: str = "gauss-newton",
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
) -> Solution:
    """Minimise J by Gauss-Newton or Levenberg-Marquardt; arguments and errors as of `solve`, which checks them."""
    begin, cost = time.perf_counter(), None

    def run_from(start: Array, search: str, descend: bool = False) -> Run:
        run = Run(start.copy(), tolerance, max_iterations, cost_tolerance, descend=descend)
        if callback is not None:
            run.callback = run.recorded.append if initialize == "auto" else callback
        METHODS[search](graph, run)
        return run

    if graph.parameters is not None:

        def solved(nodes: Graph) -> Array:
            return minimize(nodes, method=method, tolerance=max(FIRST, tolerance), initialize=initialize).state

        def jointly(start: Graph, state: Array) -> tuple[Graph, Run]:
            run = Run(state, tolerance, max_iterations, cost_tolerance)
            run.callback = None if callback is None else run.recorded.append
            return solve_jointly(start, state, METHODS[method], run), run

        graph, run = best_of_starts(graph, solved, jointly)
        if callback is not None:
            for step in run.recorded:
                callback(step)
    elif initialize == "auto":
        end = best_end(graph, run_from, method)
        run, cost = end.run, end.cost if isfinite(end.cost) else None
        if callback is not None:
            for step in run.recorded:
                callback(step)
    else:
        run = run_from(starting_state(graph, initialize), method)
    notes = image_notes(graph, run.state) if partial_edges(graph) else ()
    return make_solution(
        graph,
        run.state,
        step_norms=run.step_norms,
        costs=run.costs,
        converged=run.converged,
        reason=run.reason,
        seconds=time.perf_counter() - begin,
        solver="graphslam",
        cost=cost,
        notes=notes,
    )
