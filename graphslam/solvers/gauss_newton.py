"""Gauss-Newton: solve Omega Delta = xi, move by Delta, repeat."""

from __future__ import annotations

from ..graph import Graph
from ..linear.cholesky import Factor
from .iteration import CONFIRMED, Run, factorized, inner
from .mixing import AndersonMixing


def gauss_newton(graph: Graph, run: Run) -> None:
    """Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e, until ``run`` stops.

    Plain steps converge slowly where information, or a kernel's weights, are re-evaluated at every step; there the
    iterates are mixed (`AndersonMixing`).

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: the lectures, section 9.1; Nocedal and Wright, *Numerical Optimization*, section 10.3.
    """
    run.mixing = AndersonMixing() if graph.state_dependent_information or graph.reweighted else None
    run.reason = f"max_iterations = {run.max_iterations} reached"
    factor: Factor | None = None
    for _ in range(run.max_iterations):
        system, cost = graph.linearize(run.state)
        if run.diverged(cost) or run.settled(cost):
            return
        if factor is None:
            factor = factorized(graph, run.state)
        delta = factor.solve(system.xi)
        # the quadratic model predicts that J falls by Delta' Omega Delta = xi' Delta
        predicted = inner(system.xi, delta)
        run.step(cost, delta)
        if run.finished(predicted):
            return
        # After such a short step Omega hardly changes: the next step, which only confirms the end, uses the same factor.
        if predicted > CONFIRMED * run.cost_tolerance * cost:
            factor = None
