"""The state of an iteration Omega Delta = xi, x <- x + Delta, and the rules that stop it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..diagnosis import undetermined
from ..engine import engine
from ..graph import Graph
from ..linear.cholesky import Factor, FactorizationError
from ..linear.information import BlockSystem
from ..se2 import Array
from .mixing import AndersonMixing

#: a step shorter than the tolerance ends the iteration only where it promises to lower J by less than this part of it,
#: or less than the tolerance itself where that is greater: a rough tolerance asks for a rough end
PROMISE = 1e-6
#: a step is confirmed where its predicted decrease of J is below this many times the cost tolerance
CONFIRMED = 1e3


@dataclass(frozen=True)
class Iteration:
    """What a callback receives after each step: its number, the state (n, 3) reached, the cost before it, its norm."""

    number: int
    state: Array
    cost: float
    step_norm: float


@dataclass
class Run:
    """An iteration under way.

    Attributes:
        state: (n, 3), the current iterate.
        tolerance: the step norm below which the iteration has converged.
        max_iterations: the most steps to take.
        cost_tolerance: the relative change of J below which the iteration has converged; 0 for none.
        callback: called after each step.
        mixing: Anderson acceleration of the steps, or None for plain steps.
        costs, step_norms: J before each step, and the norm of each step.
        predicted: how much the last step should lower J by the quadratic model.
        descend: whether damped steps must lower J itself, with state-dependent information evaluated at both ends.
        recorded: the steps, where somebody wants them after the end.
        converged, reason: whether a stop rule was met, and why the iteration ended.
    """

    state: Array
    tolerance: float
    max_iterations: int = 100
    cost_tolerance: float = 0.0
    callback: Callable[[Iteration], None] | None = None
    mixing: AndersonMixing | None = None
    costs: list[float] = field(default_factory=list)
    step_norms: list[float] = field(default_factory=list)
    predicted: float = np.inf
    descend: bool = False
    recorded: list[Iteration] = field(default_factory=list)
    converged: bool = False
    reason: str = ""

    @property
    def mixed(self) -> bool:
        """Whether the last step was a mixture of iterates."""
        return self.mixing is not None and self.mixing.active

    def step(self, cost: float, delta: Array) -> None:
        """Take the correction (n, 3) from a state with this cost."""
        self.state = self.state + delta if self.mixing is None else self.mixing.next(self.state, delta)
        self.costs.append(cost)
        self.step_norms.append(inner(delta, delta) ** 0.5)
        if self.callback is not None:
            self.callback(Iteration(len(self.step_norms), self.state.copy(), cost, self.step_norms[-1]))

    def diverged(self, cost: float) -> bool:
        """Whether the cost is infinite or not a number."""
        if np.isfinite(cost):
            return False
        self.reason = f"diverged: the cost is {cost} after {len(self.step_norms)} steps"
        return True

    def settled(self, cost: float) -> bool:
        """Whether the last step changed the cost by less than the cost tolerance.

        The predicted decrease must be small, too: a step from one side of a valley to the other also leaves J unchanged.
        """
        enough = self.cost_tolerance * self.costs[-1] if self.costs else 0.0
        if abs(self.predicted) <= CONFIRMED * enough and abs(self.costs[-1] - cost) <= enough != 0:
            self._converge(f"J changed by less than {self.cost_tolerance:g} of it")
        return self.converged

    def finished(self, predicted: float, system: BlockSystem) -> bool:
        """Whether the last step, which should lower J by ``predicted``, was short enough to stop.

        A short step alone proves nothing where J is steep: it must also promise little, compared with J or with what
        rounding of the state (about 1e-15 of each coordinate) does to J.

        On badly scaled graphs rounding keeps the steps from becoming shorter than some 1e-7 (INTEL). Therefore a step
        that no longer shrinks is also the last one, if its predicted decrease is below the rounding error of J. Mixed
        steps may grow for a while and shrink again, so ten of them are compared.
        """
        self.predicted = predicted
        norm, window = self.step_norms[-1], 10 if self.mixed else 1
        before = self.step_norms[-1 - window : -1]
        if norm < self.tolerance and self.negligible(predicted, system):
            self._converge(f"step norm {norm:.1e} below the tolerance {self.tolerance:g}")
        elif abs(predicted) <= self.cost_tolerance * self.costs[-1] != 0:
            self._converge(f"the last step lowered J by less than {self.cost_tolerance:g} of it")
        elif abs(predicted) < 1e-15 * self.costs[-1] and len(before) == window and norm > 0.5 * min(before):
            self._converge(f"step norm {norm:.1e} at its rounding floor: J can fall no further")
        return self.converged

    def negligible(self, predicted: float, system: BlockSystem) -> bool:
        """Whether a predicted decrease is a small part of J, or no more than rounding makes of it."""
        part = max(PROMISE, self.tolerance, self.cost_tolerance)
        return abs(predicted) <= part * self.costs[-1] or abs(predicted) <= self.rounding(system)

    def rounding(self, system: BlockSystem) -> float:
        """What J is, at least, by rounding errors of 1e-15 of all coordinates: the sum of diag(Omega) errors²."""
        error = 1e-15 * (1 + np.abs(self.state).max(axis=0))
        return float(np.sum(system.diagonal() * error**2))

    def _converge(self, reason: str) -> None:
        self.converged, self.reason = True, reason


def factorized(graph: Graph, state: Array, damping: float = 0.0) -> Factor:
    """The Cholesky factor of Omega + damping diag(Omega), as `Graph.linearize` left Omega at ``state``.

    Raises:
        GraphError: Omega is singular; the message names the nodes that are not determined.
    """
    try:
        return graph.system.factorize(damping)
    except FactorizationError as error:
        raise undetermined(graph, state, error) from None


def inner(a: Array, b: Array) -> float:
    """The inner product of two arrays (n, 3)."""
    return engine.inner(a, b)
