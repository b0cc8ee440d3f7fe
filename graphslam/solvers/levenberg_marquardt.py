"""Levenberg-Marquardt: damped Gauss-Newton steps, of which only those that lower J are taken."""

from __future__ import annotations

import numpy as np

from ..graph import Graph
from ..linear.cholesky import FactorizationError
from .iteration import Run, factorized, inner
from .mixing import AndersonMixing


def levenberg_marquardt(graph: Graph, run: Run, most: int | None = None) -> bool:
    """Iterate (Omega + lambda diag(Omega)) Delta = xi, with lambda chosen so that J falls, until ``run`` stops.

    Returns whether it only ended because it has taken ``most`` steps.

    The end counts as converged only where an undamped step confirms it: beside very large entries of Omega (a pose on a
    landmark) even the smallest damping hides the other directions.

    lambda is Marquardt's damping by the diagonal, updated by Nielsen's rule from the gain, the actual decrease of J
    divided by the predicted one.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: Madsen, Nielsen and Tingleff, *Methods for non-linear least squares problems* (2004), section 3.2.
    """
    run.mixing = AndersonMixing() if graph.state_dependent_information and not run.descend else None
    run.reason = f"max_iterations = {run.max_iterations} reached"
    damping, growth = 1e-4, 2.0
    last = run.max_iterations if most is None else min(run.max_iterations, len(run.step_norms) + most)
    while len(run.step_norms) < last:
        # state-dependent information is evaluated once per step and kept while the step is tried
        reference = run.state
        followed = None if run.descend else reference
        system, cost = graph.linearize(run.state, reference)
        if run.diverged(cost) or (damping < 1e-6 and run.settled(cost)):
            return False
        while True:
            delta = factorized(graph, run.state, damping).solve(system.xi)
            tried = graph.cost(run.state + delta, followed)
            # the damped quadratic model predicts that J falls by Delta'(xi + lambda diag(Omega) Delta)
            predicted = float(np.sum(delta * (system.xi + damping * system.diagonal() * delta)))
            # below the rounding error of J the costs cannot be compared, but no step may raise J beyond it
            rounding = run.rounding(system)
            negligible = abs(predicted) <= max(1e-12 * cost, rounding) and tried <= max(cost * (1 + 1e-9), rounding)
            if negligible or (np.isfinite(tried) and tried < cost):
                break
            damping, growth = damping * growth, growth * 2
            if damping > 1e16:
                run.reason = f"stuck: no step lowers the cost {cost:.6g}, however short"
                return False
        gain = 1.0 if negligible else (cost - tried) / predicted
        damping, growth = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-15), 2.0
        run.step(cost, delta)
        # a short step counts only where damping does not shorten it
        if damping < 1e-6 and run.finished(predicted, system) and _confirmed(graph, run):
            return False
    return True


def _confirmed(graph: Graph, run: Run) -> bool:
    """Whether the iteration ends here: an undamped step promises little, too, or Omega is singular (not converged)."""
    system, _ = graph.linearize(run.state)
    try:
        delta = system.factorize().solve(system.xi)
    except FactorizationError:
        run.converged, run.reason = False, "stuck: damped steps lead to a state where Omega is singular"
        return True
    run.converged = run.negligible(inner(system.xi, delta), system)
    if not run.converged:
        run.reason = f"max_iterations = {run.max_iterations} reached"
    return run.converged
