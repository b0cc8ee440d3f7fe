"""Trust that grows from the odometry: which relations agree with what is trusted so far.

At first the motion edges alone are trusted. What agrees with them within the uncertainty of the poses is then trusted, the
most certain comparisons first; that makes the poses more certain, and decides about more. An edge with the residual e agrees
if

    e' (C + B P B')^-1 e <= c²,

C its covariance, P that of the poses and c² the limit of graduated non-convexity. What turns out to contradict later, with
e' C^-1 e above the limit, is left out again. This needs no good start, but noise models that are not too optimistic.

Source: the test of the innovation, Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*,
2001, section 5.4; the order is that of nearest neighbours first.
"""

from __future__ import annotations

import numpy as np

from ..edges import RelationEdges
from ..graph import Graph
from ..se2 import Array
from ..uncertainty import Uncertainty
from .iteration import Run
from .levenberg_marquardt import levenberg_marquardt

#: the most rounds, and the damped steps in each
ROUNDS, STEPS = 40, 8
#: so large a part of those that agree is trusted in a round, the most certain ones, and all that are nearly as certain
PART, NEARLY = 0.25, 4.0
#: the part of the limit that counts as long as something agrees within it: a wrong relation does so an eighth as often
FIRST = 0.25


def grown_trust(graph: Graph, start: Array, limit: float) -> tuple[Array, Array, int]:
    """The state (n, 3), the trust (R,), 0 or 1, in the relations of a graph without kernels, and the number of rounds.

    Args:
        graph: whose only measurements that may be wrong are relations.
        start: (n, 3), what the trusted edges alone give.
        limit: c².

    Raises:
        GraphError: the trusted edges do not determine the nodes.
    """
    edges = next(family for family in graph.families if isinstance(family, RelationEdges))
    covariances, state, trust = np.linalg.inv(edges.information), start, np.zeros(edges.count)
    rounds, share = 0, FIRST
    while rounds < ROUNDS:
        rounds += 1
        trusting = graph.with_trust(trust)
        run = Run(state, 1e-3 * len(graph.steps) ** 0.5, STEPS)
        levenberg_marquardt(trusting, run)
        state = run.state
        linear = edges.linearize(state, state)
        innovation = covariances + Uncertainty(trusting, state).of_edges(linear)
        e = linear.residuals
        agree = np.einsum("ei,ei->e", e, np.linalg.solve(innovation, e[:, :, None])[:, :, 0]) <= share * limit
        new = np.where(linear.mahalanobis > limit, 0.0, trust)
        if (added := np.flatnonzero(agree & (trust == 0))).size:
            # the volume in which a wrong relation would agree
            volume = np.sqrt(np.linalg.det(innovation[added]))
            new[added[volume <= max(NEARLY * volume.min(), np.quantile(volume, PART))]] = 1.0
        if np.array_equal(new, trust):
            if share == 1:
                break
            share = 1.0
        trust = new
    return state, trust, rounds
