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

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from ..se2 import Array, difference, lever_matrix, perpendicular, rotation, transform, turn_matrix, wrap

#: the probability that a measurement belongs to the landmark that its id says
RIGHT = 0.8
#: measurements agree up to this squared Mahalanobis distance; 1 % of the right ones with two coordinates lie beyond it
GATE = 9.21
#: the most measurements that make hypotheses, the hypotheses that are refined, and the steps of each
MAX_MEASUREMENTS, REFINED, STEPS = 60, 8, 8
#: the condition number of the information of a pose from which it is not determined
ALONE = 1e14


@dataclass(frozen=True, eq=False)
class Points:
    """Measured landmarks and their counterparts in a map, K of each.

    Attributes:
        measured, covariances: (K, 3) and (K, 3, 3) where they are in the frame of the measurements; headings may be NaN.
        places, place_covariances: the same in the map, zero covariances where it is exact; or of each hypothesis, (H, K, 3).
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
        columns = [f.name for f in fields(self) if f.name != "area"]
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    @property
    def oriented(self) -> np.ndarray:
        """Whether both headings are known (K,)."""
        return np.asarray(np.isfinite(self.measured[:, 2]) & np.isfinite(self.places[..., 2]))

    @property
    def known(self) -> np.ndarray:
        """Which coordinates (K, 3) are known."""
        return np.column_stack([np.ones((len(self.ids), 2), dtype=bool), self.oriented])


@dataclass(frozen=True, eq=False)
class Match:
    """A hypothesis: T (3,), its covariance, the measurements that agree (K,), and its log evidence; see the module."""

    pose: Array
    covariance: Array
    agree: np.ndarray
    evidence: float


M = TypeVar("M", bound=Match)


def register(points: Points) -> list[Match]:
    """The hypotheses that differ, by decreasing evidence; none where no two landmarks agree with any."""
    chosen = points.among(evenly(len(points.ids), MAX_MEASUREMENTS))
    poses = _hypotheses(chosen)
    if not len(poses):
        return []
    squares = _squares(chosen, poses, _variances(chosen))
    first = distinct(squares, squares <= GATE, REFINED)
    return [match for _, match in those_that_differ(refined(points, poses[first]))]


def evenly(count: int, most: int) -> np.ndarray:
    """At most so many of the numbers from 0 to count - 1, evenly spread, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def distinct(squares: Array, near: np.ndarray, most: int) -> np.ndarray:
    """The numbers of the best of H hypotheses, at most so many, that have different measurements near.

    Args:
        squares: (H, K) squared Mahalanobis distances.
        near: (H, K) what each measurement is near to, 0 for nothing. The same measurements lead to the same place.
    """
    gain = np.maximum(0.0, GATE - squares).sum(axis=1)
    best = np.argsort(-gain, kind="stable")[: 40 * most]
    near, left, kept = near[best], np.ones(len(best), dtype=bool), list[int]()
    count = np.sum(near > 0, axis=1)
    while left.any() and len(kept) < most:
        kept.append(int(np.argmax(left)))
        left &= 2 * np.sum((near == near[kept[-1]]) & (near > 0), axis=1) <= count
        left[kept[-1]] = False
    return np.asarray(best[kept])


def those_that_differ(matches: Sequence[M | None]) -> list[tuple[int, M]]:
    """The matches by decreasing evidence, with their numbers, each place once."""
    found: list[tuple[int, M]] = []
    known = [(k, match) for k, match in enumerate(matches) if match is not None]
    for k, match in sorted(known, key=lambda each: -each[1].evidence):
        if found:
            way = difference(match.pose, np.array([other.pose for _, other in found]))
            V = match.covariance + np.array([other.covariance for _, other in found])
            if (np.einsum("ki,ki->k", way, np.linalg.solve(V, way[..., None])[..., 0]) <= GATE).any():
                continue
        found.append((k, match))
    return found


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
    moved = transform(poses[:, None], points.measured)
    squares = np.sum((moved - points.places[:, :2]) ** 2, axis=2) / variance
    oriented = points.oriented
    if oriented.any():
        turn = wrap(points.measured[oriented, 2] + poses[:, 2:] - points.places[oriented, 2])
        squares[:, oriented] += turn**2 / (points.covariances + points.place_covariances)[oriented, 2, 2]
    return squares


