"""Certificates of solutions, and of GTSAM graphs of our factors, whose factors become the edges that the certificate needs.

`certify` proves for a solution, or for any state of a graph, that no other state has a lower cost.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, cast

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from .. import edges
from ..errors import GraphError, OptionError, checks, quoted
from ..factors.description import FactorDescription, describe, key_name
from ..graph import Graph
from ..se2 import Array
from .certificate import NOT_APPLICABLE, Certificate, prove, prove_edges
from .solution import Solution

#: GTSAM's own factors whose error goes through the logarithm of SE(2)
LOGARITHM = (gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2)
#: what holds a node
HELD = (gtsam.NonlinearEqualityPose2, gtsam.NonlinearEqualityPoint2)


def edges_of_factors(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[list[edges.EdgeFamily], Array, np.ndarray]:
    """The edges of a graph, the state (n, 3) of its values, and the nodes that factors in `HELD` hold.

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
    groups: dict[tuple[Any, ...], list[FactorDescription]] = defaultdict(list)
    for factor in listed:
        if isinstance(factor, HELD):
            (key,) = factor.keys()
            if np.isfinite(factor.error(_elsewhere(values, key, isinstance(factor, gtsam.NonlinearEqualityPose2)))):
                raise GraphError(f"a {type(factor).__name__} with an error gain is no constraint")
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
        a = description.arguments
        if a.get("kernel") is not None:
            raise GraphError(f"the robust kernel of {description} changes the weights with the state")
        if a.get("frame") == "world":
            raise GraphError(f"the information of {description} is frozen in the world frame; use frame='body'")
        if description.kind not in _EDGES:
            raise GraphError(f"{description.kind} has no form with constant information")
        sizes = tuple(len(a[name]) for name in ("measured", "z", "z_1") if name in a)
        groups[description.kind, len(description.keys), sizes, a.get("sensor")].append(description)
    families: list[edges.EdgeFamily] = []
    for (kind, *_), alike in groups.items():
        families += _EDGES[kind](np.array([[node[key] for key in each.keys] for each in alike]), alike)
    return families, state, np.array(fixed, dtype=int)


def _elsewhere(values: gtsam.Values, key: int, is_pose: bool) -> gtsam.Values:
    """The pose or the point of a key, moved."""
    moved, pose = gtsam.Values(), gtsam.Pose2(*_value(values, key)).compose(gtsam.Pose2(1.0, 1.0, 1.0))
    moved.insert(key, pose if is_pose else pose.translation())
    return moved


def _value(values: gtsam.Values, key: int) -> list[float]:
    if not values.exists(key):
        raise OptionError(f"the values have nothing at the key {key_name(key)}")
    try:
        pose = values.atPose2(key)
        return [pose.x(), pose.y(), pose.theta()]
    except RuntimeError:
        return [*values.atPoint2(key), 0.0]


def _columns(alike: list[FactorDescription], *names: str) -> list[Array]:
    """Arguments of factors, one row for each factor."""
    return [np.array([each.arguments[name] for each in alike]) for name in names]


