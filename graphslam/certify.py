"""`certify`: prove for a solution, or for any state of a graph, that no other state has a lower cost."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .certificate import NOT_APPLICABLE, Certificate, prove, prove_edges
from .checks import array_of
from .errors import GraphError, OptionError, quoted
from .graph import Graph
from .solution import Solution

if TYPE_CHECKING:
    import gtsam


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
    from .solvers.gtsam_edges import constant_edges

    begin = time.perf_counter()
    try:
        edges, state, fixed = constant_edges(factors, values)
    except GraphError as error:
        return Certificate(NOT_APPLICABLE, np.nan, np.nan, str(error), time.perf_counter() - begin)
    # no number where the values violate a NonlinearEqualityPose2
    return prove_edges(edges, state, fixed, 2 * factors.error(values))
