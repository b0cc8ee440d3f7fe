"""Relations that are right, found by what they agree with: first with each other, then with what is trusted.

Two relations whose first poses are neighbours on the trajectory, and whose second poses are, close a loop with the odometry
between them. Let e be the difference of the second relation from the first one that was carried along the odometry, T its
covariance, and U the volume of poses over which the relations spread. A relation at random agrees as well as this with the
probability

    p = 4/3 pi (e' T^-1 e)^(3/2) sqrt(det T) / U.

Pairs are trusted where p is so small that among all of them less than `EXPECTED` would agree by chance. p does not depend on
the scale of T: noise models that are too pessimistic by a factor of ten do no harm.

From there trust grows and shrinks. One more relation raises the optimum of J, to first order, by

    e' (C + B P B')^-1 e,   and one that is left out lowers it by   e' (C - B P B')^-1 e,

C its covariance, e its residual at the optimum and P the covariance of the poses. Truncated squares count it as c² when it is
left out. So it is trusted where this number is at most c², until no single change lowers the truncated squares. Where few
pairs agree, the odometry is the start, and only the most certain relations are added at a time.

Sources: Mangelson, Dominic, Eustice and Vasudevan, *Pairwise consistent measurement set maximization for robust multi-robot
map merging*, ICRA 2018 (pairs in a loop); Desolneux, Moisan and Morel, *From Gestalt theory to image analysis*, 2008 (the
number of chance agreements); Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*, 2001,
section 5.4 (the test of the innovation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..edges import RelationEdges
from ..graph import Graph
from ..linear.precision import inverses
from ..se2 import Array, between, compose, inverse, turn_matrix, turned_by
from .initialize import dead_reckoning, odometry
from .iteration import end_of, levenberg_marquardt, rough
from .minimize import minimize
from .uncertainty import Uncertainty

#: neighbours are at most so many poses apart, and each relation is compared with at most so many others
APART, MAX_NEIGHBOURS = 20, 50
#: so many pairs agree by chance, all together, if all relations are at random
EXPECTED = 1.0
#: the most rounds, and the damped steps in each
MAX_ROUNDS, STEPS = 40, 20
#: a relation that was left out so often stays out
LEFT_OUT = 2
#: trust grows carefully where less than this part of the relations agree in pairs
FEW = 0.25
#: then so large a part of those that agree is added in a round, the most certain ones, and all that are nearly as certain,
PART, NEARLY = 0.25, 4.0
#: and this part of the limit counts as long as something agrees within it: a wrong relation does so an eighth as often
FIRST = 0.25
#: the result is doubtful where more than this part of the pairs is left out at the end
DOUBTFUL = 0.05


@dataclass(frozen=True)
class Trusted:
    """A state (n, 3) with the trust (N,) in the measurements, and the number of rounds that led to it.

    ``settled``: no further change is due, and every measurement is fully trusted or rejected. ``certain``: nearly all pairs
    that agree were right.
    """

    state: Array
    trust: Array
    rounds: int
    settled: bool
    certain: bool = False


def grown_trust(graph: Graph, edges: RelationEdges, limit: float, max_rounds: int, initialize: str) -> Trusted:
    """Trust in the relations ``edges`` of a graph without kernels and without other measurements that may be wrong.

    Args:
        graph: with odometry from pose to pose.
        edges: its relations.
        limit: c².
        max_rounds: the most rounds.
        initialize: the start of the graph with the pairs that agree.

    Raises:
        GraphError: the odometry is not a chain, or does not determine the poses.
    """
    pairs = agreeing(graph, edges, limit)
    careful = pairs.sum() < FEW * edges.count
    trusted, left_out = pairs.copy(), np.zeros(edges.count, dtype=int)
    share = FIRST if careful else 1.0
    covariances, state = np.linalg.inv(edges.information), dead_reckoning(graph)
    own_size, volume = np.sqrt(np.linalg.det(covariances)), _volume(edges.measured)
    rounds, settled, bent = 0, False, bool(pairs.any())
    while rounds < min(MAX_ROUNDS, max_rounds) and not settled:
        rounds += 1
        trusting = graph.with_trust(trusted.astype(float))
        if bent:
            # what was wrong may have left bends that other starts do not have
            state = minimize(trusting, initialize, rough(graph)).state
        else:
            state = end_of(levenberg_marquardt, trusting, state, max_iterations=STEPS)
        linear = edges.linearize(state, state)
        by_poses = Uncertainty(trusting, state).of_edges(linear)
        # rounding may make a relation that alone determines something more certain than it is
        innovation = covariances * (1 + 1e-9) + np.where(trusted, -1.0, 1.0)[:, None, None] * by_poses
        change, size = _squares(linear.residuals, innovation), np.sqrt(np.linalg.det(innovation))
        # that of a trusted one without itself is C (C - B P B')^-1 C
        size = np.where(trusted, own_size**2 / size, size)
        chance = np.count_nonzero(change > limit) * _ellipsoid(change, size) / volume > EXPECTED
        # the worst ones first: they make others look wrong
        worst = change[trusted].max(initial=0.0)
        out = trusted & ((change > max(limit, worst / 2)) | chance)
        left_out += out
        bent = bool(out.any())
        new = np.flatnonzero(~trusted & ~chance & (change <= share * limit) & (left_out < LEFT_OUT))
        if careful and new.size:
            new = new[size[new] <= max(NEARLY * size[new].min(), np.quantile(size[new], PART))]
        if not (out.any() or new.size):
            settled, share = share == 1.0, 1.0
        trusted = trusted & ~out
        trusted[new] = True
    for _ in range(MAX_ROUNDS):
        before, trusted = trusted, (edges.squares(state) <= limit) & ~chance
        if np.array_equal(trusted, before):
            break
        state = end_of(levenberg_marquardt, graph.with_trust(trusted.astype(float)), state, max_iterations=STEPS)
    certain = settled and not careful and float(np.sum(pairs & ~trusted)) <= DOUBTFUL * float(pairs.sum())
    return Trusted(state, trusted.astype(float), rounds, settled, certain)


def _ellipsoid(squares: Array, size: Array) -> Array:
    """The volume within e' T^-1 e for these squares and roots of det T."""
    return 4 / 3 * np.pi * squares**1.5 * size


