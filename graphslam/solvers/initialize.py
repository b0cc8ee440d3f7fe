"""Initial values, and the option ``initialize``, which chooses among them.

`starting_state` makes those that are named, and for "auto" the first of `AUTO` that the edges allow; `solvers.auto` solves
from several. From the end of a solver, `descents` and restarts with one stretch of the trajectory turned by 2 pi look for a
lower minimum.

**Headings first.** Gauss-Newton reaches the optimum only from near it, mostly because of the headings. They can be computed
first, by linear least squares on unit vectors: with r_i = (cos theta_i, sin theta_i), every edge that measures a relative
heading d asks for R(d) r_i = r_j. With the headings known, the positions are linear, too. Both systems have the pattern of
Omega, so its ordering and structure are computed only once.

**Growing.** Solve the first poses, add the next ones, solve again. Each added pose begins where its motion edge leads from
the corrected pose before it, so that no error of dead reckoning accumulates, and each new landmark where its first sighting
puts it. This finds the optimum where noise is so large that starts which look at all poses at once end in other minima. Fewer
poses at a time find it more often, and take longer.

**Single numbers.** Landmarks that were seen by range or bearing alone are placed along a trajectory that grows. Ranges from a
straight way leave two places for a landmark, mirror images, and other single numbers may leave several. So the graph grows
along the odometry, and a landmark enters when its sightings from the trajectory so far leave one place: J at the second best
is higher by `trilateration.MIN_GAP`. What is left open enters at the end where J is lowest. Then, for every landmark with
another place that is not much worse, the whole graph is solved from there, and the lower J counts.

Source: Carlone, Tron, Daniilidis and Dellaert, *Initialization techniques for 3D SLAM: a survey on rotation estimation
and its use in pose graph optimization*, ICRA 2015 (there called chordal relaxation, for the plane).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np

from .. import edges
from ..engine import engine
from ..errors import GraphError, checks, quoted
from ..graph import Graph, transform
from ..graph.defaults import into_world
from ..graph.trilateration import Places, other_places, places_of
from ..maps.localization import registered
from ..se2 import Array, chained, compose, wrap
from .iteration import end_of, gauss_newton, levenberg_marquardt, rough


def rotation_first(graph: Graph) -> Array:
    """A state (n, 3): headings by linear least squares on unit vectors, then positions by linear least squares.

    Raises:
        GraphError: the edges do not connect all headings (no psi and no motion edges, for instance).
    """
    graph, state = transform.with_cartesian_sightings(graph) or graph, graph.initial.copy()
    held = _held(graph, state)
    try:
        state, unturned, untied, unlisted = engine.rotation_first(graph.objective, state, held, len(graph.steps))
    except ValueError as error:
        # headings() or positions() of a family in NumPy
        raise GraphError(f"initialize='rotation-first': {error}") from None
    if unlisted >= 0:
        related = graph.names(np.array([unlisted]))
        message = f"headings() or positions() of a family relates {related} to a node that shares no group of cliques()"
        raise GraphError(message)
    if unturned:
        nodes = graph.names(np.array(unturned))
        raise GraphError(f"initialize='rotation-first' needs edges that measure relative headings; {nodes} have none")
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
        if isinstance(family, edges.RelativePoseEdges) and not isinstance(family, edges.RelationEdges):
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
        if isinstance(family, edges.ObservationEdges):
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
        if isinstance(family, (edges.AnchorEdges, edges.PriorEdges)):
            state[family.nodes] = family.values
            held.append(family.nodes)
    if graph.map is not None:
        held.append(np.zeros(1, dtype=np.int64))
    nodes = np.concatenate(held)
    return nodes if len(nodes) else np.zeros(1, dtype=np.int64)


def sequential_start(graph: Graph, poses: int) -> Array:
    """A state (n, 3) from solving the first poses, then ``poses`` more, until all are there.

    It runs in the engine (``engine/include/vmslam/solve/grow.hpp``).

    Raises:
        GraphError: no chain of motion edges leads through all poses, or a family of edges cannot be divided.
    """
    parents, offsets = _tree(graph)
    seen = transform.first_seen(graph)
    state = engine.grow(graph.objective, graph.initial, len(graph.steps), poses, parents, offsets, seen)
    if state is None:
        # dividing them in Python, too, names the family
        transform.first_poses(graph, 1)
        raise AssertionError("a family that cannot be divided in the engine can be divided")
    return state


def _tree(graph: Graph) -> tuple[np.ndarray, Array]:
    """The parent (n,) of each node, a pose with a lower number, and the pose (n, 3) of the node in the axes of its parent.

    Poses follow from the pose before, landmarks from the first pose that sees them.
    """
    graph = transform.with_cartesian_sightings(graph) or graph
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
        The state, and the number of steps that were taken: after ``limit`` steps no further restart is tried.
    """
    return _lowered(graph, engine.lowered_by_turns, state, limit)


