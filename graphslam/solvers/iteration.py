"""An iteration Omega Delta = xi, x <- x + Delta: its rules and its end. The engine iterates (``engine/**/solve``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..diagnosis import undetermined
from ..engine import engine
from ..graph import Graph
from ..linear.cholesky import Factor, FactorizationError
from ..linear.information import BlockSystem
from ..se2 import Array
from .objective import objective_of

#: a step shorter than the tolerance ends an iteration only where it promises to lower J by less than this part of it,
#: or less than the tolerance itself where that is greater: a rough tolerance asks for a rough end
PROMISE = 1e-6


@dataclass(frozen=True)
class Iteration:
    """The argument of a callback after each step: its number, the state (n, 3) reached, the cost before it, its norm."""

    number: int
    state: Array
    cost: float
    step_norm: float


@dataclass
class Run:
    """An iteration, before and after.

    Attributes:
        state: (n, 3), where it starts; then where it ended.
        tolerance: the step norm below which the iteration has converged.
        max_iterations: the most steps to take.
        cost_tolerance: the relative change of J below which the iteration has converged; 0 for none.
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
    """Iterate in the engine from ``run.state``; ``kept`` is `gauss_newton.KEPT`.

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
        # the same again in Python, which says where
        factorized(graph, run.state, inside.damping).solve(graph.system.xi)
        raise AssertionError("a factorisation that failed in the engine succeeded")
    run.reason = _reason(run, inside)
    if inside.damped_from >= 0:
        run.reason += f", with damped steps from step {inside.damped_from + 1} on because plain ones oscillated"


def _reason(run: Run, inside: Any) -> str:
    """The reason for the end of the iteration, a sentence."""
    End, steps, cost = engine.End, len(run.step_norms), inside.cost_at_end
    norm = run.step_norms[-1] if steps else np.nan
    reasons = {
        End.most_steps: f"max_iterations = {run.max_iterations} reached",
        End.diverged: f"diverged: the cost is {cost} after {steps} steps",
        End.cost_settled: f"J changed by less than {run.cost_tolerance:g} of it",
        End.short_step: f"step norm {norm:.1e} below the tolerance {run.tolerance:g}",
        End.small_decrease: f"the last step lowered J by less than {run.cost_tolerance:g} of it",
        End.rounding_floor: f"step norm {norm:.1e} at its rounding floor: J can fall no further",
        End.no_lower_cost: f"stuck: no step lowers the cost {cost:.6g}, however short",
        End.singular: "stuck: damped steps lead to a state where Omega is singular",
    }
    return reasons[inside.end]


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
