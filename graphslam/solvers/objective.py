"""Graphs in the form in which the iterations of the engine take them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeGuard

import numpy as np

from ..edges import EdgeFamily
from ..edges.base import EngineEdges
from ..engine import engine
from ..graph import Graph
from ..linear.information import BlockSystem
from ..se2 import Array


def objective_of(graph: Any) -> Any:
    """The objective of a `Graph`, or of another object that has ``linearize``, ``cost`` and a ``system`` as a graph does."""
    objective = _of_graph(graph) if isinstance(graph, Graph) else engine.PythonObjective(_InPython(graph))
    objective.state_dependent, objective.reweighted = graph.state_dependent_information, graph.reweighted
    return objective


def _of_graph(graph: Graph) -> Any:
    system, fixed = graph.system, np.ascontiguousarray(graph.fixed, dtype=np.int64)
    families = tuple(_in_engine(family, graph) for family in graph.families)
    pairs = tuple(family.blocks(system) if _is_of_engine(family) else _NONE for family in graph.families)
    held = (system.blocks_of(fixed) if len(fixed) else _NONE, fixed, graph.without_heading)
    return engine.GraphObjective((families, pairs, system.arrays, held, system.factor_in_engine), graph.prior_cost)


_NONE = np.zeros(0, dtype=np.int64)


def _is_of_engine(family: EdgeFamily) -> TypeGuard[EngineEdges]:
    """Whether the engine computes the sums of a family: it is of the engine, and no derived class has sums of its own."""
    return isinstance(family, EngineEdges) and type(family).accumulate is EngineEdges.accumulate


def _in_engine(family: EdgeFamily, graph: Graph) -> Any:
    if _is_of_engine(family):
        return family.in_engine
    return engine.PythonFamily(_accumulate(family, graph.system), graph.initial.size)


def _accumulate(family: EdgeFamily, system: BlockSystem) -> Callable[[Array, Array, bool], float]:
    """`EdgeFamily.accumulate` of a family that is written in NumPy."""
    return lambda state, reference, add: family.accumulate(state, reference, system if add else None)


class _InPython:
    """The interface of the engine to an objective that is written in Python."""

    def __init__(self, graph: Any) -> None:
        self._graph = graph
        self._system: Any = None
        self._factor: Any = None

    def linearize(self, state: Array, reference: Array) -> float:
        self._system, cost = self._graph.linearize(state, reference)
        return cost

    def cost(self, state: Array, reference: Array) -> float:
        return self._graph.cost(state, reference)

    def factorize(self, damping: float) -> None:
        self._factor = self._system.factorize(damping)

    def solve(self) -> Array:
        return self._factor.solve(self._system.xi)

    @property
    def xi(self) -> Array:
        return self._system.xi

    def diagonal(self) -> Array:
        return self._system.diagonal()
