"""Registration of a set of landmarks in a map: the pose T = (t, theta) with R(theta) y_k + t = m_k, robust to wrong ids.

Two landmarks, or one whose heading is measured, give T in closed form: with positions as complex numbers,

    theta = arg((m_j - m_i) conj(y_j - y_i)),    t = m - R(theta) y  (the mean of both, weighted).

Every pair is a hypothesis. The best ones are refined by Gauss-Newton over the measurements that agree with them, with all
covariances, and compared by their evidence: a measurement is right with probability `RIGHT`, and otherwise anywhere in the
area A of the map. With the densities p_k of those that agree, and the covariance P of T, the log evidence over that of the
map of another place, where none is right, is by Laplace's approximation

    sum over those that agree of log(RIGHT p_k A) + sum over the others of log(1 - RIGHT) + log det(2 pi P)^1/2 - log(2 pi A).

Sources: Umeyama, *Least-squares estimation of transformation parameters between two point patterns*, PAMI 1991 (in the
plane it is the quotient above); Fischler and Bolles, *Random sample consensus*, 1981 (here all pairs, not random ones);
MacKay, *Information Theory, Inference, and Learning Algorithms*, chapter 28.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..se2 import Array, perpendicular, rotation, turn_matrix, wrap

#: the probability that a measurement belongs to the landmark that its id says
RIGHT = 0.8
#: measurements agree up to this squared Mahalanobis distance; 1 % of the right ones with two coordinates lie beyond it
GATE = 9.21
#: the most measurements that make hypotheses, the hypotheses that are refined, and the steps of each
MOST, REFINED, STEPS = 60, 8, 8


@dataclass(frozen=True, eq=False)
class Points:
    """Measured landmarks and their counterparts in a map, K of each.

    Attributes:
        measured, covariances: (K, 3) and (K, 3, 3) where they are in the frame of the measurements; headings may be NaN.
        places, place_covariances: the same in the map, zero covariances where it is exact.
        ids: (K,) of the landmarks.
        area: of the map [m²].
    """

    measured: Array
    covariances: Array
    places: Array
    place_covariances: Array
    ids: np.ndarray
    area: float

    def among(self, rows: np.ndarray) -> Points:
        """Some of the measurements."""
        return Points(
            self.measured[rows], self.covariances[rows], self.places[rows], self.place_covariances[rows], self.ids[rows],
            self.area,
        )  # fmt: skip

    @property
    def oriented(self) -> np.ndarray:
        """Whether both headings are known (K,)."""
        return np.isfinite(self.measured[:, 2]) & np.isfinite(self.places[:, 2])


@dataclass(frozen=True, eq=False)
class Match:
    """A hypothesis: T (3,), its covariance, the measurements that agree (K,), and its log evidence; see the module."""

    pose: Array
    covariance: Array
    agree: np.ndarray
    evidence: float

    def volume(self, area: float) -> float:
        """log of the share of the poses in a map of this area [m²] that the covariance leaves; see the module."""
        # the poses in the map are all that there are, however open the measurements leave T
        return min(0.0, float(np.linalg.slogdet(2 * np.pi * self.covariance)[1] / 2 - np.log(2 * np.pi * area)))

    def differs(self, other: Match) -> bool:
        """Whether another hypothesis is another place, and not the same one refined from elsewhere."""
        way = self.pose - other.pose
        way[2] = wrap(way[2])
        return float(way @ np.linalg.solve(self.covariance + other.covariance, way)) > GATE


def register(points: Points) -> list[Match]:
    """The hypotheses that differ, by decreasing evidence; none where no two landmarks agree with any."""
    count = len(points.ids)
    rows = np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))
    chosen = points.among(rows)
    poses = _hypotheses(chosen)
    if not len(poses):
        return []
    squares = _squares(chosen, poses, _variances(chosen))
    gain = np.maximum(0.0, GATE - squares).sum(axis=1)
    found: list[Match] = []
    left = REFINED
    for k in np.argsort(-gain, kind="stable").tolist():
        near = squares[k] <= GATE
        # the same measurements lead to the same place
        if any(2 * np.sum(near & match.agree[rows]) > np.sum(near) for match in found):
            continue
        match = refined(points, poses[k])
        if match is not None and all(match.differs(other) for other in found):
            found.append(match)
        left -= 1
        if left == 0:
            break
    return sorted(found, key=lambda match: -match.evidence)


def _variances(points: Points) -> Array:
    """The mean variance (K,) of the two coordinates of each measurement from its place."""
    return np.trace((points.covariances + points.place_covariances)[:, :2, :2], axis1=1, axis2=2) / 2


def _hypotheses(points: Points) -> Array:
    """T (H, 3) of every pair of different landmarks, and of every landmark whose headings are known."""
    y, m = points.measured[:, :2], points.places[:, :2]
    weight = 1 / _variances(points)
    i, j = np.triu_indices(len(y), 1)
    apart = (points.ids[i] != points.ids[j]) & np.any(m[i] != m[j], axis=1) & np.any(y[i] != y[j], axis=1)
    i, j = i[apart], j[apart]
    a, b = y[j] - y[i], m[j] - m[i]
    theta = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.einsum("hi,hi->h", a, b))
    share = (weight[i] / (weight[i] + weight[j]))[:, None]
    of_pairs = through(theta, share * y[i] + (1 - share) * y[j], share * m[i] + (1 - share) * m[j])
    k = np.flatnonzero(points.oriented)
    return np.concatenate([of_pairs, through(wrap(points.places[k, 2] - points.measured[k, 2]), y[k], m[k])])


def through(theta: Array, y: Array, m: Array) -> Array:
    """T (H, 3) with the headings (H,) that take points y to m, (H, 2) each."""
    return np.column_stack([m - np.einsum("hij,hj->hi", rotation(theta), y), theta])


def _squares(points: Points, poses: Array, variance: Array) -> Array:
    """The squared distances (H, K) of all measurements under all hypotheses, over their variance."""
    moved = np.einsum("hij,kj->hki", rotation(poses[:, 2]), points.measured[:, :2]) + poses[:, None, :2]
    squares = np.sum((moved - points.places[:, :2]) ** 2, axis=2) / variance
    oriented = points.oriented
    if oriented.any():
        turn = wrap(points.measured[oriented, 2] + poses[:, 2:] - points.places[oriented, 2])
        squares[:, oriented] += turn**2 / (points.covariances + points.place_covariances)[oriented, 2, 2]
    return squares


def linear(points: Points, pose: Array) -> tuple[Array, Array, Array]:
    """Residuals (K, 3), information (K, 3, 3) without headings that are not known, and Jacobians (K, 3, 3) by T = pose."""
    count = len(points.ids)
    turn = turn_matrix(np.full(count, pose[2]))
    moved = np.einsum("kij,kj->ki", turn[:, :2, :2], points.measured[:, :2])
    e = np.zeros((count, 3))
    e[:, :2] = moved + pose[:2] - points.places[:, :2]
    known = points.oriented
    e[known, 2] = wrap(points.measured[known, 2] + pose[2] - points.places[known, 2])
    C = turn @ points.covariances @ np.swapaxes(turn, 1, 2) + points.place_covariances
    W = np.zeros((count, 3, 3))
    W[:, :2, :2] = np.linalg.inv(C[:, :2, :2])
    W[known] = np.linalg.inv(C[known])
    J = np.tile(np.eye(3), (count, 1, 1))
    J[:, :2, 2] = perpendicular(moved)
    return e, W, J


def refined(points: Points, pose: Array) -> Match | None:
    """A hypothesis after Gauss-Newton over the measurements that agree with it; None where too few do."""
    agree = np.zeros(len(points.ids), dtype=bool)
    for _ in range(STEPS):
        e, W, J = linear(points, pose)
        squares = np.einsum("ki,kij,kj->k", e, W, e)
        before, agree = agree, squares <= GATE
        if not (len(np.unique(points.ids[agree])) > 1 or np.any(agree & points.oriented)):
            return None
        WJ = W[agree] @ J[agree]
        omega = np.einsum("kji,kjl->il", J[agree], WJ)
        try:
            step = -np.linalg.solve(omega, np.einsum("kji,kj->i", WJ, e[agree]))
        except np.linalg.LinAlgError:
            return None
        pose = pose + step
        if np.array_equal(agree, before) and float(step @ omega @ step) < 1e-12:
            break
    P = np.linalg.inv(omega)
    pose[2] = wrap(pose[2])
    W, turned = W[agree], points.oriented[agree]
    densities = np.linalg.slogdet(W[:, :2, :2])[1] / 2 - np.log(2 * np.pi) - squares[agree] / 2
    # a wrong heading is anywhere in the circle
    densities[turned] = (np.linalg.slogdet(W[turned])[1] - np.log(2 * np.pi) - squares[agree][turned]) / 2
    odds = np.sum(densities + np.log(points.area * RIGHT)) + np.sum(~agree) * np.log(1 - RIGHT)
    match = Match(pose, P, agree, float(odds))
    return replace(match, evidence=match.evidence + match.volume(points.area))
