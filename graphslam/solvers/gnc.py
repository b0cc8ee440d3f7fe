"""Graduated non-convexity: a solver that finds out which measurements are wrong, together with the trajectory.

Sightings, also those of one number, relations of two poses and absolute positions may be wrong; motion edges are always
trusted. In a pose graph the loop closures are the relations. Truncated least squares counts a measurement with
r² = e' Omega e as at most c². A wrong one then costs the same however wrong it is, and has no influence on the solution. This
cost has very many minima. Graduated non-convexity searches a good one by a sequence of problems. The first is close to least
squares, the last to truncated least squares. Each is solved with a trust between 0 and 1 in every measurement. Then the trust
is computed again. These rounds run in the engine (``engine/include/vmslam/solve/graduated.hpp``).

Each sighting has one trust, not each edge: one wrong sighting affects K - 1 pair edges, and its trust reduces the weight of
all of them. Therefore the sequence is computed with landmark nodes and Cartesian residuals, whatever the edges of the graph,
and the resulting trust is applied to the graph itself. Headings make even the squares non-convex, so a sequence may end in a
poor minimum. So the end from the minimum of a robust kernel is computed, too, and where there are few pairs a second sequence
on pair edges; the lowest truncated cost counts. Graphs whose only measurements are relations begin with what agrees in pairs
(`agreement`); the sequence is computed only where that leaves doubts.

Source: Yang, Antonante, Tzoumas and Carlone, *Graduated non-convexity for robust spatial perception*, RA-L 2020.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .. import edges
from ..edges.robust import Cauchy
from ..engine import engine
from ..errors import GraphError, OptionError, checks
from ..graph import Graph
from ..graph.transform import poses_only, with_landmark_nodes
from ..se2 import Array
from .agreement import Trusted, grown_trust
from .initialize import image_notes, partial_edges, place_landmarks
from .iteration import refuse, rough
from .joint import corrected
from .minimize import minimize
from .solution import Solution

#: the most damped steps in a round: the next one changes the problem anyway
STEPS = 5
#: the same for graphs without sightings, where wrong relations bend the whole trajectory
STEPS_OF_RELATIONS = 30
#: a second sequence is computed where there are at most so many pairs of sightings
PAIRS = 5_000
#: a sighting with less trust than this counts as rejected
REJECTED = 0.5


def solve_gnc(graph: Graph, initialize: str, tolerance: float, *, max_rounds: int, probability: float) -> Solution:
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
    if graph.measurements == 0:
        raise GraphError("graduated non-convexity needs sightings, relations or positions, and this graph has none")
    nodes, order = _by_landmark(replace(graph, parameters=None))
    best = _best_sequence(nodes, probability, max_rounds, initialize)
    trust = np.empty(len(order))
    trust[order] = best.trust
    weighted = graph.with_trust(trust)
    if len(best.state) == graph.num_nodes:
        # landmarks that were seen by single numbers alone have no other place
        weighted = weighted.with_initial(best.state)
    start = weighted.with_initial(place_landmarks(weighted, best.state[: len(graph.steps)]))
    solution = minimize(start, "given", tolerance)
    found = _trust_by_kind(weighted)
    known = {kind: each for kind, each in found.items() if len(each)}
    which = " and ".join(f"{np.count_nonzero(each < REJECTED)} of {len(each)} {kind}" for kind, each in known.items())
    note = checks.singular(f"graduated non-convexity rejected {which} in {best.rounds} rounds")
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
        notes=(*graph.notes, *image_notes(weighted, solution.state), note),
        trust=in_sightings,
        other_trust=found,
    )


#: what the measurements of edges are called
KINDS = {
    edges.SightingEdges: "sightings",
    edges.RelationEdges: "relations",
    edges.RelativePointEdges: "points",
    edges.RangeEdges: "ranges alone",
    edges.BearingEdges: "bearings alone",
    edges.PositionEdges: "positions",
}


def _trust_by_kind(graph: Graph) -> dict[str, Array]:
    """The trust in the sightings of the edges, in the relations, and in the positions, as far as there are any."""
    found: dict[str, Array] = {}
    for family in graph.families:
        if isinstance(family, edges.DoubtedEdges):
            trust = family.trusted if family.trust is None else family.trust
            if isinstance(family, edges.PositionEdges) and graph.log is not None and graph.log.positions is not None:
                rows = graph.log.positions.oriented == (family.dimension == 3)
                found.setdefault("positions", np.ones(len(rows)))[rows] = trust
            else:
                # a graph made of relative poses has a family for each kind of edge that they were
                kind = next(kind for cls, kind in KINDS.items() if isinstance(family, cls))
                found[kind] = np.append(found.get(kind, []), trust)
    return found


def _at_robust_parameters(graph: Graph, initialize: str) -> Graph:
    """The graph at parameters that a robust kernel finds: at wrong parameters correct sightings would be rejected."""
    robust = graph.with_changed(edges.SightingEdges, lambda f: replace(f, kernel=Cauchy()))
    found = minimize(robust, initialize, rough(graph))
    assert found.graph is not None
    return corrected(graph, found.graph.estimated.values, found.state).with_initial(found.state)


@dataclass(frozen=True, eq=False)
class _Doubts:
    """A graph whose measurements may be wrong, sightings by landmark, then those of other families.

    Attributes:
        graph: without kernels.
        sightings: about the landmarks that the trusted ones give; None where there are none.
        probability: c² of a measurement with d numbers is this quantile of chi-square with d degrees of freedom.
    """

    graph: Graph
    sightings: edges.MarginalEdges | None
    probability: float

    def rounds(self, state: Array, trust: Array | None = None, steps: int = STEPS) -> Any:
        """The rounds in the engine (``engine/include/vmslam/solve/graduated.hpp``), from a state (n, 3) and trust (N,)."""
        trusting, about_landmarks = self._trusting, None if self.sightings is None else self.sightings.in_engine
        doubted = tuple(
            (k, self.limit(f.dimension), about_landmarks if isinstance(f, edges.SightingEdges) else None)
            for k, f in enumerate(trusting.families)
            if isinstance(f, edges.DoubtedEdges)
        )
        trust = np.ones(trusting.measurements) if trust is None else trust
        return engine.Graduation(trusting.objective, doubted, rough(trusting), steps, state, trust)

    @cached_property
    def _trusting(self) -> Graph:
        return self.graph.with_trust(np.ones(self.graph.measurements))

    def limit(self, dimension: int) -> float:
        """c² of measurements with so many numbers."""
        from scipy.special import gammaincinv

        return float(2 * gammaincinv(dimension / 2, self.probability))

    def after(self, rounds: Any, before: int = 0) -> Trusted:
        """What the rounds have led to, after so many other ones.

        Raises:
            GraphError: the edges do not determine the nodes.
        """
        if rounds.stuck is not None:
            refuse(self.graph.with_trust(rounds.trust), rounds.state, rounds.stuck)
        return Trusted(rounds.state, rounds.trust, before + rounds.rounds, rounds.settled)

    def cost(self, sequence: Trusted) -> float:
        """The truncated squares of the measurements, and the cost of all other edges."""
        state = sequence.state
        others = sum(f.cost(state, state) for f in self.graph.families if not isinstance(f, edges.DoubtedEdges))
        return float(self.rounds(state, sequence.trust).truncated + others)


def _by_landmark(graph: Graph) -> tuple[Graph, np.ndarray]:
    """The graph with landmark nodes, without kernels, its sightings by landmark, and the order (N,) of its measurements."""
    nodes = (with_landmark_nodes(graph) or graph).without_kernel
    order = np.arange(nodes.measurements)
    seen = next((family for family in nodes.families if isinstance(family, edges.ObservationEdges)), None)
    if seen is not None:
        order[: len(seen.first)] = np.lexsort((seen.first, seen.second))
        by_landmark = seen.among(order[: len(seen.first)])
        nodes = replace(nodes, families=tuple(by_landmark if f is seen else f for f in nodes.families))
    return nodes.with_initial(place_landmarks(nodes, nodes.initial[: len(nodes.steps)])), order


def _grouped(seen: edges.ObservationEdges) -> tuple[Any, ...]:
    """The arguments of `LandmarkSightings` for sightings that are ordered by landmark."""
    ends = np.flatnonzero(np.diff(seen.second, append=-1)) + 1
    return np.append(0, ends), seen.first, seen.sightings, seen.sensor


def _best_sequence(nodes: Graph, probability: float, max_rounds: int, initialize: str) -> Trusted:
    """The best of the ends on landmark nodes, from a kernel, and on pair edges; the graph is that of `_by_landmark`."""
    seen = next((family for family in nodes.families if isinstance(family, edges.ObservationEdges)), None)
    doubts = _Doubts(nodes, None if seen is None else edges.MarginalEdges(*_grouped(seen)), probability)
    if partial_edges(nodes):
        return _from_kernel(doubts, initialize)
    if seen is None:
        return _of_relations(doubts, max_rounds, initialize)
    best = _sequence(doubts, max_rounds, initialize)
    if best.rounds == 0:
        return best

    def better(other: Trusted) -> Trusted:
        # a sequence that has not settled is used only where none has
        return min(best, other, key=lambda each: (not each.settled, doubts.cost(each)))

    with suppress(GraphError):  # as below
        best = better(_from_kernel(doubts, initialize))
    pairs = edges.VirtualMotionEdges(*_grouped(seen))
    if pairs.count > PAIRS:
        return best
    try:
        paired = replace(doubts, graph=poses_only(nodes, [pairs if f is seen else f for f in nodes.families]))
        other = _sequence(paired, max_rounds, initialize)
    except GraphError:
        return best  # without psi, pair edges may leave poses undetermined that landmark nodes determine
    if other.settled:
        # on to the nearest minimum of the truncated squares with landmark nodes
        rounds = doubts.rounds(place_landmarks(nodes.with_trust(other.trust), other.state), other.trust)
        rounds.settle()
        other = replace(doubts.after(rounds, other.rounds), settled=True)
    return better(other)


def _of_relations(doubts: _Doubts, max_rounds: int, initialize: str) -> Trusted:
    """That of a graph without sightings: from relations that agree, or where that is doubtful the better of two."""
    found: list[Trusted] = []
    single = [family for family in doubts.graph.families if isinstance(family, edges.DoubtedEdges)]
    if len(single) == 1 and isinstance(related := single[0], edges.RelationEdges):
        with suppress(GraphError):  # the odometry alone does not determine the poses
            grown = grown_trust(doubts.graph, related, doubts.limit(related.dimension), max_rounds, initialize)
            found.append(grown)
            if grown.certain:
                return grown
    # the search for the optimum of plain squares would be one among wrong relations
    given = "given" if initialize == "auto" else initialize
    found.append(_sequence(doubts, max_rounds, given, STEPS_OF_RELATIONS))
    return min(found, key=lambda each: (not each.settled, doubts.cost(each)))


def _sequence(doubts: _Doubts, max_rounds: int, initialize: str, steps: int = STEPS) -> Trusted:
    """The sequence from plain squares to squares truncated at c²."""
    rounds = doubts.rounds(minimize(doubts.graph, initialize, rough(doubts.graph)).state, steps=steps)
    rounds.graduate(max_rounds)
    return doubts.after(rounds)


def _from_kernel(doubts: _Doubts, initialize: str) -> Trusted:
    """The end from the minimum of a robust kernel.

    Plain squares put landmarks of ranges or bearings alone so far from where they are that the sequence from there rejects
    most of them, and misread ids bend a drive by metres, so that it rejects 12 to 46 % of the sightings for 3.7 to 6.9 %.
    """
    robust = doubts.graph.with_changed(edges.DoubtedEdges, lambda f: replace(f, kernel=Cauchy()))
    start = minimize(robust, initialize, rough(robust)).state
    doubted = (family for family in doubts.graph.families if isinstance(family, edges.DoubtedEdges))
    near = [f.linearize(start, start).mahalanobis <= doubts.limit(f.dimension) for f in doubted]
    # means of all sightings of a landmark would not be where the kernel has it
    rounds = doubts.rounds(start, np.concatenate(near).astype(float))
    rounds.judge(np.inf)
    rounds.settle()
    return replace(doubts.after(rounds), settled=True)
