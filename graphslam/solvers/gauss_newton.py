"""Gauss-Newton: solve Omega Delta = xi, move by Delta, repeat."""

from __future__ import annotations

from ..graph import Graph
from ..linear.cholesky import Factor
from .iteration import CONFIRMED, Run, factorized, inner
from .levenberg_marquardt import levenberg_marquardt
from .mixing import AndersonMixing

#: plain and mixed steps without progress after which the steps are damped
PATIENCE, PATIENCE_MIXED = 10, 30


def gauss_newton(graph: Graph, run: Run) -> None:
    """Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e, until ``run`` stops.

    Plain steps converge slowly where information, or a kernel's weights, are re-evaluated at every step; there the
    iterates are mixed (`AndersonMixing`). Where neither the lowest J nor the shortest step improves for `PATIENCE` steps,
    the iteration oscillates, and continues with damped steps from the best state (`levenberg_marquardt`).

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: the lectures, section 9.1; Nocedal and Wright, *Numerical Optimization*, section 10.3.
    """
    run.mixing = AndersonMixing() if graph.state_dependent_information or graph.reweighted else None
    patience = PATIENCE if run.mixing is None else PATIENCE_MIXED
    run.reason = f"max_iterations = {run.max_iterations} reached"
    factor: Factor | None = None
    best, lowest, shortest, progress = run.state, float("inf"), float("inf"), 0
    for k in range(run.max_iterations):
        system, cost = graph.linearize(run.state)
        if run.diverged(cost) or run.settled(cost):
            return
        if cost < lowest:
            best, lowest, progress = run.state, cost, k
        if factor is None:
            factor = factorized(graph, run.state)
        delta = factor.solve(system.xi)
        # the quadratic model predicts that J falls by Delta' Omega Delta = xi' Delta
        predicted = inner(system.xi, delta)
        run.step(cost, delta)
        if run.finished(predicted, system):
            return
        if run.step_norms[-1] < shortest:
            shortest, progress = run.step_norms[-1], k
        if k - progress >= patience:
            run.state = best
            levenberg_marquardt(graph, run)
            run.reason += f", with damped steps from step {k + 2} on because plain ones oscillated"
            return
        # After such a short step Omega hardly changes: the next step, which only confirms the end, uses the same factor.
        if predicted > CONFIRMED * run.cost_tolerance * cost:
            factor = None
