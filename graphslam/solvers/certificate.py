"""`Certificate`: what is proven about the cost of a state, and the words for it.

`prove` checks whether a state is a global minimum of the cost of a graph, with a lower bound on the cost of all states.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from ..edges import ConstantEdges, EdgeFamily
from ..edges.base import EngineEdges, check_nodes, check_rows
from ..engine import engine
from ..errors import GraphError
from ..graph import Graph
from ..linear.information import Structure
from ..se2 import Array, difference

GLOBAL, NOT_PROVEN, NOT_APPLICABLE = "global", "not proven", "not applicable"
#: what the first one ends with where the minimum is that of the cost with the weights of a robust kernel held at those of
#: the state, and with the parameters of the graph held at their values
FOR_WEIGHTS, WITH_PARAMETERS = " for its weights", " with the parameters held"
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
        return self.status.startswith(GLOBAL)

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


#: how far a state may be from the fixed nodes of its graph, relative to their coordinates
HELD = 1e-9
#: the part of an information matrix by which its rows and columns may differ
ROUNDED = 1e-9


def prove(graph: Graph, state: Array, *, cost: float | None = None, thorough: bool = True) -> Certificate:
    """Check whether a state (n, 3) is a global minimum of the cost of a graph; docs/beyond/certificate.md explains how.

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
    moved = _put_back(graph, state)
    if len(moved):
        outcome: _Outcome = NOT_PROVEN, 0.0, f"the state moves {graph.names(moved)}, which the graph holds", None
    else:
        outcome = _outcome(lambda: _problem(graph.families, state, graph.fixed, graph.system.structure), cost, thorough)
    status, bound, reason, direction = outcome
    proven = status == GLOBAL
    # at residuals of zero the kernel's cost is zero, too, and no cost is lower
    if graph.reweighted and status != NOT_APPLICABLE and not (proven and bound == 0):
        status, reason = status + FOR_WEIGHTS * proven, f"with the weights of the kernel held, {reason}"
    if graph.parameters is not None and proven:
        status, reason = status + WITH_PARAMETERS, f"with the parameters held at their values, {reason}"
    return _certificate((status, bound + constant, reason, direction), cost + constant, begin, graph.reweighted)


def _put_back(graph: Graph, state: Array) -> np.ndarray:
    """The fixed nodes that a state (n, 3) moves. What rounding and full turns have done to the others is undone."""
    given, there = graph.initial[graph.fixed], state[graph.fixed]
    if (given == there).all():
        return graph.fixed[:0]
    state[graph.fixed] = given
    return graph.fixed[np.any(np.abs(difference(there, given)) > HELD * (1 + np.abs(given)), axis=1)]


def prove_edges(edges: Sequence[EdgeFamily], state: Array, fixed: np.ndarray, cost: float) -> Certificate:
    """`prove` for edges that belong to no `Graph`.

    Args:
        edges: their families.
        state: (n, 3) the candidate.
        fixed: the nodes that are held at their rows of the state.
        cost: of the state.
    """
    begin = time.perf_counter()
    return _certificate(_outcome(lambda: _problem(edges, state, fixed), cost, thorough=True), cost, begin)


#: status, lower bound, reason and direction of a `Certificate`
_Outcome: TypeAlias = tuple[str, float, str, Array | None]


