"""Unknown data association, compiled: every particle decides by itself which landmark each sighting belongs to.

Unlike the kernels for known landmarks these have branches, because the particles decide differently. Maps are slices of
one pool (landmarks, 11 + n, N). Rows 0 to 8 are the Gaussian, as in `blocks`; row 9 is the *evidence* for the landmark, 0
where the particle does not have it; row 10 is the step of its last sighting. With n classes, the other rows are those of
`class_kernels`.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from graphslam.se2 import Array

from . import class_kernels, proposal
from .blocks import Nine, get_nine, get_three, put_nine
from .fast_math import INLINED, OPTIONS, atan2, sincos, wrap_angle
from .kalman import draw_pose, initial_landmark, update_landmark, update_pose
from .noise import three_normals, uniform

#: the row of the pool that holds the evidence
EVIDENCE = 9
#: the row of the pool that holds the step of the last sighting
LAST_STEP = 10


class Rule(NamedTuple):
    """How the hypotheses of a sighting are found and chosen, and how a choice changes the evidence for its landmark."""

    #: the squared residual, over its variance, within which a landmark is a hypothesis; in range and in bearing
    gate: float
    #: and how far its log likelihood may be below that of a new landmark
    below: float
    #: whether the hypothesis is drawn, or the most likely one taken
    sampled: bool
    #: the evidence after the first sighting, and from which on it no longer changes
    first: float
    kept: float
    #: what a later sighting adds, and the share of the log likelihood ratio to a new landmark that it also adds
    hit: float
    graded: float
    #: where hypotheses are drawn: the probability that a landmark in view is seen, and the odds at which one is dropped
    detection: float
    dropped: float


@njit(**OPTIONS)
def associate(
    lo: int, hi: int, belief: Array, poses: Array, drawn: bool, exact: bool, starts: Array, motion: proposal.Motion,
    key: np.uint64, pool: Array, candidates: np.ndarray, fresh: np.ndarray, sightings: Array, shown: np.ndarray,
    confusion: Array, third: float, log_new: Array, step: int, rule: Rule, choices: np.uint64, log_likelihood: Array,
) -> None:  # fmt: skip
    """Process one scan of K sightings (6, K): assign, weigh, draw the pose (2.0), update the map and its evidence.

    The hypotheses of sighting k are the landmarks j near it, with the evidence w_j = N(z_k; h(m_j), V) under the predicted
    pose, and a new landmark or clutter, with w_0. A landmark that the scan has used is no hypothesis any more. The most
    likely one is taken. Or, with w_j multiplied by P_D e_j, the probabilities that landmark j is seen and exists, one is
    drawn with the probability w / W, W = sum of all w; its likelihood under the drawn pose is then multiplied by W / w.
    Where sightings have classes, w_j is also multiplied by the ratio of `class_kernels.log_ratio`.

    Args:
        belief: Gaussians (9, N) of the poses; the covariance is zero in 1.0.
        poses: (3, N); where ``drawn`` is False the poses of 2.0 are drawn here, with the random numbers of ``key``.
        exact: whether the weights of 2.0 are exact, for the motion from ``starts`` (3, N); see `proposal`.
        candidates: pool indices of the landmarks that may be in view; ``fresh``: (K,) free indices for new landmarks.
        sightings: rows l, phi, psi and their variances; without psi rows 2 and 5 are 0 and 1.
        shown: (K,) the class of each sighting, with ``confusion`` (n, n + 1), see `class_kernels`; n = 0 without classes.
        third: 1 with psi, 0 without.
        log_new: (K,) log likelihood of each sighting if it belongs to a new landmark.
        step: the step of the scan.
        choices: the key of the uniform numbers by which hypotheses are drawn, K for each particle.
    """
    scan, known, classified = sightings.shape[1], len(candidates), len(confusion) > 0
    # for each sighting: the landmarks to which it may belong, their log likelihoods, and how many they are
    landmarks, scores, counts = np.empty((scan, known), np.int64), np.empty((scan, known)), np.empty(scan, np.int64)
    chosen, won, taken = np.empty(scan, np.int64), np.empty(scan), np.empty(known, np.bool_)
    # log P_D e of each landmark, and log W of the hypotheses of each sighting over the log likelihood of the chosen one
    seen, drawn_from = np.empty(known), np.zeros(scan)
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
            _find_near(x, landmark, sightings, rule.gate, near)
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
            if rule.sampled and count > 0:
                seen[c] = log(rule.detection * existence(rows[EVIDENCE, i], rule.dropped))
            if classified:
                for m in range(count):
                    b[6, m] += class_kernels.log_ratio(rows, i, confusion, shown[which[m]])
            for m in range(count):
                k = which[m]
                if b[6, m] >= log_new[k] - rule.below:
                    landmarks[k, counts[k]], scores[k, counts[k]] = c, b[6, m]
                    counts[k] += 1
        if rule.sampled:
            _draw(landmarks, scores, counts, seen, log_new, choices, i, chosen, won, taken, drawn_from)
        else:
            _choose(landmarks, scores, counts, chosen, won, taken)

        for k in range(scan):
            log_likelihood[i] += drawn_from[k]
            z, variances = get_three(sightings, 0, k), get_three(sightings, 3, k)
            if chosen[k] < 0:
                log_likelihood[i] += log_new[k]
            elif drawn:
                log_likelihood[i] += won[k]
            else:
                value, x = update_pose(x, get_nine(pool[candidates[chosen[k]]], 0, i), z, variances, third)
                if not exact:
                    log_likelihood[i] += value
                if classified:
                    log_likelihood[i] += class_kernels.log_ratio(pool[candidates[chosen[k]]], i, confusion, shown[k])
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
                rows[EVIDENCE, i] = rule.first
            else:
                rows = pool[candidates[chosen[k]]]
                value, landmark = update_landmark(get_nine(rows, 0, i), pose, z, variances, third)
                if exact:
                    log_likelihood[i] += value
                more = rule.hit + rule.graded * (won[k] - log_new[k])
                rows[EVIDENCE, i] = min(rows[EVIDENCE, i] + max(more, 0.0), rule.kept)
            put_nine(rows, 0, i, landmark)
            rows[LAST_STEP, i] = step
            if classified:
                class_kernels.show(rows, i, confusion, shown[k], chosen[k] >= 0)


@njit(**INLINED)
def existence(evidence: float, dropped: float) -> float:
    """Return the probability that a landmark exists, where the evidence is the log of its odds over those of one dropped."""
    odds = dropped * exp(evidence)
    return odds / (1.0 + odds)


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
def _draw(
    landmarks: np.ndarray, scores: Array, counts: np.ndarray, seen: Array, log_new: Array, key: np.uint64, particle: int,
    chosen: np.ndarray, won: Array, taken: np.ndarray, drawn_from: Array,
) -> None:  # fmt: skip
    """Draw a hypothesis for one sighting after the other, in proportion to its evidence, without the landmarks used before.

    Written are chosen (K,), -1 for a new landmark; won (K,), the log likelihood under the choice, and drawn_from (K,), the
    log of the sum of all evidence over that likelihood.
    """
    scan = len(counts)
    taken[:] = False
    for k in range(scan):
        highest = log_new[k]
        for n in range(counts[k]):
            if not taken[landmarks[k, n]]:
                highest = max(highest, scores[k, n] + seen[landmarks[k, n]])
        new = total = exp(log_new[k] - highest)
        for n in range(counts[k]):
            if not taken[landmarks[k, n]]:
                total += exp(scores[k, n] + seen[landmarks[k, n]] - highest)
        place = uniform(key, np.uint64(particle * scan + k)) * total - new
        chosen[k], won[k] = -1, log_new[k]
        for n in range(counts[k]):
            if place < 0.0:
                break
            # rounding may leave a rest behind the last one
            if not taken[landmarks[k, n]]:
                chosen[k], won[k] = landmarks[k, n], scores[k, n]
                place -= exp(scores[k, n] + seen[landmarks[k, n]] - highest)
        if chosen[k] >= 0:
            taken[chosen[k]] = True
        drawn_from[k] = highest + log(total) - won[k]


@njit(**OPTIONS)
def places(belief: Array, sightings: Array, gate: float) -> Array:
    """Return for each sighting (6, K) the box that holds the mean m of each landmark that is a hypothesis of a particle.

    That is if the landmark is perfectly known. The box of another one has to be wider by 2 sqrt(gate trace S). With the
    gate on range l and bearing, abs(m - z) <= sqrt(gate) (2 sqrt(trace S) + 2 sqrt(trace P) + sigma_l + l (sigma_theta +
    sigma_phi)) in the world, S and P the covariances of the positions of landmark and robot.

    Returns:
        (K, 4): smallest x, largest x, smallest y, largest y.
    """
    boxes = np.empty((sightings.shape[1], 4))
    for k in range(sightings.shape[1]):
        left, right, low, high = np.inf, -np.inf, np.inf, -np.inf
        r, direction = sightings[0, k], sightings[1, k]
        for i in range(belief.shape[1]):
            s, c = sincos(belief[2, i] + direction)
            x, y = belief[0, i] + r * c, belief[1, i] + r * s
            wide = 2 * sqrt(max(belief[3, i] + belief[6, i], 0.0)) + sqrt(sightings[3, k])
            wide = sqrt(gate) * (wide + r * (sqrt(max(belief[8, i], 0.0)) + sqrt(sightings[4, k])))
            left, right, low, high = min(left, x - wide), max(right, x + wide), min(low, y - wide), max(high, y + wide)
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = left, right, low, high
    return boxes
