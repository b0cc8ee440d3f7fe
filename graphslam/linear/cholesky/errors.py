"""Errors of the factorisation."""

import numpy as np
from numpy.typing import NDArray

COMPONENTS = ("x", "y", "heading")


class SingularPivot(ValueError):
    """A pivot vanished or was negative: the matrix is not positive definite.

    Attributes:
        node: node of the pivot, in node order.
        component: scalar component 0, 1 or 2 of that node.
        null_vector: (n, 3) direction, largest entry 1 in magnitude, along which x' Omega x is the bad pivot: zero up
            to rounding for a singular matrix, so the direction in which nothing holds the graph.
    """

    def __init__(self, node: int, component: int, null_vector: NDArray[np.float64]) -> None:
        self.node = node
        self.component = component
        self.null_vector = null_vector
        super().__init__(
            f"the matrix is not positive definite: pivot of node {node}, component {component} "
            f"({COMPONENTS[component]}), is zero or negative; null_vector holds the direction"
        )
