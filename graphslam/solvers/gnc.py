"""Graduated non-convexity: a solver that finds out which measurements are wrong, together with the trajectory.

Sightings, also those of one number, relations of two poses and absolute positions may be wrong; motion edges are always
trusted. In a pose graph the loop closures are the relations. Truncated least squares counts a measurement with
r² = e' Omega e as at most c². A wrong one then costs the same however wrong it is, and has no influence on the solution. This
cost has very many minima. Graduated
non-convexity searches a good one by a sequence of problems. The first is close to least squares (mu near 0), the last to
truncated least squares (mu large). For each mu the graph is solved with a trust w between 0 and 1 in every measurement. Then
the trust is computed again:

    w = 1 for r² <= mu / (mu + 1) c²,   w = 0 for r² >= (mu + 1) / mu c²,   w = c sqrt(mu (mu + 1)) / r - mu between.

Each sighting has one trust, not each edge: one wrong sighting affects K - 1 pair edges, and its trust reduces the weight of
all of them. Therefore the sequence is computed with landmark nodes and Cartesian residuals, whatever the edges of the graph,
and the resulting trust is applied to the graph itself. Headings make even the squares non-convex, so a sequence may end in a
poor minimum. Where there are few pairs, a second sequence is computed on pair edges; the lower truncated cost counts. Graphs
whose only measurements are relations begin with what agrees in pairs (`agreement`); the sequence is computed only where that
leaves doubts.

Source: Yang, Antonante, Tzoumas and Carlone, *Graduated non-convexity for robust spatial perception*, RA-L 2020.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..edges import (
    BearingEdges,
    DoubtedEdges,
    EdgeFamily,
    MarginalEdges,
    ObservationEdges,
    PositionEdges,
    RangeEdges,
    RelationEdges,
    SightingEdges,
    SingleEdges,
    VirtualMotionEdges,
)
from ..edges.robust import Cauchy
from ..errors import GraphError, OptionError
from ..graph import Graph
from ..graph.transform import poses_only, with_landmark_nodes
from ..se2 import Array
from .agreement import Trusted, grown_trust
from .corrected import corrected, sighted_edges
from .initialize import partial_edges
from .iteration import end_of, levenberg_marquardt, rough
from .minimize import minimize, without_parameters
from .solution import Solution
from .starts import place_landmarks

#: mu grows by this factor from one graph to the next
GROWTH = 1.4
#: the most damped steps in a round: the next one changes the problem anyway
STEPS = 5
#: the same for graphs without sightings, where wrong relations bend the whole trajectory
STEPS_OF_RELATIONS = 30
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
        GraphError: the graph has no measurements that may be wrong, or does not determine its nodes.
    """
    if max_rounds < 1:
        raise OptionError(f"max_iterations must be at least 1 for the method gnc, not {max_rounds}")
    begin = time.perf_counter()
    if graph.measurements == 0:
        graph = graph.with_closures()
    if graph.parameters is not None:
        graph = _at_robust_parameters(graph, initialize)
    best = _best_sequence(without_parameters(graph), probability, max_rounds, initialize)
    weighted = graph.with_trust(best.trust)
    if len(best.state) == graph.num_nodes:
        # landmarks that were seen by single numbers alone have no other place
        weighted = weighted.with_initial(best.state)
    start = weighted.with_initial(place_landmarks(weighted, best.state[: len(graph.steps)]))
    solution = minimize(start, tolerance=tolerance, initialize="given")
    found = _trust_by_kind(weighted)
    which = " and ".join(
        f"{np.count_nonzero(each < REJECTED)} of {len(each)} {kind}" for kind, each in found.items() if len(each)
    )
    note = f"graduated non-convexity rejected {which} in {best.rounds} rounds"
    in_sightings: Array | None = found.pop("sightings", None)
    if graph.log is not None and in_sightings is not None:
        of_edges, in_sightings = in_sightings, np.full(len(graph.log.steps), np.nan)
        in_sightings[graph.sighting_rows] = of_edges
    partly = f"after max_iterations = {best.rounds} some measurements are trusted in part"
    return replace(
        solution,
        converged=solution.converged and best.settled,
        reason=solution.reason if best.settled else partly,
        seconds=time.perf_counter() - begin,
        notes=(*graph.notes, note),
        trust=in_sightings,
        other_trust=found,
    )


#: what the measurements of edges are called
KINDS = {
    SightingEdges: "sightings",
    RelationEdges: "relations",
    RangeEdges: "ranges alone",
    BearingEdges: "bearings alone",
    PositionEdges: "positions",
}


