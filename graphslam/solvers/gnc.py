"""Graduated non-convexity: which sightings to trust, found along with the trajectory.

Truncated least squares counts a sighting with r² = e' Omega e at most c², so one that is wrong costs the same however
wrong it is, and pulls nowhere. Its cost has countless minima; graduated non-convexity walks to a good one, from a convex
surrogate (mu near 0: all squares) to the truncated squares (mu to infinity). At each mu the graph is solved with a
trust w in every sighting, and the trust taken anew:

    w = 1 for r² <= mu / (mu + 1) c²,   w = 0 for r² >= (mu + 1) / mu c²,   w = c sqrt(mu (mu + 1)) / r - mu between.

The trust belongs to a sighting, not to an edge: one wrong sighting poisons K - 1 pair edges at once, and loses all of
them at once. So r² is taken about the landmark, whatever the edges: landmarks are eliminated (`edges.marginal`), and
what trust is found there goes back to the graph that was given. Headings make even squares crooked, and a walk can lose
its way: two are made, on marginal and on pair edges, and the end with the lower truncated cost counts.

Source: Yang, Antonante, Tzoumas and Carlone, *Graduated non-convexity for robust spatial perception*, RA-L 2020.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..edges import MarginalEdges, ObservationEdges, VirtualMotionEdges
from ..errors import GraphError, OptionError
from ..graph import Graph
from ..se2 import Array
from ..solution import Solution
from ..transform import with_landmarks_eliminated
from .solve import solve
from .start import place_landmarks

#: mu grows by this factor from one graph to the next
GROWTH = 1.4
#: the most rounds in which trust is taken anew after a walk on other edges
LAST_ROUNDS = 20
#: the trust below which a sighting counts as rejected
REJECTED = 0.5

SightingEdges = VirtualMotionEdges | MarginalEdges | ObservationEdges


def solve_gnc(
    graph: Graph,
    probability: float = 0.99,
    tolerance: float = 1e-9,
    max_rounds: int = 100,
    initialize: str = "auto",
) -> Solution:
    """Minimise the truncated squares of a graph's sightings by graduated non-convexity.

    Args:
        graph: with edges from sightings; motion edges and anchors are always trusted.
        probability: the part of right sightings that should pass: c² is this quantile of chi-square with as many degrees
            of freedom as a sighting has numbers.
        tolerance: of the last solve, see `solve`.
        max_rounds: the most values of mu to try.
        initialize: where the first solve starts, see `solve`.

    Returns:
        The solution of the graph with the final trust, which `Solution.trust` tells; ``converged`` only if every
        sighting is wholly trusted or not at all.

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
    # the walk needs no more digits than it takes to tell right from wrong
    judged = _judged(eliminated, probability, max(tolerance, 1e-6), max_rounds, initialize)
    trust = np.empty(len(order))
    trust[order] = judged.trust
    trusting = _with_trust(graph, trust)
    solution = solve(trusting.with_initial(place_landmarks(trusting, judged.solution.state)), tolerance=tolerance)
    rejected = int(np.count_nonzero(trust < REJECTED))
    told = f"graduated non-convexity rejected {rejected} of {len(trust)} sightings in {judged.rounds} rounds"
    if graph.log is not None:
        of_edges, trust = trust, np.full(len(graph.log.steps), np.nan)
        trust[graph.sighting_rows] = of_edges
    return replace(
        solution,
        converged=solution.converged and judged.settled,
        reason=solution.reason
        if judged.settled
        else f"after max_rounds = {judged.rounds} some sightings are trusted in part",
        seconds=time.perf_counter() - begin,
        notes=(*graph.notes, told),
        trust=trust,
    )


@dataclass(frozen=True)
class _Judgement:
    solution: Solution
    trust: Array
    rounds: int
    settled: bool


