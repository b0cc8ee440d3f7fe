"""`Stretch`: what a robot has measured between two moments, as its search in a map needs it.

The sightings of a stretch are carried to its first pose by the odometry, and compared with the landmarks of a map. With the
motions m_t + w_t, w_t ~ N(0, Q_t), the landmarks y_k(w) that the sightings see, and T the first pose in the map, the
most probable T and w minimise

    sum of w_t' Q_t^-1 w_t + e' (R + S)^-1 e,    e_k = T y_k(w) - m_k,

R the covariance of the sensor and S that of the map. Linearised at w̄, the covariance is
V = D Q D' + R + S, D = dy / dw.
Generalised least squares gives T, and w = -Q D' V^-1 (e - D w̄) (`smoothed`); the steps are shortened until the sum falls.

Levers lead to the place where the map with T has a landmark. With levers to other places, the linearised problem would
contain information about headings that the measurements do not have (Huang, Mourikis and Roumeliotis, *Observability-based
rules for designing consistent EKF SLAM estimators*, IJRR 2010).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, chained, compose, lever_matrix, perpendicular, rotation, turn_matrix, wrap
from .landmark_map import LandmarkMap
from .map_evidence import Weighed, weighed
from .registration import Match, Points, evenly, linear, padded, those_that_differ


@dataclass(frozen=True, eq=False)
class Stretch:
    """Poses 0 to T of a robot: the motions between them, and what was seen from them by which sensor.

    Attributes:
        name: of the log, for messages.
        motions, noise: (T, 3) and (T, 3, 3), each pose measured from the one before, and the covariance of that.
        steps, landmarks, sightings: (M,), (M,) and (M, 2 or 3), as in a `Log`.
        sensor: its noise model.
    """

    name: str
    motions: Array
    noise: Array
    steps: np.ndarray
    landmarks: np.ndarray
    sightings: Array
    sensor: SensorModel

    @classmethod
    def of(cls, log: Log, motion: MotionModel | None = None, sensor: SensorModel | None = None) -> Stretch:
        """A whole log; without controls its initial poses, taken as exact, are all there is.

        Args:
            log: the log.
            motion, sensor: the noise models; default: those of the log, else the book's.
        """
        if log.controls is None:
            motions = between(log.initial_poses[:-1], log.initial_poses[1:])
            noise = np.zeros((len(motions), 3, 3))
        else:
            motions, noise = log.motions(motion)
        sensor = sensor or log.sensor or SensorModel()
        return cls(log.name, motions, noise, log.steps, log.landmarks, log.sightings, sensor)

    @property
    def num_poses(self) -> int:
        """T + 1."""
        return len(self.motions) + 1

    @property
    def identified(self) -> bool:
        """Whether every sighting has an id."""
        return not np.any(self.landmarks == UNIDENTIFIED)

    @property
    def rows_at(self) -> list[np.ndarray]:
        """The rows of the sightings from each pose."""
        ends = np.cumsum(np.bincount(self.steps, minlength=self.num_poses))
        return np.split(np.argsort(self.steps, kind="stable"), ends)

    def after(self, step: int) -> Stretch:
        """What comes from a pose on, which is then pose 0."""
        later = self.steps >= step
        return replace(
            self, motions=self.motions[step:], noise=self.noise[step:], steps=self.steps[later] - step,
            landmarks=self.landmarks[later], sightings=self.sightings[later],
        )  # fmt: skip


class Drift:
    """The poses (n, 3) of a stretch seen from the first one, and their covariances, as far as they are asked for.

    ``errors`` (T, 3) of the motions, where they are known about, are where the covariances are linearised.
    """

    def __init__(self, stretch: Stretch, errors: Array | None = None) -> None:
        self.poses, self.covariances = np.zeros((1, 3)), np.zeros((1, 3, 3))
        self._stretch, self._errors = stretch, errors
        self._motions = stretch.motions if errors is None else stretch.motions + errors

    def go_to(self, step: int) -> None:
        """Compute them up to a step, or farther."""
        done = len(self.poses) - 1
        if step <= done:
            return
        new = slice(done, max(step, 2 * done))
        more = drifted(self.poses[-1], self._motions[new], self._stretch.noise[new], self.covariances[-1])
        self.poses = np.concatenate([self.poses, more[0][1:]])
        self.covariances = np.concatenate([self.covariances, more[1][1:]])

    def between(self, steps: np.ndarray) -> Array:
        """The covariances (K, K, 3, 3) between the poses at steps (K,), not decreasing.

        The errors of an earlier pose s move a later pose t by [[1, 0, y_s - y_t], [0, 1, x_t - x_s], [0, 0, 1]].
        """
        x, own = self.poses[steps], self.covariances[steps]
        moved = lever_matrix(perpendicular(x[None, :, :2] - x[:, None, :2]))
        # rows are the earlier poses
        upper = own[:, None] @ np.swapaxes(moved, 2, 3)
        later = np.arange(len(x))[:, None] > np.arange(len(x))
        return np.where(later[:, :, None, None], np.transpose(upper, (1, 0, 3, 2)), upper)

    def shifts(self, steps: np.ndarray) -> Array:
        """How far, to first order, the errors move the poses at steps (K,): (K, 3), the sum of what `between` describes."""
        if self._errors is None:
            return np.zeros((len(steps), 3))
        x = self.poses
        a = np.zeros((len(x), 3))
        a[1:] = (turn_matrix(x[:-1, 2]) @ self._errors[: len(x) - 1, :, None])[..., 0]
        sums = np.cumsum(a + np.column_stack([x[:, 1] * a[:, 2], -x[:, 0] * a[:, 2], 0 * a[:, 2]]), axis=0)
        turn = sums[:, 2]
        return np.asarray((sums + np.column_stack([-x[:, 1] * turn, x[:, 0] * turn, 0 * turn]))[steps])

    def multipliers(self, steps: np.ndarray, forces: Array) -> Array:
        """D' f (T, 3), with D the derivatives of the poses at steps (K,) by the motions, and forces f (K, 3) on the poses."""
        x, f = self.poses, np.zeros((len(self.poses), 3))
        np.add.at(f, steps, forces)
        f[:, 2] += x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
        later = np.cumsum(f[::-1], axis=0)[::-1]
        later[:, 2] += x[:, 1] * later[:, 0] - x[:, 0] * later[:, 1]
        found = np.zeros((len(self._stretch.motions), 3))
        found[: len(x) - 1] = (np.swapaxes(turn_matrix(x[:-1, 2]), 1, 2) @ later[1:, :, None])[..., 0]
        return found


