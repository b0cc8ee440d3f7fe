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
from typing import cast

import numpy as np
from numba import njit

from ..edges import (
    AnchorEdges,
    EdgeFamily,
    MarginalEdges,
    ObservationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from ..edges.base import BinaryEdges, Relations
from ..errors import GraphError
from ..graph import Graph
from ..linear.cholesky import SingularPivot
from ..linear.information import BlockSystem
from ..se2 import Array, compose


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
    # linear, so it does not matter where the others start
    unit = np.zeros((graph.num_nodes, 2))
    unit[held, 0], unit[held, 1] = np.cos(state[held, 2]), np.sin(state[held, 2])
    for family in graph.families:
        relative = family.headings()
        if relative is not None:
            _add_headings(*_ends(system, family, relative), unit, system.values, system.xi)
            tied[relative.first] = tied[relative.second] = True
    if not np.all(tied[: len(graph.steps)]):
        loose = np.flatnonzero(~tied[: len(graph.steps)])
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie the headings; {graph.names(loose)} have none"
        )
    system.rest(np.flatnonzero(~tied), 0)
    unit += _solved(graph, system, held)
    # a held heading keeps its own value, its turns included
    tied[held] = False
    _turn(state, unit, tied)

    system.clear()
    position = np.zeros((graph.num_nodes, 2))
    position[held] = state[held, :2]
    for family in graph.families:
        offset = family.positions(state)
        if offset is not None:
            _add_positions(*_ends(system, family, offset), position, system.values, system.xi)
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
            y, trust = family.sensor.h_inverse(state[family.first], family.sightings), family.trusted
            columns = [y[:, 0], y[:, 1]] + ([np.cos(y[:, 2]), np.sin(y[:, 2])] if d == 3 else [])
            total = np.column_stack([np.bincount(family.second, trust * part, graph.num_nodes) for part in columns])
            count = np.bincount(family.second, trust, graph.num_nodes)
            seen = np.flatnonzero(count)
            state[seen, :2] = total[seen, :2] / count[seen, None]
            if d == 3:
                # the circular mean has no seam
                state[seen, 2] = np.arctan2(total[seen, 3], total[seen, 2])
    return state


def _held(graph: Graph, state: Array) -> np.ndarray:
    """The nodes that a start leaves where they are; anchored ones are put where their anchor is."""
    held = [graph.fixed]
    for family in graph.families:
        if isinstance(family, AnchorEdges):
            state[family.nodes] = family.values
            held.append(family.nodes)
    nodes = np.concatenate(held)
    return nodes if len(nodes) else np.zeros(1, dtype=np.int64)


def _ends(system: BlockSystem, family: EdgeFamily, relations: Relations) -> tuple[Array, ...]:
    """The relations' nodes, slots, values and information: what the kernels below begin with."""
    # a family's relations are mostly its edges, whose slots serve the iteration, too
    same = getattr(family, "first", None) is relations.first
    slots = system.slots_of(cast(BinaryEdges, family)) if same else system.edge_slots(relations)
    return (relations.first, relations.second, *slots, relations.value, relations.information)


def _solved(graph: Graph, system: BlockSystem, held: np.ndarray) -> Array:
    """The correction (n, 2) of the first two coordinates, held nodes at rest."""
    system.rest(np.arange(graph.num_nodes), 2)
    system.hold(held)
    try:
        return system.factorize().solve(system.xi)[:, :2]
    except SingularPivot as error:
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie all nodes; {graph.names(np.array([error.node]))} floats"
        ) from None


@njit(cache=True, error_model="numpy")
def _add_headings(first, second, at_first, at_second, at_pair, turn, information, unit, values, xi):  # type: ignore[no-untyped-def]
    """Add edges with residual e = R(turn) r_first - r_second in the first two coordinates of their nodes."""
    for k in range(len(first)):
        i, j, w = first[k], second[k], information[k]
        c, s = w * np.cos(turn[k]), w * np.sin(turn[k])
        for at in (at_first[k], at_second[k]):
            values[at, 0, 0] += w
            values[at, 1, 1] += w
        # the block of first and second is -w R', above the diagonal perhaps transposed
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
    """Add edges with residual e = p_first + offset - p_second in the first two coordinates of their nodes."""
    for k in range(len(first)):
        i, j, W = first[k], second[k], information[k]
        ex = position[i, 0] + offset[k, 0] - position[j, 0]
        ey = position[i, 1] + offset[k, 1] - position[j, 1]
        for row in range(2):
            for column in range(2):
                values[at_first[k], row, column] += W[row, column]
                values[at_second[k], row, column] += W[row, column]
                values[at_pair[k], row, column] -= W[row, column]
            g = W[row, 0] * ex + W[row, 1] * ey
            xi[i, row] -= g
            xi[j, row] += g


@njit(cache=True)
def _turn(state, unit, moved):  # type: ignore[no-untyped-def]
    """Headings of the vectors (n, 2) of the nodes that moved, those without direction left out."""
    for k in np.flatnonzero(moved):
        if unit[k, 0] != 0 or unit[k, 1] != 0:
            state[k, 2] = np.arctan2(unit[k, 1], unit[k, 0])