def _judged(graph: Graph, probability: float, tolerance: float, max_rounds: int, initialize: str) -> _Judgement:
    """The better of two walks on a graph with marginal edges."""
    f = _sighting_edges(graph)
    assert isinstance(f, MarginalEdges)
    limit = float(chi2.ppf(probability, f.sightings.shape[1]))
    walks = [_walk(graph, limit, tolerance, max_rounds, initialize)]
    pairs = VirtualMotionEdges(f.starts, f.nodes, f.sightings, f.sensor)
    try:
        aside = _walk(_exchanged(graph, pairs), limit, tolerance, max_rounds, initialize)
    except GraphError:
        pass  # without psi pair edges need not hold where marginal ones do
    else:
        walks.append(_settled(graph, aside, limit, tolerance))
    # one that has not come to its end is only better than none
    return min(walks, key=lambda walk: (not walk.settled, _truncated_cost(graph, walk, limit)))


def _walk(graph: Graph, limit: float, tolerance: float, max_rounds: int, initialize: str) -> _Judgement:
    """From squares to squares truncated at ``limit``."""
    family = _sighting_edges(graph)
    rough = max(tolerance, 1e-4)
    trust = np.ones(len(family.sightings))
    solution = solve(_with_trust(graph, trust), tolerance=rough, initialize=initialize)
    squares = _squares(family, trust, solution.state)
    largest = float(squares.max(initial=0.0))
    # the surrogate is convex as long as mu is no larger than this
    mu = limit / (2 * largest - limit) if 2 * largest > limit else np.inf
    rounds, settled = 0, False
    while rounds < max_rounds and not settled:
        rounds += 1
        trust = truncated_trust(squares, limit, mu)
        settled = bool(np.all((trust == 0) | (trust == 1)))
        trusting = _with_trust(graph, trust).with_initial(solution.state)
        solution = solve(trusting, tolerance=tolerance if settled else rough, method="levenberg-marquardt")
        squares = _squares(family, trust, solution.state)
        mu *= GROWTH
    return _Judgement(solution, trust, rounds, settled)


def _settled(graph: Graph, walk: _Judgement, limit: float, tolerance: float) -> _Judgement:
    """The end of another graph's walk taken on to the nearest minimum of this one's truncated squares."""
    if not walk.settled:
        return walk
    family, trust, solution = _sighting_edges(graph), walk.trust, walk.solution
    for _ in range(LAST_ROUNDS):
        trusting = _with_trust(graph, trust).with_initial(solution.state)
        solution = solve(trusting, tolerance=tolerance, method="levenberg-marquardt")
        before, trust = trust, truncated_trust(_squares(family, trust, solution.state), limit, np.inf)
        if np.array_equal(trust, before):
            break
    return replace(walk, trust=trust, solution=solution)


def _truncated_cost(graph: Graph, walk: _Judgement, limit: float) -> float:
    """The squares of the sightings, each at most ``limit``, and the cost of all other edges."""
    family, state = _sighting_edges(graph), walk.solution.state
    others = sum(other.cost(state, state) for other in graph.families if other is not family)
    return float(np.minimum(_squares(family, walk.trust, state), limit).sum() + others)


def truncated_trust(squares: Array, limit: float, mu: float) -> Array:
    """The trust (M,) in sightings with squared norms (M,), truncated at ``limit`` = c²; mu = infinity: all or nothing."""
    if not np.isfinite(mu):
        return (squares <= limit).astype(float)
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squares, 1e-300)) - mu
    return np.where(
        squares <= mu / (mu + 1) * limit, 1.0, np.where(squares >= (mu + 1) / mu * limit, 0.0, np.clip(between, 0, 1))
    )


def _eliminated(graph: Graph) -> tuple[Graph, np.ndarray]:
    """The graph with marginal edges in place of its sightings' own, and which of the sightings each one is (M,)."""
    exchanged = with_landmarks_eliminated(graph)
    if exchanged is not None:
        return exchanged
    f = _sighting_edges(graph)
    assert isinstance(f, VirtualMotionEdges | MarginalEdges)
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
    """r² (M,) of every sighting, as if it were trusted, about a mean of the trusted ones."""
    assert not isinstance(family, ObservationEdges)
    marginal = MarginalEdges(family.starts, family.nodes, family.sightings, family.sensor, trust=trust)
    return marginal.squares(state, state)
