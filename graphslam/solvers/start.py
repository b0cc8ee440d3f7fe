"""Where the iteration starts: given values, dead reckoning, or headings first and then positions.

Gauss-Newton reaches the optimum only from near it, mostly because of the headings. They can be computed first, by linear
least squares on unit vectors: with r_i = (cos theta_i, sin theta_i), every edge that measures a relative heading d asks
for R(d) r_i = r_j. With the headings known, the positions are linear, too. Both systems have the pattern of Omega, so
its ordering and structure are computed only once.

Source: Carlone, Tron, Daniilidis and Dellaert, *Initialization techniques for 3D SLAM: a survey on rotation estimation
and its use in pose graph optimization*, ICRA 2015 (there called chordal relaxation, for the plane).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..edges import AnchorEdges, ObservationEdges, PriorEdges, RelativePoseEdges, kernels
from ..edges.base import Relations
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
            _add_positions(*_ends(system, offset), position, system.values, system.xi)
    state[:, :2] = position + _solved(graph, system, held)[:, :2]
    return state


def _followed(graph: Graph, state: Array, held: np.ndarray) -> Array | None:
    """The headings (n,) where each edge leads to one more node, in the order of the edges: without loops all can be met."""
    headings, known = state[:, 2].copy(), np.zeros(graph.num_nodes, dtype=bool)
    known[held] = True
    for family in graph.families:
        edges = family.headings()
        if edges is not None and not _follow(
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
            _add_headings(*_ends(system, relative), unit, system.values, system.xi, tied)
    if not tied[: len(graph.steps)].all():
        loose = np.flatnonzero(~tied[: len(graph.steps)])
        raise GraphError(
            f"initialize='rotation-first' needs edges that measure relative headings; {graph.names(loose)} have none"
        )
    system.rest(np.flatnonzero(~tied), 0)
    correction = _solved(graph, system, held)
    # a held heading keeps its own value, with its full turns
    tied[held] = False
    _turn(state, tied, unit, correction)


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
        if isinstance(family, RelativePoseEdges):
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


def _ends(system: BlockSystem, relations: Relations) -> tuple[Array, ...]:
    """The relations' nodes, slots, values and information: the first arguments of the kernels below."""
    slots = system.slots_of(relations.first, relations.second)
    return (relations.first, relations.second, *slots, relations.value, relations.information)


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


@njit(cache=True, error_model="numpy")
def _follow(first, second, turn, information, headings, known):  # type: ignore[no-untyped-def]
    """Write the headings along edges between a known node and another one, which is known then; False at any other edge."""
    for k in range(len(first)):
        i, j = first[k], second[k]
        if known[i] == known[j] or not information[k] > 0:
            return False
        if known[i]:
            headings[j] = kernels.wrap(headings[i] + turn[k])
        else:
            headings[i] = kernels.wrap(headings[j] - turn[k])
        known[i] = known[j] = True
    return True


@njit(cache=True, error_model="numpy")
def _turn(state, moving, unit, correction):  # type: ignore[no-untyped-def]
    """Set the headings of ``moving`` nodes to the directions of ``unit`` plus the correction, where these are not zero."""
    for i in range(len(state)):
        x, y = unit[i, 0] + correction[i, 0], unit[i, 1] + correction[i, 1]
        if moving[i] and (x != 0 or y != 0):
            state[i, 2] = np.arctan2(y, x)


@njit(cache=True, error_model="numpy")
def _add_headings(first, second, at_first, at_second, at_pair, turn, information, unit, values, xi, tied):  # type: ignore[no-untyped-def]
    """Add edges with residual e = R(turn) r_first - r_second in the first two coordinates of their nodes; mark these."""
    for k in range(len(first)):
        i, j, w = first[k], second[k], information[k]
        tied[i] = tied[j] = True
        c, s = w * np.cos(turn[k]), w * np.sin(turn[k])
        for at in (at_first[k], at_second[k]):
            values[at, 0, 0] += w
            values[at, 1, 1] += w
        # the block of first and second is -w R', transposed where second < first
        V, q = values[at_pair[k]], s if i < j else -s
        V[0, 0] -= c
        V[0, 1] -= q
        V[1, 0] += q
        V[1, 1] -= c
        a, b = unit[i], unit[j]
        xi[i, 0] += c * b[0] + s * b[1] - w * a[0]
        xi[i, 1] += c * b[1] - s * b[0] - w * a[1]
        xi[j, 0] += c * a[0] - s * a[1] - w * b[0]
        xi[j, 1] += s * a[0] + c * a[1] - w * b[1]


@njit(cache=True, error_model="numpy")
def _add_positions(first, second, at_first, at_second, at_pair, offset, information, position, values, xi):  # type: ignore[no-untyped-def]
    """Add edges with residual e = p_second - p_first - offset in the first two coordinates of their nodes."""
    for k in range(len(first)):
        i, j, omega = first[k], second[k], information[k]
        W = (omega[0, 0], omega[0, 1], omega[1, 1], 0.0, 0.0, 0.0)
        e = (position[j, 0] - position[i, 0] - offset[k, 0], position[j, 1] - position[i, 1] - offset[k, 1], 0.0)
        slots = (at_first[k], at_second[k], at_pair[k])
        kernels.add_point(values, xi, i, j, slots, W, kernels.product(W, e), (0.0, 0.0))
