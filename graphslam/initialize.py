"""Where the iteration starts: given values, dead reckoning, or headings first and then positions.

Gauss-Newton ends in the optimum only from near it, and what misleads it is headings. They can be found first, by linear
least squares on unit vectors: with r_i = (cos theta_i, sin theta_i), every edge that measures a relative heading d asks
for R(d) r_i = r_j. With the headings known, the positions are linear, too. Both systems have the pattern of Omega, so
the ordering and structure found for it serve three times.

Source: Carlone, Tron, Daniilidis and Dellaert, *Initialization techniques for 3D SLAM: a survey on rotation estimation
and its use in pose graph optimization*, ICRA 2015 (there called chordal relaxation, for the plane).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from .cholesky import SingularPivot
from .edges import (
    AnchorEdges,
    EdgeFamily,
    MarginalEdges,
    ObservationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from .errors import GraphError
from .graph import Graph
from .information import BlockSystem
from .se2 import Array, compose, rotation, wrap


def rotation_first(graph: Graph) -> Array:
    """A state (n, 3): headings by linear least squares on unit vectors, then positions by linear least squares.

    Raises:
        GraphError: the edges do not tie all headings together (no psi and no motion edges, for instance).
    """
    state = graph.initial.copy()
    held = _held(graph, state)
    system = graph.system
    system.clear()
    tied = np.zeros(graph.num_nodes, dtype=bool)
    unit = np.column_stack([np.cos(state[:, 2]), np.sin(state[:, 2])])
    for family in graph.families:
        relative = family.headings()
        if relative is None:
            continue
        turn = rotation(relative.value)
        weight = relative.information[:, None, None] * np.eye(2)
        e = np.einsum("eij,ej->ei", turn, unit[relative.first]) - unit[relative.second]
        _add(system, relative.first, relative.second, turn, weight, e)
        tied[relative.first] = tied[relative.second] = True
    if not np.all(tied[: len(graph.steps)]):
        loose = np.flatnonzero(~tied[: len(graph.steps)])
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie the headings; {graph.names(loose)} have none"
        )
    unit += _solved(graph, system, np.union1d(held, np.flatnonzero(~tied)))
    moved = tied & (np.abs(unit).max(axis=1) > 0)
    state[moved, 2] = np.arctan2(unit[moved, 1], unit[moved, 0])
    # a held heading keeps its own value, its turns included
    state[held, 2] = _held_values(graph)[held, 2]

    system.clear()
    position = np.zeros((graph.num_nodes, 2))
    position[held] = state[held, :2]
    for family in graph.families:
        offset = family.positions(state)
        if offset is None:
            continue
        e = position[offset.first] + offset.value - position[offset.second]
        straight = np.broadcast_to(np.eye(2), (len(e), 2, 2))
        _add(system, offset.first, offset.second, straight, offset.information, e)
    state[:, :2] = position + _solved(graph, system, held)
    return state


def dead_reckoning(graph: Graph) -> Array:
    """A state (n, 3): poses one after the other by their motion edges from the first, landmarks as given.

    Raises:
        GraphError: there is no chain of motion edges through all poses.
    """
    state = graph.initial.copy()
    step = np.full((len(graph.steps), 3), np.nan)
    for family in graph.families:
        if isinstance(family, RelativePoseEdges):
            # several edges may lead to the next pose; the first in the file is the odometry
            following = np.flatnonzero(family.second == family.first + 1)[::-1]
            step[family.second[following]] = family.measured[following]
    missing = np.flatnonzero(np.isnan(step[1:, 0])) + 1
    if len(missing):
        raise GraphError(f"initialize='dead-reckoning' needs motion edges; none leads to {graph.names(missing)}")
    for k in range(1, len(graph.steps)):
        state[k] = compose(state[k - 1], step[k])
    return state


def without_landmarks(graph: Graph) -> Graph | None:
    """The graph with its landmark nodes exchanged for virtual-motion edges between the poses that saw them.

    Only a landmark's sightings that follow each other are paired: as many edges as sightings, and hardly more fill than
    the landmarks themselves make. The cost is far less crooked than that of landmark nodes, whose bearings turn quickly
    near a landmark that starts in the wrong place. None where there are no sightings to exchange.
    """
    families: list[EdgeFamily] = []
    for family in graph.families:
        if isinstance(family, ObservationEdges):
            order = np.lexsort((family.first, family.second))
            landmark = family.second[order]
            here = np.flatnonzero(landmark[1:] == landmark[:-1])
            pairs = order[np.column_stack([here, here + 1]).ravel()]
            starts = np.arange(0, len(pairs) + 1, 2)
            families.append(
                VirtualMotionEdges(starts, family.first[pairs], family.sightings[pairs], family.sensor, "body")
            )
        elif not isinstance(family, RelativePointEdges):
            families.append(family)
    if not any(isinstance(family, ObservationEdges) for family in graph.families):
        return None
    poses = len(graph.steps)
    return replace(
        graph, initial=graph.initial[:poses], families=tuple(families), landmark_ids=graph.landmark_ids[:0], log=None
    )


def with_landmarks_eliminated(graph: Graph) -> tuple[Graph, np.ndarray] | None:
    """The graph with its landmark nodes exchanged for marginal edges, and the sighting behind each of theirs (M,).

    None where there are no sightings of landmark nodes.
    """
    found = [family for family in graph.families if isinstance(family, ObservationEdges)]
    if not found:
        return None
    seen = found[0]
    order = np.lexsort((seen.first, seen.second))
    _, starts = np.unique(seen.second[order], return_index=True)
    marginal = MarginalEdges(
        np.append(starts, len(order)), seen.first[order], seen.sightings[order], seen.sensor, "body",
        trust=None if seen.trust is None else seen.trust[order],
    )  # fmt: skip
    others = [family for family in graph.families if not isinstance(family, ObservationEdges | RelativePointEdges)]
    return replace(
        graph, initial=graph.initial[: len(graph.steps)], families=(marginal, *others),
        landmark_ids=graph.landmark_ids[:0], log=None,
    ), order  # fmt: skip


def place_landmarks(graph: Graph, poses: Array) -> Array:
    """A state (n, 3) of poses (P, 3) and every landmark node at the mean of where its trusted sightings put it."""
    state = np.concatenate([poses, graph.initial[len(graph.steps) :]])
    for family in graph.families:
        if isinstance(family, ObservationEdges):
            d = family.sightings.shape[1]
            x = state[family.first]
            y = family.sensor.h_inverse(x, family.sightings)
            # headings as differences from any one of the landmark's, so that none is torn at the seam
            some = np.zeros((graph.num_nodes, d))
            some[family.second] = y
            offset = y - some[family.second]
            offset[:, 2:] = wrap(offset[:, 2:])
            trust = family.trusted
            total, count = np.zeros((graph.num_nodes, d)), np.bincount(family.second, trust, graph.num_nodes)
            np.add.at(total, family.second, trust[:, None] * offset)
            seen = np.flatnonzero(count)
            state[seen, :d] = some[seen] + total[seen] / count[seen, None]
    return state


def _held_values(graph: Graph) -> Array:
    values = graph.initial.copy()
    for family in graph.families:
        if isinstance(family, AnchorEdges):
            values[family.nodes] = family.values
    return values


def _held(graph: Graph, state: Array) -> np.ndarray:
    """The nodes that a start leaves where they are; anchored ones are put where their anchor is."""
    anchored = [family.nodes for family in graph.families if isinstance(family, AnchorEdges)]
    held = np.unique(np.concatenate([graph.fixed, *anchored]))
    state[held] = _held_values(graph)[held]
    return held if len(held) else np.zeros(1, dtype=np.int64)


def _add(system: BlockSystem, first: np.ndarray, second: np.ndarray, G: Array, W: Array, e: Array) -> None:
    """Add edges with residual e = G u_first - u_second, in the first two coordinates of their nodes."""
    diagonal = system.indptr[1:] - 1
    pair = system.slots(np.minimum(first, second), np.maximum(first, second))
    _accumulate(first, second, diagonal[first], diagonal[second], pair, G, W, e, system.values, system.xi)


def _solved(graph: Graph, system: BlockSystem, held: np.ndarray) -> Array:
    """The correction (n, 2) of the first two coordinates, held nodes at rest."""
    system.values[system.indptr[1:] - 1, 2, 2] = 1.0
    if len(held):
        system.hold(held)
    try:
        return system.factorize().solve(system.xi)[:, :2]
    except SingularPivot as error:
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie all nodes; {graph.names(np.array([error.node]))} floats"
        ) from None


@njit(cache=True, error_model="numpy")
def _accumulate(first, second, at_first, at_second, at_pair, G, W, e, values, xi):  # type: ignore[no-untyped-def]
    for k in range(len(first)):
        i, j = first[k], second[k]
        w00, w01, w11 = W[k, 0, 0], W[k, 0, 1], W[k, 1, 1]
        # W G and G' W G
        p00, p01 = w00 * G[k, 0, 0] + w01 * G[k, 1, 0], w00 * G[k, 0, 1] + w01 * G[k, 1, 1]
        p10, p11 = w01 * G[k, 0, 0] + w11 * G[k, 1, 0], w01 * G[k, 0, 1] + w11 * G[k, 1, 1]
        g0, g1 = w00 * e[k, 0] + w01 * e[k, 1], w01 * e[k, 0] + w11 * e[k, 1]
        V = values[at_first[k]]
        V[0, 0] += G[k, 0, 0] * p00 + G[k, 1, 0] * p10
        V[0, 1] += G[k, 0, 0] * p01 + G[k, 1, 0] * p11
        V[1, 0] += G[k, 0, 1] * p00 + G[k, 1, 1] * p10
        V[1, 1] += G[k, 0, 1] * p01 + G[k, 1, 1] * p11
        V = values[at_second[k]]
        V[0, 0] += w00
        V[0, 1] += w01
        V[1, 0] += w01
        V[1, 1] += w11
        V = values[at_pair[k]]
        # row first, column second: -G' W = -(W G)'
        V[0, 0] -= p00
        V[1, 1] -= p11
        if i < j:
            V[0, 1] -= p10
            V[1, 0] -= p01
        else:
            V[0, 1] -= p01
            V[1, 0] -= p10
        xi[i, 0] -= G[k, 0, 0] * g0 + G[k, 1, 0] * g1
        xi[i, 1] -= G[k, 0, 1] * g0 + G[k, 1, 1] * g1
        xi[j, 0] += g0
        xi[j, 1] += g1
