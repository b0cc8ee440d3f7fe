"""A robot in a map from moment to moment: whether it is where it is believed to be, and the probability that it is far off.

An extended Kalman filter predicts the pose, and each sighting of a landmark of the map agrees with it or contradicts it, by
the squared Mahalanobis distance d² of the place that it sees. Those that agree correct the pose. Sightings without ids are
assigned to the landmarks of the map, the smallest squares first; those near none may be of landmarks that the map lacks.

The robot is elsewhere with probability `LIFTED` from each pose on. With the density p = N(e; 0, V) of a sighting where it is
believed to be, and with 1 / A, A the area of the map, where it is anywhere else, each sighting adds to the log odds

    log(RIGHT p A + 1 - RIGHT)

as in `maps.registration`; without ids p is the mean over the landmarks, whose number over A is their density.

Contradictions count 1, agreements -1, and the sum, the doubt, is never below 0.

**Integrity.** The probability that a pose is off by more than a bound is

    risk = 1 - P(there) P(|N(0, s² Sigma)| within the bounds),    s² = max(1, squared residuals over their expectation).

P(there) follows from the odds above; after a drive they are smoothed by the sightings that came later (the forward-backward
recursion of a hidden Markov model with two states). Where the robot is there, its error has the covariance Sigma of the
estimate, made larger where residuals are larger than the noise models say. An error is within the bounds if the position is
within a circle and the heading within an interval.

**The map.** Where it is exact, the innovations e are white, with the covariances V. A landmark with the covariance C in the
map has one error in all its sightings. With V without C, for each landmark

    z = sum w V^-1 e,     I = sum w V^-1,     w = min(1, `AGREES`^(1/2) / d),

and q = z' (I + I C I)^-1 z has the median 2 log 2 over landmarks. Where that is clearly more, most places are off, by I^-1 z.

Sources: Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, sections 7.4 and 7.1; Shiryaev, *On optimum methods in
quickest detection problems*, Theory of Probability and its Applications 1963 (the odds of a change); Page, *Continuous
inspection schemes*, Biometrika 1954 (the doubt); Rabiner, *A tutorial on hidden Markov models*, Proceedings of the IEEE 1989;
for the term integrity, RTCA DO-229, *Minimum operational performance standards for GPS/WAAS airborne equipment*.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import OptionError, quoted
from ..errors.checks import check_real
from ..log import UNIDENTIFIED
from ..models import SensorModel
from ..se2 import Array, lever_matrix, perpendicular, rotation, wrap
from .landmark_map import LandmarkMap
from .registration import RIGHT, volume
from .stretch import Stretch, moved

#: squared Mahalanobis distance up to which a sighting agrees; 0.1 % of the right ones lie beyond it
AGREES = 13.8
#: the fewest sightings of a landmark and the fewest landmarks that say something of the map, and the median of q over
#: 2 log 2 above which it is wrong, as in `solvers.contradictions`
SEEN, FEWEST, LARGE = 3, 4, 6.0
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
        against: {landmark: how many of its sightings in a row contradict, up to the last one}.

    Args:
        newest: no landmark that the map lacks has a larger id.
    """

    def __init__(
        self, landmarks: LandmarkMap, sensor: SensorModel, pose: Array, covariance: Array, newest: int = UNIDENTIFIED
    ) -> None:
        self.squares: deque[float] = deque(maxlen=WINDOW)
        self.against: dict[int, int] = {}
        self._sensor = sensor
        self._ids = np.array(list(landmarks))
        places, covariances = landmarks.arrays(landmarks)
        self._places, self._covariances = places[:, :2], covariances[:, :2, :2]
        self._number = {j: k for k, j in enumerate(self._ids.tolist())}
        #: of each landmark the number of sightings, z and I
        self._scores = np.zeros((len(places), 2)), np.zeros((len(places), 2, 2))
        self._count = np.zeros(len(places), dtype=np.int64)
        self._area = area_of(self._places)
        self.place(pose, covariance)
        #: the largest id so far: new landmarks have larger ones
        self._newest = max(newest, int(self._ids.max()))
        self._unknown: list[_Unknown] = []
        #: the farthest range and the widest bearing at which something was seen
        self._reach = self._wide = 0.0

    def __copy__(self) -> Tracker:
        """An independent tracker in the same map."""
        other = object.__new__(Tracker)
        vars(other).update(vars(self))
        for name in ("squares", "against", "_scores", "_count", "_unknown"):
            setattr(other, name, deepcopy(getattr(self, name)))
        return other

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
        self._newest = max([self._newest, *ids.tolist()])
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

    def misfit(self) -> tuple[float, float]:
        """The root of the median of q over 2 log 2, and the median displacement [m]; zeros where few landmarks were seen."""
        seen = self._count >= SEEN
        if seen.sum() < FEWEST:
            return 0.0, 0.0
        z, information = (each[seen] for each in self._scores)
        off = np.linalg.solve(information, z[:, :, None])[:, :, 0]
        expected = information + information @ self._covariances[seen] @ information
        q = np.einsum("ki,ki->k", z, np.linalg.solve(expected, z[:, :, None])[:, :, 0])
        return middle_misfit(q, np.hypot(*off.T))

    @property
    def seen_of_map(self) -> list[int]:
        """The landmarks of the map that were seen often enough to say something of it."""
        return [int(j) for j in self._ids[self._count >= SEEN]]

    def forget(self, rows: np.ndarray) -> None:
        """Leave out new landmarks that were seen first in one of these rows."""
        self._unknown = [each for each in self._unknown if each.rows[0] not in rows]

    def _place(self, q: Array, C: Array) -> tuple[Array, Array, Array]:
        """The places (..., 2) in the map of sightings at q in the robot's axes, covariances, and Jacobians by the pose."""
        turn = rotation(self.pose[2])
        way = q @ turn.T
        J = lever_matrix(perpendicular(way))[..., :2, :]
        return self.pose[:2] + way, J @ self.covariance @ np.swapaxes(J, -1, -2) + turn @ C @ turn.T, J

    def _correct(self, n: int, k: int, q: Array, C: Array, seen: Seen) -> float:
        """Correct the pose by sighting n of landmark k where they agree; what it adds to the log odds."""
        y, V, J = self._place(q, C)
        without, V, e = np.linalg.inv(V), V + self._covariances[k], y - self._places[k]
        inverse = np.linalg.inv(V)
        square = float(e @ inverse @ e)
        self.squares.append(square)
        # one that is misread says little
        weight = 1.0 if square <= AGREES else float(np.sqrt(AGREES / square))
        self._count[k] += 1
        self._scores[0][k] += weight * without @ e
        self._scores[1][k] += weight * without
        seen.contradict[n], seen.agree[n] = square > AGREES, square <= AGREES
        before = self.against.pop(landmark := int(self._ids[k]), 0)
        if seen.contradict[n]:
            self.against[landmark] = before + 1
        if seen.agree[n]:
            K = self.covariance @ J.T @ inverse
            self.pose, P = self.pose - K @ e, self.covariance - K @ J @ self.covariance
            self.pose[2], self.covariance = wrap(self.pose[2]), (P + P.T) / 2
        density = np.exp(-square / 2) / (2 * np.pi * np.sqrt(np.linalg.det(V)))
        return float(np.log(RIGHT * self._area * density + 1 - RIGHT))

    def _assign(self, rows: np.ndarray, q: Array, C: Array, seen: Seen) -> tuple[list[tuple[int, int]], float]:
        """Sightings without ids with the numbers of landmarks that are clear, and what they add to the log odds."""
        y, V, _ = self._place(q[rows], C[rows])
        e, V = y[:, None] - self._places, V[:, None] + self._covariances
        squares = np.einsum("nki,nkij,nkj->nk", e, np.linalg.inv(V), e)
        near = np.sum(np.exp(-squares / 2) / (2 * np.pi * np.sqrt(np.linalg.det(V))), axis=1)
        gain = float(np.log(RIGHT * near * self._area / len(self._ids) + 1 - RIGHT).sum())
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