def _certificate(outcome: _Outcome, cost: float, begin: float, weighted: bool = False) -> Certificate:
    """The certificate of an outcome; ``weighted`` if cost and bound are those of the weights of a kernel, not of J."""
    status, bound, reason, direction = outcome
    # a state of cost zero, also up to rounding, is proven with the bound 0
    without = np.nan if status in (NOT_PROVEN, NOT_APPLICABLE) else 0.0
    gap = (cost - bound) / cost if bound > 0 else without
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
    """The outcome of a proof in words.

    Raises:
        GraphError: the information of an edge has a negative eigenvalue, beyond its rounding.
    """
    Finding, proof = engine.Finding, problem.proof
    finding, best, unsplit, ends, direction = proof.judge(cost, thorough)
    match finding:
        case Finding.global_minimum:
            return GLOBAL, best, f"no state has a cost lower by more than {(cost - best) / cost:.1e} of J", None
        case Finding.zero:
            reason = "the residuals of all edges are zero up to the tolerance of solvers, and no cost is below 0"
            return GLOBAL, 0.0, reason, None
        case Finding.other_cost:
            reason = f"the edges in their constant form have the cost {proof.cost:g} instead of {cost:g}"
        case Finding.without_bound:
            reason = "an edge has singular information, with an eigenvalue that is negative by rounding: J has no lower bound"
        case Finding.indefinite:
            where = f"node {ends[1]}" if ends[0] < 0 else f"the nodes {ends[0]} and {ends[1]}"
            raise GraphError(f"the information of an edge at {where} is not positive semi-definite")
        case Finding.unsplit:
            reason = f"{unsplit} edges have a heading residual near half a turn, or singular information"
        case Finding.not_stationary:
            promise = f"a step from it promises to lower J by up to {cost - best:.2g}"
            reason = f"the state is not a stationary point of J: {promise}"
        case Finding.negative:
            reason = "the matrix S has a negative direction, so that there may be a lower minimum"
    return NOT_PROVEN, best, reason, None if direction is None else direction[: problem.given]


def _problem(
    families: Sequence[EdgeFamily], state: Array, fixed: np.ndarray, structure: Structure | None = None
) -> _Problem:
    """The edges of families at a state (n, 3); ``structure`` is that of the state's nodes, where it is known."""
    reasons: list[str] = []
    taken, nodes = engine.ConstantEdges(), np.array(state, dtype=float)
    for family in families:
        try:
            if isinstance(family, EngineEdges) and type(family).constant is EngineEdges.constant:
                family.check_constant()
                landmarks = taken.take(family.in_engine, nodes)
            else:
                edges = family.constant(nodes)
                _add(taken, edges, len(nodes) + len(edges.landmarks))
                landmarks = edges.landmarks if len(edges.landmarks) else None
        except GraphError as error:
            reasons.append(str(error))
            continue
        if landmarks is not None:
            nodes = np.concatenate([nodes, landmarks])
    if reasons:
        raise GraphError("; ".join(dict.fromkeys(reasons)))
    if structure is not None and (len(nodes) != len(state) or taken.turn_with(len(nodes), structure.points)):
        structure = None
    return _Problem(taken, nodes, fixed, len(state), structure)


def _add(taken: Any, edges: ConstantEdges, nodes: int) -> None:
    """Add edges between ``nodes`` nodes.

    Raises:
        GraphError: an edge names another node, an array has another shape or is not finite, or the information of an edge is
            not symmetric.
    """
    check_nodes(edges, "first", "second")
    count, d = len(edges.first), 2 if edges.turn is None else 3
    check_rows(edges, start=(count, 2), end=(count, 2), information=(count, d, d))
    if edges.turn is not None:
        check_rows(edges, turn=(count,))
    if len(edges.second) != count or np.any(edges.first < -1) or np.any(edges.second < 0):
        message = "constant() of a family must name two nodes for each edge, of which the first may be -1, the world"
        raise GraphError(message)
    if count and max(edges.first.max(), edges.second.max()) >= nodes:
        raise GraphError(f"constant() of a family names a node above the last one, {nodes - 1}")
    arrays = edges.first, edges.second, edges.start, edges.end, edges.turn, edges.information
    if not taken.add(*arrays, ROUNDED):
        raise GraphError("the information of an edge is not symmetric")


class _Problem:
    """The edges of a graph (``engine.ConstantEdges``) at the values (N, 3) of all nodes; the graph has ``given`` of these.

    Attributes:
        proof: the function below J and its bounds, in the engine: ``engine/include/vmslam/certificate/proof.hpp``.
    """

    def __init__(
        self, edges: Any, nodes: Array, fixed: np.ndarray, given: int, structure: Structure | None = None
    ) -> None:
        structure = Structure(*edges.pattern(len(nodes))) if structure is None else structure
        self.given, self.structure, self.proof = given, structure, structure.proof()
        self.proof.begin(edges, nodes, np.asarray(fixed, np.int64))

    def __del__(self) -> None:
        # the next proof uses its memory again
        self.structure.spare[:] = [self.proof]
