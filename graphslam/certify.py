"""`certify`: prove for a solution, or for any state of a graph, that no other state has a lower cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .certificate import Certificate, prove
from .errors import OptionError
from .graph import Graph
from .solution import Solution


def certify(graph: Graph, solution: Solution | ArrayLike) -> Certificate:
    """Check whether a solution is the global minimum of the cost of a graph. docs/certificate.md explains what is proven.

    Args:
        graph: with the edges whose cost is minimised.
        solution: a `Solution` of this graph, a state (n, 3) of its nodes, or, where no landmarks are nodes, all poses
            (T+1, 3) of the trajectory.

    Raises:
        OptionError: the state has another shape.
    """
    if isinstance(solution, Solution):
        if solution.graph is graph:
            return solution.certificate
        solution = solution.state
    state = np.asarray(solution, dtype=float)
    if state.shape != graph.initial.shape and state.shape == graph.trajectory.shape and not len(graph.landmark_ids):
        state = state[graph.steps]
    if state.shape != graph.initial.shape:
        raise OptionError(f"the state must have shape {graph.initial.shape}, one row for each node, not {state.shape}")
    return prove(graph, state)