def middle_misfit(q: Array, size: Array) -> tuple[float, float]:
    """The root of the median of q over 2 log 2, and that of displacements [m]; of an even number the lower middle one."""
    middle = (len(q) - 1) // 2
    return float(np.sqrt(np.sort(q)[middle] / (2 * np.log(2)))), float(np.sort(size)[middle])


def _bounded(log_odds: float) -> float:
    """Log odds that a few sightings can still turn."""
    most = float(-np.log(LIFTED))
    return float(np.clip(log_odds, -most, most))


#: nodes of the quadrature over heading and position, and how many standard deviations it covers
_HEADING, _POSITION = np.polynomial.legendre.leggauss(24), np.polynomial.legendre.leggauss(24)
COVERED = 6.5
#: how many squares that are as expected count before the first one
PRIOR = 10


def beyond(covariances: Array, metres: float, radians: float = np.inf) -> Array:
    """The probability (...) that errors with covariances (..., 3, 3) are beyond the bounds.

    The heading is integrated by Gauss-Legendre quadrature; given it, the position is Gaussian, whose principal axes make
    the integral over the circle one of differences of error functions.

    Raises:
        OptionError: a bound is not positive, or that of the heading is beyond pi, as one in degrees.
    """
    from scipy.special import ndtr

    check_real(metres=metres, radians=radians)
    for name, bound in (("metres", metres), ("radians", radians)):
        if not bound > 0:
            raise OptionError(f"{name} must be a bound above 0, not {quoted(bound)}")
    if np.pi < radians < np.inf:
        message = f"radians is {radians:g}, beyond pi, which bounds no heading: is it in degrees?"
        raise OptionError(f"{message} Give np.deg2rad(...), or leave it out")
    P = np.asarray(covariances, dtype=float)
    variance = np.maximum(P[..., 2, 2], 1e-18)
    slope = P[..., :2, 2] / variance[..., None]
    by_heading = slope[..., :, None] * slope[..., None, :] * variance[..., None, None]
    values, axes = np.linalg.eigh(P[..., :2, :2] - by_heading)
    small, large = np.moveaxis(np.sqrt(np.maximum(values, 1e-18)), -1, 0)
    slope = (np.swapaxes(axes, -1, -2) @ slope[..., None])[..., 0]
    std = np.sqrt(variance)
    half = np.minimum(radians, COVERED * std)
    theta = half[..., None] * _HEADING[0]
    weight = half[..., None] * _HEADING[1] * np.exp(-((theta / std[..., None]) ** 2) / 2) / np.sqrt(2 * np.pi)
    weight = weight / std[..., None]
    across, along = (slope[..., n, None, None] * theta[..., None] for n in (0, 1))
    small, large = small[..., None, None], large[..., None, None]
    low, high = np.maximum(-metres, along - COVERED * large), np.minimum(metres, along + COVERED * large)
    half = np.maximum(high - low, 0) / 2
    u = (low + high) / 2 + half * _POSITION[0]
    w = np.sqrt(np.maximum(metres**2 - u**2, 0)) if np.isfinite(metres) else np.inf
    inner = ndtr((w - across) / small) - ndtr((-w - across) / small)
    density = np.exp(-(((u - along) / large) ** 2) / 2) / (np.sqrt(2 * np.pi) * large)
    inside = (weight * (density * inner * half * _POSITION[1]).sum(axis=-1)).sum(axis=-1)
    return np.asarray(np.clip(1 - inside, 0.0, 1.0))