def _volume(measured: Array) -> float:
    """U: that of a box with the covariance of relations (R, 3)."""
    return max(12**1.5 * abs(float(np.linalg.det(np.cov(measured.T)))) ** 0.5, 1e-300) if len(measured) > 1 else 1e-300


def _squares(e: Array, covariances: Array) -> Array:
    return np.einsum("ei,ei->e", e, np.linalg.solve(covariances, e[:, :, None])[:, :, 0])


def agreeing(graph: Graph, edges: RelationEdges, limit: float) -> np.ndarray:
    """Which relations (R,) agree with another one, at most ``limit`` = c² from it; see the module.

    Raises:
        GraphError: no motion edges with a covariance lead from pose to pose.
    """
    k, j, e, T = differences(graph, edges)
    squares, found = _squares(e, T), np.zeros(edges.count, dtype=bool)
    p = _ellipsoid(squares, np.sqrt(np.linalg.det(T))) / _volume(edges.measured)
    together = (squares <= limit) & (p * len(p) < EXPECTED)
    found[k[together]] = found[j[together]] = True
    return found


def differences(graph: Graph, edges: RelationEdges) -> tuple[np.ndarray, np.ndarray, Array, Array]:
    """Pairs (k, j) of relations between neighbours, their difference e (K, 3) and its covariance T (K, 3, 3).

    With O_a, O_b the odometry from the first pose of k to that of j, and between their second poses,
    e = (z_k O_b)^-1 (O_a z_j), as a pose. T is that of first order.

    Raises:
        GraphError: no motion edges with a covariance lead from pose to pose.
    """
    a, b, measured, noise = _forward(edges)
    k, j = _neighbours(a, b)
    x = dead_reckoning(graph)[: len(graph.steps)]
    spread = _spread(graph, x)
    carried = compose(measured[k], between(x[b[k]], x[b[j]]))
    e = between(carried, compose(between(x[a[k]], x[a[j]]), measured[j]))
    T = (
        _moved(between(x[b[j]], x[b[k]]), noise[k])
        + _moved(inverse(x[b[j]]), np.sign(b[j] - b[k])[:, None, None] * (spread[b[j]] - spread[b[k]]))
        + _moved(inverse(compose(x[a[k]], carried)), spread[a[j]] - spread[a[k]])
        + _moved(e, noise[j])
    )
    return k, j, e, T


def _forward(edges: RelationEdges) -> tuple[np.ndarray, np.ndarray, Array, Array]:
    """First and second poses, first < second, the motions (R, 3), and their covariances (R, 3, 3) in the second's axes."""
    noise = turned_by(np.linalg.inv(edges.information), -edges.measured[:, 2])
    back = (edges.first > edges.second)[:, None]
    measured = np.where(back, inverse(edges.measured), edges.measured)
    # z exp(n) is exp(-Ad_z n) z^-1 when turned round
    noise = np.where(back[:, :, None], _moved(edges.measured, noise), noise)
    return np.minimum(edges.first, edges.second), np.maximum(edges.first, edges.second), measured, noise


def _neighbours(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (k, j) of relations between neighbours."""
    order = np.lexsort((b, a))
    a, b = a[order], b[order]
    firsts = [np.zeros(0, dtype=np.int64)]
    offsets = [np.zeros(0, dtype=np.int64)]
    for d in range(1, min(MAX_NEIGHBOURS, len(order) - 1) + 1):
        near = a[d:] - a[:-d] <= APART
        if not near.any():
            break
        rows = np.flatnonzero(near & (np.abs(b[d:] - b[:-d]) <= APART))
        firsts.append(rows)
        offsets.append(rows + d)
    return order[np.concatenate(firsts)], order[np.concatenate(offsets)]


def _spread(graph: Graph, x: Array) -> Array:
    """The covariance (P, 3, 3) of each pose given the first, of twists in world axes: differences are those of motions."""
    step, information = odometry(graph, "dead-reckoning")
    noise = np.zeros((len(x), 3, 3))
    noise[1:] = inverses(information[1:], "motion edge", "give it a positive definite information")
    return np.cumsum(_moved(x, turned_by(noise, -step[:, 2])), axis=0)


def _moved(x: Array, covariances: Array) -> Array:
    """Covariances (k, 3, 3) of twists in the axes of poses (k, 3), in the axes in which the poses are given: Ad C Ad'."""
    adjoint = turn_matrix(x[:, 2])
    adjoint[:, 0, 2], adjoint[:, 1, 2] = x[:, 1], -x[:, 0]
    return adjoint @ covariances @ np.swapaxes(adjoint, 1, 2)
