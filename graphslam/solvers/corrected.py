"""A graph of a log at given values of its parameters; and why an Omega is singular.

`undetermined` names which nodes are not determined, in which direction, and which edges touch them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..edges import EdgeFamily, RelationEdges, RelativePoseEdges, SightingEdges
from ..edges import motion_edges as make_motion_edges
from ..errors import GraphError
from ..errors.checks import first
from ..graph import Graph
from ..identification.corrections import (
    controls_at_steps,
    corrected_controls,
    corrected_log,
    corrected_sensor,
    corrected_sightings,
)
from ..identification.declared import PARAMETERS, Parameters
from ..linear.cholesky import FactorizationError, SingularPivot
from ..se2 import Array, wrap


def sighted_edges(graph: Graph) -> SightingEdges:
    """The edges from sightings."""
    return next(family for family in graph.families if isinstance(family, SightingEdges))


def motion_edges(graph: Graph) -> RelativePoseEdges | None:
    """The motion edges, or None."""
    driven = (f for f in graph.families if isinstance(f, RelativePoseEdges) and not isinstance(f, RelationEdges))
    return next(driven, None)


def corrected(graph: Graph, values: Array, state: Array, at: Array | None = None) -> Graph:
    """The graph at values (K,) of its parameters, sharing `Graph.system`.

    Args:
        state: (n, 3) that predicts the sightings at which the noise of the sensor is evaluated.
        at: (K,) the values of the parameters there; default: ``values``.
    """
    here, there = graph.estimated.at(values), graph.estimated.at(values if at is None else at)
    seen = _sightings(graph, here)
    noisy = seen.with_noise_at(_sightings(graph, there).predicted(state))
    changed: dict[EdgeFamily, EdgeFamily] = {sighted_edges(graph): noisy}
    driven = motion_edges(graph)
    if driven is not None and any(PARAMETERS[name].of_motion for name in here.names):
        changed[driven] = _motions(driven, here, there)
    return graph.with_families((changed.get(family, family) for family in graph.families), parameters=here)


def finished(graph: Graph, values: Array, state: Array) -> Graph:
    """The graph at the estimated values (K,) and state (n, 3), with the corrected log.

    Raises:
        LogError: a corrected range would not be above zero.
    """
    found = corrected(graph, values, state)
    log, sensor = corrected_log(found.estimated), corrected_sensor(found.estimated)
    if graph.log is not None and not graph.log.has_orientation:
        log = log.without_orientation()
    return found.with_families(found.families, log=log, sensor=sensor)


def controls_of(graph: Graph) -> Array:
    """The corrected control (M, 2) at the pose of each sighting; zero where no parameter depends on it."""
    assert graph.log is not None
    if "sensor_delay" not in graph.estimated.names:
        return np.zeros((len(graph.sighting_rows), 2))
    return controls_at_steps(graph.estimated)[graph.log.steps[graph.sighting_rows]]


def _sightings(graph: Graph, parameters: Parameters) -> SightingEdges:
    """The edges from sightings, with corrected sightings."""
    edges = sighted_edges(graph)
    z = corrected_sightings(parameters, graph.sighting_rows, edges.sightings.shape[1])
    z[:, 1:] = wrap(z[:, 1:])
    return replace(edges, sightings=z, sensor=corrected_sensor(parameters), noise_at=None)  # type: ignore[call-arg]


def _motions(edges: RelativePoseEdges, here: Parameters, there: Parameters) -> RelativePoseEdges:
    """The motion edges of corrected controls, with the noise at other values of the parameters."""
    log, motion = here.recorded, here.motion
    assert log.dt is not None
    nodes = np.append(edges.first, edges.second[-1:])
    noisy = make_motion_edges(
        nodes, corrected_controls(there), log.dt, motion, starts=log.control_starts,
        control_variances=log.control_variances, recorded_dt=log.recorded_dt, frame=edges.frame,
        scale=here.motion_weight,
    )  # fmt: skip
    if here.values is there.values or np.array_equal(here.values, there.values):
        return noisy
    measured, _ = motion.accumulated_slopes(corrected_controls(here), log.dt, log.control_starts)
    return replace(noisy, measured=measured)


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
    if (text := negative_information(graph)) is not None:
        return GraphError(text)
    v = error.null_vector
    moving = np.flatnonzero(np.abs(v).max(axis=1) > 1e-6 * np.abs(v).max())
    what = _direction(v[moving], state[moving])
    touching = _edges_at(graph, moving)
    edges = "; ".join(touching[:MOST]) + (f"; and {len(touching) - MOST} more" if len(touching) > MOST else "")
    held = f"the edges there are {edges}" if touching else "no edge is there"
    names = graph.names(moving)
    return GraphError(f"the edges do not determine {names}: nothing holds {what}; {held}. {_remedy(graph)}")


def negative_information(graph: Graph) -> str | None:
    """A sentence about the first edge whose information has a negative eigenvalue, beyond rounding; None for none."""
    for family in graph.families:
        W = getattr(family, "information", None)
        if not isinstance(W, np.ndarray) or W.ndim != 3 or W.shape[1] != W.shape[2] or not np.isfinite(W).all():
            continue
        smallest = np.linalg.eigvalsh((W + np.swapaxes(W, 1, 2)) / 2)[:, 0]
        if (k := first(smallest < -1e-9 * np.abs(W).max(axis=(1, 2)))) is not None:
            return (
                f"the information of edge {k} of {type(family).__name__} is not positive semi-definite (eigenvalue "
                f"{smallest[k]:.3g}), so that J has no lower bound; information is the inverse of a covariance"
            )
    return None


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
