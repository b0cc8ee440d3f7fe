"""The edges of a GTSAM graph of our factors, in the form that the certificate needs.

`certify`: prove for a solution, or for any state of a graph, that no other state has a lower cost.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..edges import (
    AnchorEdges,
    ConstantEdges,
    MarginalEdges,
    PositionEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from ..errors import GraphError, OptionError, quoted
from ..errors.checks import array_of
from ..factors.description import FactorDescription, describe, key_name
from ..graph import Graph
from ..se2 import Array
from .certificate import NOT_APPLICABLE, Certificate, prove, prove_edges
from .solution import Solution

if TYPE_CHECKING:
    import gtsam

#: GTSAM's own factors whose error goes through the logarithm of SE(2)
LOGARITHM = (gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)


def constant_edges(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[list[ConstantEdges], Array, np.ndarray]:
    """The edges of a graph, the state (n, 3) of its values, and the nodes that `gtsam.NonlinearEqualityPose2` holds.

    Raises:
        GraphError: a factor has another cost, or information that depends on the state.
        OptionError: the values lack a key of the graph.
    """
    # a removed factor leaves an empty place
    listed = [factor for k in range(factors.size()) if (factor := factors.at(k)) is not None]
    keys = sorted({key for factor in listed for key in list(factor.keys())})
    node = {key: k for k, key in enumerate(keys)}
    state = np.array([_value(values, key) for key in keys]).reshape(-1, 3)
    fixed: list[int] = []
    described: dict[str, list[tuple[list[int], FactorDescription]]] = defaultdict(list)
    for factor in listed:
        if isinstance(factor, gtsam.NonlinearEqualityPose2):
            (key,) = factor.keys()
            if np.isfinite(factor.error(_elsewhere(values, key))):
                raise GraphError("a NonlinearEqualityPose2 with an error gain is no constraint")
            fixed.append(node[key])
            continue
        if isinstance(factor, LOGARITHM):
            raise GraphError(
                f"{type(factor).__name__} measures its error through the logarithm of SE(2), which is another cost; use "
                "RelativePoseFactor or AnchorFactor"
            )
        try:
            description = describe(factor)
        except OptionError as error:
            raise GraphError(str(error)) from None
        arguments = description.arguments
        if arguments.get("kernel") is not None:
            raise GraphError(f"the robust kernel of {description} changes the weights with the state")
        if arguments.get("frame") == "world":
            raise GraphError(f"the information of {description} is frozen in the world frame; use frame='body'")
        described[description.kind].append(([node[key] for key in description.keys], description))
    edges: list[ConstantEdges] = []
    for kind, group in described.items():
        if kind not in _EDGES:
            raise GraphError(f"{kind} has no form with constant information")
        for each in _EDGES[kind](group, state, len(state) + sum(len(e.landmarks) for e in edges)):
            edges.append(each)
    return edges, state, np.array(fixed, dtype=int)


def _elsewhere(values: gtsam.Values, key: int) -> gtsam.Values:
    """The pose of a key, moved."""
    moved = gtsam.Values()
    moved.insert(key, values.atPose2(key).compose(gtsam.Pose2(1.0, 1.0, 1.0)))
    return moved


def _value(values: gtsam.Values, key: int) -> list[float]:
    if not values.exists(key):
        raise OptionError(f"the values have nothing at the key {key_name(key)}")
    try:
        pose = values.atPose2(key)
        return [pose.x(), pose.y(), pose.theta()]
    except RuntimeError:
        return [*values.atPoint2(key), 0.0]


_Group = list[tuple[list[int], FactorDescription]]


def _anchors(group: _Group, state: Array, _: int) -> Iterable[ConstantEdges]:
    arguments = [description.arguments for _, description in group]
    nodes = np.array([keys[0] for keys, _ in group])
    held, information = (np.array([each[name] for each in arguments]) for name in ("pose", "information"))
    yield AnchorEdges(nodes, held, information).constant(state)


def _positions(group: _Group, state: Array, _: int) -> Iterable[ConstantEdges]:
    """Places without headings, and those with them."""
    for d in (2, 3):
        alike = [(keys[0], each.arguments) for keys, each in group if len(each.arguments["measured"]) == d]
        if alike:
            columns = [np.array([a[name] for _, a in alike]) for name in ("measured", "information", "lever")]
            yield PositionEdges(np.array([node for node, _ in alike]), *columns).constant(state)


def _relative(group: _Group, state: Array, _: int) -> Iterable[ConstantEdges]:
    first, second = np.array([keys for keys, _ in group]).T
    measured, information = zip(*(_measured(description) for _, description in group))
    edges = RelativePoseEdges if len(measured[0]) == 3 else RelativePointEdges
    yield edges(first, second, np.array(measured), np.array(information)).constant(state)


def _many(group: _Group, state: Array, _: int) -> Iterable[ConstantEdges]:
    for keys, description in group:
        a, nodes = description.arguments, np.array(keys)
        if a["edge_kernel"] is not None and (a["robust"] is None or np.any(a["robust"])):
            raise GraphError(f"the robust kernel of {description} changes the weights with the state")
        first, second, measured = (np.array(a[name]) for name in ("first", "second", "measured"))
        to_point = second >= len(keys) - a["points"]
        for kind, chosen, d in ((RelativePoseEdges, ~to_point, 3), (RelativePointEdges, to_point, 2)):
            if chosen.any():
                ends = nodes[first[chosen]], nodes[second[chosen]]
                yield kind(*ends, measured[chosen, :d], np.array(a["information"])[chosen, :d, :d]).constant(state)


def _measured(description: FactorDescription) -> tuple[Array, Array]:
    """The measurement of a factor of two keys in the axes of the first, and its information."""
    a, origin = description.arguments, np.zeros(3)
    if description.kind == "MotionFactor":
        covariance = a["motion"].covariance(origin, a["control"], a["dt"])
        return a["motion"].f(origin, a["control"], a["dt"]), _inverse(covariance) * a["scale"]
    if "z" in a:
        if a.get("residual") == "polar":
            raise GraphError(f"the residual h(x, m) - z of {description} has no such form; use residual='cartesian'")
        measured, covariance = a["sensor"].places(a["z"])
        return measured, _inverse(covariance) * a["scale"]
    return a["measured"], a["information"]


def _sightings(group: _Group, state: Array, begin: int) -> Iterable[ConstantEdges]:
    """Sightings of landmark nodes with psi, and those without."""
    for size in (2, 3):
        alike = [each for each in group if len(each[1].arguments["z"]) == size]
        if alike:
            yield from _relative(alike, state, begin)


def _virtual(group: _Group, state: Array, _: int) -> Iterable[ConstantEdges]:
    by_sensor: dict[Any, _Group] = defaultdict(list)
    for each in group:
        by_sensor[each[1].arguments["sensor"], len(each[1].arguments["z_1"])].append(each)
    for (sensor, _size), alike in by_sensor.items():
        z = np.array([(d.arguments["z_1"], d.arguments["z_2"]) for _, d in alike])
        nodes = np.array([keys for keys, _ in alike]).ravel()
        starts = np.arange(0, len(nodes) + 1, 2)
        edges = VirtualMotionEdges(starts, nodes, z.reshape(len(nodes), -1), sensor).constant(state)
        edges.information[:] *= np.array([d.arguments["scale"] for _, d in alike])[:, None, None]
        yield edges


def _landmarks(group: _Group, state: Array, begin: int) -> Iterable[ConstantEdges]:
    for keys, description in group:
        a = description.arguments
        order = np.argsort(keys, kind="stable") if a["weight"] == "marginal" else np.arange(len(keys))
        trust = None if a["trust"] is None else a["trust"][order]
        parts = np.array([0, len(keys)]), np.array(keys)[order], a["sightings"][order], a["sensor"]
        if a["weight"] == "marginal":
            edges = MarginalEdges(*parts, trust=trust).constant(state)
            edges.second[:] = begin
            begin += 1
        else:
            edges = VirtualMotionEdges(*parts, trust=trust, tempered=a["weight"] == "tempered").constant(state)
        yield edges


def _inverse(covariance: Array) -> Array:
    information = np.linalg.inv(covariance)
    return (information + information.T) / 2


_EDGES = {
    "AnchorFactor": _anchors,
    "PositionFactor": _positions,
    "RelativePoseFactor": _relative,
    "RelativeEdgesFactor": _many,
    "MotionFactor": _relative,
    "RelativePointFactor": _relative,
    "ObservationFactor": _sightings,
    "InverseObservationFactor": _sightings,
    "VirtualMotionFactor": _virtual,
    "LandmarkFactor": _landmarks,
}


def certify(graph: Graph | gtsam.NonlinearFactorGraph, solution: Solution | ArrayLike | gtsam.Values) -> Certificate:
    """Check whether a solution is the global minimum of the cost of a graph. docs/certificate.md explains what is proven.

    Args:
        graph: with the edges whose cost is minimised; or a GTSAM graph of the factors of `graphslam.factors`, in which
            `gtsam.NonlinearEqualityPose2` may hold poses. Its cost J is twice GTSAM's error.
        solution: a `Solution` of this graph, a state (n, 3) of its nodes, or, where no landmarks are nodes, all poses
            (T+1, 3) of the trajectory; for a GTSAM graph its `gtsam.Values`.

    Raises:
        OptionError: an argument is of another type, the state has another shape or is not finite, or the values lack a key.
    """
    if not isinstance(graph, Graph):
        if not hasattr(graph, "keyVector") or not hasattr(solution, "atPose2"):
            raise OptionError(
                "certify takes a Graph and its solution, or a gtsam.NonlinearFactorGraph and its gtsam.Values, not "
                f"{quoted(graph, 40)} and {quoted(solution, 40)}"
            )
        return _certify_factors(graph, solution)
    if isinstance(solution, Solution):
        if solution.graph is graph:
            return solution.certificate
        solution = solution.state
    state = array_of("the state", solution)
    if state.shape != graph.initial.shape and state.shape == graph.trajectory.shape and not len(graph.landmark_ids):
        state = state[graph.steps]
    if state.shape != graph.initial.shape:
        raise OptionError(f"the state must have shape {graph.initial.shape}, one row for each node, not {state.shape}")
    if not np.isfinite(state).all():
        raise OptionError("the state must be finite numbers")
    return prove(graph, state)


def _certify_factors(factors: Any, values: Any) -> Certificate:
    # here, so that only those who use GTSAM load it

    begin = time.perf_counter()
    try:
        edges, state, fixed = constant_edges(factors, values)
    except GraphError as error:
        return Certificate(NOT_APPLICABLE, np.nan, np.nan, str(error), time.perf_counter() - begin)
    # no number where the values violate a NonlinearEqualityPose2
    return prove_edges(edges, state, fixed, 2 * factors.error(values))
