"""`Certificate`: what is proven about the cost of a state, and the words for it.

`prove`: whether a state is a global minimum of the cost of a graph, with a lower bound on the cost of all states.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..edges import ConstantEdges
from ..engine import engine
from ..errors import GraphError
from ..errors.checks import first
from ..graph import Graph
from ..linear.cholesky import ROUNDOFF, HermitianFactor, HermitianSymbolic, amd, analyze_hermitian, factorize
from ..linear.information import BlockSystem
from ..se2 import Array, wrap

GLOBAL, NOT_PROVEN, NOT_APPLICABLE = "global", "not proven", "not applicable"
#: a global minimum of the cost with the weights of a robust kernel held at those of the state, ...
GLOBAL_WEIGHTS = "global for its weights"
#: ... with the parameters of the graph held at their values, ...
GLOBAL_HELD = "global with the parameters held"
#: ... and with both held
GLOBAL_WEIGHTS_HELD = "global for its weights with the parameters held"
#: the relative gap up to which a state counts as a global minimum, and J itself where all residuals are zero to rounding
PROVEN = 1e-6


@dataclass(frozen=True)
class Certificate:
    """A bound on how far the cost J of a state is above the global minimum, and its status.

    Attributes:
        status: "global": no state has a cost below ``lower_bound``, and ``relative_gap`` is at most `PROVEN`;
            "global with the parameters held": the same among all states with the values that the parameters of the graph
            have. Other values of them may have a lower cost.
            "global for its weights": with a robust kernel, the same about the cost in which the kernel's weights are held at
            those of the state. This is necessary for a global minimum of J, and not sufficient (see `prove`);
            "global for its weights with the parameters held": both.
            "not proven": there may be a lower minimum, or not; "not applicable": edges stand outside of the theory.
        lower_bound: no state has a lower J in exact arithmetic; 0 where nothing better is known, and always with a kernel;
            NaN where not applicable.
        relative_gap: (J - lower_bound) / J, between 0 and 1; 0 where J is zero up to rounding; NaN where not applicable, or
            where no bound above 0 is known. With a kernel it is that of the cost with the weights held.
        reason: one sentence.
        seconds: the time of the check.
        direction: (n, 2) complex changes of z and t (unit complex headings, complex positions) along which the function below
            J falls, where S has a negative direction; None otherwise.
    """

    status: str
    lower_bound: float
    relative_gap: float
    reason: str
    seconds: float
    direction: Array | None = field(default=None, repr=False)

    @property
    def proven(self) -> bool:
        """Whether the global minimum is proven; the status names what is held fixed for that."""
        return self.status in (GLOBAL, GLOBAL_WEIGHTS, GLOBAL_HELD, GLOBAL_WEIGHTS_HELD)

    @property
    def applicable(self) -> bool:
        """Whether the theory covers the graph."""
        return self.status != NOT_APPLICABLE

    def of_run(self, converged: bool, reason: str) -> Certificate:
        """The certificate of a solver's end: "not proven" where the solver has not converged, however tight the bound is."""
        if converged or not self.applicable:
            return self
        also = "" if self.proven else f"; {self.reason}"
        return replace(self, status=NOT_PROVEN, reason=f"the solver has not converged: {reason}{also}")


#: where J is at most `PROVEN`, and all residuals at most this part of what the edges measure, J counts as zero
ZERO = 1e-6
#: how far a state may be from the fixed nodes of its graph, relative to their coordinates
HELD = 1e-9
#: the part of an information matrix by which its rows and columns may differ, and its scaled eigenvalues be negative
ROUNDED = 1e-9, 64 * ROUNDOFF
#: the split of the information that is tried first, see `QuadraticBound`, and those among which each edge may choose
SHARE, SHARES = 0.3, (0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 0.95)
#: the most times that the edges choose again
ROUNDS = 8
#: factorisations spent on a lower bound where S is not positive definite
ATTEMPTS = 9


class Curvature(NamedTuple):
    """The split of each edge.

    Attributes:
        beta, A: (E,); beta = -1 leaves the edge out.
        error: (E,) a bound on the rounding error of A, in units.
        slack: (E,) the rounding errors that the parts of beta and kappa do not absorb.
    """

    beta: Array
    A: Array
    error: Array
    slack: Array


