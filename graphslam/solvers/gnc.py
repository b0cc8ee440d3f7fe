"""Graduated non-convexity: a solver that finds out which sightings are wrong, together with the trajectory.

Truncated least squares counts a sighting with r² = e' Omega e as at most c². A wrong sighting then costs the same however
wrong it is, and has no influence on the solution. This cost has very many minima. Graduated non-convexity searches a good
one by a sequence of problems. The first is close to least squares (mu near 0), the last to truncated least squares (mu
large). For each mu the graph is solved with a trust w between 0 and 1 in every sighting. Then the trust is computed again:

    w = 1 for r² <= mu / (mu + 1) c²,   w = 0 for r² >= (mu + 1) / mu c²,   w = c sqrt(mu (mu + 1)) / r - mu between.

Each sighting has one trust, not each edge: one wrong sighting affects K - 1 pair edges, and its trust reduces the weight of
all of them. Therefore r² is computed with the landmarks eliminated (`edges.marginal`), whatever the edges of the
graph, and the resulting trust is applied to the graph itself. Headings make even the squares non-convex, so a sequence may
end in a poor minimum. Two sequences are computed, on marginal and on pair edges; the lower truncated cost counts.

Source: Yang, Antonante, Tzoumas and Carlone, *Graduated non-convexity for robust spatial perception*, RA-L 2020.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from ..edges import LandmarkSightings, MarginalEdges, SightingEdges, VirtualMotionEdges
from ..errors import GraphError, OptionError
from ..graph import Graph
from ..se2 import Array
from ..solution import Solution
from ..transform import with_landmarks_eliminated
from .solve import solve
from .start import place_landmarks

#: mu grows by this factor from one graph to the next
GROWTH = 1.4
#: the most rounds in which the trust is computed anew after a sequence on other edges
LAST_ROUNDS = 20
#: a sighting with less trust than this counts as rejected
REJECTED = 0.5


def solve_gnc(
    graph: Graph,
    *,
    probability: float = 0.99,
    tolerance: float = 1e-9,
    max_rounds: int = 100,
    initialize: str = "auto",
) -> Solution:
    """Minimise the truncated squares of a graph's sightings by graduated non-convexity.

    Args:
        graph: with edges from sightings; motion edges and anchors are always trusted.
        probability: the fraction of correct sightings that should be accepted: c² is this quantile of the chi-square
            distribution with as many degrees of freedom as a sighting has numbers.
        tolerance: of the last solve, as in `solve`.
        max_rounds: the most values of mu to try.
        initialize: the start of the first solve, as in `solve`.

    Returns:
        The solution of the graph with the final trust, which is in `Solution.trust`. It is ``converged`` only if every
        sighting is fully trusted or rejected.

    Raises:
        GraphError: the graph has no edges from sightings, or does not determine its nodes.
        OptionError: an option has an impossible value.
    """
    if not 0 < probability < 1:
        raise OptionError(f"probability must lie between 0 and 1, not {probability!r}")
    if max_rounds < 1:
        raise OptionError(f"max_rounds must be at least 1, not {max_rounds}")
    begin = time.perf_counter()
    eliminated, order = _eliminated(graph)
    # this accuracy is enough to tell correct sightings from wrong ones
    best = _best_sequence(eliminated, probability, max(tolerance, 1e-6), max_rounds, initialize)
    trust = np.empty(len(order))
    trust[order] = best.trust
    weighted = _with_trust(graph, trust)
    start = weighted.with_initial(place_landmarks(weighted, best.solution.state))
    solution = solve(start, tolerance=tolerance, initialize="given")
    rejected = int(np.count_nonzero(trust < REJECTED))
    note = f"graduated non-convexity rejected {rejected} of {len(trust)} sightings in {best.rounds} rounds"
    if graph.log is not None:
        of_edges, trust = trust, np.full(len(graph.log.steps), np.nan)
        trust[graph.sighting_rows] = of_edges
    partly = f"after max_rounds = {best.rounds} some sightings are trusted in part"
    return replace(
        solution,
        converged=solution.converged and best.settled,
        reason=solution.reason if best.settled else partly,
        seconds=time.perf_counter() - begin,
        notes=(*graph.notes, note),
        trust=trust,
    )


@dataclass(frozen=True)
class _Sequence:
    """The end of a sequence of surrogates; ``settled`` where every sighting is fully trusted or rejected."""

    solution: Solution
    trust: Array
    rounds: int
    settled: bool


def _best_sequence(graph: Graph, probability: float, tolerance: float, max_rounds: int, initialize: str) -> _Sequence:
    """The better of two sequences on a graph with marginal edges."""
    f = _sighting_edges(graph)
    assert isinstance(f, MarginalEdges)
    # the quantile of chi-square with d degrees of freedom
    limit = float(2 * gammaincinv(f.sightings.shape[1] / 2, probability))
    sequences = [_sequence(graph, limit, tolerance, max_rounds, initialize)]
    pairs = VirtualMotionEdges(f.starts, f.nodes, f.sightings, f.sensor)
    try:
        other = _sequence(_exchanged(graph, pairs), limit, tolerance, max_rounds, initialize)
    except GraphError:
        pass  # without psi, pair edges may leave poses undetermined that marginal ones determine
    else:
        sequences.append(_finished(graph, other, limit, tolerance))
    # a sequence that has not settled is used only where none has
    return min(sequences, key=lambda each: (not each.settled, _truncated_cost(graph, each, limit)))


def _sequence(graph: Graph, limit: float, tolerance: float, max_rounds: int, initialize: str) -> _Sequence:
    """From plain squares to squares truncated at ``limit`` = c²."""
    family = _sighting_edges(graph)
    rough = max(tolerance, 1e-4)
    trust = np.ones(len(family.sightings))
    solution = solve(_with_trust(graph, trust), tolerance=rough, initialize=initialize)
    squares = _squares(family, trust, solution.state)
    largest = float(squares.max(initial=0.0))
    mu = limit / (2 * largest - limit) if 2 * largest > limit else np.inf
    rounds, settled = 0, False
    while rounds < max_rounds and not settled:
        rounds += 1
        trust = truncated_trust(squares, limit, mu)
        settled = bool(np.all((trust == 0) | (trust == 1)))
        solution = _damped(graph, trust, solution, tolerance if settled else rough)
        squares = _squares(family, trust, solution.state)
        mu *= GROWTH
    return _Sequence(solution, trust, rounds, settled)


def _finished(graph: Graph, sequence: _Sequence, limit: float, tolerance: float) -> _Sequence:
    """The end of another graph's sequence, taken on to the nearest minimum of this graph's truncated squares."""
    if not sequence.settled:
        return sequence
    family, trust, solution = _sighting_edges(graph), sequence.trust, sequence.solution
    for _ in range(LAST_ROUNDS):
        solution = _damped(graph, trust, solution, tolerance)
        before, trust = trust, truncated_trust(_squares(family, trust, solution.state), limit, np.inf)
        if np.array_equal(trust, before):
            break
    return replace(sequence, trust=trust, solution=solution)


def _damped(graph: Graph, trust: Array, start: Solution, tolerance: float) -> Solution:
    """The solution of the graph with this trust, by damped steps from another solution."""
    weighted = _with_trust(graph, trust).with_initial(start.state)
    return solve(weighted, tolerance=tolerance, method="levenberg-marquardt", initialize="given")


def _truncated_cost(graph: Graph, sequence: _Sequence, limit: float) -> float:
    """The squares of the sightings, each at most ``limit``, and the cost of all other edges."""
    family, state = _sighting_edges(graph), sequence.solution.state
    others = sum(other.cost(state, state) for other in graph.families if other is not family)
    return float(np.minimum(_squares(family, sequence.trust, state), limit).sum() + others)


def truncated_trust(squares: Array, limit: float, mu: float) -> Array:
    """The trust (M,) in sightings with squared norms (M,), truncated at ``limit`` = c²; 0 or 1 for infinite mu."""
    if not np.isfinite(mu):
        return (squares <= limit).astype(float)
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squares, 1e-300)) - mu
    return np.where(
        squares <= mu / (mu + 1) * limit, 1.0, np.where(squares >= (mu + 1) / mu * limit, 0.0, np.clip(between, 0, 1))
    )


def _eliminated(graph: Graph) -> tuple[Graph, np.ndarray]:
    """The graph with marginal edges instead of its own, and the sighting (M,) that each of them belongs to."""
    exchanged = with_landmarks_eliminated(graph)
    if exchanged is not None:
        return exchanged
    f = _sighting_edges(graph)
    assert isinstance(f, LandmarkSightings)
    marginal = MarginalEdges(f.starts, f.nodes, f.sightings, f.sensor)
    return _exchanged(graph, marginal), np.arange(len(f.sightings))


def _sighting_edges(graph: Graph) -> SightingEdges:
    for family in graph.families:
        if isinstance(family, SightingEdges):
            return family
    raise GraphError("graduated non-convexity needs edges from sightings, and this graph has none")


def _exchanged(graph: Graph, edges: SightingEdges) -> Graph:
    """The graph with other edges from its sightings."""
    families = [edges if isinstance(f, SightingEdges) else f for f in graph.families]
    return replace(graph, families=tuple(families))


def _with_trust(graph: Graph, trust: Array) -> Graph:
    return _exchanged(graph, _sighting_edges(graph).with_trust(trust))


def _squares(family: SightingEdges, trust: Array, state: Array) -> Array:
    """r² (M,) of every sighting at full trust, about the landmark that the trusted sightings give."""
    assert isinstance(family, LandmarkSightings)
    marginal = MarginalEdges(family.starts, family.nodes, family.sightings, family.sensor, trust=trust)
    return marginal.squares(state, state)
