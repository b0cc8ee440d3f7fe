"""Errors of the factorisation."""

import numpy as np
from numpy.typing import NDArray

COMPONENTS = ("x", "y", "heading")


class FactorizationError(ValueError):
    """A matrix has no Cholesky factor; ``node`` is where."""

    node: int


class NotFinite(FactorizationError):
    """The matrix holds NaN or infinity.

    Attributes:
        node: column of the first such block, in node order.
    """

    def __init__(self, row: int, node: int) -> None:
        self.node = node
        super().__init__(f"values hold NaN or infinity in block ({row}, {node})")


class SingularPivot(FactorizationError):
    """A pivot vanished or was negative: the matrix is not positive definite.

    Attributes:
        node: node of the pivot, in node order.
        component: scalar component 0, 1 or 2 of that node.
        null_vector: (n, 3) direction, largest entry 1 in magnitude, along which x' Omega x is the bad pivot: zero up
            to rounding for a singular matrix, so the direction in which nothing holds the graph. Where the direction
            itself cannot be computed, it is the coordinate of the pivot.
    """

    def __init__(self, node: int, component: int, null_vector: NDArray[np.float64]) -> None:
        self.node = node
        self.component = component
        self.null_vector = null_vector
        super().__init__(
            f"the matrix is not positive definite: pivot of node {node}, component {component} "
            f"({COMPONENTS[component]}), is zero or negative; null_vector holds the direction"
        )
