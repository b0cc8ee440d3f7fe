"""Gauss-Newton: solve Omega Delta = xi, move by Delta, repeat."""

from __future__ import annotations

from ..engine import engine
from ..graph import Graph
from .iteration import Run, iterate

#: After a plain step that lowers J by at most this part of it, Omega hardly changes: the next step uses the same factor,
#: unless the gain that it predicts, or the square of its length, is more than a tenth of that of the step before it
KEPT = 0.01


def gauss_newton(graph: Graph, run: Run) -> None:
    """Iterate x <- x + Omega^-1 xi with Omega = sum B' Omega_e B and xi = - sum B' Omega_e e, until ``run`` stops.

    Plain steps converge slowly where information, or a kernel's weights, are re-evaluated at every step; there the
    iterates are mixed (Anderson acceleration). They also converge slowly, or oscillate, where residuals are large, because
    Omega leaves out the second derivatives of the residuals; the iterates are therefore mixed after eight plain steps in any
    case. Where neither the lowest J nor the shortest step improves for ten steps, damped steps lead on from the best state
    (`levenberg_marquardt`). They converge slowly, too, so that after twenty of them undamped ones follow.

    Raises:
        GraphError: the edges do not determine the nodes.

    Source: the lectures, section 9.1; Nocedal and Wright, *Numerical Optimization*, section 10.3.
    """
    iterate(graph, run, engine.gauss_newton, KEPT)
