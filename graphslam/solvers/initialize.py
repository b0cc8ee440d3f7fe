"""The option ``initialize``: the choice of the state that a solver starts from."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

from ..checks import check_choice
from ..edges import ObservationEdges
from ..errors import GraphError
from ..graph import Graph
from ..localization import registered
from ..placing import into_world
from ..se2 import Array
from ..transform import coarse, filled, with_cartesian_sightings, without_landmarks, without_positions
from .gauss_newton import gauss_newton
from .initial_values import dead_reckoning, place_landmarks, rotation_first
from .iteration import Run
from .mirror_images import grown_from_single_numbers
from .sequential_start import sequential_start

#: the choices of the option ``initialize``
INITIALIZE = ("given", "dead-reckoning", "rotation-first", "grow", "auto")
#: the start of graphs with ranges or bearings alone
MIRRORED = "mirror images"
#: the starts that "auto" tries, in this order
AUTO = (MIRRORED, "cartesian", "virtual-motion", "rotation-first", "given")
#: the starts that grow the graph, and by how many poses at a time; "auto" tries them where ends are doubtful
GROWING = {"grow": 10, "grow by 3": 3, "grow by 1": 1}
#: longer trajectories are first solved for every eighth pose, recursively
LONG, EVERY = 5_000, 8


def starting_state(graph: Graph, initialize: str) -> Array:
    """The state (n, 3) that a solver starts from; for "auto" the first of `AUTO` that the edges allow.

    Args:
        graph: the graph to solve.
        initialize: one of `INITIALIZE`, `AUTO` or `GROWING`.

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
    return state if held else into_world(state, graph.families, _with_heading(graph))


def _with_heading(graph: Graph) -> int:
    """The number of nodes that have a heading; they are the first ones."""
    return graph.num_nodes if graph.landmark_dimension == 3 else len(graph.steps)


def cartesian_first(graph: Graph) -> Array:
    """The optimum (n, 3) with the Cartesian residual, for a graph whose landmark nodes have the polar one.

    Raises:
        GraphError: there are no polar residuals, or the edges do not determine the nodes.
    """
    easier = with_cartesian_sightings(graph)
    if easier is None:
        raise GraphError("there are no sightings with a polar residual")
    run = Run(starting_state(easier, "auto"), tolerance=_roughly(graph))
    gauss_newton(easier, run)
    return run.state


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
    run = Run(easier.initial.copy(), tolerance=_roughly(graph))
    gauss_newton(easier, run)
    return place_landmarks(graph, _in_map(graph, run.state))


def _in_map(graph: Graph, poses: Array) -> Array:
    """Poses (P, 3) as a whole where the map of the graph puts them, if it has one."""
    family = next(family for family in graph.families if isinstance(family, ObservationEdges))
    if graph.map is None:
        return poses
    ids = graph.landmark_ids[family.second - len(graph.steps)]
    return registered(poses, family.first, family.sightings, ids, graph.map, family.sensor)


def _roughly(graph: Graph) -> float:
    """The tolerance of steps on the way to a starting state, which needs little accuracy."""
    return 1e-3 * len(graph.steps) ** 0.5


def _given(graph: Graph) -> Array:
    return graph.initial


def _first_of_auto(graph: Graph) -> Array:
    for choice in AUTO:
        with suppress(GraphError):
            return _STARTS[choice](graph)
    return graph.initial


#: what makes the state of each start
_STARTS: dict[str, Callable[[Graph], Array]] = {
    "given": _given,
    "dead-reckoning": dead_reckoning,
    "rotation-first": rotation_first,
    "auto": _first_of_auto,
    MIRRORED: grown_from_single_numbers,
    "cartesian": cartesian_first,
    "virtual-motion": virtual_motion_first,
    **{name: partial(sequential_start, poses=poses) for name, poses in GROWING.items()},
}