def lower_by_halves(graph: Graph, state: Array, limit: float = np.inf) -> tuple[Array | None, int]:
    """The same without random halves of the measurements that may be wrong, until 25 one after the other lead no lower."""
    doubted = [k for k, family in enumerate(graph.families) if isinstance(family, edges.DoubtedEdges)]
    return _lowered(graph, partial(engine.lowered_by_halves, doubted), state, limit)


def _lowered(graph: Graph, lower: Callable[..., Any], state: Array, limit: float) -> tuple[Array | None, int]:
    try:
        driven, information = odometry(graph, "auto")
        variances = np.zeros(len(driven))
        variances[1:] = _turn_variance(information[1:])
        return lower(graph.objective, state, driven, variances, limit)
    except GraphError:
        # there is no odometry, or a family in NumPy refuses a state
        return None, 0


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
    if (largest := np.abs(turned).max(initial=0.0)) == 0:
        return
    # exp(i phase) makes the squares of the turns as negative as possible: the changes are imaginary, along the circle
    phase = (np.pi - np.angle(np.sum(turned**2))) / 2
    step = direction * np.exp(1j * phase) / largest
    for length, sign in product(CHANGES, (1.0, -1.0)):
        moved = state.copy()
        place = t + sign * length * step[:, 1]
        moved[:, 0], moved[:, 1] = place.real, place.imag
        moved[:poses, 2] = np.angle(z + sign * length * step[:poses, 0])
        moved[graph.fixed] = state[graph.fixed]
        yield moved


#: places whose J differs by less than this from the lowest are named: the odds are below 1000
DOUBTED = 2 * np.log(1000.0)
#: the most sweeps in which other places of all landmarks are tried
SWEEPS = 5
#: a landmark that was tried at another place has come back if it ends nearer to its first place than this share of the
#: distance
BACK = 0.1
#: a motion with less information [1/m²] counts as unknown, such as that from the end of one drive to the start of the next
NOTHING = 1e-4
#: the poses of the first graph, and how much larger the next one is
FIRST, GROWTH = 10, 1.25


def partial_edges(graph: Graph) -> list[edges.PartialEdges]:
    """The edges of ranges and bearings alone."""
    return [family for family in graph.families if isinstance(family, edges.PartialEdges)]


def grown_from_single_numbers(graph: Graph) -> Array:
    """The state (n, 3) at which the growing graph ends; see the module.

    Raises:
        GraphError: the graph has no ranges or bearings alone, or no motion edges from pose to pose.
    """
    if not partial_edges(graph):
        raise GraphError("there are no ranges or bearings alone")
    poses, state = len(graph.steps), graph.initial.copy()
    chains = (f for f in graph.families if type(f) is edges.RelativePoseEdges and f.count == poses - 1)
    if (motions := next(chains, None)) is None:
        raise GraphError("ranges and bearings alone need motion edges from every pose to the next")
    placed = set(_seen_whole(graph))
    count = min(FIRST, poses)
    while True:
        for node, found in _all_places(graph, state, count, placed):
            if found.clear or (count == poses and len(found.places)):
                state[node, :2] = found.places[0]
                placed.add(node)
        piece, nodes = transform.first_poses(graph, count)
        used = (nodes < poses) | np.isin(nodes, list(placed))
        piece, kept = transform.of_nodes(piece, used)
        state[nodes[kept]] = _solved(piece, state[nodes[kept]])
        if count == poses:
            break
        larger = min(max(count + 3, int(count * GROWTH)), poses)
        for t in range(count, larger):
            # the motion edges lead on from the last pose, except into another drive, which begins where the log says
            leads = motions.information[t - 1, 0, 0] > NOTHING
            state[t] = compose(state[t - 1], motions.measured[t - 1]) if leads else graph.initial[t]
        count = larger
    return _with_lowest_images(graph, state)


