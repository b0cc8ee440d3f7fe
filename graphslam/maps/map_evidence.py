"""The joint evidence that a set of sightings is of the landmarks of a map, and not of another place with the same ids.

Sightings share the errors of the odometry between them. The sightings of each landmark are first merged, by generalised least
squares in the frame of the measurements, into one place y_j with the joint covariance Y of all of them. Of another place,
they say as much: there the landmarks are anywhere. What decides is whether the constellation is that of the map. With
the residuals e = T y - m, V = Y + S, S the covariance of the map, J = de / dT, and T anywhere in the area A,

    p(e) = integral over T = t_nu(e; V, without T) / (2 pi A),    against 1 / A for each landmark of another place,

2 pi for its heading. t_nu is Student's t with `FREEDOM` degrees of freedom, because the variance of the noise is known to
about a half of it only. With chi² = e' V^-1 e at the best T, and k numbers less three,

    t_nu = c det(V)^-1/2 det(J' V^-1 J)^-1/2 (1 + chi² / nu)^(-(nu + k) / 2),
    c = Gamma((nu + k) / 2) / Gamma(nu / 2) (nu pi)^(-k / 2).

A landmark is where the map has it with probability `RIGHT`; others have moved, or are misread. Those that lower the
evidence are left out one by one. Its expectation over maps of other places is 1, so that among them less than one in a
thousand has an evidence above log 1000, however many sightings there are and however often one looks.

With M = V^-1 - V^-1 J P J' V^-1 and P = (J' V^-1 J)^-1, leaving block j out lowers chi² by r_j' M_jj^-1 r_j, r = M e, and
the determinants by det M_jj^-1.

Sources: Kass and Raftery, *Bayes factors*, Journal of the American Statistical Association 1995; Ville's inequality for
looking often; Cook and Weisberg, *Residuals and Influence in Regression*, 1982, for the deletion of blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..se2 import Array, perpendicular, turn_matrix, wrap
from .registration import ALONE, RIGHT, STEPS, Match, Points, evenly, linear, padded

#: log(sum of exp) along an axis; whether it has a type differs between versions of NumPy
log_sum: Any = np.logaddexp.reduce
#: degrees of freedom nu of the noise
FREEDOM = 8
#: the most sightings that are weighed together
ENOUGH = 120


@dataclass(frozen=True, eq=False)
class Weighed(Match):
    """A hypothesis by generalised least squares over the landmarks that agree, with its joint evidence.

    Attributes:
        fits, contradict: the numbers of landmarks that agree and that do not.
        oriented: whether the heading of one of those that agree is known.
    """

    fits: int
    contradict: int
    oriented: bool


@dataclass(frozen=True, eq=False)
class _Fit:
    """Least squares over n landmarks: T and P, M_jj (n, 3, 3), r (n, 3), chi², k, and log det V + log det J' V^-1 J."""

    pose: Array
    covariance: Array
    M: Array
    r: Array
    square: float
    numbers: int
    log_determinant: float


def weighed(points: Points, match: Match, noise: Callable[[np.ndarray], Array], of_map: Array) -> Weighed | None:
    """The joint evidence of a hypothesis; None where too few landmarks agree to determine T. See the module.

    Args:
        points: the sightings, K of them.
        match: T, and the sightings that agree with it one by one.
        noise: gives the covariances (k, k, 3, 3) of the sightings of some rows (k,) from one another.
        of_map: (L, L, 3, 3), those of the map, of the landmarks by increasing id.
    """
    ids, which = np.unique(points.ids, return_inverse=True)
    count, agree = np.bincount(which), np.bincount(which, match.agree)
    rows = np.flatnonzero(match.agree & (2 * agree > count)[which])
    rows = rows[evenly(len(rows), ENOUGH)]
    if not len(rows):
        return None
    y, Y = _merged(points, rows, which, noise)
    kept = np.unique(which[rows])
    first = np.array([np.flatnonzero(which == j)[0] for j in kept])
    local = replace(points.among(first), measured=y)
    S, pose, inside = of_map[kept[:, None], kept], match.pose, np.arange(len(kept))
    best: tuple[np.ndarray, _Fit, int] | None = None
    while True:
        chosen = local.among(inside)
        headings = int(chosen.oriented.sum())
        fit = _fit(chosen, pose, Y[inside[:, None], inside], S[inside[:, None], inside])
        if fit is None:
            break
        best = inside, fit, headings
        gain = _without(fit, chosen)
        if len(inside) <= 2 - (headings > 0) or gain.max() <= 0:
            break
        inside, pose = np.delete(inside, int(np.argmax(gain))), fit.pose
    if best is None:
        return None
    inside, fit, headings = best
    evidence = len(inside) * np.log(RIGHT * points.area) + headings * np.log(2 * np.pi)
    evidence += (len(ids) - len(inside)) * np.log(1 - RIGHT)
    evidence += float(_student(fit.square, fit.numbers, fit.log_determinant)) - _anywhere(fit.covariance, points.area)
    return Weighed(
        fit.pose, fit.covariance, match.agree & np.isin(which, kept[inside]), float(evidence), len(inside),
        len(ids) - len(inside), headings > 0,
    )  # fmt: skip