class QuadraticBound(NamedTuple):
    """A convex quadratic function below J that touches it at a candidate state of N nodes, in (z, t) of the free nodes.

    The engine computes it, and has the equations: ``engine/include/vmslam/certificate/minorant.hpp``.

    Attributes:
        values: (nnzb, 2, 2) complex, the blocks of S on the pattern of the graph.
        gradient: (N, 2) complex, half the gradient at the candidate; zero at a stationary point.
        scale: (N, 2) the sums of the absolute values that were added to each diagonal entry of S, or more.
        error: (N, 2) a bound on the rounding error of ``gradient``, in units.
        touched: the cost at the candidate, without the edges that were left out.
        slack: a bound on its rounding errors.
    """

    values: Array
    gradient: Array
    scale: Array
    error: Array
    touched: float
    slack: float


def prove(graph: Graph, state: Array, *, cost: float | None = None, thorough: bool = True) -> Certificate:
    """Check whether a state (n, 3) is a global minimum of the cost of a graph; docs/certificate.md explains how.

    With a robust kernel, J = sum of rho(r²) with rho concave, as for all kernels of `edges.robust`. A concave function lies
    below its tangent: with the weights w = rho'(r*²) of the state x*,

        J(x) <= J(x*) + Q(x) - Q(x*),    Q(x) = sum of w r²,

    with equality at x*. So at a global minimum x* of J the weighted cost Q, too, has its global minimum: this is what is
    proven then ("global for its weights"). It is necessary and not sufficient: at another state with other weights J may be
    lower. A state at which Q is lower than at x* has a lower J. (Source: Lange, Hunter and Yang, *Optimization transfer using
    surrogate objective functions*, 2000.)

    Where the graph has parameters, they are held at their values, and nothing is said about other values.

    Args:
        graph: with the edges whose cost is minimised.
        state: the candidate.
        cost: J at the state, where it is known; not used with a kernel.
        thorough: whether to try again after a failure, with better splits of the information and a lower bound on
            the cost. That takes some 50 factorisations instead of one.
    """
    begin = time.perf_counter()
    state = np.array(state, dtype=float)
    # the priors of parameters that are held are constant
    constant = graph.prior_cost
    if graph.reweighted:
        cost, constant = sum(family.weighted_cost(state) for family in graph.families), 0.0
    cost = (graph.cost(state) if cost is None else cost) - constant
    strayed = state[graph.fixed] - graph.initial[graph.fixed]
    strayed[:, 2] = wrap(strayed[:, 2])
    moved = graph.fixed[np.any(np.abs(strayed) > HELD * (1 + np.abs(graph.initial[graph.fixed])), axis=1)]
    if len(moved):
        outcome: _Outcome = NOT_PROVEN, 0.0, f"the state moves {graph.names(moved)}, which the graph holds", None
    else:
        state[graph.fixed] = graph.initial[graph.fixed]
        outcome = _outcome(lambda: _Problem.of(graph, state), cost, thorough)
    if graph.reweighted:
        outcome = _for_weights(outcome)
    status, bound, reason, direction = outcome
    if graph.parameters is not None and status in _HELD:
        status, reason = _HELD[status], f"with the parameters held at their values, {reason}"
    return _certificate((status, bound + constant, reason, direction), cost + constant, begin, graph.reweighted)


#: the status of a proof that holds the parameters
_HELD = {GLOBAL: GLOBAL_HELD, GLOBAL_WEIGHTS: GLOBAL_WEIGHTS_HELD}


def _for_weights(outcome: _Outcome) -> _Outcome:
    """The outcome of a proof about the cost with the weights of a kernel held, as one about the kernel's cost."""
    status, bound, reason, direction = outcome
    # at residuals of zero the kernel's cost is zero, too, and no cost is lower
    if status == NOT_APPLICABLE or (status == GLOBAL and bound == 0):
        return outcome
    return (
        GLOBAL_WEIGHTS if status == GLOBAL else status,
        bound,
        f"with the weights of the kernel held, {reason}",
        direction,
    )


def prove_edges(edges: Sequence[ConstantEdges], state: Array, fixed: np.ndarray, cost: float) -> Certificate:
    """`prove` for edges that belong to no `Graph`.

    Args:
        edges: their ``landmarks`` follow the rows of the state.
        state: (n, 3) the candidate.
        fixed: the nodes that are held at their rows of the state.
        cost: of the state.
    """
    begin = time.perf_counter()
    nodes = np.concatenate([state, *(each.landmarks for each in edges)])
    outcome = _outcome(lambda: _Problem.of_edges(edges, nodes, fixed, len(state)), cost, thorough=True)
    return _certificate(outcome, cost, begin)


