"""Sightings of a stretch of a drive, carried to its first pose by the odometry, beside the landmarks of a map.

With the motions m_t + w_t, w_t ~ N(0, Q_t), the landmarks y_k(w) that the sightings see, and T the first pose in the map, the
most probable T and w minimise

    sum of w_t' Q_t^-1 w_t + e' (R + S)^-1 e,    e_k = T y_k(w) - m_k,

R the covariance of the sensor and S that of the map. Linearised at w̄, the covariance is
V = D Q D' + R + S, D = dy / dw.
Generalised least squares gives T, and w = -Q D' V^-1 (e - D w̄) (`smoothed`); the steps are shortened until the sum falls.

Levers are those of the place where the map with T has a landmark. With others, T and the odometry would seem to say one
another's headings (Huang, Mourikis and Roumeliotis, *Observability-based rules for designing consistent EKF SLAM
estimators*, IJRR 2010).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..models import SensorModel
from ..se2 import Array, lever_matrix, perpendicular, rotation, turn_matrix, wrap
from .landmark_map import LandmarkMap
from .map_evidence import Weighed, weighed
from .registration import Match, Points, evenly, linear, padded, those_that_differ
from .stretch import Drift, Stretch

#: the most sightings by which a pose is smoothed, the most steps, and the shortest part of one
ENOUGH, STEPS, SHORTEST = 120, 15, 1 / 64
#: a pose that moves by less than the root of this many standard deviations stays where it is
STAYS = 1e-6


def points_of(log: Stretch, landmarks: LandmarkMap, rows: np.ndarray, drift: Drift) -> Points:
    """The landmarks that sightings ``rows`` see, each with the covariance of the odometry up to it, and those of the map."""
    at = log.steps[rows]
    seen = seen_from(drift.poses[at], log.sightings[rows], log.sensor)
    return paired(seen, drift.covariances[at], log.landmarks[rows], landmarks)


def levers_of(points: Points, pose: Array, poses: Array) -> Array:
    """The levers (K, 2) of the landmarks, where the map with T has them, about the poses (K, 3) that see them."""
    return perpendicular((points.places[:, :2] - pose[:2]) @ rotation(pose[2]) - poses[:, :2])


def noise_of(log: Stretch, rows: np.ndarray, drift: Drift, levers: Array) -> Array:
    """The covariances (K, K, 3, 3) of sightings from one another, by the sensor and the odometry, whose errors they share."""
    at = log.steps[rows]
    _, C, _ = seen_from(drift.poses[at], log.sightings[rows], log.sensor)
    J = lever_matrix(levers)
    measured = J[:, None] @ drift.between(at) @ np.swapaxes(J, 1, 2)[None]
    each = np.arange(len(rows))
    measured[each, each] += C
    return np.asarray(measured)


def of_landmarks(landmarks: LandmarkMap, ids: np.ndarray) -> Array:
    """The covariances (L, L, 3, 3) of landmarks of a map from one another."""
    S, some = np.zeros((len(ids), 3, len(ids), 3)), landmarks.among(ids.tolist())
    number = {j: k for k, j in enumerate(ids.tolist())}
    if some.joint is None:
        for j, C in some.covariances.items():
            S[number[j], : len(C), number[j], : len(C)] = C
        return S.transpose(0, 2, 1, 3)
    rows = [(number[j], c) for j, C in some.covariances.items() for c in range(len(C))]
    n, c = np.array(rows).T
    S[n[:, None], c[:, None], n, c] = some.joint
    return S.transpose(0, 2, 1, 3)


def seen_from(poses: Array, sightings: Array, sensor: SensorModel) -> tuple[Array, Array, Array]:
    """The landmarks (M, 3) of sightings with covariances (M, 3, 3), and their levers (M, 2) about the poses."""
    d = sightings.shape[1]
    y, C = np.full((len(poses), 3), np.nan), np.zeros((len(poses), 3, 3))
    y[:, :d], C[:, :d, :d] = sensor.places(sightings, poses)
    return y, C, perpendicular(y[:, :2] - poses[:, :2])


def paired(seen: tuple[Array, Array, Array], drift: Array, ids: np.ndarray, landmarks: LandmarkMap) -> Points:
    """The points of sightings from poses with covariances ``drift`` (M, 3, 3), and their counterparts in a map."""
    y, C, lever = seen
    J = lever_matrix(lever)
    unique, which = np.unique(ids, return_inverse=True)
    m, S = landmarks.arrays(unique.tolist())
    whole = np.array([place[:2] for place in landmarks.values()])
    reach = 2 * float(np.median(np.hypot(*lever.T)))
    area = float(np.prod(np.ptp(whole, axis=0) + reach))
    return Points(y, C + J @ drift @ np.swapaxes(J, 1, 2), m[which], S[which], ids, area)


def together(
    log: Stretch, landmarks: LandmarkMap, rows: np.ndarray, drift: Drift, points: Points, matches: list[Match]
) -> list[Weighed]:
    """Hypotheses of sightings ``rows``, which are ``points``, by decreasing joint evidence, each place once."""
    of_map, poses = of_landmarks(landmarks, np.unique(points.ids)), drift.poses[log.steps[rows]]

    def judged(match: Match) -> Weighed | None:
        levers = levers_of(points, match.pose, poses)
        try:
            return weighed(points, match, lambda some: noise_of(log, rows[some], drift, levers[some]), of_map)
        except np.linalg.LinAlgError:  # noise so different in size that a covariance is singular to double precision
            return None

    return [each for _, each in those_that_differ([judged(match) for match in matches])]


def smoothed(log: Stretch, landmarks: LandmarkMap, rows: np.ndarray, start: Match) -> Match:
    """A match of sightings ``rows`` with pose and covariance smoothed (see the module), as it is where that is singular."""
    try:
        pose, covariance = _smoothed(log, landmarks, rows, start.pose)
    except np.linalg.LinAlgError:
        return start
    return replace(start, pose=pose, covariance=covariance)


def _smoothed(log: Stretch, landmarks: LandmarkMap, rows: np.ndarray, pose: Array) -> tuple[Array, Array]:
    rows = rows[evenly(len(rows), ENOUGH)]
    at, ids = log.steps[rows], np.unique(log.landmarks[rows])
    which = np.searchsorted(ids, log.landmarks[rows])
    S = of_landmarks(landmarks, ids)[which[:, None], which]
    each = np.arange(len(rows))

    def residuals(drift: Drift, pose: Array) -> tuple[Points, Array, Array]:
        """The points, e (3K,), and R + S (3K, 3K)."""
        drift.go_to(int(at[-1]))
        seen = seen_from(drift.poses[at], log.sightings[rows], log.sensor)
        points = paired(seen, np.zeros((len(rows), 3, 3)), log.landmarks[rows], landmarks)
        turn = turn_matrix(pose[2])
        R = S.copy()
        R[each, each] += turn @ points.covariances @ turn.T
        return points, linear(points, pose)[0].ravel(), padded(R, points.known)

    b, drift = np.zeros_like(log.motions), Drift(log)
    points, e, R = residuals(drift, pose)
    cost = float(e @ np.linalg.solve(R, e))
    for _ in range(STEPS):
        levers = levers_of(points, pose, drift.poses[at])
        turn, D = turn_matrix(pose[2]), lever_matrix(levers)
        noise = D[:, None] @ drift.between(at) @ np.swapaxes(D, 1, 2)[None]
        V = R + padded(turn @ noise @ turn.T, points.known) - np.diag((~points.known).ravel().astype(float))
        J = lever_matrix(perpendicular(points.places[:, :2] - pose[:2])) * points.known[:, :, None]
        J = J.reshape(-1, 3)
        unbent = e - ((turn @ D @ drift.shifts(at)[:, :, None])[..., 0] * points.known).ravel()
        W = np.linalg.solve(V, np.column_stack([J, unbent]))
        covariance = np.linalg.inv(J.T @ W[:, :3])
        step = -covariance @ (J.T @ W[:, 3])
        force = (W[:, 3] + W[:, :3] @ step).reshape(-1, 3)
        change = -drift.multipliers(at, (np.swapaxes(turn @ D, 1, 2) @ force[:, :, None])[..., 0]) - b
        share = 1.0
        while share > SHORTEST:
            errors = (log.noise @ (b + share * change)[:, :, None])[..., 0]
            tried = residuals(drift_there := Drift(log, errors), pose + share * step)
            there = float(tried[1] @ np.linalg.solve(tried[2], tried[1]) + np.sum((b + share * change) * errors))
            if there <= cost:
                break
            share /= 2
        else:
            break
        b, pose, drift, (points, e, R), cost = b + share * change, pose + share * step, drift_there, tried, there
        if share == 1 and step @ np.linalg.solve(covariance, step) < STAYS:
            break
    pose[2] = wrap(pose[2])
    return pose, (covariance + covariance.T) / 2
