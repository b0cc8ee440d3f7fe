"""`solve`: the hand-written solver."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Real

from ..checks import check_choice, check_count, check_positive
from ..errors import OptionError, quoted
from ..graph import Graph, check_graph
from ..solution import Solution
from .gnc import solve_gnc
from .initialize import INITIALIZE
from .iteration import Iteration
from .minimize import METHODS, minimize

GNC = "gnc"


def solve(
    graph: Graph,
    *,
    method: str = "gauss-newton",
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
    probability: float = 0.99,
) -> Solution:
    """Minimise the cost J of a graph by the Omega/xi iteration.

    Args:
        graph: what to solve.
        method: "gauss-newton", which continues with damped steps where it makes no progress, or "levenberg-marquardt",
            which accepts only steps that lower J. With state-dependent information J is compared with the information held
            fixed, so that J itself may rise. "gnc": graduated non-convexity, which determines with the trajectory which
            sightings are wrong, see `solvers.gnc`; it minimises their truncated squares, and `Solution.trust` has its
            result. It has converged only if every sighting is fully trusted or rejected.
        tolerance: the iteration has converged when the Euclidean norm of the correction of all nodes is below this, and
            the correction is predicted to lower J by a negligible part only.
        max_iterations: the most steps of a run, for "gnc" the most rounds; with "auto", the lowest run that has not
            converged is continued once.
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
        probability: for "gnc", the fraction of correct sightings that should be accepted: they are truncated at this
            quantile of the chi-square distribution with as many degrees of freedom as a sighting has numbers.

    Whatever the tolerances, the iteration has also converged when the steps no longer become shorter and the predicted
    decrease of J is below its rounding error (1e-15 of J). `solvers.iteration` has all stop rules.

    Raises:
        GraphError: the edges do not determine the nodes, or "gnc" finds no sightings.
        OptionError: an option has an impossible value.

    Not reaching the tolerance is no error: `Solution.converged` and `Solution.reason` report it.
    """
    check_graph(graph)
    check_options(method, tolerance, max_iterations, initialize, cost_tolerance, probability)
    if callback is not None and not callable(callback):
        raise OptionError(f"callback must be a function of one Iteration, not {quoted(callback)}")
    if method == GNC:
        if callback is not None:
            raise OptionError("the method gnc calls no callback: leave it out")
        return solve_gnc(graph, tolerance, max_iterations, initialize, probability)
    return minimize(
        graph,
        method=method,
        tolerance=tolerance,
        max_iterations=max_iterations,
        initialize=initialize,
        callback=callback,
        cost_tolerance=cost_tolerance,
    )


def check_options(
    method: str, tolerance: float, max_iterations: int, initialize: str, cost_tolerance: float, probability: float
) -> None:
    """Raise `OptionError` if an option of `solve` has an impossible value."""
    check_choice("method", method, (*METHODS, GNC))
    check_choice("initialize", initialize, INITIALIZE)
    check_positive(tolerance=tolerance)
    if not isinstance(cost_tolerance, Real) or not 0 <= cost_tolerance < 1:
        raise OptionError(f"cost_tolerance must lie between 0 and 1, not {quoted(cost_tolerance)}")
    check_count(max_iterations=max_iterations)
    if not isinstance(probability, Real) or not 0 < probability < 1:
        raise OptionError(f"probability must lie between 0 and 1, not {quoted(probability)}")