def _with_lowest_images(graph: Graph, state: Array) -> Array:
    """The lowest state that is reached from other places of landmarks, until none is lower, or `SWEEPS` times."""
    lowest = graph.cost(state)
    for _ in range(SWEEPS):
        before = lowest
        for places in _other_images(graph, state):
            with suppress(GraphError):
                # an earlier landmark may have changed the state
                other = _solved(graph, _with_places(state, places))
                if (cost := graph.cost(other)) < lowest - 1e-9 * abs(lowest):
                    state, lowest = other, cost
        if lowest == before:
            break
    return state


def doubtful_images(graph: Graph, state: Array) -> dict[int, float]:
    """{id: odds} of the landmarks for which another place, with the whole graph solved anew, is nearly as likely.

    The odds exp((J' - J) / 2) of the present place, at most 1000; Gaussian noise is assumed.
    """
    lowest, doubtful = graph.cost(state), dict[int, float]()
    for places in _other_images(graph, state):
        with suppress(GraphError):
            other = _solved(graph, _with_places(state, places))
            higher = max(graph.cost(other) - lowest, 0.0)
            for node, place in places.items() if higher < DOUBTED else ():
                tried, moved = (np.hypot(*(each - state[node, :2])) for each in (place, other[node, :2]))
                if moved > BACK * tried:
                    j = int(graph.landmark_ids[node - len(graph.steps)])
                    doubtful[j] = min(doubtful.get(j, np.inf), float(np.exp(higher / 2)))
    return doubtful


def image_notes(graph: Graph, state: Array) -> tuple[str, ...]:
    """A note for each landmark of single numbers with another place that is nearly as likely; see `doubtful_images`."""
    found = doubtful_images(graph, state) if partial_edges(graph) else {}
    return tuple(
        f"landmark {j} may be elsewhere, such as in its mirror image: the odds for this place are {odds:.3g} to 1"
        for j, odds in found.items()
    )


def _other_images(graph: Graph, state: Array) -> Iterator[dict[int, Array]]:
    """Other places {node: (2,)} of landmarks; see `graph.trilateration.other_places`."""
    every = _all_places(graph, state, len(graph.steps), set(_seen_whole(graph)))
    return other_places((node, found, state[node]) for node, found in every)


def _with_places(state: Array, places: dict[int, Array]) -> Array:
    changed = state.copy()
    for node, place in places.items():
        changed[node, :2] = place
    return changed


def _seen_whole(graph: Graph) -> list[int]:
    """The landmark nodes that have whole sightings, or are given by a map."""
    seen = [f.second for f in graph.families if isinstance(f, edges.SightingEdges) and hasattr(f, "second")]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *seen, graph.mapped])).tolist()


def _solved(graph: Graph, start: Array) -> Array:
    return end_of(levenberg_marquardt, graph, start, 0.1 * rough(graph), max_iterations=40)


def _all_places(graph: Graph, state: Array, count: int, placed: set[int]) -> Iterator[tuple[int, Places]]:
    """The places that single numbers from the first poses leave for each landmark, except for those ``placed``."""
    families = partial_edges(graph)
    for node in sorted(set(np.concatenate([family.second for family in families]).tolist()) - placed):
        yield node, places_of([f.among((f.second == node) & (f.first < count)) for f in families], state)


