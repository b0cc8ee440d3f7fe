"""The iterations Omega Delta = xi, x <- x + Delta of Gauss-Newton and Levenberg-Marquardt, and why they end.

They run in the engine (``engine/**/solve``), and the rules by which they end are there, too (``run.cpp``). Here a graph takes
the form in which the engine iterates it, and what the engine found becomes a sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..engine import engine
from ..errors.checks import first
from ..graph import Graph
from ..linear.cholesky import Factor, FactorizationError
from ..linear.information import BlockSystem
from ..se2 import Array
from .joint import undetermined


def objective_of(graph: Any) -> Any:
    """The objective of a `Graph`, or of an object with the methods of `joint.JointGraph`."""
    if isinstance(graph, Graph):
        return graph.objective
    objective = engine.PythonObjective(graph)
    objective.state_dependent, objective.reweighted = graph.state_dependent_information, graph.reweighted
    return objective


#: a step shorter than the tolerance ends an iteration only where it promises to lower J by less than this part of it,
#: or less than the tolerance itself where that is greater: a rough tolerance asks for a rough end
PROMISE: float = engine.promise


@dataclass(frozen=True)
class Iteration:
    """The argument of a callback after each step: its number, the state (n, 3) reached, the cost before it, its norm."""

    number: int
    state: Array
    cost: float
    step_norm: float


@dataclass
class Run:
    """An iteration: where it starts and when it stops, and after it what it has done.

    It has converged where one of three rules is met: those of ``tolerance`` and ``cost_tolerance``, or that steps no longer
    become shorter and the predicted decrease of J is below 1e-15 J, or below what rounding makes of J.

    Attributes:
        state: (n, 3), where it starts; then where it ended.
        tolerance: a step is shorter than this, and its predicted decrease of J is small: at most 1e-6 of J (or this
            tolerance, or the other one, where that is greater), or no more than rounding makes of J.
        max_iterations: the most steps to take.
        cost_tolerance: J changes, or is predicted to change, by less than this part; 0: never.
        callback: called after each step.
        costs, step_norms: J before each step, and the norm of each step.
        descend: whether damped steps must lower J itself, with state-dependent information evaluated at both ends.
        recorded: the steps, where the caller asks for them.
        converged, reason: whether a stop rule was met, and why the iteration ended.
        factorizations: how often Omega was factorised.
    """

    state: Array
    tolerance: float
    max_iterations: int = 100
    cost_tolerance: float = 0.0
    callback: Callable[[Iteration], None] | None = None
    costs: list[float] = field(default_factory=list)
    step_norms: list[float] = field(default_factory=list)
    descend: bool = False
    recorded: list[Iteration] = field(default_factory=list)
    converged: bool = False
    reason: str = ""
    factorizations: int = 0


def iterate(graph: Any, run: Run, method: Callable[[Any, Any], object], kept: float) -> None:
    """Iterate in the engine from ``run.state``; ``kept`` is the part of J below which a factor is kept, 0 for never.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    callback = run.callback
    inside = engine.Run(
        np.ascontiguousarray(run.state, dtype=float), run.tolerance, run.max_iterations, run.cost_tolerance,
        run.descend, kept, None if callback is None else lambda *step: callback(Iteration(*step)),
    )  # fmt: skip
    method(objective_of(graph), inside)
    run.state, run.costs, run.step_norms = inside.state, inside.costs, inside.norms
    run.converged, run.factorizations = inside.converged, inside.factorizations
    if inside.end == engine.End.not_determined:
        refuse(graph, run.state, inside.damping)
    run.reason = _reason(run, inside)
    if inside.end == engine.End.diverged and not run.step_norms:
        run.reason += _not_finite(graph, run.state)
    if inside.damped_from >= 0:
        run.reason += f", with damped steps from step {inside.damped_from + 1} on because plain ones oscillated"
    if 0 <= inside.curved_from < len(run.step_norms):
        run.reason += f", with second derivatives from step {inside.curved_from + 1} on because steps shrank slowly"


def _not_finite(graph: Any, state: Array) -> str:
    """Which edge has a cost that is no finite number at a state, for a sentence."""
    for family in graph.families if isinstance(graph, Graph) else ():
        try:
            with np.errstate(all="ignore"):
                squares = family.linearize(state, state).mahalanobis
        except Exception:  # code of a user
            return f": the {type(family).__name__} cannot be linearised there"
        if (k := first(~np.isfinite(squares))) is not None:
            return f": edge {k} of the {type(family).__name__} has a residual or an information that is not finite"
    return ""


def refuse(graph: Any, state: Array, damping: float) -> None:
    """Raise the `GraphError` of a factorisation that failed in the engine; that in Python, repeated here, names the nodes."""
    factorized(graph, state, damping).solve(graph.system.xi)
    raise AssertionError("a factorisation that failed in the engine succeeded")


