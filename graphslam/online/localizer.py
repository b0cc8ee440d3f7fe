"""`Localizer`: a solver for a robot that drives in a map without knowing where it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import copy
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from ..edges import ANCHOR_INFORMATION, freest_turn
from ..errors import GraphError, SlamError
from ..graph.trilateration import MORE
from ..linear.precision import inverses
from ..log import UNIDENTIFIED
from ..maps.landmark_map import CORRELATIONS_LOST, LandmarkMap
from ..maps.localization import SURE, Fix
from ..maps.registration import evenly
from ..maps.stretch import Stretch, backwards, drifted
from ..maps.tracker import LARGE, Tracker, inflation
from ..maps.tracking import DOUBT, elsewhere, sure_fix
from ..models import SensorModel
from ..se2 import Array, between, rotation
from ..solvers.contradictions import MEDIANS, MOST_MOVED, TAKEN_FOR_RIGHT
from ..solvers.map_errors import (
    FEWEST,
    MOST,
    likeliest_deviation,
    of_log,
    said_of_moved,
    said_of_wider,
    scores_in_map,
)
from .backend import FREE_START, Backend, Relation

#: how much more must have been seen until another fix is tried, or a map checked again that was just widened
GROWTH = 1.5
#: the number of sightings at which the map is checked first, and how many times more at the next check if nothing changed
FIRST_CHECK, UNCHANGED = 20, 2
#: the median of the length of two standard normal numbers
MEDIAN_LENGTH = 1.1774
#: the logarithm of a change of the errors of the map that counts, and the most sightings that are gone through again for them
CHANGED, MOST_AGAIN = 0.25, 3000
#: a landmark has moved whose squared shift is so many times the median of chi-square, and of the others. In right maps none
#: was found on 260 drives, among them ones with 10 % wrong sightings or ids, biases, slips, or up to three times the noise
#: of the models. The batch solver, which has all sightings, waits for more
MOVED = 20.0
#: shifts are looked for where so many sightings of a landmark in a row contradict
IN_A_ROW = 2
#: the information of a drive on a shift is a difference, of which less than this part of the map's is rounding
ROUNDING = 1e-12


class Localizer:
    """A backend in a map: global localisation, association of sightings without ids, and detection of a lifted robot.

    Until the robot has been found, the backend has no map, and its first pose is the origin. Then, when the robot was lifted,
    and when landmarks have moved, a new backend gets all measurements again, from the new place or in the map without them.

    Attributes:
        tracker: None as long as the robot has not been found.
        columns: the number of values of the first sighting that are used, 2 or 3; None before it.
        fixes: {pose: fix} of the first pose, and of those at which the robot was put down.
    """

    def __init__(
        self, make: Callable[..., Backend], landmarks: LandmarkMap, sensor: SensorModel, start: Array | None,
        start_covariance: Array, robust: bool,
    ) -> None:  # fmt: skip
        self._make, self._landmarks, self._sensor = make, landmarks, sensor
        #: the map as it was given, without landmarks that have moved, the deviation of errors beside those that it declares,
        #: and when these are checked next
        self._declared, self._deviation, self._check = landmarks, 0.0, FIRST_CHECK
        self._contradicted = 0.0
        #: the map with all landmarks, those that have moved with their shifts [m], and whether these are looked for, because
        #: without a kernel they pull others along
        self._given, self._moved, self._robust = landmarks, dict[int, float](), robust
        #: at how many contradictions in a row each landmark was tested for this last
        self._tested: dict[int, int] = {}
        self._start = start, start_covariance
        self.fixes: dict[int, Fix] = {}
        self._calls: list[Callable[[], None]] = []
        self._begin()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "_backend":
            raise AttributeError(name)
        return getattr(self._backend, name)

    def relate(self, *relations: Relation) -> None:
        """Add relations between two poses each; that of a new pose to the one before is a motion."""
        before, new, last = self._backend.num_poses - 1, self._backend.num_poses, self._backend.pose
        leading = next((k for k, relation in enumerate(relations) if max(relation[:2]) == new), None)
        fix = None if leading is None else self.fixes.get(new)
        passed = list(relations)
        if fix is not None and leading is not None:
            # the robot was lifted: what was measured of this motion does not count
            passed[leading] = (before, new, between(last, fix.pose), np.diag(1 / np.array(FREE_START)))
        self._backend.relate(*passed)
        self._calls.append(partial(self.relate, *relations))
        if leading is not None:
            self._motions.append(between(last, self._backend.pose))
            self._noise.append(relation_covariance(relations[leading], new))
            if self.tracker is not None:
                self.tracker.move(self._motions[-1], self._noise[-1])
                if fix is not None:
                    self.tracker.place(fix.pose, fix.covariance)

    def observe(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        """Add sightings, without ids where these are `UNIDENTIFIED`, and look for the robot where that is due."""
        self._see(pose, ids, sightings)
        try:
            if (found := self._found()) is not None:
                # what seemed to have moved may have been the place where it was put down; in a long drive it stays out,
                # because it could not be left out again
                out = {j: size for j, size in self._moved.items() if j not in self._declared}
                kept = out if len(self._rows) > MOST_AGAIN else {}
                self._again(fixes=self.fixes | dict([found]), **self._without(kept))
                return
        except BaseException:
            self._calls.pop()
            self._again()
            raise
        # where there are no covariances, the map stays as it was
        with suppress(SlamError, np.linalg.LinAlgError):
            self._leave_out_moved()
        tracker = self.tracker
        if tracker is None or len(self._rows) < self._check:
            return
        # a robot that was lifted contradicts the map, too, until it is found
        if tracker.doubt < DOUBT or pose > 2 * tracker.since:
            before = vars(self).copy()
            try:
                self._check_map(tracker)
            except Exception:
                # the map stays as it was, where a measurement has no place in a wider one
                vars(self).update(before)
            changed = self._backend is not before["_backend"]
            self._check = int(np.ceil((GROWTH if changed else UNCHANGED) * len(self._rows)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the map lacks, and what the drive says against it."""
        lost = (CORRELATIONS_LOST,) * self._given.correlated
        if not self._given.oriented and any(len(z) == 3 for *_, z in self._rows[:1]):
            lost += ("psi is not used, because not all landmarks of the map have a heading there",)
        for left_out in (True, False):
            if moved := {j: size for j, size in self._moved.items() if (j not in self._declared) == left_out}:
                lost += (said_of_moved(moved, max(moved.values()), left_out=left_out),)
        for pose in sorted(set(self.fixes) - {0}):
            lost += (
                f"the robot was lifted before pose {pose}, and poses from there on are where the map has its sightings",
            )
        if self.tracker is None and len(self._rows) >= FIRST_CHECK:
            known = sum(j in self._landmarks for _, j, _ in self._rows)
            lost += (
                f"the robot has not been found in the map: of {len(self._rows)} sightings, {known} have ids of the map. "
                "Poses are those from where it began. first_fix(log, map) names the likely cause, such as too few landmarks, "
                "other ids, another place or unit, or a mirrored map",
            )
        if not self._contradicted:
            return lost
        counted = said_of_wider(self._deviation) if self._deviation else TAKEN_FOR_RIGHT.replace("covariances", "risks")
        return (
            *lost,
            f"the drive contradicts the map: its landmarks seem to be off by {self._contradicted:.1f} times what its "
            f"covariances and the noise models allow, in the median. {counted}; check its unit and its source, whether ids "
            "are misread, and whether the robot has biases or more noise than its models",
        )

    def _again(self, **changed: Any) -> None:
        """Give all measurements to a new backend, with other attributes; where it refuses one, all stays as it was."""
        before = vars(self).copy()
        vars(self).update(changed, _calls=[])
        try:
            self._begin()
            for call in before["_calls"]:
                call()
        except BaseException:
            vars(self).update(before)
            raise

    def _leave_out_moved(self) -> None:
        """Where sightings of a landmark contradict in a row, begin anew in the map without those that have surely moved."""
        if self.tracker is None or not self._robust or self.tracker.log_odds < 0:
            # a robot that is elsewhere contradicts the map, too
            return
        before, due = self._tested, dict[int, int]()
        for j, count in self.tracker.against.items():
            tested = before.get(j, 0)
            if count >= IN_A_ROW and j not in self._moved and not tested <= count < MORE * tested:
                due[j] = count
        if not due:
            return
        self._tested = before | due
        while moved := self._surely_moved():
            self._moved = self._moved | moved
            if len(self._rows) > MOST_AGAIN:
                return
            self._again(**self._without(self._moved))

    def _without(self, moved: dict[int, float]) -> dict[str, Any]:
        """The attributes that leave landmarks out of the map."""
        declared = self._given.among(set(self._given) - set(moved)) if moved else self._given
        wider = declared.widened(self._deviation) if self._deviation else declared
        return {"_moved": moved, "_declared": declared, "_landmarks": wider}

    def _surely_moved(self) -> dict[int, float]:
        """The landmark that contradicts the map most, where it has surely moved, with its shift [m]."""
        latest = dict.fromkeys(j for _, j, _ in reversed(self._rows) if j in self._landmarks)
        known = self._landmarks.among(list(latest)[:MOST]).widened(0.0)
        found, ids, d = self._backend.landmarks, list(known), self._backend.columns or 2
        pivot = None if known.joint is None else freest_turn(known.arrays(ids)[0], known.information(ids, d))
        places = np.array([found[j][:d] for j in ids])
        score, S, L, _ = scores_in_map(known, ids, places, self._backend.covariance([], ids), pivot)
        squares, sizes = dict[int, float](), dict[int, float]()
        for k, j in enumerate(ids):
            rows = slice(k * d, k * d + min(d, len(known[j])))
            if np.linalg.eigvalsh(S[rows, rows])[0] > ROUNDING * np.trace(L[rows, rows]):
                shift = np.linalg.solve(S[rows, rows], score[rows])
                squares[j], sizes[j] = float(shift @ score[rows]) / MEDIANS[len(shift)], float(np.hypot(*shift[:2]))
        if len(squares) < FEWEST or (1 + len(self._moved)) > MOST_MOVED * (len(self._moved) + len(squares)):
            # where they are many, it is the map that is wrong
            return {}
        most = max(squares, key=lambda j: squares[j])
        sure = squares[most] > MOVED * max(1.0, float(np.median(list(squares.values()))))
        return {most: sizes[most]} if sure else {}

    def _check_map(self, tracker: Tracker) -> None:
        """Where most landmarks contradict the map, begin anew with the errors that they show; see `solvers.map_errors`."""
        before, many = vars(self).copy(), len(self._rows) > MOST_AGAIN
        if not self._deviation:
            ratio, size = tracker.misfit()
            found = ratio if ratio**2 > LARGE else 0.0
            if many or not found:
                self._contradicted = found
                return
            self._widen(size / MEDIAN_LENGTH, ratio)
        elif many:
            return
        deviation, gain = self._shown()
        if gain > np.log(SURE):
            if abs(np.log(deviation / self._deviation)) > CHANGED:
                self._widen(deviation, self._contradicted)
        elif before["_deviation"]:
            self._widen(0.0, 0.0)
        else:
            vars(self).update(before)

    def _shown(self) -> tuple[float, float]:
        """The deviation [m] of errors of the map that the drive shows, in a wider map, and the gain with it."""
        assert self.tracker is not None
        ids = [j for j in self.tracker.seen_of_map if j in self._backend.landmark_ids]
        ids = [ids[k] for k in evenly(len(ids), MOST)]
        places, last = self._backend.landmarks, self._deviation
        off = np.array([places[j][:2] for j in ids]) - self._declared.arrays(ids)[0][:, :2]
        P, d = self._backend.covariance([], ids), self._backend.columns or 2
        rows = np.flatnonzero(np.arange(len(P)) % d < 2)
        of_map = self._declared.joint_covariance(ids)
        S, h = of_log(off.ravel(), P[np.ix_(rows, rows)], of_map, last)
        deviation, gain = likeliest_deviation(S, h, of_map, last)
        if gain > np.log(SURE):
            # what residuals show of larger noise in the right map
            larger = self._residual_inflation(places)
            _, gain = likeliest_deviation(S / larger, h / larger, of_map, last)
        return deviation, gain

    def _residual_inflation(self, places: dict[int, Array]) -> float:
        """By how much the variances of sightings are larger than the noise models say, at least 1; from their median."""
        poses, seen = self._backend.poses, [(step, places[j][:2], z[:2]) for step, j, z in self._rows if j in places]
        if not seen:
            # no sighting has an id of its own
            return 1.0
        steps, marks, z = (np.array(column) for column in zip(*seen))
        q, C = self._sensor.places(z)
        way = np.einsum("kji,kj->ki", rotation(poses[steps, 2]), marks - poses[steps, :2])
        return inflation(np.einsum("ki,ki->k", way - q, np.linalg.solve(C, (way - q)[:, :, None])[:, :, 0]))

    def _widen(self, deviation: float, contradicted: float) -> None:
        """Begin anew in a map with errors of a deviation [m] beside those that it declares."""
        wider = self._declared.widened(deviation) if deviation else self._declared
        self._again(_deviation=deviation, _landmarks=wider, _contradicted=contradicted)

    def locate(self, pose: int, measured: Array, information: Array, lever: Array) -> None:
        """Add a position in the frame of the map, which has no meaning before the robot has been found there."""
        if self.tracker is not None:
            self._backend.locate(pose, measured, information, lever)
        self._calls.append(partial(self.locate, pose, measured, information, lever))

    def _begin(self) -> None:
        """A new backend and tracker."""
        (start, covariance), fix = self._start, self.fixes.get(0)
        if fix is not None:
            start, covariance = fix.pose, np.linalg.inv(ANCHOR_INFORMATION)
        held = {} if start is None else {"map": self._landmarks, "start_covariance": covariance}
        self._backend = self._make(np.zeros(3) if start is None else start, **held)
        #: whether the first pose is anchored at its fix until landmarks of the map hold it: a free start has so little
        #: information that it is lost in rounding errors of precise odometry
        self._anchored = fix is not None
        self.tracker: Tracker | None = None
        if start is not None:
            known = covariance if fix is None else fix.covariance
            # landmarks that have left the map keep their ids
            self.tracker = Tracker(self._landmarks, self._sensor, start, known, max(self._given))
            if fix is None:
                self.tracker.place(start, covariance, np.inf)
        self._motions: list[Array] = []
        self._noise: list[Array] = []
        self._rows: list[tuple[int, int, Array]] = []
        self.columns: int | None = None
        #: the numbers of sightings and of doubts from which the next search is due
        self._due, self._tried = 2, DOUBT
        self._tested = {}

    def _see(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        """Pass sightings on, and count them where they were not refused."""
        backend, landmarks, tracker, earlier = self._backend, np.array(ids), copy(self.tracker), dict[int, int]()
        # those with one number have ids, and say too little to find the robot by them
        alone = np.isnan(sightings).any(axis=1)
        whole, of_whole = sightings[~alone], landmarks[~alone]
        # also one that has no place yet is refused if its noise is beyond double precision
        inverses(self._sensor.places(whole)[1], "sighting", "check the noise of the sensor")
        rows = len(self._rows) + np.arange(len(whole))
        new = [(pose, j, z) for j, z in zip(of_whole.tolist(), whole)]
        if tracker is not None:
            tracker.pose = backend.pose
            # none, in most cases
            motions, noise = np.reshape(self._motions[pose:], (-1, 3)), np.reshape(self._noise[pose:], (-1, 3, 3))
            (*_, x), (*_, P) = drifted(np.zeros(3), motions, noise)
            seen = tracker.see(pose, rows, of_whole, whole, backwards(x, P))
            landmarks[~alone], earlier = seen.landmarks, seen.earlier
        if (known := landmarks != UNIDENTIFIED).any():
            observe = partial(backend.observe, pose, landmarks[known].tolist(), self._as_used(sightings[known]))
            # a range or a bearing alone does not hold it
            if self._anchored and any(j in self._landmarks for j in landmarks[known & ~alone].tolist()):
                backend.release(np.zeros(3), observe)
                self._anchored = False
            else:
                observe()
        for row, id in earlier.items():
            step, _, z = self._rows[row]
            if step >= backend.num_final:
                # it was of nothing so far, and stays so where it is refused
                with suppress(GraphError):
                    backend.observe(step, [id], self._as_used(z[None]))
        self.tracker, self.columns = tracker, self.columns or self._as_used(sightings).shape[1]
        self._rows += new
        self._calls.append(partial(self._see, pose, ids, sightings))

    def _as_used(self, sightings: Array) -> Array:
        """Sightings without psi where the map has no headings."""
        return sightings[:, : self._backend.columns or sightings.shape[1]]

    def _found(self) -> tuple[int, Fix] | None:
        """The pose whose place in the map was found, for the first time or anew, and its fix; None for none."""
        tracker = self.tracker
        if tracker is None:
            if len(self._rows) < self._due:
                return None
            self._due = int(np.ceil(GROWTH * len(self._rows)))
            fix = sure_fix(self._stretch(), self._landmarks)
            return None if fix is None else (0, fix)
        if tracker.doubt < self._tried:
            self._tried = self._tried if tracker.doubt else DOUBT
            return None
        self._tried = int(np.ceil(GROWTH * tracker.doubt))
        put_down, _ = elsewhere(self._stretch(), tracker, self._landmarks)
        return None if put_down is None else put_down[:2]

    def _stretch(self) -> Stretch:
        steps, ids, rows = zip(*sorted(self._rows, key=itemgetter(0)))
        # some may have psi, and some not
        sightings = np.array([z[: min(map(len, rows))] for z in rows])
        motions, noise = np.array(self._motions).reshape(-1, 3), np.array(self._noise).reshape(-1, 3, 3)
        return Stretch("the drive", motions, noise, np.array(steps), np.array(ids), sightings, self._sensor)


def relation_covariance(relation: Relation, new: int) -> Array:
    """The covariance (3, 3) of a relation to the pose ``new``, in the axes of the other one; from it, that of the inverse."""
    first, _, z, information = relation
    covariance = np.linalg.inv(information)
    return backwards(z, covariance)[1] if first == new else covariance
