"""`solve`: the hand-written solver.

`solve_many`: solve one graph after another, on several processes, with what graphs of the same structure share.
"""

from __future__ import annotations

import pickle
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import cache
from inspect import signature
from numbers import Real
from typing import Any

from ..errors import GraphError, OptionError, SlamError, quoted
from ..errors.checks import check_choice, check_count, check_known, check_positive
from ..graph import Graph, check_graph
from ..linear.information import Structures, sharing
from .gnc import solve_gnc
from .initialize import INITIALIZE
from .iteration import Iteration
from .minimize import METHODS, minimize
from .solution import Solution

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


#: by default processes are started after so many seconds of work in this process; starting them takes about two
ALONE = 3.0
#: graphs that are read ahead for each process, so that none waits
AHEAD = 2


def solve_many(graphs: Iterable[Graph], *, jobs: int | None = None, **options: Any) -> Iterator[Solution | SlamError]:
    """Solve many graphs; the results come in the order of the graphs, each as soon as those before it are done.

    Graphs with edges between the same nodes share the pattern of Omega, its ordering and the structure of its factor. Every
    number except ``seconds`` is the same, to the last bit, as from `solve` on one thread, whatever ``jobs`` is. A graph that
    no other process can make again, because a class of its edges belongs to the caller's script or notebook, is solved in
    this process.

    Args:
        graphs: a list, or an iterator of any length: at most two graphs for each process are held at a time. An error
            that the iterator raises is raised here after the results of the graphs before it.
        jobs: how many processes; 0 for this process only; None (default) for this process during the first seconds,
            and one process on each core after that.
        options: those of `solve`, the same for all graphs: method, tolerance, max_iterations, initialize,
            cost_tolerance. A ``callback`` would not be called in this process, and is refused.

    Returns:
        An iterator of results. In place of a graph that could not be solved stands the error: the `GraphError` of
        `solve`, or a `SlamError` where the process died in the middle of the graph. Not converging is no error.

    Raises:
        OptionError: an option does not exist or has an impossible value; or, in its turn, something is no `Graph`.
    """
    known = [name for name in signature(solve).parameters if name not in ("graph", "callback")]
    check_known("solve_many", options, known, f"; it takes jobs and {', '.join(known)}")
    defaults = {name: signature(solve).parameters[name].default for name in known}
    check_options(**(defaults | options))
    if jobs is not None:
        check_count(jobs=jobs)
    if not isinstance(graphs, Iterable):
        given = f"a {type(graphs).__name__}"
        raise OptionError(f"graphs must be a list or an iterator of graphs, not {given}; for one graph use solve")
    return _results(_checked(graphs), jobs, options)


def _checked(graphs: Iterable[Graph]) -> Iterator[Graph]:
    for number, graph in enumerate(graphs):
        check_graph(graph, f"graphs[{number}]")
        yield graph


def _results(graphs: Iterator[Graph], jobs: int | None, options: dict[str, Any]) -> Iterator[Solution | SlamError]:
    from ..processes import default_jobs

    limit = 0.0 if jobs else float("inf")
    if jobs is None:
        jobs = default_jobs()
        limit = ALONE if jobs > 1 else limit
    structures, spent = Structures(), 0.0
    while spent < limit:
        graph = next(graphs, None)
        if graph is None:
            return
        begin = time.perf_counter()
        result = _solved(graph, options, structures)
        spent += time.perf_counter() - begin
        yield result
    yield from _in_processes(graphs, jobs, options, structures)


def _in_processes(
    graphs: Iterator[Graph], jobs: int, options: dict[str, Any], structures: Structures
) -> Iterator[Solution | SlamError]:
    from ..processes import processes

    waiting: deque[tuple[Graph, Future[Solution | SlamError | None] | None]] = deque()
    more, failure = True, None
    with processes(jobs) as pool:
        while more or waiting:
            while more and len(waiting) < AHEAD * jobs:
                try:
                    graph = next(graphs, None)
                except Exception as error:
                    graph, failure = None, error
                more = graph is not None
                if graph is not None:
                    data = _packed(graph)
                    waiting.append((graph, None if data is None else pool.schedule(_task, (data, options))))
            if waiting:
                graph, future = waiting.popleft()
                yield _received(graph, future) or _solved(graph, options, structures)
    if failure is not None:
        raise failure


def _solved(graph: Graph, options: dict[str, Any], structures: Structures) -> Solution | SlamError:
    with sharing(structures):
        try:
            return solve(graph, **options)
        except GraphError as error:
            return error


def _packed(graph: Graph) -> bytes | None:
    # a pool would not survive an object that cannot be made again in its processes, so it is given bytes
    with suppress(Exception):
        return pickle.dumps(graph, protocol=pickle.HIGHEST_PROTOCOL)
    return None


@cache
def _of_this_process() -> Structures:
    return Structures()


def _task(data: bytes, options: dict[str, Any]) -> Solution | SlamError | None:
    """The task of a process: the result without the graph, or None where it cannot make the graph from its bytes."""
    try:
        graph = pickle.loads(data)
    except Exception:
        return None
    result = _solved(graph, options, _of_this_process())
    return replace(result, graph=None) if isinstance(result, Solution) and result.graph is graph else result


def _received(graph: Graph, future: Future[Solution | SlamError | None] | None) -> Solution | SlamError | None:
    if future is None:
        return None
    from pebble import ProcessExpired

    from ..processes import how_it_ended

    try:
        result = future.result()
    except ProcessExpired as error:
        return SlamError(how_it_ended(error))
    return replace(result, graph=graph) if isinstance(result, Solution) and result.graph is None else result
