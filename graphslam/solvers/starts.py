"""Initial values: the given ones, dead reckoning, headings first and then positions, a growing trajectory, and restarts.

Headings first: Gauss-Newton reaches the optimum only from near it, mostly because of the headings. They can be computed
first, by linear least squares on unit vectors: with r_i = (cos theta_i, sin theta_i), every edge that measures a relative
heading d asks for R(d) r_i = r_j. With the headings known, the positions are linear, too. Both systems have the pattern of
Omega, so its ordering and structure are computed only once.

Source: Carlone, Tron, Daniilidis and Dellaert, *Initialization techniques for 3D SLAM: a survey on rotation estimation
and its use in pose graph optimization*, ICRA 2015 (there called chordal relaxation, for the plane).

Growing: solve the first poses, add the next ones, solve again. Each added pose begins where its motion edge leads from the
corrected pose before it, so that no error of dead reckoning accumulates, and each new landmark where its first sighting puts
it. This finds the optimum where noise is so large that starts which look at all poses at once end in other minima. Fewer
poses at a time find it more often, and take longer.

Restarts with one stretch of the trajectory turned by 2 pi look for a lower minimum near a local one.
`descents` has those from an end that is not proven, along the negative direction of its certificate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..edges import AnchorEdges, DoubtedEdges, ObservationEdges, PriorEdges, RelationEdges, RelativePoseEdges
from ..engine import engine
from ..errors import GraphError, quoted
from ..graph import Graph
from ..graph.transform import first_poses, first_seen, with_cartesian_sightings
from ..se2 import Array, chained, wrap


def rotation_first(graph: Graph) -> Array:
    """A state (n, 3): headings by linear least squares on unit vectors, then positions by linear least squares.

    Raises:
        GraphError: the edges do not connect all headings (no psi and no motion edges, for instance).
    """
    graph, state = with_cartesian_sightings(graph) or graph, graph.initial.copy()
    held = _held(graph, state)
    try:
        state, unturned, untied, unlisted = engine.rotation_first(graph.objective, state, held, len(graph.steps))
    except ValueError as error:
        # headings() or positions() of a family in NumPy
        raise GraphError(f"initialize='rotation-first': {error}") from None
    if unlisted >= 0:
        related = graph.names(np.array([unlisted]))
        raise GraphError(
            f"headings() or positions() of a family relates {related} to a node that shares no group of cliques()"
        )
    if len(unturned):
        raise GraphError(
            f"initialize='rotation-first' needs edges that measure relative headings; {graph.names(unturned)} have none"
        )
    if untied >= 0:
        raise GraphError(
            f"initialize='rotation-first' needs edges that tie all nodes; nothing holds {graph.names(np.array([untied]))}"
        )
    return state


def dead_reckoning(graph: Graph) -> Array:
    """A state (n, 3): poses one after the other by their motion edges from the first, landmarks as given.

    Raises:
        GraphError: there is no chain of motion edges through all poses.
    """
    state, (step, _) = graph.initial.copy(), odometry(graph, "dead-reckoning")
    poses = slice(0, len(step))
    state[poses] = chained(state[0], step[1:])
    state[poses, 2] = wrap(state[poses, 2])
    return state


def odometry(graph: Graph, initialize: str) -> tuple[Array, Array]:
    """The measured motion (P, 3) to each pose from the pose before it, and its information (P, 3, 3); 0 for the first.

    Raises:
        GraphError: no motion edge leads to a pose; the message names the option's value ``initialize``.
    """
    step, information = np.full((len(graph.steps), 3), np.nan), np.zeros((len(graph.steps), 3, 3))
    step[:1] = 0.0
    for family in graph.families:
        if isinstance(family, RelativePoseEdges) and not isinstance(family, RelationEdges):
            # several edges may lead to the next pose; the first in the file is the odometry
            following = np.flatnonzero(family.second == family.first + 1)[::-1]
            step[family.second[following]] = family.measured[following]
            information[family.second[following]] = family.information[following]
    missing = np.flatnonzero(np.isnan(step[:, 0]))
    if len(missing):
        raise GraphError(f"initialize={quoted(initialize)} needs motion edges; none leads to {graph.names(missing)}")
    return step, information


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


def most_steps(total: int, poses: int) -> float:
    """The most steps of `sequential_start` for ``total`` poses, each counted as the part of the poses that it moves."""
    return engine.most_steps_of_growth(total, poses)


def sequential_start(graph: Graph, poses: int) -> Array:
    """A state (n, 3) from solving the first poses, then ``poses`` more, until all are there.

    It runs in the engine (``engine/include/vmslam/solve/grow.hpp``).

    Raises:
        GraphError: no chain of motion edges leads through all poses, or a family of edges cannot be divided.
    """
    parents, offsets = _tree(graph)
    state = engine.grow(graph.objective, graph.initial, len(graph.steps), poses, parents, offsets, first_seen(graph))
    if state is None:
        # dividing them in Python, too, names the family
        first_poses(graph, 1)
        raise AssertionError("a family that cannot be divided in the engine can be divided")
    return state


def _tree(graph: Graph) -> tuple[np.ndarray, Array]:
    """The parent (n,) of each node, a pose with a lower number, and the pose (n, 3) of the node in the axes of its parent.

    Poses follow from the pose before, landmarks from the first pose that sees them.
    """
    graph = with_cartesian_sightings(graph) or graph
    poses, unturned = len(graph.steps), np.zeros_like(graph.initial)
    parents, offsets = np.full(graph.num_nodes, -1), np.zeros((graph.num_nodes, 3))
    parents[1:poses] = np.arange(poses - 1)
    offsets[:poses], _ = odometry(graph, "grow")
    for family in graph.families:
        for relations, columns in ((family.positions(unturned), slice(0, 2)), (family.headings(), 2)):
            if relations is None:
                continue
            # of several sightings the last assignment stays: that of the first pose
            backwards = np.argsort(-relations.first, kind="stable")
            first, second = relations.first[backwards], relations.second[backwards]
            at_landmark = second >= poses
            parents[second[at_landmark]] = first[at_landmark]
            offsets[second[at_landmark], columns] = relations.value[backwards][at_landmark]
    # those of a map stay where they are
    parents[graph.mapped] = -1
    return parents, offsets


def lower_by_turns(graph: Graph, state: Array, limit: float = np.inf) -> tuple[Array | None, int]:
    """The state (n, 3) that other turns lead to, one after the other, each kept if it lowers J; None if none does.

    It runs in the engine (``engine/include/vmslam/solve/restarts.hpp``).

    Returns:
        The state, and the number of steps that were taken: after ``limit`` steps no further turn is tried.
    """
    try:
        return engine.lowered_by_turns(graph.objective, state, *_turned(graph), limit)
    except GraphError:
        # there is no odometry, or a family in NumPy refuses a state
        return None, 0


def lower_by_halves(graph: Graph, state: Array, limit: float = np.inf) -> tuple[Array | None, int]:
    """The same without random halves of the measurements that may be wrong, until 25 one after the other lead no lower.

    The halves are the same in each call.
    """
    doubted = [k for k, family in enumerate(graph.families) if isinstance(family, DoubtedEdges)]
    try:
        return engine.lowered_by_halves(graph.objective, doubted, state, *_turned(graph), limit)
    except GraphError:
        return None, 0


def _turned(graph: Graph) -> tuple[Array, Array]:
    """The measured motion (P, 3) to each pose, and the variance (P,) of its turn.

    Raises:
        GraphError: no motion edge leads to a pose.
    """
    driven, information = odometry(graph, "auto")
    variances = np.zeros(len(driven))
    variances[1:] = _turn_variance(information[1:])
    return driven, variances


#: the lengths that are tried, as changes of the heading [rad] that turns most
CHANGES = (4.0, 2.0, 1.0)


def descents(graph: Graph, state: Array, direction: Array) -> Iterator[Array]:
    """States (n, 3) along a direction of `Certificate`, from which the cost may fall below that of the state.

    The function below J falls along the direction, and along the direction turned by any angle; it is turned so that the
    headings change most. J itself need not fall at once, so that long steps come first: on simulated logs, most lower ends
    were reached from changes of two to four radians.
    """
    poses = len(graph.steps)
    z, t = np.exp(1j * state[:poses, 2]), state[:, 0] + 1j * state[:, 1]
    turned = direction[:poses, 0] * np.conj(z)
    largest = np.abs(turned).max(initial=0.0)
    if largest == 0:
        return
    # exp(i phase) makes the squares of the turns as negative as possible: the changes are imaginary, along the circle
    phase = (np.pi - np.angle(np.sum(turned**2))) / 2
    step = direction * np.exp(1j * phase) / largest
    for length in CHANGES:
        for sign in (1.0, -1.0):
            moved = state.copy()
            place = t + sign * length * step[:, 1]
            moved[:, 0], moved[:, 1] = place.real, place.imag
            moved[:poses, 2] = np.angle(z + sign * length * step[:poses, 0])
            moved[graph.fixed] = state[graph.fixed]
            yield moved
