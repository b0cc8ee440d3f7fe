"""The hand-written solver: choose a start, iterate by Gauss-Newton or Levenberg-Marquardt, return a `Solution`."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite
from numbers import Real
from typing import Any

from ..checks import check_choice, check_count, check_positive
from ..errors import OptionError, quoted
from ..graph import Graph, check_graph
from ..se2 import Array
from ..solution import Solution, make_solution
from .auto import best_end
from .gauss_newton import gauss_newton
from .initialize import INITIALIZE, starting_state
from .iteration import Iteration, Run
from .levenberg_marquardt import levenberg_marquardt
from .with_parameters import FIRST, best_of_starts, solve_jointly

METHODS: dict[str, Callable[[Any, Run], Any]] = {
    "gauss-newton": gauss_newton,
    "levenberg-marquardt": levenberg_marquardt,
}

__all__ = ["INITIALIZE", "METHODS", "Iteration", "solve", "starting_state"]


def solve(
    graph: Graph,
    *,
    method: str = "gauss-newton",
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
) -> Solution:
    """Minimise the cost J of a graph by the Omega/xi iteration.

    Args:
        graph: what to solve.
        method: "gauss-newton", which continues with damped steps where it makes no progress, or "levenberg-marquardt",
            which accepts only steps that lower J. With state-dependent information J is compared with the information held
            fixed, so that J itself may rise.
        tolerance: the iteration has converged when the Euclidean norm of the correction of all nodes is below this, and
            the correction is predicted to lower J by a negligible part only.
        max_iterations: the most steps of a run; with "auto", the lowest run that has not converged is continued once.
        initialize: "given", the graph's own initial values; "dead-reckoning" along the motion edges; "rotation-first",
            headings by linear least squares and then positions; "grow", solve the first poses, add ten more, solve again,
            and so on; or "auto". "auto" starts landmark nodes from virtual-motion edges, and other graphs rotation-first
            where the edges allow it. Where that does not converge, or ends above the cost of the given values, at an
            implausible J or after many steps, it tries other turns of the robot and further starts until ends agree, or
            an end is proven to be the global minimum. In graphs of at most 1,000 nodes it also tries a few more if no
            end is proven. It returns the converged solution with the lowest cost, which is never above that of the
            given values. Unless it is proven, a lower one may exist: of 100 logs with up to three times the book's
            noise, one ended 0.003 % too high (benchmarks/hard_logs.py).
        callback: called after each step with an `Iteration`; with "auto" only after the search, once for each step of the
            run that is returned.
        cost_tolerance: the iteration has also converged when a step changes J, or is predicted to change it, by less
            than this fraction; 0 disables this rule. (A step norm of 1e-9 corresponds to a relative change of J of about
            1e-16; 1e-6 is enough for a figure.)

    Whatever the tolerances, the iteration has also converged when the steps no longer become shorter and the predicted
    decrease of J is below its rounding error (1e-15 of J). `solvers.iteration` has all stop rules.

    Raises:
        GraphError: the edges do not determine the nodes.
        OptionError: an option has an impossible value.

    Not reaching the tolerance is no error: `Solution.converged` and `Solution.reason` report it.
    """
    check_graph(graph)
    check_options(method, tolerance, max_iterations, initialize, cost_tolerance)
    if callback is not None and not callable(callback):
        raise OptionError(f"callback must be a function of one Iteration, not {quoted(callback)}")
    begin, cost = time.perf_counter(), None

    def run_from(start: Array, search: str, descend: bool = False) -> Run:
        run = Run(start.copy(), tolerance, max_iterations, cost_tolerance, descend=descend)
        if callback is not None:
            run.callback = run.recorded.append if initialize == "auto" else callback
        METHODS[search](graph, run)
        return run

    if graph.parameters is not None:

        def solved(nodes: Graph) -> Array:
            return solve(nodes, method=method, tolerance=max(FIRST, tolerance), initialize=initialize).state

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
    )


def check_options(method: str, tolerance: float, max_iterations: int, initialize: str, cost_tolerance: float) -> None:
    """Raise `OptionError` if an option of `solve` has an impossible value."""
    check_choice("method", method, METHODS)
    check_choice("initialize", initialize, INITIALIZE)
    check_positive(tolerance=tolerance)
    if not isinstance(cost_tolerance, Real) or not 0 <= cost_tolerance < 1:
        raise OptionError(f"cost_tolerance must lie between 0 and 1, not {quoted(cost_tolerance)}")
    check_count(max_iterations=max_iterations)
