"""The errors of the places of a map, from a log that contradicts them; and the solution in the map with these errors.

Let each coordinate of a landmark have an error with the variance s² beside its covariance in the map, C for all landmarks.
A solution with the prior Q = C + s0² I puts the landmarks x from the map, with the joint covariance P. What the log alone
says of them has the information S = P^-1 - Q^-1 and the vector h = P^-1 x, so that

    -2 log p(log | s) = log det(I + S Q_s) - h' Q_s (I + S Q_s)^-1 h + constant,    Q_s = C + s² I.

Its minimum is the s of the next solution. The first one follows from the scores of the solution in the map as it is
(`contradictions`). The map stays as it is where the log is not much more probable with s than without, if the noise is
as large as the residuals of the last solution show.

**Single landmarks.** With a shift d_j of landmark j, what its sightings see is m_j + d_j. At the solution m with the map's
prior (mean mu, information L) and the covariance P of the landmarks, the least squares estimate of the shift and its
information are, in the linear model and without solving again,

    S = L - L P L,    d_j = S_jj^-1 (L (m - mu))_j,

so that d_j is the difference of the position from this log and the rest of the map, and that in the map.

Sources: MacKay, *Bayesian interpolation*, Neural Computation 1992 (the evidence of a prior's variance); Belsley, Kuh and
Welsch, *Regression Diagnostics*, 1980, chapter 2 (deletion of observations).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..edges import LandmarkPriors, PriorEdges, Way
from ..errors import GraphError
from ..errors.checks import listed
from ..graph import Graph
from ..graph.build import priors_of_map
from ..maps.landmark_map import LandmarkMap
from ..maps.localization import SURE
from ..maps.registration import evenly
from ..maps.tracker import middle_misfit
from ..se2 import Array
from .uncertainty import Uncertainty

if TYPE_CHECKING:
    from .solution import Solution

#: the most landmarks that the deviation is found from, the most solutions, and the change of it that is small
MOST, ROUNDS, SETTLED = 60, 5, 0.1
#: the fewest landmarks that say something of the map
FEWEST = 3
#: the log determines a landmark where it has more than this part of the information that its sightings alone would give, and
#: the lever where it has more than this part of that of exact poses
DETERMINED = 1e-6
#: the deviation is looked for within this factor of the last one
WITHIN = 100.0


def in_wider_map(
    solution: Solution, deviation: float, again: Callable[[Graph], Solution]
) -> tuple[Solution, float] | None:
    """The solution with the errors of the map that the log shows, and their deviation [m]; None where there is none.

    Args:
        solution: in the map as it is, of a log.
        deviation: the first that is tried.
        again: solves a graph from its initial values.
    """
    graph, seconds = solution.graph, solution.seconds
    assert graph is not None and graph.map is not None and graph.log is not None
    nodes = np.sort(graph.mapped)
    nodes = nodes[np.isin(graph.landmark_ids[nodes - len(graph.steps)], graph.log.landmarks)]
    nodes = nodes[evenly(len(nodes), MOST)]
    ids = graph.landmark_ids[nodes - len(graph.steps)].tolist()
    of_map, rows = graph.map.joint_covariance(ids), np.tile([True, True, False], len(nodes))
    for _ in range(ROUNDS):
        try:
            last, solution = deviation, again(in_map(graph, graph.map.widened(deviation), solution.state))
            seconds += solution.seconds
            if not solution.converged or solution.graph is None:
                return None
            P = Uncertainty(solution.graph, solution.state).joint(nodes)[np.ix_(rows, rows)]
            off = solution.state[nodes, :2] - graph.map.arrays(ids)[0][:, :2]
            S, h = of_log(off.ravel(), P, of_map, last)
            deviation, _ = likeliest_deviation(S, h, of_map, last)
        except (GraphError, np.linalg.LinAlgError):
            return None
        if abs(np.log(deviation / last)) < SETTLED:
            break
    # what residuals show of larger noise in the right map
    larger = solution.residual_inflation
    _, gain = likeliest_deviation(S / larger, h / larger, of_map, last)
    return (replace(solution, seconds=seconds), last) if gain > np.log(SURE) else None


def said_of_wider(deviation: float) -> str:
    """What a note says of a solution, or of an online solver, in a map that is off by a deviation [m]."""
    return (
        f"Poses, covariances and risks count each of its places as off by {deviation:.2g} m more than the map says "
        "(standard deviation of x and y), as the log shows"
    )


def said_of_moved(ids: Iterable[int], size: float, *, left_out: bool) -> str:
    """A sentence on landmarks that have moved, by up to a size [m], and whether the map counts without them."""
    done = "The map counts without moved landmarks, which this log places anew; map_states says what else has changed"
    if not left_out:
        done = (
            "Moved landmarks pull the poses along, which are less exact than their covariances say; map_states says what has "
            "changed, and its map leaves moved landmarks out"
        )
    return f"probably moved since the map was made: {listed('landmark', sorted(ids))}, by up to {size:.2g} m. {done}"


def in_map(graph: Graph, known: LandmarkMap, state: Array) -> Graph:
    """The graph with other covariances of its map, or without some of its landmarks, beginning at a state (n, 3)."""
    d, mapped = graph.landmark_dimension, np.sort(graph.mapped)
    places = {j: known[j] for j in graph.landmark_ids[mapped - len(graph.steps)].tolist() if j in known}
    values, nodes = state.copy(), len(graph.steps) + np.searchsorted(graph.landmark_ids, list(places))
    for node, place in zip(nodes.tolist(), places.values()):
        values[node, : len(place[:d])] = place[:d]
    priors, fixed = priors_of_map(known, places, graph.landmark_ids, values, d)
    others = (family for family in graph.families if not isinstance(family, (LandmarkPriors, PriorEdges)))
    return replace(graph, families=(*priors, *others), fixed=fixed, map=known, initial=state.copy())


def likeliest_deviation(S: Array, h: Array, of_map: Array | float = 0.0, last: float = 0.1) -> tuple[float, float]:
    """s [m] from S (k, k) and h (k,), the covariance of the map C, and the deviation of the last solution; and by how much
    the logarithm of the probability of the log is above that without s."""
    from scipy.optimize import minimize_scalar

    each = np.eye(len(h))

    def unlikely(logarithm: float) -> float:
        Q = of_map + np.exp(2 * logarithm) * each
        mixed = each + S @ Q
        return float(np.linalg.slogdet(mixed)[1] - h @ Q @ np.linalg.solve(mixed, h))

    bounds = np.log(last) + np.log(WITHIN) * np.array([-1, 1])
    found = minimize_scalar(unlikely, bounds=bounds, method="bounded", options={"xatol": 0.01})
    return float(np.exp(found.x)), (unlikely(-np.inf) - float(found.fun)) / 2


def of_log(off: Array, covariance: Array, of_map: Array, last: float) -> tuple[Array, Array]:
    """S and h of displacements x (k,) with their covariance P, in a solution with C of the map and the deviation s0."""
    inverse = np.linalg.inv(covariance)
    return inverse - np.linalg.inv(of_map + last**2 * np.eye(len(off))), inverse @ off


def misfit(g: Array, S: Array, alone: Array) -> tuple[float, float]:
    """The root of the median of q over 2 log 2, and the median of displacements [m], of landmarks that the log determines.

    ``alone`` is d' H d. With few landmarks the median is the lower one of two.
    """
    q, size, determined = displacements(g, S, alone)
    return (0.0, 0.0) if determined.sum() < FEWEST else middle_misfit(q, size)


def displacements(g: Array, S: Array, alone: Array) -> tuple[Array, Array, np.ndarray]:
    """q and the displacement [m] of each landmark that the log determines, and which of all (n,) these are."""
    count = len(g) // 2
    each = np.arange(count)
    own, known = (matrix.reshape(count, 2, count, 2)[each, :, each] for matrix in (S, alone))
    determined = np.linalg.eigvalsh(own)[:, 0] > DETERMINED * np.trace(known, axis1=1, axis2=2)
    own, forces = own[determined], g.reshape(count, 2)[determined]
    moved = np.linalg.solve(own, forces[:, :, None])[:, :, 0]
    return np.einsum("ki,ki->k", moved, forces), np.hypot(moved[:, 0], moved[:, 1]), determined


def scores_in_map(
    known: LandmarkMap, ids: Sequence[int], places: Array, covariance: Array, pivot: Array | None
) -> tuple[Array, Array, Array, Array]:
    """L (m - mu) (k,), S (k, k) and L (k, k) of landmarks at places (K, d) with a covariance P (k, k), k = d K.

    With them (3, 3), which turns axes of the world into those of the prior.

    Args:
        known: the map, none of whose coordinates is exact.
        pivot: of the prior (`edges.Way`), where it turns with the map.
    """
    d = places.shape[1]
    chosen = np.tile(np.arange(3) < d, len(ids))
    means, nodes = np.zeros((2, len(ids), 3))
    for k, j in enumerate(ids):
        means[k, : min(d, len(known[j]))] = known[j][:d]
    nodes[:, :d] = places
    L = known.information(ids, d)[np.ix_(chosen, chosen)]
    way = Way.of(nodes, means, pivot)
    mixed = L @ way.jacobian()[np.ix_(chosen, chosen)]
    return L @ way.v[chosen], L - mixed @ covariance @ mixed.T, L, way.turn
