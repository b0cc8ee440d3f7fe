"""The error that all sightings of a scan have in common, as of a sensor that shakes or of inexact time stamps.

The noise models have independent errors of single sightings. `errors_of_scans` finds the covariance C of an error b_t of the
whole scan t, and `Solution.covariance` adds what it does to the solution. With residuals e of the sightings and motions,
whitened, their Jacobian B, and Omega = B'B + the information of all other edges, a drive with errors of several kinds p,

    e = M sum over p of A_p n_p,   M = I - B Omega^-1 B',   n_p independent with the variances theta_p,

gives q_p = abs(A_p' e)² the expected value sum over r of S_pr theta_r, where S_pr is the mean of abs(A_p' M A_r n)² over
random signs n. S theta = q then gives the variances, whatever the scale of the noise models is. The
kinds are the noise of single sightings, of the motion along its axes and of positions, errors of one scan along the way and
in the heading, and such errors that last over several scans. These last ones come from a biased robot or wrong ids and do
not count. The covariance of theta is 2 S^-1 where the noise is that of the models.

Residuals of different sightings of one scan are correlated where poses do not follow the scans, and errors of successive
motions cancel each other where they do, as with estimated noise. Both are in q.

Encoders with coarse ticks have the same residuals: the path of the odometry is off by r_t at each scan, so that the pose with
r_t sees everything with the error -r_t. Only the few values of their speeds tell.

A robust kernel takes errors of scans for outliers, so that the first C is too small. Its weights count C in the next rounds.

Sources: Rao, *Estimation of variance and covariance components: MINQUE theory*, 1971.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import edges
from ..edges.base import EngineEdges
from ..graph import Graph
from ..graph.defaults import on_an_arc
from ..se2 import Array, turn_matrix
from .joint import motion_edges, sighted_edges

#: the axes of the robot along which scans and motions have errors: ahead, and the heading
AXES = (0, 2)
#: C is believed whose variances are so many standard errors above zero, and explain this part of their q
SURELY, SHARE = 5.0, 1 / 3
#: C is looked for where the products of residuals in a scan, or those of successive motions with the other sign, are more
#: standard errors above zero than this
SUSPECTED = 2.0, -2.0
#: the rounds in which the weights of the kernel follow C, and the number of scans over which other errors last
ROUNDS, LASTING = 4, 9
#: ticks of encoders leave at least so many different speeds, and at most this part of the number of controls
TICKS = 5, 0.05
#: the nodes follow directions of which less than this part is left
DETERMINED = 1e-4
#: the fewest scans and motions that say something; the most samples, and their number times that of the poses
FEWEST, MOST, SAMPLES = 20, 24, 20_000


def errors_of_scans(graph: Graph, state: Array) -> tuple[Array, str]:
    """The covariance C (3, 3), in the robot's axes, of the error that all sightings of a scan have in common, and a sentence.

    It is zero, and the sentence empty, where the log does not surely show such errors.
    """
    C, sure = np.zeros((3, 3)), np.zeros(len(AXES), dtype=bool)
    moved, log = motion_edges(graph), graph.log
    seen = any(isinstance(family, edges.SightingEdges) and family.count for family in graph.families)
    if moved is None or log is None or log.times is None or not (counted_once(graph) and seen) or moved.count < FEWEST:
        return C, ""
    # sightings on an arc, which the Cartesian residual has along a line, have an error in common, too
    straight = isinstance(sighted_edges(graph), edges.CartesianObservationEdges)
    if (straight and graph.sensor is not None and on_an_arc(log, graph.sensor)) or not _suspected(graph, moved, state):
        return C, ""
    for k in range(ROUNDS):
        theta, z, share = _of_scans(graph, moved, state, C)
        if k == 0:
            sure = (z > SURELY) & (share > SHARE)
        if not sure.any():
            return C, ""
        C[AXES, AXES] = np.where(sure, np.maximum(theta, 0.0), 0.0)
    sizes = {"m": C[0, 0] ** 0.5, "rad": C[2, 2] ** 0.5}
    size = ", ".join(f"{value:.2g} {unit}" for unit, value in sizes.items() if value > 0)
    values = 0 if log.controls is None else len(np.unique(np.round(log.controls[:, 0], 6)))
    if log.controls is not None and TICKS[0] <= values < TICKS[1] * len(log.controls):
        # poses that follow the scans are right
        return np.zeros((3, 3)), (
            f"the odometry has an error of about {size} at each scan, which it takes back until the next one, and its speeds "
            f"have {values} values, as where encoders count coarse ticks: estimate the noise (noise='auto'), or record finer "
            "ticks; covariances by noise models that are given do not contain it"
        )
    return C, (
        f"the sightings of each scan have an error in common of about {size}, as where the sensor shakes or times are "
        "inexact. Covariances contain it; for better poses fasten the sensor, record the time at which it measured, or "
        "estimate the noise (noise='auto')"
    )


def counted_once(graph: Graph) -> bool:
    """Whether all edges are of known families, and sightings have errors of their own, as pairs of them have not."""
    seen = [family for family in graph.families if isinstance(family, edges.SightingEdges) and family.count]
    once = graph.num_nodes > len(graph.steps) or all(isinstance(family, edges.MarginalEdges) for family in seen)
    # what edges of a user's own say about the noise is not known
    return once and all(isinstance(family, (EngineEdges, edges.PriorEdges)) for family in graph.families)


def _suspected(graph: Graph, moved: edges.RelativePoseEdges, state: Array) -> bool:
    """Whether sightings of one scan have correlated residuals, or the errors of successive motions cancel each other.

    This takes a small part of the time of the estimate. Of drives on which C was found, each has the one above 3.7 standard
    errors or the other above 0.9; without such errors they are at most 1.8 and -2.9 (docs/decisions.md).
    """
    linear = _weighted(sighted_edges(graph), state, np.zeros((3, 3))).linearize(state, state)
    steps, axes = linear.nodes[0], list(AXES)
    at_scan = (linear.jacobians[0] @ turn_matrix(state[steps, 2]))[:, :, axes]
    pulls = np.einsum("eia,eij,ej->ae", at_scan, linear.information, linear.residuals)
    scans = [np.bincount(steps, pull) ** 2 - np.bincount(steps, pull**2) for pull in pulls]
    motions = replace(moved, frame="body").linearize(state, state)
    errors = motions.residuals[np.argsort(motions.nodes[0])][:, axes]
    errors = errors / np.sqrt(np.diagonal(np.linalg.inv(motions.information), axis1=1, axis2=2))[:, axes]
    successive = [*-(errors[1:] * errors[:-1]).T]
    kinds = zip((scans, successive), SUSPECTED)
    return any(np.sum(each) > limit * np.sqrt(np.sum(each**2)) for products, limit in kinds for each in products)


def _of_scans(graph: Graph, moved: edges.RelativePoseEdges, state: Array, C: Array) -> tuple[Array, Array, Array]:
    """`variances` of errors of scans along `AXES`; the weights of sightings count the covariance C of such errors."""
    from scipy.sparse import diags

    seen, poses = sighted_edges(graph), len(graph.steps)
    weighted = _weighted(seen, state, C)
    changed = graph.with_families(weighted if f is seen else f for f in graph.families)
    # poses follow the noise of positions, too
    positions = [settled(f, state) for f in graph.families if isinstance(f, edges.PositionEdges) and f.count]
    drive = Whitened(changed, [weighted, replace(moved, frame="body"), *positions], state)
    steps = drive.edges[0].nodes[0]
    at_scan = drive.edges[0].jacobians[0] @ turn_matrix(state[steps, 2])
    scans = [drive.rows(0, at_scan[:, :, a : a + 1], steps, poses) for a in AXES]
    lags = range(-(LASTING // 2), LASTING // 2 + 1)
    lasting = diags([LASTING**-0.5] * LASTING, list(lags), shape=(poses, poses))
    drive.kinds = [*scans, *(A @ lasting for A in scans), *drive.motions(1)]
    drive.kinds += [drive.single(k) for k in (0, *range(2, len(drive.edges)))]
    q, S = equations(drive, poses)
    theta, z, share = variances(q, S)
    return theta[: len(AXES)], z[: len(AXES)], share[: len(AXES)]


def equations(drive: Whitened, poses: int) -> tuple[Array, Array]:
    """q (P,) and S (P, P) of the kinds of errors of a drive with so many poses."""
    rng, samples = np.random.default_rng(0), int(np.clip(SAMPLES / poses, 4, MOST))
    q = drive.squares(drive.residuals)
    S = [drive.squares(A @ rng.choice([-1.0, 1.0], (A.shape[1], samples))) for A in drive.kinds]
    return q, np.stack(S, axis=1)


def variances(q: Array, S: Array) -> tuple[Array, Array, Array]:
    """theta (P,), that over its standard errors, and the part of q that each kind explains; zeros where S is singular."""
    size = np.sqrt(np.diag(S))
    if size.all() and q.all():
        scaled = S / size[:, None] / size
        inverse = np.linalg.inv((scaled + scaled.T) / 2)
        if np.diag(inverse).min() > 0:
            theta, errors = inverse @ (q / size) / size, np.sqrt(2 * np.diag(inverse)) / size
            return theta, theta / errors, size**2 * theta / q
    return (np.zeros(len(q)),) * 3


def settled(family: Any, state: Array) -> Any:
    """Edges without a kernel, with the weights that it gives them at a state as their trust."""
    return replace(family, kernel=None, trust=family.trusted * family.kernel_weights(state))


class Whitened:
    """Families of a graph without kernels at a state, whitened, and what the estimate leaves of errors in them.

    Attributes:
        edges: each family linearised.
        first: where the residuals of each begin, and their number.
        residuals: e (N, 1) of all of them, in their order.
        kinds: the sparse matrices A_p (N, K) of kinds of errors, which the caller adds.
    """

    def __init__(self, graph: Graph, families: Sequence[Any], state: Array) -> None:
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu

        self._factor, self.kinds = graph.linearize(state)[0].own_factor(), list[Any]()
        self.edges = [family.linearize(state, state) for family in families]
        self._roots = [np.swapaxes(np.linalg.cholesky(each.information), 1, 2) for each in self.edges]
        self.first = np.cumsum([0, *(each.residuals.size for each in self.edges)])
        white = [root @ each.residuals[:, :, None] for root, each in zip(self._roots, self.edges)]
        self.residuals = np.concatenate([each.reshape(-1, 1) for each in white])
        self._followed = np.zeros((len(self.residuals), 0))
        free = np.ones((graph.num_nodes, 3))
        free[graph.fixed] = 0.0
        ends = [(k, J, nodes) for k, each in enumerate(self.edges) for J, nodes in zip(each.jacobians, each.nodes)]
        self._by_nodes = sum(self.rows(k, J, nodes, graph.num_nodes) for k, J, nodes in ends) @ diags(free.ravel())
        self._of_landmarks = None
        for k, seen in enumerate(families):
            if isinstance(seen, edges.MarginalEdges):
                blocks = np.zeros((len(self.edges[k].nodes[0]), 1, 1)) + np.eye(seen.dimension)
                by_landmarks = self.rows(k, blocks, seen.group, len(seen.starts) - 1)
                self._of_landmarks = splu((by_landmarks.T @ by_landmarks).tocsc()), by_landmarks

    def motions(self, k: int) -> list[Any]:
        """A_p of errors of single motions, the family k, along each of `AXES`."""
        sizes = np.sqrt(np.diagonal(np.linalg.inv(self.edges[k].information), axis1=1, axis2=2))[:, :, None] * np.eye(3)
        return [self.rows(k, sizes[:, :, a : a + 1], np.arange(len(sizes)), len(sizes)) for a in AXES]

    def single(self, k: int) -> Any:
        """A_p of errors of single measurements of the family k."""
        from scipy.sparse import eye

        return eye(self.first[-1], self.edges[k].residuals.size, -self.first[k], format="csr")

    def free(self, directions: Array) -> None:
        """Let the estimate follow errors in some directions (N, K), too, as far as the nodes do not follow them anyway."""
        lengths = np.maximum(np.linalg.norm(directions, axis=0), 1e-300)
        followed, sizes, _ = np.linalg.svd(self._left(directions / lengths), full_matrices=False)
        self._followed = followed[:, sizes > DETERMINED]

    def squares(self, errors: Array) -> Array:
        """abs(A_p' M errors)² of each kind, the mean over the columns of errors (N, K)."""
        left = self._left(errors)
        left = left - self._followed @ (self._followed.T @ left)
        return np.array([np.mean(np.sum((A.T @ left) ** 2, axis=0)) for A in self.kinds])

    def _left(self, errors: Array) -> Array:
        """What is left of errors (N, K) where the nodes follow them."""
        errors = self._without_landmarks(errors)
        pulls = (self._by_nodes.T @ errors).reshape(-1, 3, errors.shape[1])
        return self._without_landmarks(errors - self._by_nodes @ self._factor.solve(pulls).reshape(-1, errors.shape[1]))

    def _without_landmarks(self, errors: Array) -> Array:
        """What is left of errors (N, K) where landmarks that are no nodes follow them."""
        if self._of_landmarks is None:
            return errors
        factor, by_landmarks = self._of_landmarks
        return errors - by_landmarks @ factor.solve(by_landmarks.T @ errors)

    def rows(self, k: int, blocks: Array, columns: np.ndarray, width: int) -> Any:
        """Blocks (E, d, m) of the edges k, whitened, in columns (E,) of m numbers each, as a sparse matrix (N, m width)."""
        from scipy.sparse import csr_matrix

        blocks = self._roots[k] @ blocks
        E, d, m = blocks.shape
        row = np.broadcast_to(self.first[k] + np.arange(E * d).reshape(E, d, 1), blocks.shape)
        column = np.broadcast_to(m * columns[:, None, None] + np.arange(m), blocks.shape)
        return csr_matrix((blocks.ravel(), (row.ravel(), column.ravel())), shape=(self.first[-1], m * width))


def _weighted(seen: edges.SightingEdges, state: Array, C: Array) -> edges.SightingEdges:
    """The sightings without a kernel, with the weights that it gives them where scans have errors with the covariance C."""
    plain = replace(seen, kernel=None)
    if seen.kernel is None:
        return plain
    linear = plain.linearize(state, state)
    at_scan = linear.jacobians[0] @ turn_matrix(state[linear.nodes[0], 2])
    wide = np.linalg.inv(linear.information) + at_scan @ C @ np.swapaxes(at_scan, 1, 2)
    solved = np.linalg.solve(wide, linear.residuals[:, :, None])[:, :, 0]
    return plain.with_trust(seen.trusted * seen.kernel.weight(np.einsum("ei,ei->e", linear.residuals, solved)))
