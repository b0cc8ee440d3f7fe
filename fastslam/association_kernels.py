"""Unknown data association, compiled: every particle decides by itself which landmark each sighting belongs to.

Unlike the kernels for known landmarks these have branches, because the particles decide differently. Maps are slices of
one pool (landmarks, 11, N). Rows 0 to 8 are the Gaussian, as in `blocks`; row 9 is the *evidence* for the landmark, 0
where the particle does not have it; row 10 is the step of its last sighting.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from . import proposal
from .blocks import Nine, get_nine, get_three, put_nine
from .fast_math import INLINED, OPTIONS, atan2, wrap_angle
from .kalman import draw_pose, initial_landmark, update_landmark, update_pose
from .noise import three_normals

#: the row of the pool that holds the evidence
EVIDENCE = 9
#: the row of the pool that holds the step of the last sighting
LAST_STEP = 10


@njit(**OPTIONS)
def associate(
    lo: int, hi: int, belief: Array, poses: Array, drawn: bool, exact: bool, starts: Array, motion: proposal.Motion,
    key: np.uint64, pool: Array, candidates: np.ndarray,
    fresh: np.ndarray, sightings: Array, third: float, log_new: Array, gate: float, step: int, kept: float,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Process one scan of K sightings (6, K): assign, weigh, draw the pose (2.0), update the map and its evidence.

    Args:
        belief: Gaussians (9, N) of the poses; the covariance is zero in 1.0.
        poses: (3, N); where ``drawn`` is False the poses of 2.0 are drawn here, with the random numbers of ``key``.
        exact: whether the weights of 2.0 are exact, for the motion from ``starts`` (3, N); see `proposal`.
        candidates: pool indices of the landmarks that may be in view; ``fresh``: (K,) free indices for new landmarks.
        sightings: rows l, phi, psi and their variances; without psi rows 2 and 5 are 0 and 1.
        third: 1 with psi, 0 without.
        log_new: (K,) log likelihood of each sighting if it belongs to a new landmark: the density under Q alone at a
            squared Mahalanobis distance of ``gate``.
        step: the step of the scan.
        kept: the evidence from which on a landmark is never dropped.
    """
    scan, known = sightings.shape[1], len(candidates)
    # for each sighting: the landmarks to which it may belong, their log likelihoods, and how many they are
    landmarks, scores, counts = np.empty((scan, known), np.int64), np.empty((scan, known)), np.empty(scan, np.int64)
    chosen, won, taken = np.empty(scan, np.int64), np.empty(scan), np.empty(known, np.bool_)
    near, which, b = np.empty(scan, np.bool_), np.empty(scan, np.int64), np.empty((7, scan))
    for i in range(lo, hi):
        x = get_nine(belief, 0, i)
        counts[:] = 0
        for c in range(known):
            rows = pool[candidates[c]]
            if rows[EVIDENCE, i] == 0:
                # a particle without the landmark cannot choose it
                continue
            landmark = get_nine(rows, 0, i)
            _find_near(x, landmark, sightings, gate, near)
            # the sightings that remain are stored side by side, so that several are weighed at once
            count = 0
            for k in range(scan):
                if near[k]:
                    which[count] = k
                    for n in range(6):
                        b[n, count] = sightings[n, k]
                    count += 1
            for m in range(count):
                b[6, m], _ = update_pose(x, landmark, get_three(b, 0, m), get_three(b, 3, m), third)
            for m in range(count):
                k = which[m]
                if b[6, m] >= log_new[k]:
                    landmarks[k, counts[k]], scores[k, counts[k]] = c, b[6, m]
                    counts[k] += 1
        _choose(landmarks, scores, counts, chosen, won, taken)

        for k in range(scan):
            z, variances = get_three(sightings, 0, k), get_three(sightings, 3, k)
            if chosen[k] < 0:
                log_likelihood[i] += log_new[k]
            elif drawn:
                log_likelihood[i] += won[k]
            else:
                value, x = update_pose(x, get_nine(pool[candidates[chosen[k]]], 0, i), z, variances, third)
                if not exact:
                    log_likelihood[i] += value
        if exact:
            pose, ratio = proposal.draw_weighted(get_three(starts, 0, i), x, proposal.five_normals(key, i), motion)
            poses[0, i], poses[1, i], poses[2, i] = pose
            log_likelihood[i] += ratio
        elif not drawn:
            n0, n1, n2 = three_normals(key, i)
            poses[0, i], poses[1, i], poses[2, i] = draw_pose(x, n0, n1, n2)
        pose = get_three(poses, 0, i)

        for k in range(scan):
            z, variances = get_three(sightings, 0, k), get_three(sightings, 3, k)
            if chosen[k] < 0:
                rows = pool[fresh[k]]
                landmark = initial_landmark(pose, z, variances)
                rows[EVIDENCE, i] = 1.0
            else:
                rows = pool[candidates[chosen[k]]]
                value, landmark = update_landmark(get_nine(rows, 0, i), pose, z, variances, third)
                if exact:
                    log_likelihood[i] += value
                rows[EVIDENCE, i] = min(rows[EVIDENCE, i] + 1, kept)
            put_nine(rows, 0, i, landmark)
            rows[LAST_STEP, i] = step


