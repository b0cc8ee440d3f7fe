"""Anchor: a prior on a pose, (x - x̂)' Omega_0 (x - x̂). Without an anchor the whole graph can move freely."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine import engine
from ..se2 import Array, wrap
from .base import ConstantEdges, EngineEdges, Linearization

#: the lectures' Omega_0 = 1e6 I
ANCHOR_INFORMATION = 1e6 * np.eye(3)


@dataclass(frozen=True, eq=False)
class AnchorEdges(EngineEdges):
    """Anchors of nodes (E,) at values (E, 3) with information (E, 3, 3), e = x - x̂ with the heading wrapped."""

    nodes: np.ndarray
    values: Array
    information: Array

    def __post_init__(self) -> None:
        # J depends on the symmetric part only, and code that reads one triangle must find the same
        symmetric = (self.information + np.swapaxes(self.information, 1, 2)) / 2
        object.__setattr__(self, "information", symmetric)

    @property
    def count(self) -> int:
        return len(self.nodes)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.count + 1), self.nodes

    def linearize(self, state: Array, reference: Array) -> Linearization:
        residuals = state[self.nodes] - self.values
        residuals[:, 2] = wrap(residuals[:, 2])
        jacobians = np.broadcast_to(np.eye(3), (self.count, 3, 3))
        return Linearization(residuals, self.information, (self.nodes,), (jacobians,))

    def constant(self, state: Array) -> ConstantEdges:
        # a relative pose measured from the origin of the world
        ends = np.full(self.count, -1), self.nodes
        return ConstantEdges(*ends, self.values[:, :2], np.zeros((self.count, 2)), self.values[:, 2], self.information)

    def _to_engine(self) -> Any:
        return engine.AnchorEdges(self.nodes, self.values, self.information)
