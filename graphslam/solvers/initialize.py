"""The option ``initialize``: the choice of the state that a solver starts from.

Landmarks that were seen by range or bearing alone are placed along a trajectory that grows. Ranges from a straight way leave
two places for a landmark, mirror images, and other single numbers may leave several. So the graph grows along the odometry,
and a landmark enters when its sightings from the trajectory so far leave one place: J at the second best is higher by
`trilateration.MIN_GAP`. What is left open enters at the end where J is lowest. Then, for every landmark with another place
that is not much worse, the whole graph is solved from there, and the lower J counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from operator import attrgetter

import numpy as np

from ..edges import ObservationEdges, PartialEdges, RelativePoseEdges, SightingEdges
from ..errors import GraphError
from ..errors.checks import check_choice
from ..graph import Graph
from ..graph.defaults import into_world
from ..graph.localization import registered
from ..graph.transform import (
    coarse,
    filled,
    first_poses,
    of_nodes,
    with_cartesian_sightings,
    without_landmarks,
    without_positions,
)
from ..graph.trilateration import Places, other_places, places_of
from ..se2 import Array, compose
from .iteration import end_of, gauss_newton, levenberg_marquardt, rough
from .starts import dead_reckoning, place_landmarks, rotation_first, sequential_start

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


def partial_edges(graph: Graph) -> list[PartialEdges]:
    """The edges of ranges and bearings alone."""
    return [family for family in graph.families if isinstance(family, PartialEdges)]


def grown_from_single_numbers(graph: Graph) -> Array:
    """The state (n, 3) at which the growing graph ends; see the module.

    Raises:
        GraphError: the graph has no ranges or bearings alone, or no motion edges from pose to pose.
    """
    if not partial_edges(graph):
        raise GraphError("there are no ranges or bearings alone")
    motions = next(
        (f for f in graph.families if type(f) is RelativePoseEdges and f.count == len(graph.steps) - 1), None
    )
    if motions is None:
        raise GraphError("ranges and bearings alone need motion edges from every pose to the next")
    poses, state = len(graph.steps), graph.initial.copy()
    placed = set(_seen_whole(graph))
    count = min(FIRST, poses)
    while True:
        for node, found in _all_places(graph, state, count, placed):
            if found.clear or (count == poses and len(found.places)):
                state[node, :2] = found.places[0]
                placed.add(node)
        piece, nodes = first_poses(graph, count)
        used = (nodes < poses) | np.isin(nodes, list(placed))
        piece, kept = of_nodes(piece, used)
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
    """A note for each landmark with another place that is nearly as likely; see `doubtful_images`."""
    return tuple(
        f"landmark {j} may be elsewhere, such as in its mirror image: the odds for this place are {odds:.3g} to 1"
        for j, odds in doubtful_images(graph, state).items()
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
    seen = [f.second for f in graph.families if isinstance(f, SightingEdges) and hasattr(f, "second")]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *seen, graph.mapped])).tolist()


def _solved(graph: Graph, start: Array) -> Array:
    return end_of(levenberg_marquardt, graph, start, 0.1 * rough(graph), max_iterations=40)


def _all_places(graph: Graph, state: Array, count: int, but: set[int]) -> Iterator[tuple[int, Places]]:
    """The places of the landmarks from their single numbers seen by the first poses, except for some landmarks."""
    families = partial_edges(graph)
    for node in sorted(set(np.concatenate([family.second for family in families]).tolist()) - but):
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
    check_choice("initialize", initialize, _STARTS)
    easier = without_positions(graph)
    if easier is graph or initialize == "given":
        return _STARTS[initialize](graph)
    # positions would bend what is still far from its shape; they put it where it belongs as a whole
    state = _STARTS[initialize](easier)
    held = graph.map is not None or len(graph.fixed)
    with_heading = graph.num_nodes - len(graph.without_heading)
    return state if held else into_world(state, graph.families, with_heading)


def cartesian_first(graph: Graph) -> Array:
    """The optimum (n, 3) with the Cartesian residual, for a graph whose landmark nodes have the polar one.

    Raises:
        GraphError: there are no polar residuals, or the edges do not determine the nodes.
    """
    easier = with_cartesian_sightings(graph)
    if easier is None:
        raise GraphError("there are no sightings with a polar residual")
    return end_of(gauss_newton, easier, starting_state(easier, "auto"))


def virtual_motion_first(graph: Graph) -> Array:
    """The poses by virtual-motion edges instead of landmark nodes, then the landmarks from these poses; (n, 3).

    Raises:
        GraphError: the graph has no sightings of landmark nodes, or they do not determine the poses.
    """
    easier = without_landmarks(graph)
    if easier is None:
        raise GraphError("there are no sightings of landmark nodes to make virtual-motion edges of")
    if len(graph.steps) > LONG and (coarser := coarse(graph, EVERY)) is not None:
        smaller, nodes = coarser
        poses = virtual_motion_first(smaller)[: len(smaller.steps)]
        easier = easier.with_initial(filled(graph, nodes[: len(poses)], poses))
    return place_landmarks(graph, _in_map(graph, end_of(gauss_newton, easier, easier.initial)))


def _in_map(graph: Graph, poses: Array) -> Array:
    """Poses (P, 3) as a whole where the map of the graph puts them, if it has one."""
    family = next(family for family in graph.families if isinstance(family, ObservationEdges))
    if graph.map is None:
        return poses
    ids = graph.landmark_ids[family.second - len(graph.steps)]
    return registered(poses, family.first, family.sightings, ids, graph.map, family.sensor)


def starts_of_auto(graph: Graph) -> tuple[str, ...]:
    """The starts of `AUTO` for the families of a graph: some are for sightings of landmark nodes."""
    if any(isinstance(family, ObservationEdges | PartialEdges) for family in graph.families):
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
