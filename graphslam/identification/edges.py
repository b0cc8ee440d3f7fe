"""The edges of a drive whose noise and biases are unknown: residuals, Jacobians, parts of covariances, and weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..se2 import Array


@dataclass
class Edges:
    """Edges of one kind at one state.

    Attributes:
        first, second: (E,) nodes.
        residuals: (E, d).
        by_first, by_second: (E, d, 3) Jacobians.
        by_parameters: (E, d, K).
        parts: {name of a variance: C (E, d, d)}.
        information: W (E, d, d), the inverse covariance times the weights.
        weights: u (E,) of Student's t.
        squares: (E,) e' W e without the weights.
    """

    first: np.ndarray
    second: np.ndarray
    residuals: Array
    by_first: Array
    by_second: Array
    by_parameters: Array
    parts: Mapping[str, Array]
    information: Array = field(default_factory=lambda: np.empty(0))
    weights: Array = field(default_factory=lambda: np.empty(0))
    squares: Array = field(default_factory=lambda: np.empty(0))

    def weigh(self, covariances: Array, degrees: float, hidden: Array | float) -> None:
        """Set the information and the weights; ``hidden`` (E,) is tr(W F) without the weights."""
        inverse, d = np.linalg.inv(covariances), self.residuals.shape[1]
        self.squares = np.einsum("ei,ei->e", self.residuals, (inverse @ self.residuals[:, :, None])[:, :, 0])
        self.weights = (degrees + d) / (degrees + self.squares + hidden)
        self.information = self.weights[:, None, None] * inverse

    def pull(self, forces: Array, nodes: Array) -> Array:
        """Add B' f for forces f (E, d, k) to right-hand sides (n, 3, k), and return J' f (K, k)."""
        add_at(nodes, self.first, np.swapaxes(self.by_first, 1, 2) @ forces)
        add_at(nodes, self.second, np.swapaxes(self.by_second, 1, 2) @ forces)
        return np.einsum("edp,edk->pk", self.by_parameters, forces)

    def moved(self, nodes: Array, parameters: Array) -> Array:
        """How residuals change, (E, d, k), when nodes (n, 3, k) and parameters (K, k) do."""
        return self.by_first @ nodes[self.first] + self.by_second @ nodes[self.second] + self.by_parameters @ parameters


def add_at(total: Array, rows: np.ndarray, values: Array) -> None:
    """Add values (E, ...) to these rows (E,) of ``total`` (n, ...), which may occur several times."""
    width = total[0].size
    places = rows[:, None] * width + np.arange(width)
    # several times as fast as `np.add.at`
    total += np.bincount(places.ravel(), values.ravel(), total.size).reshape(total.shape)
