"""Levenberg-Marquardt: damped Gauss-Newton steps, of which only those that lower J are taken."""

from __future__ import annotations

from typing import Any

from ..engine import engine
from ..graph import Graph
from .iteration import Run, iterate


def levenberg_marquardt(graph: Graph, run: Run) -> None:
    """Iterate (Omega + lambda diag(Omega)) Delta = xi, with lambda chosen so that J falls, until ``run`` stops.

    The end counts as converged only where an undamped step confirms it: beside very large entries of Omega (a pose on a
    landmark) even the smallest damping hides the other directions.

    lambda is Marquardt's damping by the diagonal, updated by Nielsen's rule from the gain, the actual decrease of J
    divided by the predicted one.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: Madsen, Nielsen and Tingleff, *Methods for non-linear least squares problems* (2004), section 3.2.
    """

    def search(objective: Any, inside: Any) -> None:
        engine.levenberg_marquardt(objective, inside, run.max_iterations)

    iterate(graph, run, search, 0.0)
