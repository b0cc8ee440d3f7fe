"""Which landmark was that? Decided by every particle for itself, compiled.

Unlike the kernels for known landmarks these branch: particles differ in what they see. Maps are slices of one pool
(landmarks, 11, N), where row 9 is the *evidence* for the landmark, 0 where the particle does not have it, and row 10
the step that saw it last.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from .branchless import INLINED, OPTIONS, atan2, wrap_angle
from .fusion import Nine, draw_pose, first_sighting, fold_into_landmark, fold_into_pose
from .noise import normal_pair

#: the row of the pool that holds the evidence
EVIDENCE = 9
#: the row that holds the step that saw it last
SEEN = 10


@njit(**INLINED)
def _read(rows: Array, i: int) -> Nine:
    return (
        rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i], rows[6, i], rows[7, i], rows[8, i],
    )  # fmt: skip


@njit(**OPTIONS)
def associate(
    lo: int, hi: int, belief: Array, poses: Array, drawn: bool, key: np.uint64, pool: Array, candidates: np.ndarray,
    fresh: np.ndarray, sightings: Array, q: Array, third: float, log_new: Array, gate: float, step: int,
    kept: float, log_likelihood: Array,
) -> None:  # fmt: skip
    """One scan of K sightings (K, 3): assign, weigh, draw the pose (2.0), update the map and its evidence.

    Args:
        belief: (9, N) of the poses; without covariance in 1.0.
        poses: (3, N); where ``drawn`` is False the poses of 2.0 are drawn here, with the numbers of ``key``.
        candidates: the landmarks of the pool that may be in view; ``fresh``: (K,) free ones for new landmarks.
        third: 1 where there is psi, 0 where not; then the third columns of sightings and q are 0 and 1.
        log_new: (K,) log likelihood of each sighting if it is of a new landmark: that of a squared Mahalanobis distance
            of ``gate`` under Q alone.
        step: which step the scan belongs to.
        kept: the evidence at which a landmark stays for good.
    """
    scan, known = len(sightings), len(candidates)
    # of each sighting the landmarks that it may be of, their log likelihoods, and how many
    landmarks, scores, counts = np.empty((scan, known), np.int64), np.empty((scan, known)), np.empty(scan, np.int64)
    chosen, won, taken = np.empty(scan, np.int64), np.empty(scan), np.empty(known, np.bool_)
    columns, near, which, b = (
        np.empty((4, scan)),
        np.empty(scan, np.bool_),
        np.empty(scan, np.int64),
        np.empty((7, scan)),
    )
    for k in range(scan):
        columns[0, k], columns[1, k], columns[2, k], columns[3, k] = sightings[k, 0], sightings[k, 1], q[k, 0], q[k, 1]
    for i in range(lo, hi):
        x = _read(belief, i)
        counts[:] = 0
        for c in range(known):
            rows = pool[candidates[c]]
            if rows[EVIDENCE, i] == 0:
                # a particle without the landmark cannot choose it
                continue
            landmark = _read(rows, i)
            _find_near(x, landmark, columns, gate, near)
            # side by side, so that several are weighed at once
            count = 0
            for k in range(scan):
                if near[k]:
                    which[count] = k
                    for n in range(3):
                        b[n, count], b[3 + n, count] = sightings[k, n], q[k, n]
                    count += 1
            for m in range(count):
                z, variances = (b[0, m], b[1, m], b[2, m]), (b[3, m], b[4, m], b[5, m])
                b[6, m], _ = fold_into_pose(x, landmark, z, variances, third)
            for m in range(count):
                k = which[m]
                if b[6, m] >= log_new[k]:
                    landmarks[k, counts[k]], scores[k, counts[k]] = c, b[6, m]
                    counts[k] += 1
        _choose(landmarks, scores, counts, chosen, won, taken)

        for k in range(scan):
            z, variances = (sightings[k, 0], sightings[k, 1], sightings[k, 2]), (q[k, 0], q[k, 1], q[k, 2])
            if chosen[k] < 0:
                log_likelihood[i] += log_new[k]
            elif drawn:
                log_likelihood[i] += won[k]
            else:
                value, x = fold_into_pose(x, _read(pool[candidates[chosen[k]]], i), z, variances, third)
                log_likelihood[i] += value
        if not drawn:
            n0, n1 = normal_pair(key, i, 0)
            n2, _ = normal_pair(key, i, 1)
            poses[0, i], poses[1, i], poses[2, i] = draw_pose(x, n0, n1, n2)
        pose = (poses[0, i], poses[1, i], poses[2, i])

        for k in range(scan):
            z, variances = (sightings[k, 0], sightings[k, 1], sightings[k, 2]), (q[k, 0], q[k, 1], q[k, 2])
            if chosen[k] < 0:
                rows = pool[fresh[k]]
                landmark = first_sighting(pose, z, variances, third)
                rows[EVIDENCE, i] = 1.0
            else:
                rows = pool[candidates[chosen[k]]]
                _, landmark = fold_into_landmark(_read(rows, i), pose, z, variances, third)
                rows[EVIDENCE, i] = min(rows[EVIDENCE, i] + 1, kept)
            for n in range(9):
                rows[n, i] = landmark[n]
            rows[SEEN, i] = step


@njit(**OPTIONS)
def charge(
    lo: int, hi: int, poses: Array, pool: Array, candidates: np.ndarray, step: int, view: Array, kept: float
) -> None:
    """Count one against every landmark that may still be lost, if it was in view and the step's scans did not see it.

    Args:
        view: least range, largest range [m] and largest bearing [rad] within which a landmark should be seen.
    """
    for c in range(len(candidates)):
        rows = pool[candidates[c]]
        for i in range(lo, hi):
            missed = 0 < rows[EVIDENCE, i] < kept and rows[SEEN, i] != step
            if missed and _in_view(rows[0, i] - poses[0, i], rows[1, i] - poses[1, i], poses[2, i], view):
                rows[EVIDENCE, i] -= 1


@njit(**INLINED)
def _find_near(x: Nine, landmark: Nine, columns: Array, gate: float, near: np.ndarray) -> None:
    """Which sightings, columns (4, K) of l, phi and their variances, range and bearing leave within the gate.

    Each alone: e² <= gate (its entry on the diagonal of V). Since V >= Q all others are less likely than a new landmark.
    """
    dx, dy = landmark[0] - x[0], landmark[1] - x[1]
    r = sqrt(dx * dx + dy * dy)
    ux, uy = dx / r, dy / r
    vx, vy = -uy / r, ux / r
    direction = atan2(dy, dx) - x[2]
    # C = Cov(m - x) and Cov(m - x, theta) = -P_xt, as in `fold_into_pose`
    cxx, cxy, cyy = x[3] + landmark[3], x[4] + landmark[4], x[6] + landmark[6]
    along = cxx * ux * ux + 2 * cxy * ux * uy + cyy * uy * uy
    across = cxx * vx * vx + 2 * cxy * vx * vy + cyy * vy * vy + 2 * (vx * x[5] + vy * x[7]) + x[8]
    for k in range(len(near)):
        e0, e1 = columns[0, k] - r, wrap_angle(columns[1, k] - direction)
        near[k] = (e0 * e0 <= gate * (along + columns[2, k])) & (e1 * e1 <= gate * (across + columns[3, k]))


@njit(**INLINED)
def _choose(
    landmarks: np.ndarray, scores: Array, counts: np.ndarray, chosen: np.ndarray, won: Array, taken: np.ndarray
) -> None:
    """The likeliest pair first, then the likeliest of the rest: no landmark is seen twice in a scan.

    chosen and won (K,) are the landmark of each sighting, -1 for none, and its score; ties go to the first.
    """
    scan = len(counts)
    taken[:] = False
    # of each sighting the place of the likeliest landmark that is left, -1 where there is none
    favourite = np.empty(scan, np.int64)
    for k in range(scan):
        chosen[k], favourite[k] = -1, _likeliest(landmarks[k], scores[k], counts[k], taken)
    while True:
        best, sighting = -np.inf, -1
        for k in range(scan):
            if chosen[k] < 0 and favourite[k] >= 0 and scores[k, favourite[k]] > best:
                best, sighting = scores[k, favourite[k]], k
        if sighting < 0:
            break
        landmark = landmarks[sighting, favourite[sighting]]
        chosen[sighting], won[sighting], taken[landmark] = landmark, best, True
        for k in range(scan):
            if chosen[k] < 0 and favourite[k] >= 0 and landmarks[k, favourite[k]] == landmark:
                favourite[k] = _likeliest(landmarks[k], scores[k], counts[k], taken)


@njit(**INLINED)
def _likeliest(landmarks: np.ndarray, scores: Array, count: int, taken: np.ndarray) -> int:
    best, place = -np.inf, -1
    for n in range(count):
        if scores[n] > best and not taken[landmarks[n]]:
            best, place = scores[n], n
    return place


@njit(**INLINED)
def _in_view(dx: float, dy: float, heading: float, view: Array) -> bool:
    r = sqrt(dx * dx + dy * dy)
    return view[0] <= r <= view[1] and abs(wrap_angle(atan2(dy, dx) - heading)) <= view[2]


@njit(**OPTIONS)
def extent(rows: Array, kept: float) -> tuple[int, bool, float, float, float, float]:
    """How many particles have a landmark, whether any may still lose it, and the box of its means.

    The box is least x, most x, least y, most y.
    """
    count, losable, left, right, low, high = 0, False, np.inf, -np.inf, np.inf, -np.inf
    for i in range(rows.shape[1]):
        if rows[EVIDENCE, i] > 0:
            count += 1
            losable |= rows[EVIDENCE, i] < kept
            left, right = min(left, rows[0, i]), max(right, rows[0, i])
            low, high = min(low, rows[1, i]), max(high, rows[1, i])
    return count, losable, left, right, low, high
