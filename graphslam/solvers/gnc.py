"""Graduated non-convexity: a solver that finds out which sightings are wrong, together with the trajectory.

Truncated least squares counts a sighting with r² = e' Omega e as at most c². A wrong sighting then costs the same however
wrong it is, and has no influence on the solution. This cost has very many minima. Graduated non-convexity searches a good
one by a sequence of problems. The first is close to least squares (mu near 0), the last to truncated least squares (mu
large). For each mu the graph is solved with a trust w between 0 and 1 in every sighting. Then the trust is computed again:

    w = 1 for r² <= mu / (mu + 1) c²,   w = 0 for r² >= (mu + 1) / mu c²,   w = c sqrt(mu (mu + 1)) / r - mu between.

Each sighting has one trust, not each edge: one wrong sighting affects K - 1 pair edges, and its trust reduces the weight of
all of them. Therefore the sequence is computed with landmark nodes and Cartesian residuals, whatever the edges of the graph,
and the resulting trust is applied to the graph itself. Headings make even the squares non-convex, so a sequence may end in a
poor minimum. Where there are few pairs, a second sequence is computed on pair edges; the lower truncated cost counts.

Source: Yang, Antonante, Tzoumas and Carlone, *Graduated non-convexity for robust spatial perception*, RA-L 2020.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from ..edges import EdgeFamily, MarginalEdges, ObservationEdges, VirtualMotionEdges
from ..edges.robust import Cauchy
from ..errors import GraphError, OptionError
from ..graph import Graph
from ..parameters.corrected import corrected, sighted_edges
from ..se2 import Array
from ..solution import Solution
from ..transform import poses_only, with_landmark_nodes
from .initial_values import place_landmarks
from .iteration import Run
from .levenberg_marquardt import levenberg_marquardt
from .minimize import minimize
from .with_parameters import without_parameters

#: mu grows by this factor from one graph to the next
GROWTH = 1.4
#: the most damped steps in a round: the next one changes the problem anyway
STEPS = 5
#: a second sequence is computed where there are at most so many pairs of sightings
PAIRS = 5_000
#: the most rounds in which the trust is computed again after a sequence on other edges
LAST_ROUNDS = 20
#: a sighting with less trust than this counts as rejected
REJECTED = 0.5


def solve_gnc(graph: Graph, tolerance: float, max_rounds: int, initialize: str, probability: float) -> Solution:
    """`solve` with the method "gnc": c² is the quantile of ``probability``, and ``max_rounds`` the most values of mu.

    Motion edges and anchors are always trusted.

    Raises:
        GraphError: the graph has no edges from sightings, or does not determine its nodes.
    """
    if max_rounds < 1:
        raise OptionError(f"max_iterations must be at least 1 for the method gnc, not {max_rounds}")
    begin = time.perf_counter()
    if graph.parameters is not None:
        graph = _at_robust_parameters(graph, initialize)
    best = _best_sequence(without_parameters(graph), probability, max_rounds, initialize)
    trust, weighted = best.trust, graph.with_trust(best.trust)
    start = weighted.with_initial(place_landmarks(weighted, best.state[: len(graph.steps)]))
    solution = minimize(start, tolerance=tolerance, initialize="given")
    rejected = int(np.count_nonzero(trust < REJECTED))
    note = f"graduated non-convexity rejected {rejected} of {len(trust)} sightings in {best.rounds} rounds"
    if graph.log is not None:
        of_edges, trust = trust, np.full(len(graph.log.steps), np.nan)
        trust[graph.sighting_rows] = of_edges
    partly = f"after max_iterations = {best.rounds} some sightings are trusted in part"
    return replace(
        solution,
        converged=solution.converged and best.settled,
        reason=solution.reason if best.settled else partly,
        seconds=time.perf_counter() - begin,
        notes=(*graph.notes, note),
        trust=trust,
    )


def _at_robust_parameters(graph: Graph, initialize: str) -> Graph:
    """The graph at parameters that a robust kernel finds: at wrong parameters correct sightings would be rejected."""
    seen = sighted_edges(graph)
    robust = replace(seen, kernel=Cauchy())  # type: ignore[type-var]
    families = tuple(robust if family is seen else family for family in graph.families)
    found = minimize(replace(graph, families=families), tolerance=_rough(graph), initialize=initialize)
    assert found.graph is not None and found.graph.parameters is not None
    return corrected(graph, found.graph.parameters.values, found.state).with_initial(found.state)


@dataclass(frozen=True)
class _Sequence:
    """The end of a sequence of surrogates; ``settled`` where every sighting is fully trusted or rejected."""

    state: Array
    trust: Array
    rounds: int
    settled: bool


@dataclass(frozen=True, eq=False)
class _Sightings:
    """The residuals of the sightings of a graph, about the landmarks that the trusted ones give, and the other edges.

    Attributes:
        edges: the sightings grouped by landmark, in the order ``order`` (M,).
        others: the other edges.
        limit: c², at which squares are truncated.
    """

    edges: MarginalEdges
    order: np.ndarray
    others: tuple[EdgeFamily, ...]
    limit: float

    @classmethod
    def of(cls, graph: Graph, probability: float) -> _Sightings:
        """The squares of a graph with landmark nodes."""
        edges = next(family for family in graph.families if isinstance(family, ObservationEdges))
        order = np.lexsort((edges.first, edges.second))
        _, starts = np.unique(edges.second[order], return_index=True)
        grouped = MarginalEdges(np.append(starts, len(order)), edges.first[order], edges.sightings[order], edges.sensor)
        # the quantile of chi-square with d degrees of freedom
        limit = float(2 * gammaincinv(edges.sightings.shape[1] / 2, probability))
        return cls(grouped, order, tuple(family for family in graph.families if family is not edges), limit)

    def squares(self, state: Array, trust: Array) -> Array:
        """r² (M,) of every sighting, as if it were fully trusted itself."""
        squares = np.empty(len(self.order))
        squares[self.order] = replace(self.edges, trust=trust[self.order]).squares(state, state)
        return squares

    def cost(self, sequence: _Sequence) -> float:
        """The truncated squares of the sightings, and the cost of all other edges."""
        state = sequence.state
        squares = np.minimum(self.squares(state, sequence.trust), self.limit)
        return float(squares.sum() + sum(other.cost(state, state) for other in self.others))


def _best_sequence(graph: Graph, probability: float, max_rounds: int, initialize: str) -> _Sequence:
    """The better of two sequences, one on landmark nodes, one on pair edges."""
    nodes = with_landmark_nodes(graph)
    if nodes is None:
        raise GraphError("graduated non-convexity needs edges from sightings, and this graph has none")
    nodes = nodes.with_initial(place_landmarks(nodes, nodes.initial[: len(nodes.steps)]))
    sightings = _Sightings.of(nodes, probability)
    best = _sequence(nodes, np.arange(len(sightings.order)), sightings, max_rounds, initialize)
    f = sightings.edges
    pairs = VirtualMotionEdges(f.starts, f.nodes, f.sightings, f.sensor)
    if best.rounds == 0 or pairs.count > PAIRS:
        return best
    try:
        other = _sequence(
            poses_only(nodes, [pairs, *sightings.others]), sightings.order, sightings, max_rounds, initialize
        )
    except GraphError:
        return best  # without psi, pair edges may leave poses undetermined that landmark nodes determine
    other = _finished(nodes, other, sightings)
    # a sequence that has not settled is used only where none has
    return min(best, other, key=lambda each: (not each.settled, sightings.cost(each)))


def _sequence(graph: Graph, order: np.ndarray, sightings: _Sightings, max_rounds: int, initialize: str) -> _Sequence:
    """The sequence from plain squares to squares truncated at c²; the edges have the sightings in an order (M,)."""
    limit, trust = sightings.limit, np.ones(len(order))
    state = minimize(graph, tolerance=_rough(graph), initialize=initialize).state
    squares = sightings.squares(state, trust)
    largest = float(squares.max(initial=0.0))
    mu = limit / (2 * largest - limit) if 2 * largest > limit else np.inf
    rounds, settled = 0, largest <= limit
    while rounds < max_rounds and not settled:
        rounds += 1
        trust = truncated_trust(squares, limit, mu)
        settled = bool(np.all((trust == 0) | (trust == 1)))
        state = _damped(graph, trust[order], state)
        squares = sightings.squares(state, trust)
        mu *= GROWTH
    return _Sequence(state, trust, rounds, settled)


def _finished(graph: Graph, sequence: _Sequence, sightings: _Sightings) -> _Sequence:
    """The end of another graph's sequence, taken on to the nearest minimum of the truncated squares with landmark nodes."""
    if not sequence.settled:
        return sequence
    trust, state = sequence.trust, place_landmarks(graph.with_trust(sequence.trust), sequence.state)
    for _ in range(LAST_ROUNDS):
        state = _damped(graph, trust, state)
        before, trust = trust, truncated_trust(sightings.squares(state, trust), sightings.limit, np.inf)
        if np.array_equal(trust, before):
            break
    return replace(sequence, trust=trust, state=state)


def _damped(graph: Graph, trust: Array, state: Array) -> Array:
    """The state (n, 3) after some damped steps with this trust."""
    run = Run(state, _rough(graph), STEPS)
    levenberg_marquardt(graph.with_trust(trust), run)
    return run.state


def _rough(graph: Graph) -> float:
    """The step norm below which the trust in sightings is determined."""
    return 1e-3 * len(graph.steps) ** 0.5


def truncated_trust(squares: Array, limit: float, mu: float) -> Array:
    """The trust (M,) in sightings with squared norms (M,), truncated at ``limit`` = c²; 0 or 1 for infinite mu."""
    if not np.isfinite(mu):
        return (squares <= limit).astype(float)
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squares, 1e-300)) - mu
    return np.where(
        squares <= mu / (mu + 1) * limit, 1.0, np.where(squares >= (mu + 1) / mu * limit, 0.0, np.clip(between, 0, 1))
    )
