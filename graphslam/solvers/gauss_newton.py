"""Gauss-Newton: solve Omega Delta = xi, move by Delta, repeat."""

from __future__ import annotations

from ..graph import Graph
from ..linear.cholesky import Factor
from ..se2 import Array
from .iteration import CONFIRMED, PROMISE, Run, factorized, inner
from .levenberg_marquardt import levenberg_marquardt
from .mixing import AndersonMixing

#: Gauss-Newton that has not converged after so many plain steps converges slowly, or oscillates: the iterates are mixed
PLAIN = 8
#: plain and mixed steps without progress after which the steps are damped
PATIENCE, PATIENCE_MIXED = 10, 30
#: so many damped steps follow, and then undamped ones again
DAMPED_STEPS = 20
#: After a plain step that lowers J by at most this part of it, Omega hardly changes: the next step uses the same factor, ...
KEPT = 0.01
#: ... unless the gain that it predicts, or the square of its length, is more than this part of that of the step before it
SHRINKING = 0.1


def gauss_newton(graph: Graph, run: Run) -> None:
    """Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e, until ``run`` stops.

    Plain steps converge slowly where information, or a kernel's weights, are re-evaluated at every step; there the
    iterates are mixed (`AndersonMixing`). They also converge slowly, or oscillate, where residuals are large, because Omega
    leaves out the second derivatives of the residuals; the iterates are therefore mixed after `PLAIN` steps in any case.
    Where neither the lowest J nor the shortest step improves for `PATIENCE` steps, damped steps lead on from the best
    state (`levenberg_marquardt`). They converge slowly, too, so that after `DAMPED_STEPS` of them undamped ones follow.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: the lectures, section 9.1; Nocedal and Wright, *Numerical Optimization*, section 10.3.
    """
    run.reason = f"max_iterations = {run.max_iterations} reached"
    best, damped_from = _undamped(graph, run, plain=PLAIN), len(run.step_norms)
    while best is not None:
        run.state = best
        if len(run.step_norms) == run.max_iterations or not levenberg_marquardt(graph, run, most=DAMPED_STEPS):
            break
        best = _undamped(graph, run, plain=0)
    if len(run.step_norms) > damped_from:
        run.reason += f", with damped steps from step {damped_from + 1} on because plain ones oscillated"


def _undamped(graph: Graph, run: Run, plain: int) -> Array | None:
    """Steps until ``run`` stops, or makes no progress: then the best state (n, 3), otherwise None.

    The iterates are mixed after ``plain`` steps. Without plain steps, a run that takes all its iterations also ends at the
    best state.
    """
    mixed_from = 0 if graph.state_dependent_information or graph.reweighted else plain
    run.mixing = None
    factor: Factor | None = None
    best, lowest, shortest, progress = run.state, float("inf"), float("inf"), 0
    for k in range(run.max_iterations - len(run.step_norms)):
        if k == mixed_from:
            run.mixing = AndersonMixing()
        system, cost = graph.linearize(run.state)
        if run.diverged(cost) or run.settled(cost):
            return None
        if cost < lowest:
            best, lowest, progress = run.state, cost, k
        confirmed = CONFIRMED * run.cost_tolerance * cost
        # the quadratic model predicts that J falls by Delta' Omega Delta = xi' Delta
        if factor is not None:
            delta = factor.solve(system.xi)
            predicted = inner(system.xi, delta)
            longest = SHRINKING * run.step_norms[-1] ** 2
            if predicted > confirmed and (predicted > SHRINKING * run.predicted or inner(delta, delta) > longest):
                factor = None
        if factor is None:
            factor = factorized(graph, run.state)
            delta = factor.solve(system.xi)
            predicted = inner(system.xi, delta)
        run.step(cost, delta)
        if run.finished(predicted, system):
            if cost <= lowest * (1 + PROMISE) or graph.state_dependent_information:
                return None
            # mixed steps may also end at a maximum, or in a higher minimum
            run.converged = False
            return best
        if run.step_norms[-1] < shortest:
            shortest, progress = run.step_norms[-1], k
        if k - progress >= (PATIENCE_MIXED if run.mixed else PATIENCE):
            return best
        if predicted > (KEPT * cost if run.mixing is None else confirmed):
            factor = None
    return None if plain else best