#: the start of graphs with ranges or bearings alone
MIRRORED = "mirror images"
#: the starts that "auto" tries, in this order
AUTO = (MIRRORED, "cartesian", "virtual-motion", "rotation-first", "given")
#: the starts that grow the graph, and by how many poses at a time; "auto" tries them where ends are doubtful
GROWING = {"grow": 10, "grow by 3": 3}
#: longer trajectories are first solved for every eighth pose, recursively
LONG, EVERY = 5_000, 8


def starting_state(graph: Graph, initialize: str) -> Array:
    """The state (n, 3) that a solver starts from; for "auto" the first of `AUTO` that the edges allow.

    Args:
        graph: the graph to solve.
        initialize: one of `solvers.INITIALIZE`, `AUTO` or `GROWING`.

    Raises:
        GraphError: the edges do not allow this start.
        OptionError: there is no such start.
    """
    checks.check_choice("initialize", initialize, _STARTS)
    easier = transform.without_positions(graph)
    if easier is graph or initialize == "given":
        return _STARTS[initialize](graph)
    # positions would bend what is still far from its shape; they put it where it belongs as a whole
    state = _STARTS[initialize](easier)
    held = graph.map is not None or len(graph.fixed)
    return state if held else into_world(state, graph.families, graph.num_nodes - len(graph.without_heading))


def cartesian_first(graph: Graph) -> Array:
    """The optimum (n, 3) with the Cartesian residual, for a graph whose landmark nodes have the polar one.

    Raises:
        GraphError: there are no polar residuals, or the edges do not determine the nodes.
    """
    easier = transform.with_cartesian_sightings(graph)
    if easier is None:
        raise GraphError("there are no sightings with a polar residual")
    return end_of(gauss_newton, easier, starting_state(easier, "auto"))


def virtual_motion_first(graph: Graph) -> Array:
    """The poses by virtual-motion edges instead of landmark nodes, then the landmarks from these poses; (n, 3).

    Raises:
        GraphError: the graph has no sightings of landmark nodes, or they do not determine the poses.
    """
    easier = transform.without_landmarks(graph)
    if easier is None:
        raise GraphError("there are no sightings of landmark nodes to make virtual-motion edges of")
    if len(graph.steps) > LONG and (coarser := transform.coarse(graph, EVERY)) is not None:
        smaller, nodes = coarser
        poses = virtual_motion_first(smaller)[: len(smaller.steps)]
        easier = easier.with_initial(transform.filled(graph, nodes[: len(poses)], poses))
    return place_landmarks(graph, _in_map(graph, end_of(gauss_newton, easier, easier.initial)))


def _in_map(graph: Graph, poses: Array) -> Array:
    """Poses (P, 3) as a whole where the map of the graph puts them, if it has one."""
    if graph.map is None:
        return poses
    family = next(family for family in graph.families if isinstance(family, edges.ObservationEdges))
    ids = graph.landmark_ids[family.second - len(graph.steps)]
    return registered(poses, family.first, family.sightings, ids, graph.map, family.sensor)


def starts_of_auto(graph: Graph) -> tuple[str, ...]:
    """The starts of `AUTO` for the families of a graph: some are for sightings of landmark nodes."""
    if any(isinstance(family, (edges.ObservationEdges, edges.PartialEdges)) for family in graph.families):
        return AUTO
    return AUTO[AUTO.index("rotation-first") :]


def _first_of_auto(graph: Graph) -> Array:
    for choice in starts_of_auto(graph):
        with suppress(GraphError):
            return _STARTS[choice](graph)
    return graph.initial


#: what makes the state of each start
_STARTS: dict[str, Callable[[Graph], Array]] = {
    "given": attrgetter("initial"),
    "dead-reckoning": dead_reckoning,
    "rotation-first": rotation_first,
    "auto": _first_of_auto,
    MIRRORED: grown_from_single_numbers,
    "cartesian": cartesian_first,
    "virtual-motion": virtual_motion_first,
    **{name: partial(sequential_start, poses=poses) for name, poses in GROWING.items()},
}