def _anchors(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    yield edges.AnchorEdges(nodes[:, 0], *_columns(alike, "pose", "information"))


def _positions(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    yield edges.PositionEdges(nodes[:, 0], *_columns(alike, "measured", "information", "lever"))


def _relative(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    measured, information = zip(*map(_measured, alike))
    kind = edges.RelativePoseEdges if len(measured[0]) == 3 else edges.RelativePointEdges
    yield kind(nodes[:, 0], nodes[:, 1], np.array(measured), np.array(information))


def _measured(description: FactorDescription) -> tuple[Array, Array]:
    """The measurement of a factor of two keys in the axes of the first, and its information."""
    a, origin = description.arguments, np.zeros(3)
    if description.kind == "MotionFactor":
        covariance = a["motion"].covariance(origin, a["control"], a["dt"])
        return a["motion"].f(origin, a["control"], a["dt"]), _inverse(covariance) * a["scale"]
    if "z" in a:
        if a.get("residual") == "polar":
            raise GraphError(f"the residual h(x, m) - z of {description} has no such form; use residual='cartesian'")
        noisy = None if a["noise_at"] is None else a["noise_at"][None]
        measured, covariance = (each[0] for each in a["sensor"].places(a["z"][None], noisy=noisy))
        return measured, _inverse(covariance) * a["scale"]
    return a["measured"], a["information"]


def _many(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    for own, description in zip(nodes, alike):
        a = description.arguments
        if a["edge_kernel"] is not None and (a["robust"] is None or np.any(a["robust"])):
            raise GraphError(f"the robust kernel of {description} changes the weights with the state")
        first, second, measured, information = map(np.array, map(a.get, ("first", "second", "measured", "information")))
        to_point = second >= len(own) - a["points"]
        for kind, chosen, d in ((edges.RelativePoseEdges, ~to_point, 3), (edges.RelativePointEdges, to_point, 2)):
            if chosen.any():
                ends = own[first[chosen]], own[second[chosen]]
                yield kind(*ends, measured[chosen, :d], information[chosen, :d, :d])


def _virtual(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    z_1, z_2, scale = _columns(alike, "z_1", "z_2", "scale")
    # the information of a pair has the product of the trust in its sightings
    trust = np.repeat(scale**0.5, 2)
    z, starts = np.stack([z_1, z_2], axis=1), np.arange(0, nodes.size + 1, 2)
    sensor = alike[0].arguments["sensor"]
    given = [each.arguments["noise_at"] for each in alike]
    noisy = np.array([own if at is None else at for own, at in zip(z, given)]).reshape(nodes.size, -1)
    yield edges.VirtualMotionEdges(
        starts, nodes.ravel(), z.reshape(nodes.size, -1), sensor, trust=trust, noise_at=noisy
    )


def _landmarks(nodes: np.ndarray, alike: list[FactorDescription]) -> Iterator[edges.EdgeFamily]:
    for own, description in zip(nodes, alike):
        a = description.arguments
        order = np.argsort(own, kind="stable") if a["weight"] == "marginal" else np.arange(len(own))
        trust = None if a["trust"] is None else a["trust"][order]
        parts = np.array([0, len(own)]), own[order], a["sightings"][order], a["sensor"]
        noisy = None if a["noise_at"] is None else a["noise_at"][order]
        if a["weight"] == "marginal":
            yield edges.MarginalEdges(*parts, trust=trust, noise_at=noisy)
        else:
            yield edges.VirtualMotionEdges(*parts, trust=trust, noise_at=noisy, tempered=a["weight"] == "tempered")


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
    "ObservationFactor": _relative,
    "InverseObservationFactor": _relative,
    "VirtualMotionFactor": _virtual,
    "LandmarkFactor": _landmarks,
}


def certify(graph: Graph | gtsam.NonlinearFactorGraph, solution: Solution | ArrayLike | gtsam.Values) -> Certificate:
    """Check whether a solution is the global minimum of the cost of a graph; docs/beyond/certificate.md explains how.

    Args:
        graph: with the edges whose cost is minimised; or a GTSAM graph of the factors of `graphslam.factors`, in which
            `gtsam.NonlinearEqualityPose2` and ``NonlinearEqualityPoint2`` may hold nodes. Its cost J is twice GTSAM's error.
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
        begin, values = time.perf_counter(), cast(gtsam.Values, solution)
        try:
            families, state, fixed = edges_of_factors(graph, values)
        except GraphError as error:
            return Certificate(NOT_APPLICABLE, np.nan, np.nan, str(error), time.perf_counter() - begin)
        # no number where the values violate a constraint
        return prove_edges(families, state, fixed, 2 * graph.error(values))
    if isinstance(solution, Solution):
        if solution.graph is graph:
            return solution.certificate
        solution = solution.state
    state = checks.array_of("the state", solution)
    if state.shape != graph.initial.shape and state.shape == graph.trajectory.shape and not len(graph.landmark_ids):
        state = state[graph.steps]
    if state.shape != graph.initial.shape:
        raise OptionError(f"the state must have shape {graph.initial.shape}, one row for each node, not {state.shape}")
    if not np.isfinite(state).all():
        raise OptionError("the state must be finite numbers")
    return prove(graph, state)
