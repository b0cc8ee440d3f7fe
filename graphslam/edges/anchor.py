"""Anchor: a pose held at a value, (x - x̂)' Omega_0 (x - x̂). Without one the whole graph floats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..se2 import Array, wrap
from .base import BlockSystem, Linearization, Relations

#: the lectures' Omega_0 = 1e6 I
ANCHOR_INFORMATION = 1e6 * np.eye(3)


@dataclass(frozen=True, eq=False)
class AnchorEdges:
    """Anchors of nodes (E,) at values (E, 3) with information (E, 3, 3), e = x - x̂ with the heading wrapped."""

    nodes: np.ndarray
    values: Array
    information: Array

    @property
    def count(self) -> int:
        """The number of anchors."""
        return len(self.nodes)

    @property
    def frozen_information(self) -> bool:
        """Never: the information is given."""
        return False

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        """One node each; see `EdgeFamily.cliques`."""
        return np.arange(self.count + 1), self.nodes

    def linearize(self, state: Array, reference: Array) -> Linearization:
        """See `EdgeFamily.linearize`."""
        residuals = state[self.nodes] - self.values
        residuals[:, 2] = wrap(residuals[:, 2])
        return Linearization(
            residuals, self.information, (self.nodes,), (np.broadcast_to(np.eye(3), (self.count, 3, 3)),)
        )

    def headings(self) -> Relations | None:
        """See `EdgeFamily.headings`."""
        return None

    def positions(self, state: Array) -> Relations | None:
        """See `EdgeFamily.positions`."""
        return None

    def cost(self, state: Array, reference: Array) -> float:
        """See `EdgeFamily.cost`."""
        return float(self.linearize(state, reference).mahalanobis.sum())

    def accumulate(self, state: Array, reference: Array, system: BlockSystem) -> float:
        """See `EdgeFamily.accumulate`."""
        edges = self.linearize(state, reference)
        # add.at, not +=: a node may be anchored twice
        np.add.at(system.values, system.slots(self.nodes, self.nodes), self.information)
        np.add.at(system.xi, self.nodes, -np.einsum("eij,ej->ei", self.information, edges.residuals))
        return float(edges.mahalanobis.sum())