def inflation(squares: Sequence[float] | Array, rows: int = 2) -> float:
    """s² from the squared Mahalanobis distances of sightings with so many numbers each; their median, as some are wrong."""
    count = len(squares)
    if not count:
        return 1.0
    from scipy.special import chdtri

    return max(1.0, (PRIOR + count * float(np.median(squares)) / float(chdtri(rows, 0.5))) / (PRIOR + count))


def unlocated(landmarks: LandmarkMap, sensor: SensorModel, pose: Array) -> Tracker:
    """A tracker of a robot that may be anywhere in the map, linearised at a pose."""
    area = area_of(np.array([place[:2] for place in landmarks.values()]))
    return Tracker(landmarks, sensor, pose, np.diag([area, area, np.pi**2 / 3]))


def presence(drive: Stretch, poses: Array, landmarks: LandmarkMap) -> Array:
    """The probability (T+1,) that a robot was where its poses (T+1, 3) are, from all sightings of a drive.

    Where it was lifted, the motion says nothing. That may have been at any moment since the last sighting before.
    """
    from scipy.special import expit

    tracker, rows_at = unlocated(landmarks, drive.sensor, poses[0]), drive.rows_at
    before, gains, still, last = np.zeros(len(poses)), np.zeros(len(poses)), np.ones(len(poses)), 0
    for step, pose in enumerate(poses):
        if step:
            noise = drive.noise[step - 1]
            tracker.move(drive.motions[step - 1], noise)
            if noise[0, 0] + noise[1, 1] > NOTHING:
                still[last + 1 : step] = np.arange(step - last - 1, 0, -1) / (step - last)
        tracker.pose, rows = np.array(pose), rows_at[step]
        before[step] = tracker.log_odds
        if len(rows):
            gains[step], last = tracker.see(step, rows, drive.landmarks[rows], drive.sightings[rows]).gain, step
    after = np.zeros(len(poses))
    for step in range(len(poses) - 1, 0, -1):
        later = after[step] + gains[step]
        stay, change = np.log1p(-LIFTED), np.log(LIFTED)
        after[step - 1] = np.logaddexp(stay + later, change) - np.logaddexp(change + later, stay)
    return np.asarray(still * expit(before + gains + after))
