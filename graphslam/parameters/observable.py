"""Whether a log tells the parameters: the information that it would have without any noise.

With all measurements replaced by what the state predicts, a change of the parameters that the nodes can follow exactly, such
as one scale for wheels and ranges, has no information at all. (With the measured values such a change still has some: a
smaller world has smaller residuals.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from ..errors import GraphError
from ..graph import Graph
from ..linear.cholesky import FactorizationError
from ..se2 import Array, between
from .corrected import corrected, motion_edges, predictions, sighted_edges
from .corrections import corrected_controls, motion_slopes
from .declared import PARAMETERS
from .joint import Border, JointGraph

#: the least information of a combination of parameters, over that with all nodes known
LEAST = 1e-7
#: parameters with at least this part of the largest one in such a combination are named
NAMED = 0.1


def check_observable(joint: JointGraph, nodes: Array, values: Array) -> None:
    """Raise `GraphError` where the log does not tell the parameters, at nodes (n, 3) and values (K,), with names and reason.

    A prior does not help: what the log does not tell at all would only be the prior.
    """
    parameters, K = joint.parameters.at(values), len(values)
    graph, slopes = _without_noise(corrected(joint.graph, values, nodes), nodes)
    graph.linearize(nodes)
    try:
        factor = graph.system.factorize()
    except FactorizationError:
        # the nodes alone are not determined: the solver says so
        return
    seen = sighted_edges(graph)
    border = Border.of_sightings(joint._copies, graph, seen, nodes, nodes, seen.sightings)
    if (driven := motion_edges(graph)) is not None:
        border += Border.of_motions(driven, nodes, nodes, slopes)
    known = np.diag(border.own)
    still = [name for name, information in zip(parameters.names, known) if not information > 0]
    if still:
        raise GraphError(f"the log does not tell {' and '.join(still)}: nothing that was recorded depends on it")
    schur = border.own - np.einsum("nik,nil->kl", border.mixed, factor.solve(border.mixed))
    scale = 1 / np.sqrt(known)
    information, directions = eigh(scale[:, None] * schur * scale)
    if information[0] < LEAST:
        direction = np.abs(directions[:, 0])
        names = [parameters.names[k] for k in range(K) if direction[k] >= NAMED * direction.max()]
        what = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} together"
        why = "poses and landmarks can follow a change of it exactly"
        if len(names) > 1:
            why = "they can change so that poses and landmarks follow exactly; estimate all but one of them"
        if {"wheel_scale", "range_scale"} <= set(names):
            why = "both only change the size of the world; estimate one of the two, relative to the other"
        raise GraphError(f"the log does not tell {what}: {why}")
    deviations = np.sqrt(np.diag(np.linalg.inv(schur + np.diag(parameters.weights))))
    for name, deviation in zip(parameters.names, deviations.tolist()):
        if deviation > PARAMETERS[name].limit:
            raise GraphError(
                f"the log does not tell {name}: its standard deviation would be {deviation:.2g} "
                f"{PARAMETERS[name].unit}".rstrip()
                + "; estimate fewer parameters, or give it a prior"
            )


def _without_noise(graph: Graph, nodes: Array) -> tuple[Graph, Array]:
    """The graph whose measurements are what the nodes predict, and the derivative (T, 3, K) of its motions."""
    seen, driven = sighted_edges(graph), motion_edges(graph)
    parameters = graph.parameters
    assert parameters is not None
    trust = seen.trusted * graph.sighting_weights(nodes)
    exact = replace(seen, sightings=predictions(seen, nodes), kernel=None, trust=trust)  # type: ignore[type-var]
    changed = {seen: exact}
    slopes = np.zeros((0, 3, len(parameters)))
    if driven is not None:
        measured = between(nodes[driven.first], nodes[driven.second])
        changed[driven] = replace(driven, measured=measured)  # type: ignore[index, assignment]
        _, slopes = motion_slopes(parameters, corrected_controls(parameters), measured[:, :2])
    found = replace(graph, families=tuple(changed.get(family, family) for family in graph.families))  # type: ignore[call-overload]
    vars(found)["system"] = graph.system
    return found, slopes
