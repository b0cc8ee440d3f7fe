"""Graphs with parameters of vehicle and sensor: first the nodes at the given parameters, then both together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..graph import Graph
from ..parameters.corrected import finished
from ..parameters.joint import JointGraph
from ..parameters.observable import check_observable
from ..se2 import Array
from .iteration import Run

#: the nodes are first solved to this tolerance, at the given parameters
FIRST = 1e-4


def without_parameters(graph: Graph) -> Graph:
    """The same graph with its parameters held at their values."""
    return replace(graph, parameters=None)


def solve_jointly(graph: Graph, start: Array, search: Callable[[JointGraph, Run], None], run: Run) -> Graph:
    """Nodes and parameters together, from nodes (n, 3); the end of ``run`` becomes that of the nodes.

    Args:
        graph: with parameters.
        start: (n, 3) the nodes solved at the given parameters.
        search: an iteration of `graphslam.solvers`.
        run: its rules; the state is replaced.

    Returns:
        The graph at the estimated parameters.

    Raises:
        GraphError: the log does not determine the parameters.
        LogError: an estimated parameter takes a range below zero.
    """
    joint = JointGraph(graph.with_initial(start))
    check_observable(joint, start, joint.parameters.values)
    run.state = joint.joined(start, joint.parameters.values)
    report = run.callback
    if report is not None:
        told = report
        run.callback = lambda step: told(replace(step, state=joint.parted(step.state)[0]))
    search(joint, run)
    nodes, values = joint.parted(run.state)
    if np.isfinite(run.state).all():
        check_observable(joint, nodes, values)
    run.state = nodes.copy()
    return finished(graph, values, nodes)
