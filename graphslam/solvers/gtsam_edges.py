"""The edges of a GTSAM graph of our factors, in the form that the certificate needs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import gtsam
import numpy as np

from ..edges import (
    AnchorEdges,
    ConstantEdges,
    MarginalEdges,
    PositionEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from ..errors import GraphError, OptionError
from ..factors.description import FactorDescription, describe, key_name
from ..se2 import Array

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