@njit(**OPTIONS)
def count_misses(
    lo: int, hi: int, poses: Array, pool: Array, candidates: np.ndarray, step: int, view: Array, kept: float
) -> None:
    """Lower the evidence by 1 for landmarks that were in view in this step without a sighting, except for permanent ones.

    Args:
        view: smallest range, largest range [m] and largest bearing [rad] at which a landmark should be seen.
    """
    for c in range(len(candidates)):
        rows = pool[candidates[c]]
        for i in range(lo, hi):
            missed = 0 < rows[EVIDENCE, i] < kept and rows[LAST_STEP, i] != step
            if missed and _in_view(rows[0, i] - poses[0, i], rows[1, i] - poses[1, i], poses[2, i], view):
                rows[EVIDENCE, i] -= 1


@njit(**INLINED)
def _find_near(x: Nine, landmark: Nine, sightings: Array, gate: float, near: np.ndarray) -> None:
    """Mark the sightings (6, K) that may belong to the landmark, in near (K,).

    Range and bearing are each tested alone: e² <= gate * (the entry on the diagonal of V). Since V >= Q, every sighting
    outside is less likely than under a new landmark.
    """
    dx, dy = landmark[0] - x[0], landmark[1] - x[1]
    r = sqrt(dx * dx + dy * dy)
    ux, uy = dx / r, dy / r
    vx, vy = -uy / r, ux / r
    direction = atan2(dy, dx) - x[2]
    # C = Cov(m - x) and Cov(m - x, theta) = -P_xt, as in `update_pose`
    cxx, cxy, cyy = x[3] + landmark[3], x[4] + landmark[4], x[6] + landmark[6]
    along = cxx * ux * ux + 2 * cxy * ux * uy + cyy * uy * uy
    across = cxx * vx * vx + 2 * cxy * vx * vy + cyy * vy * vy + 2 * (vx * x[5] + vy * x[7]) + x[8]
    for k in range(len(near)):
        e0, e1 = sightings[0, k] - r, wrap_angle(sightings[1, k] - direction)
        near[k] = (e0 * e0 <= gate * (along + sightings[3, k])) & (e1 * e1 <= gate * (across + sightings[4, k]))


@njit(**INLINED)
def _choose(
    landmarks: np.ndarray, scores: Array, counts: np.ndarray, chosen: np.ndarray, won: Array, taken: np.ndarray
) -> None:
    """Assign the most likely pair first, then the most likely of the rest; no landmark is used twice in a scan.

    Written are chosen and won (K,): the landmark of each sighting, -1 for none, and its score. Ties go to the first.
    """
    scan = len(counts)
    taken[:] = False
    # for each sighting the place of the most likely landmark that is not taken, -1 for none
    favourite = np.empty(scan, np.int64)
    for k in range(scan):
        chosen[k], favourite[k] = -1, _most_likely(landmarks[k], scores[k], counts[k], taken)
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
                favourite[k] = _most_likely(landmarks[k], scores[k], counts[k], taken)


@njit(**INLINED)
def _most_likely(landmarks: np.ndarray, scores: Array, count: int, taken: np.ndarray) -> int:
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
    """Return how many particles have a landmark, whether any may still drop it, and the bounding box of its means.

    The box is smallest x, largest x, smallest y, largest y.
    """
    count, droppable, left, right, low, high = 0, False, np.inf, -np.inf, np.inf, -np.inf
    for i in range(rows.shape[1]):
        if rows[EVIDENCE, i] > 0:
            count += 1
            droppable |= rows[EVIDENCE, i] < kept
            left, right = min(left, rows[0, i]), max(right, rows[0, i])
            low, high = min(low, rows[1, i]), max(high, rows[1, i])
    return count, droppable, left, right, low, high