def _trust_by_kind(graph: Graph) -> dict[str, Array]:
    """The trust in the sightings of the edges, in the relations, and in the positions, as far as there are any."""
    found: dict[str, Array] = {}
    for family in graph.families:
        if isinstance(family, DoubtedEdges):
            trust = family.trusted if family.trust is None else family.trust
            if isinstance(family, PositionEdges) and graph.log is not None and graph.log.positions is not None:
                rows = graph.log.positions.oriented == (family.dimension == 3)
                found.setdefault("positions", np.ones(len(rows)))[rows] = trust
            else:
                found[next(kind for cls, kind in KINDS.items() if isinstance(family, cls))] = trust
    return found


def _at_robust_parameters(graph: Graph, initialize: str) -> Graph:
    """The graph at parameters that a robust kernel finds: at wrong parameters correct sightings would be rejected."""
    seen = sighted_edges(graph)
    robust = replace(seen, kernel=Cauchy())
    families = tuple(robust if family is seen else family for family in graph.families)
    found = minimize(replace(graph, families=families), tolerance=rough(graph), initialize=initialize)
    assert found.graph is not None
    return corrected(graph, found.graph.estimated.values, found.state).with_initial(found.state)


@dataclass(frozen=True, eq=False)
class _Measurements:
    """The residuals of what may be wrong in a graph, and its other edges. Those of sightings are about the landmarks that
    the trusted ones give.

    Attributes:
        sightings: grouped by landmark, in the order ``order`` (M,); None where there are none.
        single: the families of relations and positions.
        others: the other edges.
        limits: c² (N,), at which the squares of each measurement are truncated; squares are counted in units of it.
    """

    sightings: MarginalEdges | None
    order: np.ndarray
    single: tuple[SingleEdges, ...]
    others: tuple[EdgeFamily, ...]
    limits: Array

    @classmethod
    def of(cls, graph: Graph, probability: float) -> _Measurements:
        """Those of a graph whose sightings, if it has any, are of landmark nodes."""
        grouped, order = None, np.zeros(0, dtype=np.int64)
        from scipy.special import gammaincinv

        edges = next((family for family in graph.families if isinstance(family, ObservationEdges)), None)
        if edges is not None:
            order = np.lexsort((edges.first, edges.second))
            _, starts = np.unique(edges.second[order], return_index=True)
            by_landmark = np.append(starts, len(order)), edges.first[order], edges.sightings[order], edges.sensor
            grouped = MarginalEdges(*by_landmark)
        single = tuple(family for family in graph.families if isinstance(family, SingleEdges))
        doubted = [family for family in graph.families if isinstance(family, DoubtedEdges)]
        # the quantiles of chi-square with d degrees of freedom
        limits = [np.full(f.measurements, 2 * gammaincinv(f.dimension / 2, probability)) for f in doubted]
        others = tuple(family for family in graph.families if not isinstance(family, DoubtedEdges))
        return cls(grouped, order, single, others, np.concatenate([np.zeros(0), *limits]))

    def squares(self, state: Array, trust: Array) -> Array:
        """r² / c² (N,) of every measurement, as if it were fully trusted itself."""
        squares, start = np.empty(len(self.limits)), len(self.order)
        if self.sightings is not None and start:
            seen = replace(self.sightings, trust=trust[: len(self.order)][self.order])
            squares[self.order] = seen.squares(state, state)
        for family in self.single:
            squares[start : start + family.count] = family.squares(state)
            start += family.count
        return squares / self.limits

    def cost(self, sequence: Trusted) -> float:
        """The truncated squares of the measurements, and the cost of all other edges."""
        state = sequence.state
        squares = np.minimum(self.squares(state, sequence.trust), 1.0) * self.limits
        return float(squares.sum() + sum(other.cost(state, state) for other in self.others))


def _best_sequence(graph: Graph, probability: float, max_rounds: int, initialize: str) -> Trusted:
    """The better of two sequences, one on landmark nodes, one on pair edges."""
    if graph.measurements == 0:
        raise GraphError("graduated non-convexity needs sightings, relations or positions, and this graph has none")
    nodes = (with_landmark_nodes(graph) or graph).without_kernel
    nodes = nodes.with_initial(place_landmarks(nodes, nodes.initial[: len(nodes.steps)]))
    measured = _Measurements.of(nodes, probability)
    if partial_edges(nodes):
        return _from_kernel(nodes, measured, initialize)
    if measured.sightings is None:
        return _of_relations(nodes, measured, max_rounds, initialize)
    best = _sequence(nodes, np.arange(len(measured.limits)), measured, max_rounds, initialize)
    if best.rounds == 0:
        return best
    f = measured.sightings
    pairs = VirtualMotionEdges(f.starts, f.nodes, f.sightings, f.sensor)
    if pairs.count > PAIRS:
        return best
    order = np.append(measured.order, np.arange(len(measured.order), len(measured.limits)))
    try:
        paired = poses_only(nodes, [pairs, *measured.others, *measured.single])
        other = _sequence(paired, order, measured, max_rounds, initialize)
    except GraphError:
        return best  # without psi, pair edges may leave poses undetermined that landmark nodes determine
    other = _finished(nodes, other, measured)
    # a sequence that has not settled is used only where none has
    return min(best, other, key=lambda each: (not each.settled, measured.cost(each)))


