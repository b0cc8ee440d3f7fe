"""Initial values of the iteration: given values, dead reckoning, or headings first and then positions.

Gauss-Newton reaches the optimum only from near it, mostly because of the headings. They can be computed first, by linear
least squares on unit vectors: with r_i = (cos theta_i, sin theta_i), every edge that measures a relative heading d asks
for R(d) r_i = r_j. With the headings known, the positions are linear, too. Both systems have the pattern of Omega, so
its ordering and structure are computed only once.

Source: Carlone, Tron, Daniilidis and Dellaert, *Initialization techniques for 3D SLAM: a survey on rotation estimation
and its use in pose graph optimization*, ICRA 2015 (there called chordal relaxation, for the plane).
"""

from __future__ import annotations

import numpy as np

from ..edges import AnchorEdges, ObservationEdges, PriorEdges, RelationEdges, RelativePoseEdges
from ..edges.base import Relations
from ..engine import engine
from ..errors import GraphError, quoted
from ..graph import Graph
from ..linear.cholesky import FactorizationError
from ..linear.information import BlockSystem
from ..se2 import Array, compose


def rotation_first(graph: Graph) -> Array:
    """A state (n, 3): headings by linear least squares on unit vectors, then positions by linear least squares.

    Raises:
        GraphError: the edges do not connect all headings (no psi and no motion edges, for instance).
    """
    state, system = graph.initial.copy(), graph.system
    held = _held(graph, state)
    headings = _followed(graph, state, held)
    if headings is None:
        _solve_headings(graph, state, held)
    else:
        state[:, 2] = headings

    system.clear()
    position = np.zeros((graph.num_nodes, 2))
    position[held] = state[held, :2]
    for family in graph.families:
        offset = family.positions(state)
        if offset is not None:
            engine.add_positions(*_relations(system, offset), position, *system.arrays)
    state[:, :2] = position + _solved(graph, system, held)[:, :2]
    return state


def _followed(graph: Graph, state: Array, held: np.ndarray) -> Array | None:
    """The headings (n,) where each edge leads to one more node, in the order of the edges: without loops all can be met."""
    headings, known = state[:, 2].copy(), np.zeros(graph.num_nodes, dtype=bool)
    known[held] = True
    for family in graph.families:
        edges = family.headings()
        if edges is not None and not engine.follow_headings(
            edges.first, edges.second, edges.value, edges.information, headings, known
        ):
            return None
    return headings if known[: len(graph.steps)].all() else None


def _solve_headings(graph: Graph, state: Array, held: np.ndarray) -> None:
    """Write the headings by linear least squares on unit vectors into a state (n, 3)."""
    system = graph.system
    system.clear()
    tied = np.zeros(graph.num_nodes, dtype=bool)
    # linear, so it does not matter where the others start
    unit = np.zeros((graph.num_nodes, 2))
    unit[held, 0], unit[held, 1] = np.cos(state[held, 2]), np.sin(state[held, 2])
    for family in graph.families:
        relative = family.headings()
        if relative is not None:
            engine.add_headings(*_relations(system, relative), unit, *system.arrays)
            tied[relative.first] = tied[relative.second] = True
    if not tied[: len(graph.steps)].all():
        loose = np.flatnonzero(~tied[: len(graph.steps)])
        raise GraphError(
            f"initialize='rotation-first' needs edges that measure relative headings; {graph.names(loose)} have none"
        )
    system.rest(np.flatnonzero(~tied), 0)
    correction = _solved(graph, system, held)
    # a held heading keeps its own value, with its full turns
    tied[held] = False
    direction = unit + correction[:, :2]
    tied &= np.any(direction != 0, axis=1)
    state[tied, 2] = np.arctan2(direction[tied, 1], direction[tied, 0])


def dead_reckoning(graph: Graph) -> Array:
    """A state (n, 3): poses one after the other by their motion edges from the first, landmarks as given.

    Raises:
        GraphError: there is no chain of motion edges through all poses.
    """
    state, (step, _) = graph.initial.copy(), odometry(graph, "dead-reckoning")
    for k in range(1, len(graph.steps)):
        state[k] = compose(state[k - 1], step[k])
    return state


