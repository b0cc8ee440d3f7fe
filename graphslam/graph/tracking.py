"""A log followed through a map: what its sightings are of where it has no ids, and where the robot was lifted.

From the first fix on, an extended Kalman filter predicts the pose, and each sighting of a landmark of the map agrees with
it or contradicts it, by the squared Mahalanobis distance of the place that it sees. Those that agree correct the pose.
Without ids, the sightings of a moment are assigned to the landmarks of the map, the smallest squares first.

Contradictions count 1, agreements -1, and the sum is never below 0. Where it reaches `DOUBT`, the sightings since it left 0
are given a fix of their own. If that is a sure one, at another place, the robot was lifted and put down there (*kidnapped*):
the control before says nothing about this, and what follows begins at the new fix.

Sources: Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, sections 7.4 (the filter) and 7.1 (kidnapping); Page,
*Continuous inspection schemes*, Biometrika 1954 (the sum).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GraphError
from ..errors.checks import listed
from ..log import UNIDENTIFIED, Log
from ..models import ANYWHERE, MotionModel, SensorModel, additional_variances
from ..se2 import Array, between, compose, rotation, wrap
from .landmark_map import LandmarkMap
from .localization import SURE, Fix, first_fix

#: squared Mahalanobis distance up to which a sighting agrees; 0.1 % of the right ones lie beyond it
AGREES = 13.8
#: without ids a second landmark whose square is less than this larger leaves open which one it is
UNCLEAR = 6.0
#: the sum of contradictions at which another place is looked for
DOUBT = 4
#: squared Mahalanobis distance [3 degrees of freedom] beyond which a fix is another place
ELSEWHERE = 30.0
#: a motion with a larger variance [m²] says nothing
NOTHING = 1e5


@dataclass(frozen=True, eq=False)
class Followed:
    """A log along a map.

    Attributes:
        landmarks: (M,) the landmark of each sighting, `UNIDENTIFIED` where that is not clear.
        fixes: {step: fix} where the log begins, and where the robot was put down.
        lifted: {step: (last step that agreed before, distance [m] to where it was expected)} of the latter.
        agree: (M,) whether the sighting agrees with a landmark of the map.
    """

    landmarks: np.ndarray
    fixes: dict[int, Fix]
    lifted: dict[int, tuple[int, float]]
    agree: np.ndarray


def in_frame_of(
    log: Log, landmarks: LandmarkMap, *, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> tuple[Log, tuple[str, ...]]:
    """The log with its initial poses in the frame of a map, and notes, one sentence each; see `first_fix` and the module.

    Sightings without ids get those of the map; the others of such a log are left out. Where the robot was lifted, the
    control says nothing. The log has no psi where a landmark that is seen and exact in the map has no heading there.
    """
    notes = []
    found = follow(log, landmarks, motion=motion, sensor=sensor)
    fix = found.fixes[0]
    placed = _placed(log.initial_poses, fix.pose)
    notes.append(f"the first pose was found in the map: {fix.sentence}")
    for step, (before, way) in found.lifted.items():
        placed[step:] = _placed(placed[step:], found.fixes[step].pose)
        notes.append(
            f"the robot was lifted between steps {before} and {step}, and put down {way:.2f} m from where it was expected: "
            f"{found.fixes[step].sentence}"
        )
    log = log.replace(initial_poses=placed, **_freed(log, found.lifted))
    if not log.identified:
        known = found.landmarks != UNIDENTIFIED
        notes.append(
            f"the map gives {known.sum()} of {len(known)} sightings without ids their landmark; the others are left out"
        )
        log = log.with_sightings(known, landmarks=found.landmarks[known])
    seen = [j for j in log.landmark_ids.tolist() if j in landmarks]
    if log.has_orientation and (bare := [j for j in seen if j not in landmarks.covariances and len(landmarks[j]) == 2]):
        notes.append(f"psi is not used, because the map has no heading of {listed('landmark', bare)}, exact in it")
        log = log.without_orientation()
    return log, tuple(notes)


def follow(
    log: Log, landmarks: LandmarkMap, *, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> Followed:
    """A log along a map, from its first fix to its end.

    Raises:
        GraphError: as `first_fix`.
    """
    models: dict[str, Any] = {"motion": motion, "sensor": sensor}
    fix = first_fix(log, landmarks, **models)
    result = Followed(
        np.where(log.identified, log.landmarks, UNIDENTIFIED), {0: fix}, {}, np.zeros(len(log.steps), dtype=bool)
    )
    if log.controls is None:
        if not log.identified:
            raise GraphError(f"{log.name} has no controls, and sightings without ids need them in a map")
        return result
    places = _Places(log, landmarks, sensor or log.sensor or SensorModel())
    motions, noise = log.motions(motion)
    rows_of = np.split(np.argsort(log.steps, kind="stable"), np.cumsum(np.bincount(log.steps, minlength=log.num_poses)))
    x, P, step = fix.pose, fix.covariance, 0
    doubt, since, last, tried = 0, 0, 0, 0
    expected = x, P
    while True:
        rows = rows_of[step]
        if len(rows):
            x, P, agree, contradict = places.corrected(x, P, rows, result.landmarks)
            result.agree[rows] = False
            result.agree[agree] = True
            if doubt == 0 and contradict:
                since, tried, expected = step, DOUBT, (x, P)
            doubt = max(0, doubt + contradict - len(agree))
            last = step if len(agree) and doubt == 0 else last
            if doubt >= tried > 0 and since > 0:
                tried = 2 * doubt
                elsewhere = _elsewhere(log, landmarks, since, expected, models)
                if elsewhere is not None:
                    result.fixes[since] = elsewhere
                    way = float(np.hypot(*(elsewhere.pose - expected[0])[:2]))
                    result.lifted[since] = min(last, since - 1), way
                    x, P, step, doubt, last = elsewhere.pose, elsewhere.covariance, since, 0, since
                    # sightings from here on are judged again
                    tried = 0
                    if not places.identified:
                        result.landmarks[log.steps >= since] = UNIDENTIFIED
                    continue
        if step == log.num_poses - 1:
            return result
        if noise[step][0, 0] + noise[step][1, 1] > NOTHING:
            again = _fix_from(log, landmarks, step + 1, models)
            if again is None:
                return result
            x, P, doubt, last = again.pose, again.covariance, 0, step + 1
        else:
            x, P = _moved(x, P, motions[step], noise[step])
        step += 1


class _Places:
    """The landmarks of a map for the sightings of a log."""

    def __init__(self, log: Log, landmarks: LandmarkMap, sensor: SensorModel) -> None:
        self.log, self.sensor, self.identified = log, sensor, log.identified
        self.ids = np.array(list(landmarks))
        self.places = np.array([place[:2] for place in landmarks.values()])
        none = np.zeros((2, 2))
        self.covariances = np.array([landmarks.covariances.get(j, none)[:2, :2] for j in landmarks])
        self.number = {j: k for k, j in enumerate(self.ids.tolist())}

    def corrected(
        self, x: Array, P: Array, rows: np.ndarray, named: np.ndarray
    ) -> tuple[Array, Array, np.ndarray, int]:
        """The pose (3,) and its covariance after sightings of one step, those that agree, and how many contradict.

        ``named`` (M,) gets the ids of sightings that have none.
        """
        if self.identified:
            pairs = [(r, self.number[j]) for r in rows.tolist() if (j := int(self.log.landmarks[r])) in self.number]
            contradict = 0
        else:
            pairs, contradict = self._assigned(x, P, rows)
        agree = []
        for row, k in pairs:
            e, V, J = self._residual(x, P, row, np.array([k]))
            if float(e[0] @ np.linalg.solve(V[0], e[0])) > AGREES:
                contradict += 1
                continue
            K = P @ J.T @ np.linalg.inv(V[0])
            x, P = x - K @ e[0], P - K @ J @ P
            x[2], P = wrap(x[2]), (P + P.T) / 2
            agree.append(row)
            if not self.identified:
                named[row] = self.ids[k]
        return x, P, np.array(agree, dtype=int), contradict

    def _residual(self, x: Array, P: Array, row: int, ks: np.ndarray) -> tuple[Array, Array, Array]:
        """Residuals (n, 2) of a sighting from landmarks, their covariances (n, 2, 2), and the Jacobian (2, 3) by the pose."""
        (y,), (C,) = self.sensor.places(self.log.sightings[row : row + 1], x[None])
        J = np.array([[1, 0, x[1] - y[1]], [0, 1, y[0] - x[0]]])
        return y[:2] - self.places[ks], J @ P @ J.T + C[:2, :2] + self.covariances[ks], J

    def _assigned(self, x: Array, P: Array, rows: np.ndarray) -> tuple[list[tuple[int, int]], int]:
        """The sightings of a step with the numbers of their landmarks, and how many have none nearby."""
        squares = np.empty((len(rows), len(self.ids)))
        every = np.arange(len(self.ids))
        for n, row in enumerate(rows.tolist()):
            e, V, _ = self._residual(x, P, row, every)
            squares[n] = np.einsum("ki,kij,kj->k", e, np.linalg.inv(V), e)
        chosen: list[tuple[int, int]] = []
        ns, ks = np.nonzero(squares < AGREES)
        for m in np.argsort(squares[ns, ks]).tolist():
            if all(ns[m] != n and ks[m] != k for n, k in chosen):
                chosen.append((int(ns[m]), int(ks[m])))
        others = np.partition(squares, 1, axis=1)[:, 1] if len(every) > 1 else np.full(len(rows), np.inf)
        clear = [(int(rows[n]), int(k)) for n, k in chosen if others[n] > squares[n, k] + UNCLEAR]
        return clear, int(np.sum(squares.min(axis=1) > AGREES))


def _elsewhere(
    log: Log, landmarks: LandmarkMap, step: int, expected: tuple[Array, Array], models: Mapping[str, Any]
) -> Fix | None:
    """A sure fix of the log from a step on, at another place than where the robot was expected; None where there is none."""
    fix = _fix_from(log, landmarks, step, models)
    if fix is None:
        return None
    way = fix.pose - expected[0]
    way[2] = wrap(way[2])
    return fix if float(way @ np.linalg.solve(fix.covariance + expected[1], way)) > ELSEWHERE else None


def _fix_from(log: Log, landmarks: LandmarkMap, step: int, models: Mapping[str, Any]) -> Fix | None:
    """A sure fix of the log from a step on; None where there is none."""
    try:
        fix = first_fix(log.at_steps(np.arange(step, log.num_poses)), landmarks, **models)
    except GraphError:
        return None
    return fix if fix.odds > SURE and len(fix.agree) >= DOUBT else None


def _moved(x: Array, P: Array, motion: Array, noise: Array) -> tuple[Array, Array]:
    """The pose after a motion, and its covariance; see `localization.drifted`."""
    after = compose(x, motion)
    F = np.array([[1, 0, x[1] - after[1]], [0, 1, after[0] - x[0]], [0, 0, 1]])
    J = np.eye(3)
    J[:2, :2] = rotation(x[2])
    return after, F @ P @ F.T + J @ noise @ J.T


def _placed(poses: Array, first: Array) -> Array:
    """Poses moved as a whole so that the first one is ``first``; headings keep their full turns."""
    placed = compose(first, between(poses[0], poses))
    placed[:, 2] = first[2] + poses[:, 2] - poses[0, 2]
    return placed


def _freed(log: Log, lifted: dict[int, tuple[int, float]]) -> dict[str, Array]:
    """The variances of the controls, with those that say nothing before the steps at which the robot was put down."""
    if not lifted:
        return {}
    assert log.controls is not None and log.dt is not None
    variances = additional_variances(log.control_variances, len(log.controls))
    for step in lifted:
        pieces = np.arange(log.control_starts[step - 1], log.control_starts[step])
        longest = pieces[np.argmax(log.dt[pieces])]
        variances[longest] = np.array(ANYWHERE) / max(float(log.dt[longest]), 1e-6) ** 2
    return {"control_variances": variances}
