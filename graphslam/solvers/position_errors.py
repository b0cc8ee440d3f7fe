"""Errors of absolute positions that last, as those of satellite receivers, and the solution that counts them.

The covariances of positions are those of independent errors. Where the error of a position is much that of the one before,
n positions say no more than one, and covariances with independent errors are too small by this factor. The variances of the
errors of single positions, of those that last over L positions each, of motions and of sightings follow from the residuals
as in `scan_errors`. Over times that are long against the errors, positions then are as good as independent ones with

    m = sum over L of L theta_L

times their variances, so that the graph is solved again with the information of positions divided by m. The equations hold
for any weights, and say more with those of the next solution: m is found in a few rounds. For a first-order Gauss-Markov
process with the correlation time tau, sampled every dt, n = m / sum theta_L = (1 + a) / (1 - a), a = exp(-dt / tau).

Lasting errors of the odometry, as of biases that nobody estimates, are another kind, and do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..edges import PositionEdges, SightingEdges
from ..errors import GraphError
from ..graph import Graph
from ..linear.cholesky import FactorizationError
from ..se2 import Array
from .joint import motion_edges
from .scan_errors import SHARE, SURELY, Whitened, equations, settled, variances

if TYPE_CHECKING:
    from .solution import Solution

#: the fewest positions that say something; the number of lengths L, each a quarter of the one before, and the part of the
#: drive that the longest one is; the windows of a length that overlap
FEWEST, LENGTHS, LONGEST, OVERLAP = 20, 10, 5, 4
#: positions that the kernel gives less than this weight are wrong, and have it; others count as a whole
WRONG = 0.25
#: the rounds in which m is found, and the smallest m that is said
ROUNDS, LEAST = 4, 1.5


def with_lasting_errors(solution: Solution, again: Callable[[Graph], Solution] | None) -> tuple[Solution, str]:
    """The solution that counts the errors of positions as lasting as the log surely shows, and a sentence.

    The solution stays, and the sentence is empty, where the log does not show it.

    Args:
        again: the solution of another graph; without it, the sentence only says what is wrong.
    """
    graph, log = solution.graph, solution.graph and solution.graph.log
    if graph is None or log is None or log.times is None or motion_edges(graph) is None:
        return solution, ""
    nodes = np.concatenate([[], *(f.nodes for f in graph.families if isinstance(f, PositionEdges))]).astype(int)
    if len(nodes) < FEWEST:
        return solution, ""
    try:
        m, n = lasting_errors(graph, solution.state)
        if m < LEAST:
            return solution, ""
        if again is not None:
            wider = again(replace(_wider(graph, solution.state, m), initial=solution.state.copy()))
            if not wider.converged:
                again = None
    except (FactorizationError, GraphError, np.linalg.LinAlgError):
        return solution, ""
    step = float(np.median(np.diff(log.times[graph.steps[np.unique(nodes)]])))
    text = (
        f"errors of absolute positions last for about {step / np.log1p(2 / max(n - 1, 0.1)):.2g} s, as those of satellite "
        f"receivers do, so that {m:.2g} positions count as one. "
    )
    if again is None:
        return solution, text + (
            f"Covariances take them for independent, and are too small: multiply the standard deviations of the positions "
            f"by {m**0.5:.2g}"
        )
    seconds = solution.seconds + wider.seconds
    positions = {k: trust for k, trust in solution.other_trust.items() if k == "positions"}
    wider = replace(wider, seconds=seconds, other_trust={**wider.other_trust, **positions})
    return wider, text + "Poses, covariances and risks contain it"


def lasting_errors(graph: Graph, state: Array) -> tuple[float, float]:
    """m, by which the information of positions is too large, and the number n of positions over which errors last.

    Both are 1 where the log does not surely show lasting errors.

    Raises:
        FactorizationError, GraphError: the edges do not determine the nodes.
    """
    from scipy.optimize import nnls

    m, kind = 1.0, -1
    for _ in range(ROUNDS):
        lengths, q, S = _equations(_wider(graph, state, m), state)
        if kind < 0:
            # lengths share their errors, so each is tried alone
            alone = [[i, *range(len(lengths), len(q))] for i in range(len(lengths))]
            found = [variances(q[rows], S[np.ix_(rows, rows)]) for rows in alone]
            kind = int(np.argmax([z[0] for _, z, _ in found]))
            _, z, share = found[kind]
            if z[0] < SURELY or share[0] < SHARE:
                return 1.0, 1.0
        rows, size = alone[kind], np.sqrt(np.diag(S))[alone[kind]]
        scaled = S[np.ix_(rows, rows)] / size[:, None] / size
        lasting, single = (nnls(scaled, q[rows] / size)[0] / size)[:2]
        m = max(1.0, m * (lengths[kind] * lasting + single))
    return m, (lengths[kind] * lasting + single) / max(lasting + single, 1e-300)


def _wider(graph: Graph, state: Array, m: float) -> Graph:
    """The graph with the information of positions divided by m; wrong ones keep the weights of a kernel at a state."""

    def changed(f: PositionEdges) -> PositionEdges:
        weights = f.kernel_weights(state)
        trust = f.trusted * np.where(weights < WRONG, weights, 1.0)
        return replace(f, information=f.information * trust[:, None, None] / m, kernel=None, trust=None)

    return graph.with_changed(PositionEdges, changed)


def _equations(graph: Graph, state: Array) -> tuple[Array, Array, Array]:
    """Lengths L (K,), the last one 1, and q and S of errors of positions with these lengths, then of others."""
    from scipy.sparse import csr_matrix, hstack

    moved = motion_edges(graph)
    assert moved is not None
    positions = [f for f in graph.families if isinstance(f, PositionEdges) and f.count]
    plain = {f: settled(f, state) for f in graph.families if isinstance(f, SightingEdges) and f.count}
    changed = graph.with_families(plain.get(f, f) for f in graph.families)
    drive = Whitened(changed, [*positions, replace(moved, frame="body"), *plain.values()], state)
    # the first numbers of positions among the residuals, in the order of time
    first = np.concatenate([drive.first[k] + f.dimension * np.arange(f.count) for k, f in enumerate(positions)])
    first = first[np.argsort(np.concatenate([f.nodes for f in positions]), kind="stable")]
    x, y = (csr_matrix((np.ones(len(first)), (first + k, np.arange(len(first)))), (drive.first[-1], len(first))) for k in (0, 1))
    lengths = [length for k in range(LENGTHS) if (length := len(first) // (LONGEST * 2**k)) > 1]
    drive.kinds = [hstack([x @ windows, y @ windows]).tocsr() for windows in (_windows(len(first), each) for each in lengths)]
    drive.kinds += [hstack([drive.single(k) for k in range(len(positions))]).tocsr(), *drive.motions(len(positions))]
    drive.kinds += [drive.single(k) for k in range(len(positions) + 1, len(drive.edges))]
    return np.array(lengths), *equations(drive, len(graph.steps))


def _windows(count: int, length: int) -> Any:
    """(count, K) errors over windows of a length, which overlap; the sum of all of them has the variance 1 at each row."""
    from scipy.sparse import csr_matrix

    starts = np.arange(1 - length, count, max(1, length // OVERLAP))
    row = starts[:, None] + np.arange(length)
    column = np.broadcast_to(np.arange(len(starts))[:, None], row.shape)
    inside = (row >= 0) & (row < count)
    windows = np.bincount(row[inside], minlength=count)
    return csr_matrix((windows[row[inside]] ** -0.5, (row[inside], column[inside])), (count, len(starts)))
