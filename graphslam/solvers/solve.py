"""`solve`: the hand-written solver; `solve_many`: many graphs, on several threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from inspect import signature
from itertools import count
from numbers import Real
from typing import Any

from ..engine import available_threads
from ..errors import GraphError, OptionError, checks, quoted
from ..graph import Graph, check_graph
from ..models import RANGE_NOISES
from . import INITIALIZE
from .gnc import solve_gnc
from .iteration import METHODS, Iteration
from .minimize import at_estimated_ranges, minimize, shortened_ranges, takes_estimated_ranges
from .solution import Solution, doubted

GNC = "gnc"
#: the default of the probability of gnc
PROBABILITY = 0.99


def solve(
    graph: Graph,
    *,
    method: str = "gauss-newton",
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
    probability: float = PROBABILITY,
    range_noise: str = "auto",
) -> Solution:
    """Minimise the cost J of a graph by the Omega/xi iteration.

    Args:
        graph: what to solve.
        method: "gauss-newton", which continues with Newton's or damped steps where it makes little progress, or
            "levenberg-marquardt", which accepts only steps that lower J. With state-dependent information J is compared with
            the information held fixed, so that J itself may rise. "gnc": graduated non-convexity, which determines with the
            trajectory which sightings are wrong, see `solvers.gnc`; it minimises their truncated squares, and
            `Solution.trust` has its result. It has converged only if every sighting is fully trusted or rejected.
        tolerance: the iteration has converged when the Euclidean norm of the correction of all nodes is below this, and
            the correction is predicted to lower J by a negligible part only.
        max_iterations: the most steps of a run, for "gnc" the most rounds of each sequence (where none has
            settled, the end from a robust kernel counts); with "auto", the lowest run that has not
            converged is continued once.
        initialize: "given", the graph's own initial values, or yours (`Graph.with_initial`); "dead-reckoning" along the
            motion edges; "rotation-first", headings by linear least squares and then positions; "grow", solve the first
            poses, add ten more, solve again, and so on; or "auto". "auto" starts landmark nodes from virtual-motion edges,
            and other graphs rotation-first where the edges allow it. Where that does not converge, or ends above the cost
            of the given values, at an implausible J or after many steps, it tries other turns of the robot and further
            starts until ends agree, or an end is proven to be the global minimum. If no end is proven then, it also starts
            from the lowest one with a random half of the sightings left out, several times, and then with all of them. In
            graphs of at most 1,000 nodes it also tries a few more starts if no end is proven. It returns the converged
            solution with the lowest cost, which is never above that of the given values. Unless it is proven, a lower one
            may exist: of 400 logs with up to three times the book's noise, three ended 0.2 to 0.8 % too high
            (benchmarks/hard_logs.py --seed 70 to 73).
        callback: called after each step with an `Iteration`; with "auto" only after the search, once for each step of the
            run that is returned. It counts the steps of all passes to the estimated ranges. Not for "gnc".
        cost_tolerance: the iteration has also converged when a step changes J, or is predicted to change it, by less
            than this fraction; 0 disables this rule. (A step norm of 1e-9 corresponds to a relative change of J of about
            1e-16; 1e-6 is enough for a figure.) Not for "gnc".
        probability: for "gnc", the fraction of correct sightings that should be accepted: they are truncated at this
            quantile of the chi-square distribution with as many degrees of freedom as a sighting has numbers.
        range_noise: "measured", Q and L at the measured sightings, as in the lectures; "estimated", at those that the
            solution predicts: it is solved again with `Graph.with_noise_at` until it no longer moves. Where the noise of the
            range grows with the range, measured ranges that are too short weigh too much, and the map becomes too small.
            Costs and iterations are those of the last pass. Graphs with parameters do this in any case. "auto" is
            "estimated" where the noise was estimated from the log itself, but not for "gnc", and "measured" else; a note says
            so where noise that is given grows with the range.

    Whatever the tolerances, the iteration has also converged when the steps no longer become shorter and the predicted
    decrease of J is below its rounding error (1e-15 of J, or what rounding of the coordinates makes of J: in UTM they are
    millions of metres). `solvers.iteration` has all stop rules.

    Raises:
        GraphError: the edges do not determine the nodes, or "gnc" finds no sightings.
        OptionError: an option has an impossible value.

    Not reaching the tolerance is no error: `Solution.converged` and `Solution.reason` report it.
    """
    check_graph(graph)
    check_options(method, tolerance, max_iterations, initialize, cost_tolerance, probability, range_noise)
    if callback is not None and not callable(callback):
        raise OptionError(f"callback must be a function of one Iteration, not {quoted(callback)}")
    if method == GNC and callback is not None:
        raise OptionError("the method gnc calls no callback: leave it out")
    # the steps of all passes to the estimated ranges have one count
    numbers = count(1)
    counted = None if callback is None else lambda step: callback(replace(step, number=next(numbers)))

    solved: Callable[[Graph, str, float], Solution]
    if method == GNC:
        solved = partial(solve_gnc, max_rounds=max_iterations, probability=probability)
    else:
        solved = partial(
            minimize, method=method, max_iterations=max_iterations, callback=counted, cost_tolerance=cost_tolerance
        )
    # the sightings that gnc trusts may change from pass to pass
    again = takes_estimated_ranges(graph, range_noise) and (method != GNC or range_noise == "estimated")
    run = partial(at_estimated_ranges, solved=solved, required=range_noise == "estimated") if again else solved
    solution = doubted(run(graph, initialize, tolerance), lambda wider: run(wider, "given", tolerance))
    given = range_noise == "auto" and method != GNC and graph.log is not None and not graph.log.simulated
    return solution if again or not given else replace(solution, notes=(*solution.notes, *shortened_ranges(graph)))


def check_options(
    method: str, tolerance: float, max_iterations: int, initialize: str, cost_tolerance: float, probability: float,
    range_noise: str,
) -> None:  # fmt: skip
    """Raise `OptionError` if an option of `solve` has an impossible value."""
    checks.check_choice("method", method, (*METHODS, GNC))
    if not isinstance(initialize, str):
        message = "initialize names a start; for your own values: solve(graph.with_initial(values), initialize='given')"
        raise OptionError(message)
    checks.check_choice("initialize", initialize, INITIALIZE)
    checks.check_choice("range_noise", range_noise, RANGE_NOISES)
    checks.check_positive(tolerance=tolerance)
    if not isinstance(cost_tolerance, Real) or not 0 <= cost_tolerance < 1:
        raise OptionError(f"cost_tolerance must lie between 0 and 1, not {quoted(cost_tolerance)}")
    if method == GNC and cost_tolerance > 0:
        raise OptionError("the method gnc ends by its own rules and uses no cost_tolerance: leave it out")
    checks.check_count(max_iterations=max_iterations)
    if not isinstance(probability, Real) or not 0 < probability < 1:
        raise OptionError(f"probability must lie between 0 and 1, not {quoted(probability)}")
    if method != GNC and probability != PROBABILITY:
        raise OptionError(f"the method {method} uses no probability: take method='gnc', or leave it out")


#: graphs that are read ahead for each thread, so that none waits
AHEAD = 2


def solve_many(graphs: Iterable[Graph], *, jobs: int | None = None, **options: Any) -> Iterator[Solution | GraphError]:
    """Solve many graphs; the results come in the order of the graphs, each as soon as those before it are done.

    Every number except ``seconds`` is the same, to the last bit, as from `solve`, whatever ``jobs`` is, also where one graph
    or its variants occur several times.

    Args:
        graphs: a list, or an iterator of any length: at most two graphs for each thread are held at a time. An error
            that the iterator raises is raised here after the results of the graphs before it.
        jobs: how many threads; 0 for that of the caller, which is the fastest for graphs of less than about 100 nodes; by
            default one for each core that this process may use.
        options: those of `solve`, the same for all graphs: method, tolerance, max_iterations, initialize,
            cost_tolerance, probability, range_noise. A ``callback`` would be called by several threads, and is refused.

    Returns:
        An iterator of results. In place of a graph that could not be solved stands the `GraphError` of `solve`. Not
        converging is no error.

    Raises:
        OptionError: an option does not exist or has an impossible value; or, in its turn, something is no `Graph`.
    """
    known = [name for name in signature(solve).parameters if name not in ("graph", "callback")]
    checks.check_known("solve_many", options, known, f"; it takes jobs and {', '.join(known)}")
    defaults = {name: signature(solve).parameters[name].default for name in known}
    check_options(**(defaults | options))
    if jobs is not None:
        checks.check_count(jobs=jobs)
    if not isinstance(graphs, Iterable):
        given = f"a {type(graphs).__name__}"
        raise OptionError(f"graphs must be a list or an iterator of graphs, not {given}; for one graph use solve")
    return _results(_checked(graphs), available_threads() if jobs is None else jobs, options)


def _checked(graphs: Iterable[Graph]) -> Iterator[Graph]:
    for number, graph in enumerate(graphs):
        check_graph(graph, f"graphs[{number}]")
        yield graph


def _results(graphs: Iterator[Graph], jobs: int, options: dict[str, Any]) -> Iterator[Solution | GraphError]:
    if jobs == 0:
        yield from (_solved(graph, options) for graph in graphs)
        return
    waiting: deque[Future[Solution | GraphError]] = deque()
    more, failure = True, None
    with ThreadPoolExecutor(jobs) as pool:
        while more or waiting:
            while more and len(waiting) < AHEAD * jobs:
                try:
                    waiting.append(pool.submit(_solved, next(graphs), options))
                except StopIteration:
                    more = False
                except Exception as error:
                    more, failure = False, error
            if waiting:
                yield waiting.popleft().result()
    if failure is not None:
        raise failure


def _solved(graph: Graph, options: dict[str, Any]) -> Solution | GraphError:
    try:
        return solve(graph, **options)
    except GraphError as error:
        return error
