"""The convex quadratic function below J that touches it at a candidate: its matrix S, its gradient, rounding errors.

The engine computes them, and has the equations: ``engine/include/vmslam/certificate/minorant.hpp``.
"""

from __future__ import annotations

from typing import NamedTuple

from ..se2 import Array


class Curvature(NamedTuple):
    """The split of each edge.

    Attributes:
        beta, A: (E,); beta = -1 leaves the edge out.
        error: (E,) a bound on the rounding error of A, in units.
        slack: (E,) what the parts of beta and kappa leave of the rounding errors that they absorb.
    """

    beta: Array
    A: Array
    error: Array
    slack: Array


class Minorant(NamedTuple):
    """The function below J at a candidate state of N nodes, in the variables (z, t) of the nodes that are free.

    Attributes:
        values: (nnzb, 2, 2) complex, the blocks of S on the pattern of the graph.
        gradient: (N, 2) complex, half the gradient at the candidate; zero at a stationary point.
        scale: (N, 2) the sums of the absolute values that were added to each diagonal entry of S, or more.
        error: (N, 2) a bound on the rounding error of ``gradient``, in units.
        touched: the cost at the candidate, without the edges that were left out.
        slack: a bound on its rounding errors.
    """

    values: Array
    gradient: Array
    scale: Array
    error: Array
    touched: float
    slack: float