def odometry(graph: Graph, initialize: str) -> tuple[Array, Array]:
    """The measured motion (P, 3) to each pose from the pose before it, and the variance (P,) of its turn; 0 for the first.

    Raises:
        GraphError: no motion edge leads to a pose; the message names the option's value ``initialize``.
    """
    step, variance = np.full((len(graph.steps), 3), np.nan), np.zeros(len(graph.steps))
    step[:1] = 0.0
    for family in graph.families:
        if isinstance(family, RelativePoseEdges) and not isinstance(family, RelationEdges):
            # several edges may lead to the next pose; the first in the file is the odometry
            following = np.flatnonzero(family.second == family.first + 1)[::-1]
            step[family.second[following]] = family.measured[following]
            variance[family.second[following]] = _turn_variance(family.information[following])
    missing = np.flatnonzero(np.isnan(step[:, 0]))
    if len(missing):
        raise GraphError(f"initialize={quoted(initialize)} needs motion edges; none leads to {graph.names(missing)}")
    return step, variance


def _turn_variance(information: Array) -> Array:
    """The last diagonal element of the inverse of each matrix (E, 3, 3); infinite where it is singular."""
    determinant = np.linalg.det(information)
    minor = information[:, 0, 0] * information[:, 1, 1] - information[:, 0, 1] * information[:, 1, 0]
    return np.divide(minor, determinant, out=np.full(len(minor), np.inf), where=determinant > 0)


def place_landmarks(graph: Graph, poses: Array) -> Array:
    """A state (n, 3) of poses (P, 3) and every landmark node at the mean of where its trusted sightings put it.

    Landmarks of a map are where that puts them.
    """
    state = np.concatenate([poses, graph.initial[len(graph.steps) :]])
    for family in graph.families:
        if isinstance(family, ObservationEdges):
            d = family.sightings.shape[1]
            y, trust = family.sensor.h_inverse(state[family.first], family.sightings), family.trusted
            columns = [y[:, 0], y[:, 1]] + ([np.cos(y[:, 2]), np.sin(y[:, 2])] if d == 3 else [])
            total = np.column_stack([np.bincount(family.second, trust * part, graph.num_nodes) for part in columns])
            count = np.bincount(family.second, trust, graph.num_nodes)
            seen = np.flatnonzero(count)
            state[seen, :2] = total[seen, :2] / count[seen, None]
            if d == 3:
                # the circular mean does not depend on where headings wrap
                state[seen, 2] = np.arctan2(total[seen, 3], total[seen, 2])
    state[graph.mapped] = graph.initial[graph.mapped]
    return state


def _held(graph: Graph, state: Array) -> np.ndarray:
    """The nodes that keep their values; anchored ones, and those of a map, get the value that is given for them.

    A map may leave all headings open, so that the first pose keeps its value, too: that of the first fix.
    """
    held = [graph.fixed]
    for family in graph.families:
        if isinstance(family, AnchorEdges | PriorEdges):
            state[family.nodes] = family.values
            held.append(family.nodes)
    if graph.map is not None:
        held.append(np.zeros(1, dtype=np.int64))
    nodes = np.concatenate(held)
    return nodes if len(nodes) else np.zeros(1, dtype=np.int64)


def _relations(system: BlockSystem, relations: Relations) -> tuple[Array, ...]:
    """The nodes of relations, the blocks between them, values and information, as the engine takes them."""
    pairs = system.slots_of(relations.first, relations.second)[2]
    return relations.first, relations.second, pairs, relations.value, relations.information


def _solved(graph: Graph, system: BlockSystem, held: np.ndarray) -> Array:
    """The correction (n, 3), in which the third coordinate and held nodes are at rest."""
    system.rest(np.arange(graph.num_nodes), 2)
    system.hold(held)
    try:
        return system.factorize().solve(system.xi)
    except FactorizationError as error:
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie all nodes; nothing holds {graph.names(np.array([error.node]))}"
        ) from None