def drifted(start: Array, motions: Array, noise: Array, covariance: Array | None = None) -> tuple[Array, Array]:
    """The poses (T+1, 3) after motions (T, 3), and their covariances (T+1, 3, 3), in world axes; see `moved`.

    The errors of a motion are those of the first pose that would move its end as far: their covariances are summed there.
    """
    poses = chained(start, motions)
    poses[:, 2] = wrap(poses[:, 2])
    away = perpendicular(poses[:, :2] - poses[0, :2])
    back, there = lever_matrix(-away[1:]) @ turn_matrix(poses[:-1, 2]), lever_matrix(away)
    first = np.zeros((3, 3)) if covariance is None else covariance
    errors = np.concatenate([first[None], back @ noise @ np.swapaxes(back, 1, 2)])
    return poses, there @ np.cumsum(errors, axis=0) @ np.swapaxes(there, 1, 2)


def moved(x: Array, P: Array, motion: Array, noise: Array) -> tuple[Array, Array]:
    """A pose (3,) and its covariance (3, 3) after a motion m (3,) with covariance Q (3, 3), in the axes of the pose.

    Sigma' = F Sigma F' + J Q J', F = d compose(x, m) / dx, J = d compose(x, m) / dm.
    """
    after = compose(x, motion)
    F = np.array([[1, 0, x[1] - after[1]], [0, 1, after[0] - x[0]], [0, 0, 1]])
    J = turn_matrix(x[2])
    return after, F @ P @ F.T + J @ noise @ J.T


def backwards(x: Array, P: Array) -> tuple[Array, Array]:
    """The motions (..., 3) from poses x with covariances P back to the origin, in the axes of x, and their covariances."""
    back = between(x, np.zeros(3))
    F = lever_matrix(perpendicular(back[..., :2])) @ turn_matrix(back[..., 2])
    return back, F @ P @ np.swapaxes(F, -1, -2)


#: the most sightings by which a pose is smoothed, the most steps, and the shortest part of one
ENOUGH, STEPS, SHORTEST = 120, 15, 1 / 64
#: a pose stays where it is if the squared Mahalanobis norm of its step is below this
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
    of_map, poses = landmarks.between(np.unique(points.ids).tolist()), drift.poses[log.steps[rows]]

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
    S = landmarks.between(ids.tolist())[which[:, None], which]
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