def _reason(run: Run, inside: Any) -> str:
    """The reason for the end of the iteration, a sentence."""
    End, steps, cost = engine.End, len(run.step_norms), inside.cost_at_end
    norm = run.step_norms[-1] if steps else np.nan
    match inside.end:
        case End.most_steps:
            return f"max_iterations = {run.max_iterations} reached"
        case End.diverged:
            return f"diverged: the cost is {cost} after {steps} steps"
        case End.cost_settled:
            return f"J changed by less than {run.cost_tolerance:g} of it"
        case End.short_step:
            return f"step norm {norm:.1e} below the tolerance {run.tolerance:g}"
        case End.small_decrease:
            return f"the last step lowered J by less than {run.cost_tolerance:g} of it"
        case End.rounding_floor:
            return f"step norm {norm:.1e} at its rounding floor: J can fall no further"
        case End.no_lower_cost:
            return f"stuck: no step lowers the cost {cost:.6g}, however short"
    return "stuck: damped steps lead to a state where Omega is singular"


def end_of(
    method: Callable[[Graph, Run], None], graph: Graph, start: Array, tolerance: float | None = None,
    max_iterations: int = 100,
) -> Array:  # fmt: skip
    """The state (n, 3) at which an iteration ends; the start where that is not finite.

    Args:
        method: `gauss_newton` or `levenberg_marquardt`.
        tolerance: default: `rough`.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    run = Run(start.copy(), rough(graph) if tolerance is None else tolerance, max_iterations)
    method(graph, run)
    return run.state if np.isfinite(run.state).all() else start


def rough(graph: Graph) -> float:
    """The step norm below which an iteration on the way to a solution ends: 1 mm or 1 mrad for each pose."""
    return 1e-3 * len(graph.steps) ** 0.5


def rounding(state: Array, system: BlockSystem) -> float:
    """The part of J that rounding errors of 1e-15 of all coordinates cause: the sum of diag(Omega) errors²."""
    return engine.rounding(np.ascontiguousarray(state), np.ascontiguousarray(system.diagonal()))


def factorized(graph: Graph, state: Array, damping: float = 0.0) -> Factor:
    """The Cholesky factor of Omega + damping diag(Omega), as `Graph.linearize` left Omega at ``state``.

    Raises:
        GraphError: Omega is singular; the message names the nodes that are not determined.
    """
    try:
        return graph.system.factorize(damping)
    except FactorizationError as error:
        raise undetermined(graph, state, error) from None


#: After a plain step that lowers J by at most this part of it, Omega hardly changes: the next step uses the same factor,
#: unless the gain that it predicts, or the square of its length, is more than a tenth of that of the step before it
KEPT = 0.01


def gauss_newton(graph: Graph, run: Run) -> None:
    """Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e, until ``run`` stops.

    Plain steps converge slowly, or oscillate, where residuals are large or have a kernel, because Omega leaves out second
    derivatives. Where a step after the fourth promises less than 1 % of J, but more than 1 % of what the one before it
    promised, Omega has them from there on (Newton's method, damped where J does not fall).

    Edges whose information depends on the state, those of landmarks that are no nodes, and those written in Python have no
    second derivatives. There the iterates are mixed (Anderson acceleration), after eight plain steps if there is no kernel
    and information is constant. Where neither the lowest J nor the shortest step improves for ten steps, damped steps lead
    on from the best state (`levenberg_marquardt`). They converge slowly, too, so that after twenty of them undamped ones
    follow.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: the lectures, section 9.1; Nocedal and Wright, *Numerical Optimization*, section 10.3.
    """
    iterate(graph, run, engine.gauss_newton, KEPT)


def levenberg_marquardt(graph: Graph, run: Run) -> None:
    """Iterate (Omega + lambda diag(Omega)) Delta = xi, with lambda chosen so that J falls, until ``run`` stops.

    The end counts as converged only where an undamped step confirms it: beside very large entries of Omega (a pose on a
    landmark) even the smallest damping hides the other directions.

    lambda is Marquardt's damping by the diagonal, updated by Nielsen's rule from the gain, the actual decrease of J
    divided by the predicted one.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: Madsen, Nielsen and Tingleff, *Methods for non-linear least squares problems* (2004), section 3.2.
    """

    def search(objective: Any, inside: Any) -> None:
        engine.levenberg_marquardt(objective, inside, run.max_iterations)

    iterate(graph, run, search, 0.0)


#: the names of the methods
METHODS: dict[str, Callable[[Any, Run], Any]] = {
    "gauss-newton": gauss_newton,
    "levenberg-marquardt": levenberg_marquardt,
}
