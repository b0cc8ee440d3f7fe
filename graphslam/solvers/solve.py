"""The hand-written solver: sum up Omega and xi, solve Omega Delta = xi, move, repeat."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Real

import numpy as np
from numba import njit

from ..checks import check_choice, check_count, check_positive
from ..diagnosis import undetermined
from ..errors import GraphError, OptionError
from ..graph import Graph
from ..linear.cholesky import Factor, SingularPivot
from ..se2 import Array
from ..solution import Solution, make_solution
from ..transform import coarse, filled, without_landmarks
from .mixing import AndersonMixing
from .start import dead_reckoning, place_landmarks, rotation_first

METHODS = ("gauss-newton", "levenberg-marquardt")
INITIALIZE = ("given", "dead-reckoning", "rotation-first", "auto")
#: drives of more poses are straightened on every so manieth first, again and again
LONG, EVERY = 5_000, 8
#: the starts that "auto" tries, in turn
AUTO = ("virtual-motion", "rotation-first", "given")

#: a step that lowers J by less than this many times the cost tolerance is followed by one with the same factor
CONFIRMED = 1e3


@dataclass(frozen=True)
class Iteration:
    """What a callback sees after each step: its number, the state (n, 3) reached, the cost before it, its norm."""

    number: int
    state: Array
    cost: float
    step_norm: float


@dataclass
class _Run:
    """The iteration under way."""

    state: Array
    callback: Callable[[Iteration], None] | None
    cost_tolerance: float = 0.0
    costs: list[float] = field(default_factory=list)
    promised: float = np.inf
    step_norms: list[float] = field(default_factory=list)
    converged: bool = False
    reason: str = ""

    mixing: AndersonMixing | None = None

    def step(self, cost: float, delta: Array) -> float:
        """Take the correction and return its norm."""
        if self.mixing is None:
            self.state = self.state + delta
        else:
            self.state = self.mixing.next(self.state, delta)
        self.costs.append(cost)
        self.step_norms.append(_inner(delta, delta) ** 0.5)
        if self.callback is not None:
            self.callback(Iteration(len(self.step_norms), self.state.copy(), cost, self.step_norms[-1]))
        return self.step_norms[-1]

    def diverged(self, cost: float) -> bool:
        """Whether the cost has left the numbers, which is then the reason to stop."""
        if np.isfinite(cost):
            return False
        self.reason = f"diverged: the cost is {cost} after {len(self.step_norms)} steps"
        return True

    def settled(self, cost: float) -> bool:
        """Whether the last step changed the cost by less than the part of it that the caller cares about.

        It must not have promised much more: a step across a valley, from one side to the other, changes nothing, either.
        """
        enough = self.cost_tolerance * self.costs[-1] if self.costs else 0.0
        if abs(self.promised) <= CONFIRMED * enough and abs(self.costs[-1] - cost) <= enough != 0:
            self.converged, self.reason = True, f"J changed by less than {self.cost_tolerance:g} of it"
        return self.converged

    def finished(self, tolerance: float, promised: float) -> bool:
        """Whether the last step, which promised to lower J by ``promised``, was short enough to stop.

        On badly scaled graphs rounding keeps the steps from becoming shorter than some 1e-7 (INTEL). So a step that no
        longer shrinks is taken for the last, too, when it promises less than a rounding error of J. Mixed steps may grow
        for a while and shrink again: there it takes ten.
        """
        self.promised = promised
        norm, window = self.step_norms[-1], 1 if self.mixing is None else 10
        before = self.step_norms[-1 - window : -1]
        if norm < tolerance:
            self.converged, self.reason = True, f"step norm {norm:.1e} below the tolerance {tolerance:g}"
        elif abs(promised) <= self.cost_tolerance * self.costs[-1] != 0:
            self.converged, self.reason = True, f"the last step lowered J by less than {self.cost_tolerance:g} of it"
        elif abs(promised) < 1e-15 * self.costs[-1] and len(before) == window and norm > 0.5 * min(before):
            self.converged, self.reason = True, f"step norm {norm:.1e} at its rounding floor: J can fall no further"
        return self.converged


def solve(
    graph: Graph,
    method: str = "gauss-newton",
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "given",
    callback: Callable[[Iteration], None] | None = None,
    cost_tolerance: float = 0.0,
) -> Solution:
    """Minimise the cost J of a graph.

    Args:
        graph: what to solve.
        method: "gauss-newton" (each step to the minimum of the linearised graph; in the world frame the information is
            re-evaluated at every step, as in the lectures) or "levenberg-marquardt" (damped, takes only steps that
            lower J; in the world frame J with the information held still, solved, re-evaluated, and solved again).
        tolerance: converged when the Euclidean norm of a whole correction is below this.
        max_iterations: the most steps to take.
        initialize: "given", the graph's own initial values; "dead-reckoning" along the motion edges; "rotation-first",
            headings by linear least squares and then positions; "auto", for sightings of landmark nodes by virtual-motion
            edges first, else rotation-first where the edges allow it, and should that end above the given values' cost,
            or not end, the other ways too: the best end counts.
        callback: called after each step with an `Iteration`.
        cost_tolerance: converged, too, when a step changes J by less than this part of it; 0 leaves it to ``tolerance``.
            (Steps of 1e-9 need about 1e-16 here; 1e-6 is plenty for a picture.)

    Raises:
        GraphError: the edges do not determine the nodes.
        OptionError: an option has an impossible value.

    Not reaching the tolerance is no error: see `Solution.converged` and `Solution.reason`.
    """
    check_choice("method", method, METHODS)
    check_choice("initialize", initialize, INITIALIZE)
    check_positive(tolerance=tolerance)
    if not isinstance(cost_tolerance, Real) or not 0 <= cost_tolerance < 1:
        raise OptionError(f"cost_tolerance must lie between 0 and 1, not {cost_tolerance!r}")
    check_count(max_iterations=max_iterations)
    begin = time.perf_counter()

    def run_from(start: Array, search: str) -> _Run:
        # plain steps converge slowly where the information, or a kernel's weights, are re-evaluated at each of them
        slow = graph.frozen_information or (graph.reweighted and search == "gauss-newton")
        run = _Run(start.copy(), callback, cost_tolerance, mixing=AndersonMixing() if slow else None)
        (_gauss_newton if search == "gauss-newton" else _levenberg_marquardt)(graph, run, tolerance, max_iterations)
        return run

    if initialize == "auto":
        run = _best_run(graph, run_from, method)
    else:
        run = run_from(starting_state(graph, initialize), method)
    seconds = time.perf_counter() - begin
    return make_solution(
        graph,
        run.state,
        step_norms=run.step_norms,
        costs=run.costs,
        converged=run.converged,
        reason=run.reason,
        seconds=seconds,
        solver="graphslam",
    )


def virtual_motion_first(graph: Graph) -> Array:
    """A state (n, 3) to start from: poses by virtual-motion edges in place of the landmark nodes, then the landmarks.

    Raises:
        GraphError: the graph has no sightings of landmark nodes, or they do not determine the poses.
    """
    easier = without_landmarks(graph)
    if easier is None:
        raise GraphError("there are no sightings of landmark nodes to make virtual-motion edges of")
    if len(graph.steps) > LONG and (seen_from_afar := coarse(graph, EVERY)) is not None:
        smaller, nodes = seen_from_afar
        poses = virtual_motion_first(smaller)[: len(smaller.steps)]
        easier = easier.with_initial(filled(graph, nodes[: len(poses)], poses))
    # a start needs no digits
    return place_landmarks(graph, solve(easier, tolerance=1e-3 * len(graph.steps) ** 0.5).state)


def starting_state(graph: Graph, initialize: str) -> Array:
    """The state (n, 3) that `solve` starts from; for "auto" the one that it tries first.

    Raises:
        GraphError: the edges do not allow this start.
        OptionError: there is no such start.
    """
    check_choice("initialize", initialize, (*INITIALIZE, "virtual-motion"))
    if initialize == "auto":
        for choice in AUTO:
            try:
                return starting_state(graph, choice)
            except GraphError:
                continue
    if initialize == "rotation-first":
        return rotation_first(graph)
    if initialize == "virtual-motion":
        return virtual_motion_first(graph)
    return dead_reckoning(graph) if initialize == "dead-reckoning" else graph.initial


def _best_run(graph: Graph, run_from: Callable[[Array, str], _Run], method: str) -> _Run:
    """The run that ends lowest: from rotations first; from the given values, and damped, where that is not good enough."""
    given_cost = graph.cost(graph.initial)
    best: _Run | None = None
    best_cost = np.inf
    for initialize in AUTO:
        try:
            start = starting_state(graph, initialize)
        except GraphError:
            continue  # these edges do not allow that start
        for search in dict.fromkeys((method, "levenberg-marquardt")):
            try:
                run = run_from(start, search)
            except GraphError:
                if initialize == "given" and best is None:
                    raise
                continue
            cost = graph.cost(run.state) if run.converged else np.inf
            run.reason += f" (started {initialize}, {search})"
            if best is None or cost < best_cost:
                best, best_cost = run, cost
            # an end above the start's own cost is not an end to be content with
            if run.converged and best_cost <= given_cost * (1 + 1e-9):
                return best
    assert best is not None
    return best


def _gauss_newton(graph: Graph, run: _Run, tolerance: float, max_iterations: int) -> None:
    run.reason = f"max_iterations = {max_iterations} reached"
    factor: Factor | None = None
    for _ in range(max_iterations):
        system, cost = graph.linearize(run.state)
        if run.diverged(cost) or run.settled(cost):
            return
        if factor is None:
            factor = _factorize(graph, run.state)
        delta = factor.solve(system.xi)
        # what the quadratic model promises: J falls by Delta' Omega Delta = xi' Delta
        promised = _inner(system.xi, delta)
        run.step(cost, delta)
        if run.finished(tolerance, promised):
            return
        # After a step this short Omega is all but the same, and the next one only has to confirm that it ends here.
        if promised > CONFIRMED * run.cost_tolerance * cost:
            factor = None


def _factorize(graph: Graph, state: Array, damping: float = 0.0) -> Factor:
    try:
        return graph.system.factorize(damping)
    except SingularPivot as error:
        raise undetermined(graph, state, error) from None


def _levenberg_marquardt(graph: Graph, run: _Run, tolerance: float, max_iterations: int) -> None:
    # Marquardt's damping by the diagonal, updated by Nielsen's rule
    damping, growth = 1e-4, 2.0
    run.reason = f"max_iterations = {max_iterations} reached"
    while len(run.step_norms) < max_iterations:
        # state-dependent information is re-evaluated once per step and held still while the step is tried
        reference = run.state
        system, cost = graph.linearize(run.state, reference)
        if run.diverged(cost) or (damping < 1e-6 and run.settled(cost)):
            return
        while True:
            delta = _factorize(graph, run.state, damping).solve(system.xi)
            tried = graph.cost(run.state + delta, reference)
            # the damped quadratic model promises that J falls by Delta'(xi + damping diag(Omega) Delta)
            promised = float(np.sum(delta * (system.xi + damping * system.diagonal() * delta)))
            # below the rounding error of J a comparison of costs says nothing
            negligible = abs(promised) <= 1e-12 * cost
            if negligible or (np.isfinite(tried) and tried < cost):
                break
            damping, growth = damping * growth, growth * 2
            if damping > 1e16:
                run.reason = f"stuck: no step lowers the cost {cost:.6g}, however short"
                return
        gain = 1.0 if negligible else (cost - tried) / promised
        damping, growth = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-15), 2.0
        run.step(cost, delta)
        # a short step means something only when damping does not shorten it
        if damping < 1e-6 and run.finished(tolerance, promised):
            return


@njit(cache=True)
def _inner(a: Array, b: Array) -> float:
    # not np.vdot: beyond 10^4 numbers BLAS wakes its threads, which costs more than a factorisation
    total = 0.0
    for k in range(len(a)):
        for c in range(3):
            total += a[k, c] * b[k, c]
    return total