def linear(points: Points, poses: Array) -> tuple[Array, Array, Array]:
    """Residuals (..., K, 3) at poses T (..., 3), information without headings that are unknown, Jacobians (..., K, 3, 3)."""
    turn = turn_matrix(poses[..., 2])[..., None, :, :]
    moved = (turn[..., :2, :2] @ points.measured[:, :2, None])[..., 0]
    e, known = np.zeros((*moved.shape[:-1], 3)), np.broadcast_to(points.oriented, moved.shape[:-1])
    e[..., :2] = moved + poses[..., None, :2] - points.places[..., :2]
    off = points.measured[:, 2] + poses[..., None, 2] - points.places[..., 2]
    e[known, 2] = wrap(off[known])
    C = turn @ points.covariances @ np.swapaxes(turn, -1, -2) + points.place_covariances
    W = np.zeros(C.shape)
    W[..., :2, :2] = np.linalg.inv(C[..., :2, :2])
    W[known] = np.linalg.inv(C[known])
    return e, W, lever_matrix(perpendicular(moved))


def padded(covariances: Array, known: np.ndarray) -> Array:
    """Covariances (k, k, 3, 3) as a matrix (3k, 3k), with variances of 1 for coordinates that are not known."""
    both = known[:, None, :, None] & known[None, :, None, :]
    V = np.where(both, covariances, 0.0).transpose(0, 2, 1, 3).reshape(known.size, known.size)
    return np.asarray(V + np.diag((~known).ravel().astype(float)))


def refined(points: Points, poses: Array) -> list[Match | None]:
    """Hypotheses (H, 3) after Gauss-Newton over the measurements that agree with them; None where too few do.

    The places of ``points`` may be those of each hypothesis (H, K, 3).
    """
    of_landmark = points.ids[:, None] == np.unique(points.ids)
    agree = np.zeros((len(poses), len(points.ids)), dtype=bool)
    enough = np.ones(len(poses), dtype=bool)
    for _ in range(STEPS):
        e, W, J = linear(points, poses)
        squares = np.einsum("hki,hkij,hkj->hk", e, W, e, optimize=True)
        before, agree = agree, squares <= GATE
        enough &= (np.sum(agree @ of_landmark, axis=1) > 1) | np.any(agree & points.oriented, axis=1)
        JW = np.where(agree[..., None, None], np.swapaxes(J, 2, 3) @ W, 0.0)
        omega = (JW @ J).sum(axis=1)
        enough &= np.linalg.cond(omega) < ALONE
        omega[~enough] = np.eye(3)
        step = -np.linalg.solve(omega, (JW @ e[..., None]).sum(axis=1))[..., 0]
        step[~enough] = 0.0
        poses = poses + step
        still = np.all(agree == before, axis=1) & (np.einsum("hi,hij,hj->h", step, omega, step) < 1e-12)
        if np.all(still | ~enough):
            break
    P = np.linalg.inv(omega)
    poses[:, 2] = wrap(poses[:, 2])
    densities = np.linalg.slogdet(W[..., :2, :2])[1] / 2 - np.log(2 * np.pi) - squares / 2
    # a wrong heading is anywhere in the circle
    turned = np.broadcast_to(points.oriented, squares.shape)
    densities[turned] = (np.linalg.slogdet(W[turned])[1] - np.log(2 * np.pi) - squares[turned]) / 2
    odds = np.where(agree, densities + np.log(points.area * RIGHT), np.log(1 - RIGHT)).sum(axis=1)
    evidence = odds + volume(P, points.area)
    return [Match(poses[h], P[h], agree[h], float(evidence[h])) if enough[h] else None for h in range(len(poses))]


def volume(covariances: Array, area: float) -> Array:
    """log of the share of the poses in a map of this area [m²] that covariances (H, 3, 3) leave; see the module."""
    # the poses in the map are all that there are, however open the measurements leave T
    return np.minimum(0.0, np.linalg.slogdet(2 * np.pi * covariances)[1] / 2 - np.log(2 * np.pi * area))