def _without(fit: _Fit, points: Points) -> Array:
    """What leaving out each landmark (n,) adds to the evidence; -inf where the others do not determine T."""
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.linalg.slogdet(fit.M)[1]
    determined = np.isfinite(size)
    M = np.where(determined[:, None, None], fit.M, np.eye(3))
    squares = np.maximum(fit.square - np.einsum("ki,kij,kj->k", fit.r, np.linalg.inv(M), fit.r), 0.0)
    numbers = fit.numbers - 2 - points.oriented
    gain = _student(squares, numbers, fit.log_determinant + size)
    gain -= _student(fit.square, fit.numbers, fit.log_determinant)
    gain += np.log((1 - RIGHT) / RIGHT / points.area) - points.oriented * np.log(2 * np.pi)
    return np.where(determined & (numbers >= 0), gain, -np.inf)


def _merged(
    points: Points, rows: np.ndarray, which: np.ndarray, noise: Callable[[np.ndarray], Array]
) -> tuple[Array, Array]:
    """The places (n, 3) of the landmarks of some rows (k,), and Y (n, n, 3, 3)."""
    known, k = points.known[rows], len(rows)
    W = np.linalg.inv(padded(noise(rows), known)).reshape(k, 3, k, 3)
    ids, first, number = np.unique(which[rows], return_index=True, return_inverse=True)
    y = np.where(known, points.measured[rows], 0.0)
    # headings without a jump of a turn
    y[:, 2] = y[first[number], 2] + wrap(y[:, 2] - y[first[number], 2])
    # W G and G' W G are sums over the sightings of each landmark
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(len(ids)))
    WG = np.add.reduceat(W[:, :, order] * known[order], starts, axis=2)
    GWG = np.add.reduceat(WG[order] * known[order][:, :, None, None], starts, axis=0)
    size = 3 * len(ids)
    Y = np.linalg.inv(GWG.reshape(size, size) + np.diag((~known[first]).ravel().astype(float)))
    means = (Y @ np.einsum("kinj,ki->nj", WG, y).ravel()).reshape(-1, 3)
    return np.where(known[first], means, np.nan), Y.reshape(len(ids), 3, len(ids), 3).transpose(0, 2, 1, 3)


def _fit(points: Points, pose: Array, Y: Array, S: Array) -> _Fit | None:
    """Gauss-Newton from a pose over landmarks with joint covariances (n, n, 3, 3); None where they leave T open."""
    known, count = points.known, len(points.ids)
    numbers = int(known.sum()) - 3
    if numbers < 0:
        return None
    for _ in range(STEPS):
        e, _, J = linear(points, pose)
        # the same levers as those of the noise, or T and the odometry would seem to tell one another's headings
        J[:, :2, 2] = perpendicular(points.places[:, :2] - pose[:2])
        turn = turn_matrix(pose[2])
        V = padded(turn @ Y @ turn.T + S, known)
        e, J = e.ravel(), (J * known[:, :, None]).reshape(-1, 3)
        W = np.linalg.inv(V)
        WJ = W @ J
        omega = J.T @ WJ
        if np.linalg.cond(omega) > ALONE:
            return None
        P = np.linalg.inv(omega)
        step = P @ (WJ.T @ e)
        pose = pose - step
        if step @ omega @ step < 1e-12:
            break
    e = e - J @ step
    pose[2] = wrap(pose[2])
    M, r = W - WJ @ P @ WJ.T, W @ e
    log_determinant = np.linalg.slogdet(V)[1] + np.linalg.slogdet(omega)[1]
    each = np.arange(count)
    blocks = M.reshape(count, 3, count, 3)[each, :, each]
    return _Fit(pose, (P + P.T) / 2, blocks, r.reshape(-1, 3), max(float(e @ r), 0.0), numbers, float(log_determinant))


def _student(squares: Array | float, numbers: Array | int, log_determinant: Array | float) -> Array:
    """log t_nu; see the module."""
    from scipy.special import gammaln

    half = (FREEDOM + np.asarray(numbers)) / 2
    constant = gammaln(half) - gammaln(FREEDOM / 2) - np.asarray(numbers) / 2 * np.log(np.pi * FREEDOM)
    return np.asarray(constant - np.asarray(log_determinant) / 2 - half * np.log1p(np.asarray(squares) / FREEDOM))


def _anywhere(covariance: Array, area: float) -> float:
    """log of the volume of the poses that T may be: those in the map, or all that P leaves where these are more."""
    return max(float(np.log(2 * np.pi * area)), float(np.linalg.slogdet(2 * np.pi * covariance)[1] / 2))
