"""Explains a singular Omega: which nodes are not determined, in which direction, and which edges touch them."""

from __future__ import annotations

import numpy as np

from .errors import GraphError
from .graph import Graph
from .linear.cholesky import FactorizationError, SingularPivot
from .parameters.corrected import motion_edges
from .se2 import Array

#: the most edges that a message lists
MOST = 4


def undetermined(graph: Graph, state: Array, error: FactorizationError) -> GraphError:
    """The error for an Omega at a state (n, 3) that is singular, or not finite.

    The null vector v of Omega (Omega v = 0) is a motion that does not change the cost; its large entries are the nodes
    that move.
    """
    if not isinstance(error, SingularPivot):
        return GraphError(
            f"the information matrix of the graph is not finite at {graph.names(np.array([error.node]))}: the numbers there "
            "leave the range of double precision; look for extreme noise, or for a pose that lies on a landmark"
        )
    v = error.null_vector
    moving = np.flatnonzero(np.abs(v).max(axis=1) > 1e-6 * np.abs(v).max())
    what = _direction(v[moving], state[moving])
    touching = _edges_at(graph, moving)
    edges = "; ".join(touching[:MOST]) + (f"; and {len(touching) - MOST} more" if len(touching) > MOST else "")
    held = f"the edges there are {edges}" if touching else "no edge is there"
    names = graph.names(moving)
    return GraphError(f"the edges do not determine {names}: nothing holds {what}; {held}. {_remedy(graph)}")


def _remedy(graph: Graph) -> str:
    """Advice for the user: for the graph of a log it names rows and options, else edges."""
    if graph.log is None:
        return "Add edges (a relative pose, a sighting, a loop closure) or an anchor there"
    if graph.log.controls is None:
        return "The log has no odometry to hold them: add it, or remove the sightings from there"
    if motion_edges(graph) is None:
        return "Use motion edges, which hold every pose: edges='landmark+motion' (--edges landmark+motion)"
    return (
        "The odometry and the sightings there count for nothing beside the others: look for extreme noise models, units, or "
        "motions (slam-compare show)"
    )


def _direction(v: Array, state: Array) -> str:
    """The motion v (k, 3) of k nodes in words: a coordinate, a shift or a turn of all of them, or something else."""
    size = np.abs(v).max()
    if len(v) == 1:
        free = [name for name, part in zip(("x", "y", "heading"), v[0]) if abs(part) > 1e-6 * size]
        return f"its {free[0]}" if len(free) == 1 else f"a combination of its {', '.join(free[:-1])} and {free[-1]}"
    # a rigid motion moves every node by d + omega (-y, x) and turns it by omega
    omega = v[:, 2].mean()
    shift = v[:, :2] - omega * np.column_stack([-state[:, 1], state[:, 0]])
    if np.ptp(v[:, 2]) < 1e-4 * size and np.all(np.ptp(shift, axis=0) < 1e-4 * max(size, np.abs(shift).max())):
        return "the whole piece, which can shift" if abs(omega) < 1e-6 * size else "the whole piece, which can turn"
    return "a motion of these against the rest"


def _edges_at(graph: Graph, nodes: np.ndarray) -> list[str]:
    """The groups of edges that touch the nodes, named by the nodes they connect; edges to other nodes come first."""
    inside = np.zeros(graph.num_nodes, dtype=bool)
    inside[nodes] = True
    leading_out: list[str] = []
    within: list[str] = []
    for family in graph.families:
        starts, tied = family.cliques()
        group = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        for g in np.unique(group[inside[tied]]).tolist():
            ends = np.unique(tied[starts[g] : starts[g + 1]])
            (within if np.all(inside[ends]) else leading_out).append(f"between {graph.names(ends)}")
    return leading_out + within
