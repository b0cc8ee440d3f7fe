"""A graph of a log at given values of its parameters, and what its sightings should have been."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..edges import (
    EdgeFamily,
    LandmarkSightings,
    MarginalEdges,
    ObservationEdges,
    RelationEdges,
    RelativePoseEdges,
    SightingEdges,
)
from ..edges import motion_edges as make_motion_edges
from ..graph import Graph
from ..se2 import Array, wrap
from .corrections import corrected_controls, corrected_log, corrected_sensor, corrected_sightings
from .declared import PARAMETERS, Parameters

#: a predicted range counts as at least and at most so many times the measured one: wrong sightings predict anything
PLAUSIBLE = (0.5, 2.0)
#: the most passes to the places of landmarks that are no nodes, and the change [m, rad] below which they are found
PASSES, SAME = 20, 1e-12


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
    assert graph.parameters is not None
    here, there = graph.parameters.at(values), graph.parameters.at(values if at is None else at)
    seen = _sightings(graph, here)
    predicted = predictions(_sightings(graph, there), state)
    measured = seen.sightings[:, 0]
    predicted[:, 0] = np.clip(predicted[:, 0], *(np.abs(measured) * factor for factor in PLAUSIBLE))
    changed: dict[EdgeFamily, EdgeFamily] = {sighted_edges(graph): replace(seen, noise_at=predicted)}  # type: ignore[type-var]
    driven = motion_edges(graph)
    if driven is not None and any(PARAMETERS[name].of_motion for name in here.names):
        changed[driven] = _motions(driven, here, there)
    families = tuple(changed.get(family, family) for family in graph.families)
    found = replace(graph, families=families, parameters=here)
    vars(found)["system"] = graph.system
    return found


def finished(graph: Graph, values: Array, state: Array) -> Graph:
    """The graph at the estimated values (K,) and state (n, 3), with the corrected log.

    Raises:
        LogError: a corrected range would not be above zero.
    """
    found = corrected(graph, values, state)
    assert found.parameters is not None
    log, sensor = corrected_log(found.parameters), corrected_sensor(found.parameters)
    if graph.log is not None and not graph.log.has_orientation:
        log = log.without_orientation()
    finished = replace(found, log=log, sensor=sensor)
    vars(finished)["system"] = graph.system
    return finished


def predictions(edges: SightingEdges, state: Array) -> Array:
    """The sightings (M, d) that a state (n, 3) predicts: of landmark nodes, or of the places that its poses give them."""
    if isinstance(edges, ObservationEdges):
        d = edges.sightings.shape[1]
        return edges.sensor.h(state[edges.first], state[edges.second][:, :d])
    assert isinstance(edges, LandmarkSightings)
    predicted = None
    # the places depend on the noise, which depends on the places
    for _ in range(PASSES):
        means = MarginalEdges(
            edges.starts, edges.nodes, edges.sightings, edges.sensor, kernel=edges.kernel, trust=edges.trust,
            noise_at=predicted,
        ).landmarks(state, state)  # fmt: skip
        places = means[edges.group][:, : edges.sightings.shape[1]]
        before, predicted = predicted, edges.sensor.h(state[edges.nodes], places)
        predicted[:, 0] = np.clip(predicted[:, 0], *(np.abs(edges.sightings[:, 0]) * factor for factor in PLAUSIBLE))
        if before is not None and np.abs(predicted - before).max(initial=0.0) < SAME:
            break
    assert predicted is not None
    return predicted


def _sightings(graph: Graph, parameters: Parameters) -> SightingEdges:
    """The edges from sightings, with corrected sightings."""
    edges = sighted_edges(graph)
    z = corrected_sightings(parameters, graph.sighting_rows, edges.sightings.shape[1])
    z[:, 1:] = wrap(z[:, 1:])
    return replace(edges, sightings=z, sensor=corrected_sensor(parameters), noise_at=None)  # type: ignore[type-var]


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