#: status, lower bound, reason and direction of a `Certificate`
_Outcome: TypeAlias = tuple[str, float, str, Array | None]


def _certificate(outcome: _Outcome, cost: float, begin: float, weighted: bool = False) -> Certificate:
    """The certificate of an outcome; ``weighted`` if cost and bound are those of the weights of a kernel, not of J."""
    status, bound, reason, direction = outcome
    if bound > 0:
        gap = (cost - bound) / cost
    else:
        # a state of cost zero, also up to rounding, is proven with the bound 0
        gap = np.nan if status in (NOT_PROVEN, NOT_APPLICABLE) else 0.0
    if weighted and status != NOT_APPLICABLE:
        bound = 0.0
    return Certificate(status, float(bound), float(gap), reason, time.perf_counter() - begin, direction)


def _outcome(problem: Callable[[], _Problem], cost: float, thorough: bool) -> _Outcome:
    if not np.isfinite(cost):
        return NOT_PROVEN, 0.0, "the cost of the state is not finite, or the state violates a constraint", None
    try:
        return _judged(problem(), cost, thorough)
    except GraphError as error:
        return NOT_APPLICABLE, np.nan, str(error), None


def _judged(problem: _Problem, cost: float, thorough: bool) -> _Outcome:
    curve, direction = problem.curvature(SHARE), None
    if not problem.check_information(curve):
        reason = "an edge has singular information, whose smallest eigenvalue is negative by rounding, so that J has no bound"
        return NOT_PROVEN, 0.0, reason, None
    function = problem.quadratic_bound(curve)
    exact = float(problem.forces.cost.sum())
    if max(cost, exact) <= PROVEN and problem.zero():
        return (
            GLOBAL,
            0.0,
            "the residuals of all edges are zero up to the tolerance of solvers, and no cost is below 0",
            None,
        )
    if not abs(exact - cost) <= PROVEN * cost + function.slack:
        return NOT_PROVEN, 0.0, f"the edges in their constant form have the cost {exact:g} instead of {cost:g}", None
    bound, factor = problem.bound(function)
    if factor.negative is not None:
        direction = factor.negative[: problem.given]
        if thorough:
            bound = problem.raised_bound(curve, function)
    best = max(0.0, min(bound, cost))
    if cost - best <= PROVEN * cost:
        return GLOBAL, best, f"no state has a cost lower by more than {(cost - best) / cost:.1e} of J", None
    omitted = int(np.sum(curve.beta < 0))
    if omitted:
        reason = f"{omitted} edges have a heading residual near half a turn, or singular information"
    elif direction is None:
        reason = (
            f"the state is not a stationary point of J: a step from it promises to lower J by up to {cost - bound:.2g}"
        )
    else:
        reason = "the matrix S has a negative direction, so that there may be a lower minimum"
    return NOT_PROVEN, best, reason, direction


