"""A robot in a map from moment to moment: what its sightings are of, and whether it is where it is believed to be.

An extended Kalman filter predicts the pose, and each sighting of a landmark of the map agrees with it or contradicts it, by
the squared Mahalanobis distance d² of the place that it sees. Those that agree correct the pose. Sightings without ids are
assigned to the landmarks of the map, the smallest squares first; those near none may be of landmarks that the map lacks.

The robot is elsewhere with probability `LIFTED` from each pose on. With the density p = N(e; 0, V) of a sighting where it is
believed to be, and with 1 / A, A the area of the map, where it is anywhere else, each sighting adds to the log odds

    log(RIGHT p A + 1 - RIGHT)

as in `graph.registration`; without ids p is the mean over the landmarks, whose number over A is their density.

Contradictions count 1, agreements -1, and the sum, the doubt, is never below 0.

Sources: Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, sections 7.4 and 7.1; Shiryaev, *On optimum methods in
quickest detection problems*, Theory of Probability and its Applications 1963 (the odds of a change); Page, *Continuous
inspection schemes*, Biometrika 1954 (the doubt).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from ..log import UNIDENTIFIED
from ..models import SensorModel
from ..se2 import Array, lever_matrix, perpendicular, rotation, wrap
from .landmark_map import LandmarkMap
from .registration import RIGHT, volume
from .stretch import moved

#: squared Mahalanobis distance up to which a sighting agrees; 0.1 % of the right ones lie beyond it
AGREES = 13.8
#: without ids, a sighting is ambiguous where the squares of the nearest two landmarks differ by less than this
UNCLEAR = 6.0
#: the probability that a robot is lifted between two poses
LIFTED = 1e-5
#: a motion with a variance above this [m²] is unknown
NOTHING = 1e5
#: the squares that are kept
WINDOW = 50
#: width of the border of a map around its landmarks, both sides together [m]
MARGIN = 10.0
#: the fewest sightings of a landmark that the map lacks, and their share of the moments in which it is in view
CONFIRMED, SHARE = 4, 0.3
#: such a landmark is in view within this share of the field in which anything was seen
INSIDE = 0.9


@dataclass(frozen=True, eq=False)
class Seen:
    """What a moment says, for n sightings.

    Attributes:
        landmarks: (n,) their ids, `UNIDENTIFIED` where that is not clear.
        agree, contradict: (n,) whether they agree with the pose, or are of no landmark that should be there.
        earlier: {row: id} of earlier sightings of a new landmark.
        gain: what they add to the log odds.
    """

    landmarks: np.ndarray
    agree: np.ndarray
    contradict: np.ndarray
    earlier: dict[int, int]
    gain: float = 0.0


@dataclass(eq=False)
class _Unknown:
    """Something that is seen where the map has nothing: its place, the rows of its sightings, and the moments in view."""

    place: Array
    covariance: Array
    rows: list[int] = field(default_factory=list)
    views: int = 0
    id: int = UNIDENTIFIED


class Tracker:
    """The filter; see the module.

    Attributes:
        pose, covariance: (3,) and (3, 3).
        log_odds: that the robot is there, and not elsewhere.
        doubt: the number of contradictions, less that of agreements, never below 0.
        since, expected: the step at which it left 0 last, and the pose and covariance before that.
        squares: the last d² of sightings with a landmark.
    """

    def __init__(self, landmarks: LandmarkMap, sensor: SensorModel, pose: Array, covariance: Array) -> None:
        self.squares: deque[float] = deque(maxlen=WINDOW)
        self._sensor = sensor
        self._ids = np.array(list(landmarks))
        places, covariances = landmarks.arrays(landmarks)
        self._places, self._covariances = places[:, :2], covariances[:, :2, :2]
        self._number = {j: k for k, j in enumerate(self._ids.tolist())}
        self._area = area_of(self._places)
        self.place(pose, covariance)
        self._newest = int(self._ids.max())
        self._unknown: list[_Unknown] = []
        #: the farthest range and the widest bearing at which something was seen
        self._reach = self._wide = 0.0

    def place(self, pose: Array, covariance: Array, log_odds: float | None = None) -> None:
        """Put the robot somewhere; the odds are those of a pose in the map that is chosen blindly, unless they are given."""
        self.pose, self.covariance = pose, covariance
        self.log_odds = _bounded(float(volume(covariance, self._area)) if log_odds is None else log_odds)
        self.doubt, self.since, self.expected = 0, 0, (pose, covariance)

    def move(self, motion: Array, noise: Array) -> None:
        """A motion (3,) with its covariance, in the axes of the pose."""
        from scipy.special import expit, logit

        self.pose, self.covariance = moved(self.pose, self.covariance, motion, noise)
        elsewhere = float(expit(-self.log_odds))
        self.log_odds = float(-logit(elsewhere + (1 - elsewhere) * LIFTED))
        if noise[0, 0] + noise[1, 1] > NOTHING:
            self.log_odds = min(self.log_odds, 0.0)

    def see(
        self, step: int, rows: np.ndarray, ids: np.ndarray, sightings: Array, back: tuple[Array, Array] | None = None
    ) -> Seen:
        """Sightings (n, 2 or 3) of one moment, of which those that agree correct the pose.

        Args:
            step: the moment.
            rows: (n,) numbers, by which `Seen.earlier` names them later.
            ids: (n,) `UNIDENTIFIED` where they have none.
            back: of sightings from an earlier pose, this pose (3,) in the axes of the present one, with its covariance.
        """
        count, before = len(ids), (self.pose, self.covariance)
        places, covariances = self._sensor.places(sightings, None if back is None else np.tile(back[0], (count, 1)))
        q, C = places[:, :2], covariances[:, :2, :2]
        if back is not None:
            before = moved(*before, *back)
            J = lever_matrix(perpendicular(q - back[0][:2]))[:, :2]
            C = C + J @ back[1] @ np.swapaxes(J, 1, 2)
        seen = Seen(np.array(ids), np.zeros(count, dtype=bool), np.zeros(count, dtype=bool), {})
        gain = 0.0
        for n in np.flatnonzero(seen.landmarks != UNIDENTIFIED).tolist():
            if (k := self._number.get(int(ids[n]))) is not None:
                gain += self._correct(n, k, q[n], C[n], seen)
        if len(unnamed := np.flatnonzero(seen.landmarks == UNIDENTIFIED)):
            pairs, gains = self._assign(unnamed, q, C, seen)
            gain += gains
            for n, k in pairs:
                seen.landmarks[n] = self._ids[k]
                self._correct(n, k, q[n], C[n], seen)
            self._look_for_new(rows, q, C, seen)
        self.log_odds = _bounded(self.log_odds + gain)
        if self.doubt == 0 and seen.contradict.any():
            self.since, self.expected = step, before
        self.doubt = max(0, self.doubt + int(seen.contradict.sum()) - int(seen.agree.sum()))
        return replace(seen, gain=gain)

    def forget(self, rows: np.ndarray) -> None:
        """Leave out new landmarks that were seen first in one of these rows."""
        self._unknown = [each for each in self._unknown if each.rows[0] not in rows]

    def _place(self, q: Array, C: Array) -> tuple[Array, Array, Array]:
        """The place (2,) in the map of a sighting at q in the robot's axes, its covariance, and the Jacobian by the pose."""
        turn = rotation(self.pose[2])
        way = turn @ q
        J = np.array([[1, 0, -way[1]], [0, 1, way[0]]])
        return self.pose[:2] + way, J @ self.covariance @ J.T + turn @ C @ turn.T, J

    def _correct(self, n: int, k: int, q: Array, C: Array, seen: Seen) -> float:
        """Correct the pose by sighting n of landmark k where they agree; what it adds to the log odds."""
        y, V, J = self._place(q, C)
        V, e = V + self._covariances[k], y - self._places[k]
        inverse = np.linalg.inv(V)
        square = float(e @ inverse @ e)
        self.squares.append(square)
        seen.contradict[n], seen.agree[n] = square > AGREES, square <= AGREES
        if seen.agree[n]:
            K = self.covariance @ J.T @ inverse
            self.pose, P = self.pose - K @ e, self.covariance - K @ J @ self.covariance
            self.pose[2], self.covariance = wrap(self.pose[2]), (P + P.T) / 2
        density = np.exp(-square / 2) / (2 * np.pi * np.sqrt(np.linalg.det(V)))
        return float(np.log(RIGHT * self._area * density + 1 - RIGHT))

    def _assign(self, rows: np.ndarray, q: Array, C: Array, seen: Seen) -> tuple[list[tuple[int, int]], float]:
        """Sightings without ids with the numbers of landmarks that are clear, and what they add to the log odds."""
        squares, gain = np.empty((len(rows), len(self._ids))), 0.0
        for m, n in enumerate(rows.tolist()):
            y, V, _ = self._place(q[n], C[n])
            e, V = y - self._places, V + self._covariances
            squares[m] = np.einsum("ki,kij,kj->k", e, np.linalg.inv(V), e)
            near = np.sum(np.exp(-squares[m] / 2) / (2 * np.pi * np.sqrt(np.linalg.det(V))))
            gain += float(np.log(RIGHT * near * self._area / len(self._ids) + 1 - RIGHT))
        seen.contradict[rows] = squares.min(axis=1) > AGREES
        chosen: list[tuple[int, int]] = []
        ms, ks = np.nonzero(squares < AGREES)
        for i in np.argsort(squares[ms, ks]).tolist():
            if all(ms[i] != m and ks[i] != k for m, k in chosen):
                chosen.append((int(ms[i]), int(ks[i])))
        second = np.partition(squares, 1, axis=1)[:, 1] if len(self._ids) > 1 else np.full(len(rows), np.inf)
        return [(int(rows[m]), k) for m, k in chosen if second[m] > squares[m, k] + UNCLEAR], gain

    def _look_for_new(self, rows: np.ndarray, q: Array, C: Array, seen: Seen) -> None:
        """Sightings of no landmark of the map: those of one place get a new id together."""
        self._reach = max(self._reach, float(np.hypot(*q.T).max()))
        self._wide = max(self._wide, float(np.abs(np.arctan2(q[:, 1], q[:, 0])).max()))
        turn = rotation(self.pose[2])
        for each in self._unknown:
            ahead, left = (each.place - self.pose[:2]) @ turn
            inside = np.hypot(ahead, left) < INSIDE * self._reach and abs(np.arctan2(left, ahead)) < INSIDE * self._wide
            each.views += int(inside)
        left_over = list(self._unknown)
        for n in np.flatnonzero(seen.contradict & (seen.landmarks == UNIDENTIFIED)).tolist():
            y, V, _ = self._place(q[n], C[n])
            squares = [(y - each.place) @ np.linalg.solve(V + each.covariance, y - each.place) for each in left_over]
            if not squares or min(squares) > AGREES:
                self._unknown.append(_Unknown(y, V, [int(rows[n])], 1))
                continue
            # one is seen once in a moment
            it = left_over.pop(int(np.argmin(squares)))
            K = it.covariance @ np.linalg.inv(it.covariance + V)
            it.place, it.covariance = it.place + K @ (y - it.place), it.covariance - K @ it.covariance
            it.rows.append(int(rows[n]))
            if it.id == UNIDENTIFIED and len(it.rows) >= max(CONFIRMED, SHARE * it.views):
                self._newest += 1
                it.id = self._newest
                seen.earlier.update(dict.fromkeys(it.rows[:-1], it.id))
            seen.landmarks[n] = it.id
        # what is hardly ever seen again is none
        self._unknown = [
            each for each in self._unknown
            if each.id != UNIDENTIFIED or each.views < 3 * CONFIRMED or len(each.rows) > SHARE / 2 * each.views
        ]  # fmt: skip


def area_of(places: Array) -> float:
    """The area [m²] of a map with landmarks at these places (L, 2)."""
    return float(np.prod(np.ptp(places, axis=0) + MARGIN))


def _bounded(log_odds: float) -> float:
    """Log odds that a few sightings can still turn."""
    most = float(-np.log(LIFTED))
    return float(np.clip(log_odds, -most, most))
