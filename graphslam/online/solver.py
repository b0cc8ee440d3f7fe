"""`OnlineSolver`: graph SLAM while the robot drives, with an estimate of the whole graph after every step."""

from __future__ import annotations

import inspect
import sys
from copy import deepcopy
from functools import partial
from numbers import Real
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..edges import ANCHOR_INFORMATION
from ..edges.robust import Kernel, kernel_of
from ..errors import GraphError, OptionError, quoted
from ..errors.checks import (
    array_or_none,
    check_choice,
    check_count,
    check_heading,
    check_known,
    check_move,
    check_positive,
    check_turn_rate,
    checked_pose,
    finite_numbers,
    singular,
)
from ..linear.precision import inverses, model_of
from ..log.measurements import checked_sightings
from ..log.rows import NO_ID, UNIDENTIFIED
from ..maps.landmark_map import as_map
from ..maps.tracker import beyond, inflation
from ..models import MotionModel, SensorModel
from ..se2 import Array, transform, wrap
from ..solvers.uncertainty import ids_of, split
from .backend import Backend, information_of
from .localizer import Localizer
from .own import OwnBackend

#: the backends
BACKENDS = ("own", "isam2")


class OnlineSolver:
    """Poses, landmarks and edges in the order in which a robot measures them; each call updates the estimate.

    A step of the robot is `move`, then `observe` what the sensor measures there; `relate` adds loop closures, and `locate`
    absolute positions. The particle filters of `fastslam` have `move`, `observe` and `locate`, too, for the newest pose
    only. Landmarks are nodes with the Cartesian residual, as in `Graph.from_log` with ``edges="landmark+motion"``, and the
    first pose is anchored.

    A call is refused as a whole, and the solver then is as it was before. Only an update that fails inside of ISAM2 cannot
    be taken back. A solver is for one thread at a time; threads that share one need a lock around each call.

    In a map (``map``) the robot need not know where it is: without ``start`` its poses are those from the origin, until its
    sightings say surely where in the map it began (`located`), and are in the map then. Sightings may have no ids there. A
    robot that is lifted is found again. `integrity_risk` is the probability that the pose is off by more than a bound. With a
    kernel, landmarks that have surely moved leave the map. Where most landmarks contradict the map, it counts as off by what
    they show. `notes` say so. Both go through the drive again, and the call takes as long; beyond 3000 sightings `notes`
    alone say it, and poses and risks take the map for right.

    Args:
        start: the first pose (3,); default: the origin, or unknown in a map.
        backend: "own": the project's solver, `online.own.OwnBackend`, whose estimate is a minimum of J after every call.
            "isam2": GTSAM's ISAM2, `online.isam2.Isam2Backend`, which relinearises what moves by more than a threshold.
        motion, sensor: the noise models; default: the book's.
        motion_weight: lambda, the factor on the information of the motion edges.
        kernel: a robust kernel, or its name, on the sightings, positions, and relations between known poses; "none" for
            none. Default: cauchy in a map, where single landmarks may have moved, and none else.
        options: of the backend; see `online.own.OwnBackend` (tolerance, lag, map, start_covariance) and
            `online.isam2.Isam2Backend` (edges, weight, residual, threshold, skip, factorization, params).

    Raises:
        OptionError: an option has an impossible value, or the backend does not have it.
        GraphError: a noise model is outside of what double precision can hold, or ``map`` has no landmarks.
    """

    def __init__(
        self,
        start: ArrayLike | None = None,
        *,
        backend: str = "own",
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        **options: Any,
    ) -> None:
        check_positive(motion_weight=motion_weight)
        kind: Any = backend_class(backend)
        known = backend_options(backend)
        check_known(f"the backend {backend}", options, known, f"; its own options are {', '.join(known)}")
        self.backend, self.motion = backend, model_of(MotionModel, motion)
        self.sensor = model_of(SensorModel, sensor)
        in_map = options.pop("map", None)
        if kernel is None and in_map is not None:
            kernel = "cauchy"
        self.motion_weight, self.kernel = motion_weight, kernel_of(kernel)
        first = None if start is None else checked_pose("start", start)
        self._backend: Backend
        if in_map is not None:
            known_map = as_map(in_map)
            if not known_map:
                raise GraphError("the map has no landmarks, so that the robot cannot be found in the map")
            held = options.pop("start_covariance", None)
            if held is not None and first is None:
                raise OptionError("start_covariance needs start: in a map the first pose is unknown without it")
            # without a covariance the start is exact
            held = np.linalg.inv(ANCHOR_INFORMATION) if held is None else held
            make = partial(kind, sensor=self.sensor, kernel=self.kernel, **options)
            self._backend = cast(Backend, Localizer(make, known_map, self.sensor, first, held, self.kernel is not None))
        else:
            self._backend = kind(np.zeros(3) if first is None else first, self.sensor, self.kernel, **options)
        #: whether nobody has said where the first pose is
        self._anywhere = first is None and in_map is None and "start_covariance" not in options
        #: the times of the latest call and of the newest pose, not a number where it is unknown
        self._time, self._arrived = -np.inf, np.nan

    def __copy__(self) -> OnlineSolver:
        """An independent solver, as `copy.deepcopy` makes one. ISAM2 has no copies."""
        return deepcopy(self)

    def __repr__(self) -> str:
        """One line: backend and sizes."""
        backend = self._backend
        sizes = singular(f"{backend.num_poses} poses, {len(backend.landmark_ids)} landmarks")
        return f"<OnlineSolver ({self.backend}): {sizes}>"

    # -- measurements ------------------------------------------------------------------------------------------------

    def move(
        self,
        control: ArrayLike | None = None,
        dt: float | None = None,
        *,
        motion: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        time: float | None = None,
    ) -> None:
        """Add a new pose with its motion edge.

        Args:
            control, dt: (nu, omega) [m/s, rad/s] for dt [s].
            motion, covariance: instead of a control, the new pose (3,) measured from the one before, with (3, 3).
            time: of the new pose [s], after all times so far. With a control, dt may be left out where the time of the
                pose before is known; a measured motion has no dt.

        Raises:
            OptionError: a value is impossible. GraphError: the new pose is not determined.
        """
        clock = self._checked_time(time, later=True)
        check_move(control, dt, motion, covariance)
        if dt is None and time is not None and np.isfinite(self._arrived):
            dt = time - self._arrived
        if control is not None:
            if dt is None:
                raise OptionError("a control needs dt, or the times of this pose and of the one before")
            check_positive(dt=dt)
            u = finite_numbers("control", control, (2,))
            check_turn_rate(float(u[1]))
            # a motion beyond floating point has no inverse covariance, and is refused for that
            measured, P = self.motion.moved(u, float(dt))
            information = inverses(P[None], "motion", "raise epsilon")[0]
        else:
            measured, information = checked_pose("motion", motion), information_of(covariance)
        last = self.step
        self._backend.relate((last, last + 1, measured, self.motion_weight * information))
        if time is not None:
            self._arrived = float(time)
        else:
            self._arrived = self._arrived + float(dt) if control is not None else np.nan  # type: ignore[arg-type]
        self._time = float(np.fmax(clock, self._arrived))

    def observe(
        self, ids: ArrayLike | None, sightings: ArrayLike, *, pose: int | None = None, time: float | None = None
    ) -> None:
        """Add sightings of landmarks.

        Args:
            ids: the landmarks (K,); in a map None, or -1 or `graphslam.log.UNIDENTIFIED` for some, where the map has to say
                it.
            sightings: (K, 2 or 3), what the sensor measures. Without psi one of range and bearing may be NaN: it was not
                measured. A landmark that has only such sightings waits (`waiting`) until they leave one place for it; with a
                lag, those from poses that have become final do not count.
            pose: the number of the pose from which they are seen; default: the newest.
            time: of the sightings [s], not before all times so far.

        Raises:
            OptionError: a value is impossible. GraphError: the pose is unknown or final.
        """
        clock = self._checked_time(time)
        pose = self.step if pose is None else pose
        check_count(pose=pose)
        self._check_pose(pose, "sightings from")
        landmarks, z = self._checked(ids, sightings)
        if landmarks:
            self._backend.observe(pose, landmarks, z)
        if time is not None and pose == self.step and np.isnan(self._arrived):
            self._arrived = float(time)
        self._time = clock

    def relate(self, first: ArrayLike, second: ArrayLike, motion: ArrayLike, covariance: ArrayLike) -> None:
        """Add a measured relation of two poses, such as a loop closure; or K relations, which are then solved for together.

        Args:
            first, second: the numbers of the poses, or (K,) each. The next pose number may be among them, which is then new.
            motion: the second pose in the axes of the first, (3,) or (K, 3).
            covariance: (3, 3) of each motion, or (K, 3, 3).

        Raises:
            OptionError: a value is impossible. GraphError: a pose is unknown, final or not determined. Nothing is added then.
        """
        ends, several, last = *_pairs(first, second), self.step
        motions = finite_numbers("motion", motion, (len(ends), 3) if several else (3,)).reshape(-1, 3)
        check_heading("motion", motions[:, 2])
        given = array_or_none(covariance)
        if several and given is not None and given.ndim == 3:
            information = [information_of(P) for P in finite_numbers("covariance", given, (len(ends), 3, 3))]
        else:
            information = [information_of(covariance)] * len(ends)
        for a, b in ends:
            check_count(first=a, second=b)
            if a == b:
                raise GraphError(f"a relation from pose {a} to itself: it needs two different poses")
            if min(a, b) > last or max(a, b) > last + 1:
                raise GraphError(f"a relation between poses {a} and {b}: the poses so far are 0 to {last}")
            self._check_pose(min(a, b), "a relation from")
        self._backend.relate(*((int(a), int(b), z, omega) for (a, b), z, omega in zip(ends, motions, information)))
        if self.step > last:
            self._arrived = np.nan

    def locate(
        self, position: ArrayLike, covariance: ArrayLike, *, lever: ArrayLike = (0.0, 0.0), pose: int | None = None
    ) -> None:
        """Add an absolute position, of GPS for example.

        Without ``start`` and ``start_covariance`` the first position moves all poses to where it was measured, and from then
        on positions alone hold them. A start that is given is in the frame of the positions, and exact without a covariance.

        Args:
            position: (x, y) [m], or (x, y, theta) with the heading of the robot.
            covariance: (2, 2) or (3, 3), in world axes.
            lever: the point of the robot that is measured, (ahead, left) [m] of its pose.
            pose: the number of the pose; default: the newest.

        Raises:
            OptionError: a value is impossible. GraphError: the pose is unknown or final.
        """
        pose = self.step if pose is None else pose
        check_count(pose=pose)
        self._check_pose(pose, "a position of")
        measured, arm = finite_numbers("position", position, (2,), (3,)), finite_numbers("lever", lever, (2,))
        d = len(measured)
        add = partial(self._backend.locate, int(pose), measured, information_of(covariance, d), arm)
        if not self._anywhere:
            add()
            return
        x = self._backend.poses[pose]
        turn = float(measured[2] - x[2]) if d == 3 else 0.0
        # the motion that takes the point of the robot to where it was measured
        point = transform(np.array([0.0, 0.0, turn]), transform(x, arm))
        self._backend.release(np.array([*(measured[:2] - point), turn]), add)
        self._anywhere = False

    def relinearize(self) -> None:
        """Linearise all edges at the estimate, and solve again.

        With the backend "own", covariances are then those of the batch solution; ISAM2 then is at the batch solution.
        """
        self._backend.relinearize()

    # -- estimates ---------------------------------------------------------------------------------------------------

    @property
    def step(self) -> int:
        """The number of the newest pose."""
        return self._backend.num_poses - 1

    @property
    def located(self) -> bool:
        """Whether poses are in the frame of the map; without a map, False."""
        return self._backend.tracker is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks, one sentence each: what of the drive so far contradicts the map, or the noise models.

        The latter only with the backend "own". With a lag it is J of windows of lag + 1 poses, each when the next pose comes.
        """
        return (*self._backend.notes, *filter(None, [self._backend.misfit]))

    @property
    def num_final(self) -> int:
        """The number of poses that are final, the first ones, because they are older than the lag."""
        return self._backend.num_final

    @property
    def converged(self) -> bool:
        """Whether the last call ended at the minimum; for ISAM2, whether the last `relinearize` did, and True before."""
        return self._backend.converged

    @property
    def cost(self) -> float:
        """J at the estimate, with the priors of a map, the anchor not counted.

        With a lag it is the part of J that the edges of the poses that are not final have. Priors are no part of it, because
        those that final poses have left are known but for a constant.
        """
        return self._backend.cost

    @property
    def pose(self) -> Array:
        """The newest pose (3,), heading in [-pi, pi)."""
        x = self._backend.pose
        x[2] = wrap(x[2])
        return x

    @property
    def poses(self) -> Array:
        """The estimate of all poses so far, (t+1, 3), headings in [-pi, pi); of final poses, the last one they had."""
        x = self._backend.poses
        x[:, 2] = wrap(x[:, 2])
        return x

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)}, by increasing id; without landmark nodes, empty."""
        return {id: np.append(x[:2], wrap(x[2:])) for id, x in sorted(self._backend.landmarks.items())}

    @property
    def waiting(self) -> dict[int, int]:
        """{id: number} of the ranges and bearings alone that wait until their landmark has one place."""
        return {id: len(rows) for id, rows in sorted(self._backend.waiting.items())}

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Covariances in world axes: of the newest pose (3, 3), or of what the arguments name.

        With the backend "own", edges that were linearised too far from the estimate, or have second derivatives in the
        linear system of the last pass, are first linearised again without them, and the parts of the tree above them
        factorised again (`engine/include/vmslam/online/edge.hpp`): standard deviations are then within 0.2 % of those of
        the batch solution, and `relinearize` makes them the same. The first call after a change looks at all edges; where
        all edges needed second derivatives, it takes the time of `relinearize`.

        Args:
            poses: a number of a pose, which gives (3, 3), or a list of P numbers, which gives (P, 3, 3).
            landmarks: an id, which gives (d, d), d = 2 or 3, or a list of L ids, which gives (L, d, d).
            joint: return one matrix (3 P + d L, 3 P + d L), poses first, instead of a block for each. Without it, poses
                and landmarks together give a pair (blocks of poses, blocks of landmarks).

        Raises:
            GraphError: a pose or landmark is unknown, a pose is final, or the edges do not determine the covariance.
            OptionError: an argument is no id and no list of ids.
        """
        if poses is None and landmarks is None:
            poses = self.step
        steps, ids = ids_of("poses", poses), ids_of("landmarks", landmarks)
        for step in steps:
            check_count(pose=step)
            self._check_pose(step, "the covariance of")
        known = set(self._backend.landmark_ids)
        if unknown := [id for id in ids if id not in known]:
            raise GraphError(f"there is no covariance of landmark {unknown[0]}: it is no node of the graph")
        matrix = self._backend.covariance(steps, ids)
        return matrix if joint else split(matrix, poses, landmarks, self._backend.columns or 2)

    def integrity_risk(self, metres: float, radians: float = np.inf) -> float:
        """The probability that the newest pose is off by more than the bounds; in a map 1 before the robot is `located`.

        Without a map, errors are those against the first pose, and covariances count as they are: the sizes of residuals, by
        which a map enlarges them, are known after the drive (`Solution.integrity_risk`). `maps.tracker` has the equations.
        It is as right as the map's covariances: see `notes`, which `replay` does not have. A map of another drive needs its
        joint covariance; as "own" or "fixed" (`LandmarkMap.used_as`) too little is said.

        Args:
            metres: the bound on the position.
            radians: the bound on the heading.

        Raises:
            GraphError: the edges do not determine the pose. OptionError: a bound is not positive.
        """
        tracker = self._backend.tracker
        if tracker is None:
            in_map = isinstance(self._backend, Localizer)
            off = beyond(np.eye(3) if in_map else self.covariance(), metres, radians)
            return 1.0 if in_map else float(off)
        from scipy.special import expit  # late: 0.1 s that few programs need

        off = beyond(inflation(tracker.squares) * self.covariance(), metres, radians)
        return float(1 - expit(tracker.log_odds) * (1 - off))

    # -- checks ------------------------------------------------------------------------------------------------------

    def _checked_time(self, time: float | None, *, later: bool = False) -> float:
        """The time of the latest call, with this one's."""
        if time is None:
            return self._time
        if not isinstance(time, Real) or not abs(time) <= sys.float_info.max:
            raise OptionError(f"time must be a finite number, not {quoted(time)}")
        if time < self._time or (later and time == self._time):
            raise OptionError(f"time runs backwards: {quoted(time)} s after {quoted(self._time)} s")
        return float(time)

    def _check_pose(self, pose: int, what: str) -> None:
        if pose > self.step:
            raise GraphError(f"{what} the unknown pose {pose}: the poses so far are 0 to {self.step}")
        if pose < self.num_final:
            used = f"with lag={self.step - self.num_final}, the poses from {self.num_final} on can be used"
            raise GraphError(f"{what} pose {pose}, which is final: {used}. Choose a longer lag")

    def _checked(self, ids: ArrayLike | None, sightings: ArrayLike) -> tuple[list[int], Array]:
        in_map, columns = isinstance(self._backend, Localizer), self._backend.columns
        advice = "the solver takes identified landmarks only, except in a map: leave out what nobody has identified"
        landmarks, z = checked_sightings(ids, sightings, () if in_map else (UNIDENTIFIED, NO_ID), advice)
        if len(z) == 0:
            return [], np.zeros((0, columns or 2))
        landmarks[landmarks == NO_ID] = UNIDENTIFIED
        if np.isnan(z[landmarks == UNIDENTIFIED]).any():
            raise OptionError("a range or a bearing alone needs the id of its landmark")
        if columns not in (None, z.shape[1]) and not (in_map and z.shape[1] == 3):
            raise OptionError(f"the sightings so far have {columns} numbers each, these have {z.shape[1]}")
        return landmarks.tolist(), z


def _pairs(first: Any, second: Any) -> tuple[list[tuple[int, int]], bool]:
    """The numbers of poses of relations, and whether these are lists.

    Raises:
        OptionError: these are not as many whole numbers each.
    """
    lists = [
        isinstance(ends, list | tuple) or (isinstance(ends, np.ndarray) and ends.ndim > 0) for ends in (first, second)
    ]
    if not any(lists):
        return [(first, second)], False
    if not all(lists) or len(first) != len(second):
        given = f"{quoted(first, 40)} and {quoted(second, 40)}"
        raise OptionError(f"first and second must be as many pose numbers each, not {given}")
    return list(zip(first, second)), True


def backend_class(backend: str) -> type[Any]:
    """The class of a backend; GTSAM is imported for ISAM2 only.

    Raises:
        OptionError: there is no such backend.
    """
    check_choice("backend", backend, BACKENDS)
    if backend == "isam2":
        from .isam2 import Isam2Backend

        return Isam2Backend
    return OwnBackend


def backend_options(backend: str) -> list[str]:
    """The names of the options that a backend has of its own."""
    parameters = inspect.signature(backend_class(backend)).parameters.values()
    return [each.name for each in parameters if each.kind is each.KEYWORD_ONLY]
