"""``initialize="auto"``: solve from several starts, and return the best result, never one worse than the given values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from .iteration import Run, factorized
from .starting import AUTO, starting_state

DAMPED = "levenberg-marquardt"
#: graphs of at most so many nodes are always run from a second start: that takes milliseconds
SMALL = 100
#: J per degree of freedom beyond which an end is doubtful and compared with another start's
DOUBTFUL = 3.0
#: ends whose costs differ by less than this part are one minimum
SAME = 1e-6


@dataclass(frozen=True)
class _End:
    """The end of one run and its cost; infinite where it is no number."""

    run: Run
    cost: float


def best_run(graph: Graph, run_from: Callable[..., Run], method: str) -> Run:
    """The run with the lowest end among the starts of `AUTO`.

    The search ends early where J per degree of freedom is plausible or two starts converge to the same cost; in small
    graphs both must hold. An end with a higher cost than the given values never counts. If no run converges to a lower one,
    Levenberg-Marquardt runs from the given values and accepts only steps that lower J itself. (With state-dependent
    information a fixed point of the iteration may have a higher J.)

    Args:
        graph: what to solve.
        run_from: runs a method from a state; with ``descend=True`` so that every step lowers J itself.
        method: the method that is tried first from every start. Levenberg-Marquardt follows if it does not converge, unless
            an earlier start has converged to an acceptable cost.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    given = _finite(graph.cost(graph.initial))
    ends: list[_End] = []
    error: GraphError | None = None
    for initialize in AUTO:
        try:
            start = starting_state(graph, initialize)
        except GraphError:
            continue  # these edges do not allow that start
        # a start that only serves for comparison is worth one attempt
        searches = (method,) if any(_allowed(end, given) and end.run.converged for end in ends) else (method, DAMPED)
        for search in dict.fromkeys(searches):
            try:
                run = run_from(start, search)
            except GraphError as failure:
                error = failure
                continue
            run.reason += f" (started {initialize}, {search})"
            ends.append(_End(run, _finite(graph.cost(run.state))))
            if run.converged:
                break
        if _enough(graph, [end.cost for end in ends if end.run.converged and _allowed(end, given)]):
            break
    if error is not None and not any(end.run.converged for end in ends):
        # if nodes are undetermined, Omega is singular at the given values as well, and this raises; if only a later state
        # was singular, it does not
        graph.linearize(graph.initial)
        factorized(graph, graph.initial)
        if not ends:
            raise error
    allowed = [end for end in ends if _allowed(end, given)]
    if not any(end.run.converged for end in allowed):
        run = run_from(graph.initial, DAMPED, descend=True)
        run.reason += " (started given; J falls at every step, because all other ends are above the given values)"
        if not graph.cost(run.state) <= given:
            run.state, run.converged = graph.initial.copy(), False
        allowed.append(_End(run, _finite(graph.cost(run.state))))
    return _best(graph, allowed)


def _allowed(end: _End, given: float) -> bool:
    """Whether an end is not above the cost of the given values, but for rounding."""
    return end.cost <= given * (1 + 1e-9)


def _best(graph: Graph, ends: list[_End]) -> Run:
    """The lowest end. One that has not converged must be lower than a converged one by more than `SAME`.

    With state-dependent information only a fixed point is a solution, and J on the way to it may be lower.
    """
    converged = min((end for end in ends if end.run.converged), key=lambda end: end.cost, default=None)
    lowest = min(ends, key=lambda end: end.cost)
    if converged is not None and (graph.state_dependent_information or converged.cost <= lowest.cost * (1 + SAME)):
        return converged.run
    return lowest.run


def _enough(graph: Graph, costs: list[float]) -> bool:
    """Whether the costs of converged ends leave no reason to try another start."""
    if not costs:
        return False
    plausible = min(costs) <= DOUBTFUL * graph.expected_cost
    agreed = sum(cost <= min(costs) * (1 + SAME) for cost in costs) > 1
    return (plausible and agreed) if graph.num_nodes <= SMALL else (plausible or agreed)


def _finite(cost: float) -> float:
    return cost if np.isfinite(cost) else np.inf