@dataclass(frozen=True, eq=False)
class _Problem:
    """The edges of a graph in one list, the pattern of S and the nodes that are free."""

    state: Array
    edges: tuple[Array, ...]
    free: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    symbolic: HermitianSymbolic
    #: the edges at the state, in the engine: their ``cost`` (E,), whether all residuals are ``zero``, see `QuadraticBound`
    forces: Any
    given: int
    #: (N,) a bound on the rounding errors of sums over the edges that meet at a node, in units of their terms
    summation: Array

    @classmethod
    def of(cls, graph: Graph, state: Array) -> _Problem:
        reasons: list[str] = []
        parts: list[ConstantEdges] = []
        nodes = np.array(state, dtype=float)
        for family in graph.families:
            try:
                edges = family.constant(nodes)
            except GraphError as error:
                reasons.append(str(error))
                continue
            parts.append(edges)
            nodes = np.concatenate([nodes, edges.landmarks])
        if reasons:
            raise GraphError("; ".join(dict.fromkeys(reasons)))
        system = graph.system if len(nodes) == graph.num_nodes else None
        return cls.of_edges(parts, nodes, graph.fixed, graph.num_nodes, system)

    @classmethod
    def of_edges(
        cls,
        edges: Sequence[ConstantEdges],
        nodes: Array,
        fixed: np.ndarray,
        given: int,
        system: BlockSystem | None = None,
    ) -> _Problem:
        """The problem of edges at the values (N, 3) of all nodes, of which the first ``given`` are those of the graph."""
        n, joined = len(nodes), _joined(edges)
        first, second = joined[:2]
        if system is not None:
            symbolic = system.structure.hermitian
        else:
            tied = first >= 0
            pairs = np.sort(np.column_stack([first[tied], second[tied]]), axis=1)
            system = BlockSystem.from_cliques(n, [(np.arange(0, 2 * len(pairs) + 1, 2), pairs.ravel())])
            symbolic = analyze_hermitian(system.indptr, system.indices, amd(system.indptr, system.indices))
        free = np.ones(n, dtype=bool)
        free[fixed] = False
        ends = engine.hold_roots(first, second, free)
        force = engine.Candidate(nodes, *joined)
        summation = ROUNDOFF * (128.0 + 4 * ends)
        return cls(nodes, joined, free, system.indptr, system.indices, symbolic, force, given, summation)

    def check_information(self, curve: Curvature) -> bool:
        """Raise `GraphError` where the information of an edge has a negative eigenvalue, beyond its rounding.

        Only edges without a split can have one. The result is whether all are positive semi-definite in exact arithmetic.
        """
        suspects = np.flatnonzero(curve.beta < 0)
        if not len(suspects):
            return True
        W = self.edges[6][suspects][:, [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
        diagonal = np.einsum("eii->ei", W)
        size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        smallest = np.linalg.eigvalsh(W / size[:, :, None] / size[:, None, :])[:, 0]
        if (k := first(smallest < -ROUNDED[1])) is not None:
            a, b = (int(nodes[suspects[k]]) for nodes in self.edges[:2])
            ends = f"node {b}" if a < 0 else f"the nodes {a} and {b}"
            raise GraphError(f"the information of an edge at {ends} is not positive semi-definite")
        return all(_semidefinite(W[k]) for k in np.flatnonzero(smallest < ROUNDED[1]))

    def zero(self) -> bool:
        """Whether all residuals are zero up to rounding, or at most `ZERO` of what the edges measure, so that J is no guide.

        A solver stops at steps of 1e-9, not at the rounding error of the state. The scale of the information does not
        matter here: at a wrong minimum of perfect measurements some residuals are of the size of the world.
        """
        if self.forces.zero.all():
            return True
        first, second, start, end, turn, oriented, _ = self.edges
        theta = np.where(first >= 0, self.state[first, 2], 0.0)
        error = self.forces.reached - (start[:, 0] + 1j * start[:, 1])
        size = np.max(np.abs(self.forces.reached) + np.hypot(*end.T), where=first >= 0, initial=0.0)
        wrong = np.where(oriented, wrap(self.state[second, 2] - theta - turn), 0.0)
        return bool(np.all(np.abs(error) <= ZERO * size) and np.all(np.abs(wrong) <= ZERO))

    def curvature(self, share: float) -> Curvature:
        """The split of the information of all edges for one share."""
        return Curvature(*self.forces.curvature(share))

    def quadratic_bound(self, curve: Curvature) -> QuadraticBound:
        """The function below J for a split."""
        return QuadraticBound(*self.forces.minorant(self.free, self.indptr, self.indices, *curve))

    def bound(self, function: QuadraticBound, shift: Array | float = 0.0) -> tuple[float, HermitianFactor]:
        """A lower bound on the cost of all states, -inf where S is not proven positive definite, and the factor of S.

        Args:
            function: the function below J.
            shift: (N,) to add to the diagonal of S, and to the multipliers of the headings.
        """
        # S is at least what is assembled minus ``assembled``, and L L^H is at most that minus ``assembled + margin``,
        # so that S is at least L L^H plus ``margin``.
        shifts = np.full(len(function.scale), shift)
        assembled, margin = engine.margins(
            function.scale, shifts, self.summation, self.symbolic.rounding, self.symbolic.order
        )
        while True:
            values = engine.changed(function.values, self.indptr, function.scale, shifts, assembled, margin)
            factor = factorize(self.symbolic, values)
            if factor.negative is not None:
                return -np.inf, factor
            if np.all(factor.error <= margin):
                break
            margin = np.where(function.scale > 0, np.maximum(margin, assembled + 2 * factor.error), 1.0)
        gradient, terms = function.gradient, function.error
        if np.any(shift):
            gradient, terms = gradient.copy(), terms.copy()
            terms[:, 0] += shifts
            gradient[:, 0] += shift * np.exp(1j * self.state[:, 2]) * self.free
        # rounding errors of the gradient
        error = np.sqrt(np.sum((self.summation[:, None] * terms) ** 2 / margin))
        decrease = (np.sqrt(factor.square(gradient)) + 1.001 * error) ** 2
        return function.touched - decrease - function.slack, factor

    def raised_bound(self, curve: Curvature, function: QuadraticBound) -> float:
        """The best lower bound after each edge has chosen its split for the directions in which S is the smallest.

        S is linear in beta and A, and the split of an edge may be any average of splits. Each round finds the smallest
        direction of S, in which every edge takes the split that is best there, and averages it with the ones before
        (Frank and Wolfe 1956, for the smallest eigenvalue).
        """
        choices = [self.curvature(share) for share in SHARES]
        best = -np.inf
        for k in range(ROUNDS):
            bound, factor, shift = self.shifted(function)
            best = max(best, bound)
            if shift == 0.0 or factor is None:
                break
            x = self.smallest(factor, function)
            stretched, turned = self.forces.strains(x)
            part = 2 / (k + 3)
            gains = [np.where(c.beta < 0, -np.inf, c.beta * stretched + c.A * turned) for c in choices]
            chosen = np.argmax(gains, axis=0), np.arange(len(curve.beta))
            beta, A, error, slack = (np.array(rows)[chosen] for rows in zip(*choices))
            beta, A = (1 - part) * curve.beta + part * beta, (1 - part) * curve.A + part * A
            out = (curve.beta < 0) | (beta < 0)
            error, slack = np.maximum(curve.error, error), np.maximum(curve.slack, slack)
            curve = Curvature(np.where(out, -1.0, beta), A, error, slack)
            function = self.quadratic_bound(curve)
        return best

    def shifted(self, function: QuadraticBound) -> tuple[float, HermitianFactor | None, float]:
        """The best lower bound among a few shifts of the multipliers, with the factor for the least, and that shift.

        With lower multipliers S is positive definite, but its function touches J no longer at its own minimum.
        """
        weight = function.scale[:, 0] / 8
        bound, factor = self.bound(function)
        if factor.negative is None:
            return bound, factor, 0.0
        low, high, best, least = 0.0, 1e-6, -np.inf, None
        for _ in range(ATTEMPTS):
            middle = high if least is None else np.sqrt(low * high) if low else high / 10
            bound, factor = self.bound(function, middle * weight)
            best = max(best, bound)
            if factor.negative is not None:
                low, high = middle, 10 * high if least is None else high
            else:
                high, least = middle, factor
        return best, least, high

    def smallest(self, factor: HermitianFactor, function: QuadraticBound) -> Array:
        """About the smallest direction (N, 2) of S against its scale, by inverse iteration with a shifted factor."""
        weight = np.where(function.scale > 0, function.scale, 0.0)
        x = np.random.default_rng(0).standard_normal((len(self.state), 2)) + 0j
        for _ in range(5):
            x = factor.solve(weight * x)
            x /= np.sqrt(np.sum(weight * np.abs(x) ** 2))
        return x


def _semidefinite(W: Array) -> bool:
    """Whether a symmetric matrix (3, 3) is positive semi-definite, in exact arithmetic: all principal minors are >= 0."""
    a, b, c, d, e, f = (Fraction(float(number)) for number in W[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]])
    two = min(a * c - b * b, a * f - d * d, c * f - e * e)
    return min(a, c, f, two, a * (c * f - e * e) - b * (b * f - d * e) + d * (b * e - c * d)) >= 0


def _joined(parts: Sequence[ConstantEdges]) -> tuple[Array, ...]:
    first = np.concatenate([np.zeros(0, np.int64), *(edges.first for edges in parts)])
    second = np.concatenate([np.zeros(0, np.int64), *(edges.second for edges in parts)])
    start = np.concatenate([np.zeros((0, 2)), *(edges.start for edges in parts)])
    end = np.concatenate([np.zeros((0, 2)), *(edges.end for edges in parts)])
    turn, oriented, information = np.zeros(len(first)), np.zeros(len(first), dtype=bool), np.zeros((len(first), 6))
    at = 0
    for edges in parts:
        to = at + len(edges.first)
        if not engine.take_upper(edges.information, information[at:to], ROUNDED[0]):
            raise GraphError("the information of an edge is not symmetric")
        if edges.turn is not None:
            turn[at:to], oriented[at:to] = edges.turn, True
        at = to
    return first, second, start, end, turn, oriented, information
