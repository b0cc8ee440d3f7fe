"""`OnlineSolver`: graph SLAM while the robot drives, with the solution of the whole graph after every step."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from copy import deepcopy
from numbers import Real
from operator import index
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ..checks import check_count, check_positive, check_type, real_array
from ..edges import ANCHOR_INFORMATION
from ..edges.robust import Kernel, code_and_width, kernel_of
from ..engine import engine
from ..errors import GraphError, OptionError, quoted
from ..landmark_map import LandmarkMap, as_map
from ..models import MotionModel, SensorModel
from ..precision import check_model, inverses
from ..reading import NO_ID, UNIDENTIFIED
from ..se2 import Array, wrap

#: kinds of edges: to a new pose, a sighting of a landmark, another relation of poses
MOTION, SIGHTING, RELATION = range(3)
#: the most passes of one step, after which the batch solver takes over
PASSES = 15
#: the standard deviation [m, rad] of landmarks that are exact in a map
EXACT = 1e-5
#: the part of J below which steps leave it
TOLERANCE = 1e-7
#: the fewest steps from one pose that stays a node, with a lag, to the next
STRETCH = 20

Model = TypeVar("Model", MotionModel, SensorModel)


class OnlineSolver:
    """Poses, landmarks and edges step by step; after every step the estimate is a minimum of J over all edges so far.

    The graph is that of `Graph.from_log` with ``edges="landmark+motion"``: landmarks are nodes, sightings have the
    Cartesian residual, and the first pose is anchored. Call `step` once for each motion.

    The estimate follows the nearest minimum from step to step, and `converged` tells whether it was reached. Only what a
    step changes is eliminated again; see `engine/include/vmslam/online`.

    Args:
        start: the first pose (3,).
        motion, sensor: the noise models; default: the book's.
        motion_weight: lambda, the factor on the information of the motion edges.
        kernel: a robust kernel on the sightings, or its name.
        lag: poses that are older than so many steps are final. They are marginalised: their edges, at their last
            linearisation and with their last robust weights, become a dense prior on what they are tied to. Landmarks stay
            nodes, and so does one pose in each stretch of ``lag`` steps, at least `STRETCH`, in which landmarks were new:
            the prior of a stretch is relative to it. None keeps all poses.
        tolerance: a step ends where the next pass would lower J by less than this part of it; default: `TOLERANCE`, and a
            hundredth of it with a lag, because later steps cannot correct what a prior was made of. Together with what passes
            leave out, J was at most 1.1e-6 above that of the batch solver on all steps that were compared
            (`docs/benchmarks.md`).
        map: landmarks that are known beforehand, in a form that `Graph.from_log` takes; exact ones have a standard deviation
            of `EXACT`. Sightings have psi where all its landmarks have headings, and else not. Give ``start`` in its frame.
        start_covariance: (3, 3) of the first pose; default: it is anchored. After a first fix, four times its covariance.

    Raises:
        OptionError: an option has an impossible value.
        GraphError: a noise model is outside of what double precision can hold.
    """

    def __init__(
        self,
        start: ArrayLike = (0.0, 0.0, 0.0),
        *,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        tolerance: float | None = None,
        lag: int | None = None,
        map: Any = None,
        start_covariance: ArrayLike | None = None,
    ) -> None:
        if tolerance is None:
            tolerance = TOLERANCE if lag is None else TOLERANCE / 100
        check_positive(motion_weight=motion_weight, tolerance=tolerance)
        if lag is not None:
            check_count(lag=lag)
            check_positive(lag=lag)
        self.motion = _model("motion", motion, MotionModel)
        self.sensor = _model("sensor", sensor, SensorModel)
        check_model(self.motion)
        check_model(self.sensor)
        self.motion_weight, self.kernel, self.lag = motion_weight, kernel_of(kernel), lag
        self._system = engine.OnlineSystem(tolerance, PASSES)
        #: the nodes of the poses that are not final, and the values of those that are
        self._poses: list[int] = [self._system.add_node()]
        self._final = np.zeros((64, 3))
        self._num_final = 0
        self._landmarks: dict[int, int] = {}
        #: the number of landmarks when a final pose was kept last
        self._mapped = 0
        self._columns: int | None = None
        #: the times of the latest step and of the newest pose, not a number where it is unknown
        self._time, self._arrived = -np.inf, np.nan
        held = ANCHOR_INFORMATION if start_covariance is None else _information(start_covariance)
        self._system.add_prior([0], _numbers("start", start, (3,)), np.ascontiguousarray(held), False)
        self._system.solve(self._poses, self._poses)
        if map is not None:
            known = as_map(map)
            self._begin_with(*priors_of(known, 3 if known.oriented else 2))

    def _begin_with(self, ids: Sequence[int], places: Array, information: Array, columns: int) -> None:
        """Landmarks (K,) at places (K, 3), with information (3K, 3K) in world axes, which sightings of ``columns`` see."""
        self._columns = columns
        self._use_kernel(columns)
        self._landmarks = {j: self._system.add_node() for j in ids}
        nodes = list(self._landmarks.values())
        self._system.add_prior(nodes, places, np.ascontiguousarray(information), columns == 2)
        self._system.solve(nodes, self._poses)

    def _use_kernel(self, dimension: int | None) -> None:
        """The robust kernel of sightings with residuals of a dimension; none as long as there are no sightings."""
        kernel, gain = None, 1.0
        if self.kernel is not None and dimension is not None:
            kernel = self.kernel.of_dimension(dimension)
            gain = kernel.information_per_weight(dimension)
        self._system.use_kernel(*code_and_width(kernel), gain)

    def __copy__(self) -> OnlineSolver:
        """A solver of its own, as `copy.deepcopy` makes one: steps of one do not change the other."""
        return deepcopy(self)

    @property
    def num_poses(self) -> int:
        """The number of poses so far."""
        return self._num_final + len(self._poses)

    @property
    def num_final(self) -> int:
        """The number of poses that are final, the first ones, because they are older than the lag."""
        return self._num_final

    @property
    def passes(self) -> int:
        """How often the last step solved the tree again because edges had to be evaluated again."""
        return int(self._system.passes)

    @property
    def converged(self) -> bool:
        """Whether the last step ended at the minimum. Otherwise neither its passes nor those after a batch solution ended."""
        return bool(self._system.converged)

    def step(
        self,
        control: ArrayLike | None = None,
        dt: float | None = None,
        *,
        motion: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        ids: ArrayLike = (),
        sightings: ArrayLike = (),
        pose: int | None = None,
        relations: Iterable[tuple[int, int, ArrayLike, ArrayLike]] = (),
        time: float | None = None,
    ) -> Array:
        """A motion to a new pose, and what is seen from there; returns the newest pose (3,).

        Args:
            control, dt: (nu, omega) [m/s, rad/s] for dt [s].
            motion, covariance: instead of a control, the new pose (3,) measured from the one before, with (3, 3).
            ids, sightings: landmarks (K,) and what the sensor measures (K, 2 or 3).
            pose: the number of the known pose from which the landmarks are seen, instead of a motion.
            relations: loop closures (first, second, measured (3,), covariance (3, 3)) between poses. Without a motion the
                first relation may lead to the next pose number, which is then new.
            time: of the step [s]; it may not run backwards. With a control, dt may be left out where the time of the pose
                before is known.

        Raises:
            OptionError: a value is impossible. GraphError: a pose is unknown or not determined.
                The solver then is as it was before the step.
        """
        related = _relations(relations)
        last = self.num_poses - 1
        moves = (control is not None) + (motion is not None) + (pose is not None)
        created = next(
            (k for k, (i, j, *_) in enumerate(related) if max(i, j) == last + 1 and 0 <= min(i, j) <= last), None
        )
        clock, arrived = self._time, self._arrived
        travels = pose is None and (moves > 0 or created is not None)
        if time is not None:
            if not isinstance(time, Real) or not abs(time) <= sys.float_info.max:
                raise OptionError(f"time must be a finite number, not {quoted(time)}")
            if time < clock or (time == clock and travels):
                raise OptionError(f"time runs backwards: {quoted(time)} s after {quoted(clock)} s")
            if dt is None and np.isfinite(arrived):
                dt = time - arrived
            clock = time
        if moves > 1 or (moves == 0 and created is None and not (related and not np.size(ids))):
            raise OptionError(
                "a step needs a motion: give a control and dt, a motion and its covariance, or a known pose"
            )
        if covariance is not None and motion is None:
            raise OptionError(
                "a covariance belongs to a measured motion; that of a control comes from the motion model"
            )
        edge: tuple[int, Array, Array] | None = None
        backwards = False
        if control is not None:
            check_positive(dt=dt)  # type: ignore[arg-type]
            u, seconds = _numbers("control", control, (2,))[None], np.array([float(dt)])  # type: ignore[arg-type]
            # a motion beyond floating point has no inverse covariance, and is refused for that
            with np.errstate(over="ignore", invalid="ignore"):
                z, P = self.motion.accumulate(u, seconds, np.array([0, 1]))
            edge = last, z[0], self.motion_weight * inverses(P, "motion", "raise epsilon")[0]
        elif motion is not None:
            edge = last, _numbers("motion", motion, (3,)), self.motion_weight * _information(covariance)
        elif pose is None and created is not None:
            i, j, z_ij, P_ij = related.pop(created)
            edge, backwards = (min(i, j), _numbers("relation", z_ij, (3,)), _information(P_ij)), i > j
            self._check_kept(min(i, j), "a relation from")
        known = last + 1 + (edge is not None)
        for i, j, *_ in related:
            if not (0 <= i < known and 0 <= j < known and i != j):
                raise GraphError(f"a relation between poses {i} and {j}: the poses so far are 0 to {known - 1}")
            self._check_kept(min(i, j), "a relation from")
        if pose is not None:
            check_count(pose=pose)
            self._check_kept(pose, "sightings from")
        if pose is not None and pose > last:
            raise GraphError(f"sightings from the unknown pose {pose}: the poses so far are 0 to {last}")
        ends = np.array([(i, j) for i, j, *_ in related], dtype=np.int64).reshape(-1, 2)
        loops = np.array([_numbers("relation", z, (3,)) for _, _, z, _ in related]).reshape(-1, 3)
        weights = np.array([_information(P) for *_, P in related]).reshape(-1, 3, 3)
        seen = self._checked(ids, sightings)
        self._add(
            edge, seen[0], *self.edges_of(seen[1]), pose=pose, relations=(ends, loops, weights), backwards=backwards
        )
        if time is not None and (travels or (pose == last and np.isnan(arrived))):
            self._arrived = float(time)
        elif travels:
            self._arrived = arrived + float(dt) if control is not None else np.nan  # type: ignore[arg-type]
        self._time = float(np.fmax(clock, self._arrived))
        return self.pose

    def edges_of(self, sightings: Array) -> tuple[Array, Array]:
        """Landmarks measured in the robot's axes (K, 2 or 3), and their information, from sightings."""
        at_origin = np.zeros((len(sightings), 3))
        # a range beyond floating point has no inverse covariance, and is refused for that
        with np.errstate(over="ignore", invalid="ignore"):
            measured = self.sensor.h_inverse(at_origin, sightings)
            covariances = self.sensor.landmark_covariance(at_origin, sightings)
        return measured, inverses(covariances, "sighting", "check the noise of the sensor") if len(
            measured
        ) else covariances

    def _checked(self, ids: ArrayLike, sightings: ArrayLike) -> tuple[list[int], Array]:
        try:
            landmarks = np.atleast_1d(np.asarray(ids))
        except ValueError:
            raise OptionError(f"ids must be whole numbers, not {ids!r:.80}") from None
        z = _array(sightings)
        if landmarks.size == 0 and z is not None and z.size == 0:
            return [], np.zeros((0, self._columns or 2))
        if landmarks.size and (landmarks.dtype.kind not in "iu" or landmarks.ndim != 1):
            raise OptionError(f"ids must be whole numbers, not {quoted(ids)}")
        if np.any((landmarks == UNIDENTIFIED) | (landmarks == NO_ID)):
            raise OptionError("a step takes identified landmarks only: leave out what nobody has identified")
        if z is None or z.ndim != 2 or z.shape[1] not in (2, 3) or not np.isfinite(z).all() or np.any(z[:, 0] <= 0):
            raise OptionError(
                f"sightings must be (range, bearing) or with psi, with ranges above zero, not {quoted(sightings)}"
            )
        if len(z) != landmarks.size:
            raise OptionError(
                f"each sighting needs the id of its landmark: there are {len(z)} sightings, ids {quoted(ids)}"
            )
        if self._columns not in (None, z.shape[1]):
            raise OptionError(f"the sightings so far have {self._columns} numbers each, these have {z.shape[1]}")
        return landmarks.tolist(), z

    def _add(
        self,
        edge: tuple[int, Array, Array] | None,
        landmarks: Sequence[int],
        measured: Array,
        information: Array,
        *,
        pose: int | None = None,
        relations: tuple[np.ndarray, Array, Array] | None = None,
        backwards: bool = False,
    ) -> None:
        """A step of checked numbers: a motion edge (from, measured, information), and landmarks in the robot's axes.

        With ``backwards``, the edge is measured from the new pose instead.
        """
        system, k, loops = self._system, len(landmarks), 0 if relations is None else len(relations[0])
        known, poses, moved, columns = system.num_nodes, len(self._poses), int(edge is not None), self._columns
        total = moved + k + loops
        ends, kinds = np.empty((total, 2), np.int32), np.empty(total, np.int8)
        z, W, rows = np.zeros((total, 3)), np.zeros((total, 6)), np.full(total, 3, np.int8)
        fresh: list[int] = []
        if edge is not None:
            self._poses.append(system.add_node())
            pair = self._node(edge[0]), self._poses[-1]
            ends[0], kinds[0] = (pair[::-1], RELATION) if backwards else (pair, MOTION)
            z[0], W[0] = edge[1], _packed(edge[2])
        if k:
            d, node = measured.shape[1], self._poses[-1] if pose is None else self._node(pose)
            if columns is None:
                self._columns = d
                self._use_kernel(d)
            for row, landmark in enumerate(landmarks, start=moved):
                end = self._landmarks.get(landmark)
                if end is None:
                    end = self._landmarks[landmark] = system.add_node()
                    fresh.append(landmark)
                ends[row] = node, end
            seen = slice(moved, moved + k)
            kinds[seen], rows[seen], z[seen, :d], W[seen, : 3 if d == 2 else 6] = (
                SIGHTING,
                d,
                measured,
                _packed(information),
            )
        if relations is not None and loops:
            ends[moved + k :] = np.array(self._poses)[relations[0] - self._num_final]
            kinds[moved + k :], z[moved + k :], W[moved + k :] = RELATION, relations[1], _packed(relations[2])
        if not system.add(known, ends, kinds, rows, z, W, self._poses[-1:]):
            for landmark in fresh:
                del self._landmarks[landmark]
            del self._poses[poses:]
            if columns is None:
                self._columns = None
                self._use_kernel(None)
            raise GraphError("the step leaves a pose or landmark undetermined, so that it was not taken")
        while self.lag is not None and len(self._poses) > self.lag + 1:
            self._marginalize()

    def _marginalize(self) -> None:
        """Make the oldest pose final."""
        if self._num_final == len(self._final):
            self._final = np.concatenate([self._final, np.zeros_like(self._final)])
        oldest = self._poses.pop(0)
        # where the map grows, one at intervals stays a node: what others leave is then relative to a pose nearby
        due = self._num_final % max(self.lag or 0, STRETCH) == 0
        if due and (self._num_final == 0 or len(self._landmarks) > self._mapped):
            self._mapped = len(self._landmarks)
            self._final[self._num_final] = self._system.values([oldest])[0]
        else:
            self._final[self._num_final] = self._system.marginalize(oldest, self._poses[-1:])
        self._num_final += 1
        if self._system.crowded():
            number = self._system.renumber()
            self._poses = [number[node] for node in self._poses]
            self._landmarks = {key: number[node] for key, node in self._landmarks.items()}

    def _node(self, pose: int) -> int:
        return self._poses[pose - self._num_final]

    def _check_kept(self, pose: int, what: str) -> None:
        if pose < self._num_final:
            raise GraphError(
                f"{what} pose {pose}, which is final: with lag={self.lag}, the poses from {self._num_final} on can be used. "
                "Choose a longer lag"
            )

    def relinearize(self) -> None:
        """Linearise all edges at the estimate and factorise all again; covariances are then those of the batch solution."""
        self._system.relinearize(self._poses[-1:])

    @property
    def pose(self) -> Array:
        """The newest pose (3,), heading in [-pi, pi)."""
        x = np.asarray(self._system.values(self._poses[-1:])[0])
        x[2] = wrap(x[2])
        return x

    @property
    def poses(self) -> Array:
        """The estimate of all poses so far, (t+1, 3), headings in [-pi, pi); of final poses, the last one they had."""
        self._system.complete()
        x = np.concatenate([self._final[: self._num_final], self._system.places(self._poses)])
        x[:, 2] = wrap(x[:, 2])
        return x

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)}, by increasing id."""
        known, d = sorted(self._landmarks), self._columns or 2
        x = self._system.values([self._landmarks[key] for key in known])
        return {key: np.append(row[:2], wrap(row[2:d])) for key, row in zip(known, x, strict=True)}

    @property
    def cost(self) -> float:
        """J at the estimate, the anchor not counted; with a lag, of the edges of poses that are not final."""
        return float(self._system.cost())

    def covariance(self, pose: int | None = None, *, landmarks: Sequence[int] = ()) -> Array:
        """The joint covariance of a pose, by default the newest, and of landmarks, in world axes.

        Its order is the pose (3 numbers), then each landmark (2 or 3). Edges that were linearised too far from the estimate,
        or have second derivatives in the linear system of the last pass, are first linearised again without them, and the
        parts of the tree above them factorised again (`engine/include/vmslam/online/edge.hpp`): standard deviations are then
        within 2 % of those of the batch solution, and `relinearize` makes them the same. The first call after a step
        looks at all edges; where all edges needed second derivatives, it takes the time of `relinearize`.

        Raises:
            GraphError: a pose or landmark is unknown, the pose is final, or the edges do not determine the covariance.
            OptionError: ``landmarks`` is no list of ids.
        """
        pose = self.num_poses - 1 if pose is None else pose
        check_count(pose=pose)
        self._check_kept(pose, "the covariance of")
        try:
            unknown = [key for key in landmarks if key not in self._landmarks]
        except TypeError:
            raise OptionError(f"landmarks must be a list of ids, not {landmarks!r:.80}") from None
        if pose >= self.num_poses or unknown:
            raise GraphError(
                f"there is no covariance of pose {pose} and landmarks {list(landmarks)}: not all are known"
            )
        nodes = [self._node(pose), *(self._landmarks[key] for key in landmarks)]
        block = self._system.covariance(nodes, self._poses[-1:])
        if block is None:
            raise GraphError("there is no covariance: the edges do not determine all nodes to double precision")
        d = self._columns or 2
        kept = [0, 1, 2, *(3 * k + c for k in range(1, len(landmarks) + 1) for c in range(d))]
        return np.asarray(block[np.ix_(kept, kept)])


def priors_of(known: LandmarkMap, columns: int) -> tuple[list[int], Array, Array, int]:
    """The ids, places (K, 3), information (3K, 3K) and number of coordinates of the landmarks of a map."""
    ids, count = list(known), len(known)
    places = np.zeros((count, 3))
    places[:, :columns] = [place[:columns] for place in known.values()]
    if known.joint is not None:
        information = known.joint_information(ids, columns)
    else:
        information = block_diag(
            *(known.own_information(j, columns) if j in known.covariances else np.zeros((3, 3)) for j in ids)
        )
    exact = np.repeat([j not in known.covariances for j in ids], 3) & np.tile(np.arange(3) < columns, count)
    information[exact, exact] = EXACT**-2
    return ids, places, information, columns


def _packed(information: Array) -> Array:
    """The entries (..., 3 or 6) of symmetric matrices as in `edges::Symmetric`."""
    if information.shape[-1] == 2:
        return information[..., [0, 0, 1], [0, 1, 1]]
    return information[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def _array(value: ArrayLike) -> Array | None:
    """A value as an array of numbers, None if it is none."""
    try:
        return real_array(value).copy()
    except (TypeError, ValueError, OverflowError):
        return None


def _relations(
    relations: Iterable[tuple[int, int, ArrayLike, ArrayLike]],
) -> list[tuple[int, int, ArrayLike, ArrayLike]]:
    """Relations with checked numbers of poses."""
    try:
        related = [(index(i), index(j), z, P) for i, j, z, P in relations]
    except (TypeError, ValueError):
        raise OptionError(
            f"relations must be a list of (first pose, second pose, measured, covariance), not {quoted(relations)}"
        ) from None
    return related


def _model(name: str, value: Any, kind: type[Model]) -> Model:
    check_type(kind, **{name: value})
    return kind() if value is None else value


def _numbers(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = _array(value)
    if array is None or array.shape != shape or not np.isfinite(array).all():
        raise OptionError(f"{name} must be finite numbers of shape {shape}, not {quoted(value)}")
    return array


def _information(covariance: ArrayLike | None) -> Array:
    P = _numbers("covariance", covariance, (3, 3))  # type: ignore[arg-type]
    if not np.allclose(P, P.T, rtol=0, atol=1e-9 * np.abs(P).max()) or not np.linalg.eigvalsh(P)[0] > 0:
        raise OptionError(f"covariance must be a symmetric positive definite 3 x 3 matrix, not {quoted(covariance)}")
    return np.asarray(inverses(P[None], "motion", "check its covariance")[0])