def _of_relations(graph: Graph, measured: _Measurements, max_rounds: int, initialize: str) -> Trusted:
    """That of a graph without sightings: from relations that agree, or where that is doubtful the better of two."""
    found: list[Trusted] = []
    if len(measured.single) == 1 and isinstance(edges := measured.single[0], RelationEdges):
        with suppress(GraphError):  # the odometry alone does not determine the poses
            grown = grown_trust(graph, edges, float(measured.limits[0]), max_rounds, initialize)
            found.append(grown)
            if grown.certain:
                return grown
    # the search for the optimum of plain squares would be one among wrong relations
    given = "given" if initialize == "auto" else initialize
    found.append(_sequence(graph, np.arange(len(measured.limits)), measured, max_rounds, given, STEPS_OF_RELATIONS))
    return min(found, key=lambda each: (not each.settled, measured.cost(each)))


def _sequence(
    graph: Graph, order: np.ndarray, measured: _Measurements, max_rounds: int, initialize: str, steps: int = STEPS
) -> Trusted:
    """The sequence from plain squares to squares truncated at c²; the edges have the measurements in an order (N,)."""
    trust = np.ones(len(order))
    state = minimize(graph, tolerance=rough(graph), initialize=initialize).state
    squares = measured.squares(state, trust)
    largest = float(squares.max(initial=0.0))
    mu = 1 / (2 * largest - 1) if 2 * largest > 1 else np.inf
    rounds, settled = 0, largest <= 1
    while rounds < max_rounds and not settled:
        rounds += 1
        trust = truncated_trust(squares, 1.0, mu)
        settled = bool(np.all((trust == 0) | (trust == 1)))
        state = _damped(graph, trust[order], state, steps)
        squares = measured.squares(state, trust)
        mu *= GROWTH
    return Trusted(state, trust, rounds, settled)


def _from_kernel(graph: Graph, measured: _Measurements, initialize: str) -> Trusted:
    """The end from the minimum of a robust kernel, for graphs with ranges or bearings alone.

    Plain squares put their landmarks so far from where they are that the sequence from there rejects most of them.
    """
    robust = tuple(replace(f, kernel=Cauchy()) if isinstance(f, DoubtedEdges) else f for f in graph.families)
    state = minimize(replace(graph, families=robust), tolerance=rough(graph), initialize=initialize).state
    trust = truncated_trust(measured.squares(state, np.ones(len(measured.limits))), 1.0, np.inf)
    return _settled(graph, Trusted(state, trust, 0, settled=True), measured)


def _finished(graph: Graph, sequence: Trusted, measured: _Measurements) -> Trusted:
    """The end of another graph's sequence, taken on to the nearest minimum of the truncated squares with landmark nodes."""
    if not sequence.settled:
        return sequence
    state = place_landmarks(graph.with_trust(sequence.trust), sequence.state)
    return _settled(graph, replace(sequence, state=state), measured)


def _settled(graph: Graph, sequence: Trusted, measured: _Measurements) -> Trusted:
    """The nearest minimum of the truncated squares."""
    state, trust, rounds = sequence.state, sequence.trust, sequence.rounds
    for _ in range(LAST_ROUNDS):
        rounds += 1
        state = _damped(graph, trust, state)
        before, trust = trust, truncated_trust(measured.squares(state, trust), 1.0, np.inf)
        if np.array_equal(trust, before):
            break
    return replace(sequence, trust=trust, state=state, rounds=rounds)


def _damped(graph: Graph, trust: Array, state: Array, steps: int = STEPS) -> Array:
    """The state (n, 3) after some damped steps with this trust."""
    return end_of(levenberg_marquardt, graph.with_trust(trust), state, max_iterations=steps)


def truncated_trust(squares: Array, limit: float, mu: float) -> Array:
    """The trust (M,) in measurements with squared norms (M,), truncated at ``limit`` = c²; 0 or 1 for infinite mu."""
    if not np.isfinite(mu):
        return (squares <= limit).astype(float)
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squares, 1e-300)) - mu
    return np.where(
        squares <= mu / (mu + 1) * limit, 1.0, np.where(squares >= (mu + 1) / mu * limit, 0.0, np.clip(between, 0, 1))
    )
