"""GTSAM's ISAM2 on the factors of this package, as a backend of `OnlineSolver`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import Kernel
from ..errors import GraphError, OptionError
from ..errors.checks import check_choice, check_count, check_not_negative, check_number, check_positive, check_type
from ..factors import AnchorFactor, LandmarkFactor, ObservationFactor, PositionFactor, RelativePoseFactor
from ..graph.trilateration import NumberRow, WaitingNumbers, edges_of_rows
from ..models import RESIDUALS, WEIGHTS, SensorModel
from ..se2 import Array, between, compose, inverse, turn_matrix
from ..solvers.gtsam_factors import factors_of_single_numbers
from .backend import RELEASED_START, Backend, Relation, information_of

EDGES = ("landmark+motion", "virtual+motion")
#: how ISAM2 eliminates nodes
FACTORIZATIONS = ("qr", "cholesky")
#: the most updates that relinearise everything, and the largest motion [m, rad] after which they end
MAX_UPDATES, TOLERANCE = 50, 1e-9
#: keys of poses by step, and of landmark nodes in the order of their first sightings (ids may be negative)
X, M = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.M


class Isam2Backend(Backend):
    """ISAM2, with one update for each call.

    With ``edges="landmark+motion"`` every sighting is one factor: GTSAM's own type where it has the same cost, and else an
    `ObservationFactor`. With ``edges="virtual+motion"`` every landmark has one `LandmarkFactor` of all its sightings, which
    a larger one replaces whenever the landmark is seen again. GTSAM cannot take back an update that fails: after a
    `GraphError` of an update, start again.

    GTSAM's own parameters, a threshold of 0.1 at every tenth update, end up to 0.05 m from the batch solution on the sample
    log.

    Args:
        start, sensor, kernel: checked by `OnlineSolver`; a kernel is for landmark nodes.
        edges: "landmark+motion" or "virtual+motion".
        weight: of virtual-motion edges: "pairs", "tempered" or "marginal"; see `Graph.from_log`.
        residual: of landmark nodes: "cartesian" or "polar"; see `Graph.from_log`.
        threshold: a node is linearised again where one of its coordinates has moved by this much [m, rad].
        skip: linearise again at every N-th update only.
        factorization: "qr", or "cholesky", which is up to a third faster and finds systems with very unequal information
            indeterminate, among them those of ordinary drives (docs/decisions.md).
        params: `gtsam.ISAM2Params`, instead of these three.
        start_covariance: (3, 3) of the first pose; default: it is anchored. Give one where absolute positions are added.

    Raises:
        OptionError: an option has an impossible value.

    Source: Kaess et al., *iSAM2: incremental smoothing and mapping using the Bayes tree*, IJRR 2012.
    """

    def __init__(
        self,
        start: Array,
        sensor: SensorModel,
        kernel: Kernel | None,
        *,
        edges: str = EDGES[0],
        weight: str = WEIGHTS[0],
        residual: str = RESIDUALS[0],
        threshold: float = 0.01,
        skip: int = 1,
        factorization: str = FACTORIZATIONS[0],
        params: gtsam.ISAM2Params | None = None,
        start_covariance: ArrayLike | None = None,
    ) -> None:
        check_choice("edges", edges, EDGES)
        check_choice("weight", weight, WEIGHTS)
        check_choice("residual", residual, RESIDUALS)
        if kernel is not None and edges.startswith("virtual"):
            raise OptionError("isam2 takes a kernel with edges='landmark+motion' only")
        check_type(gtsam.ISAM2Params, params=params)
        params = _parameters(threshold, skip, factorization) if params is None else params
        # a factor that was removed leaves a slot for the next one
        params.findUnusedFactorSlots = True
        advice = "; factorization='qr' also works where information is very unequal"
        self._advice = "" if params.getFactorization() == "QR" else advice
        self._sensor, self._kernel = sensor, kernel
        self._edges, self._weight, self._residual = edges, weight, residual
        self._isam, self._factorization = gtsam.ISAM2(params), params.getFactorization().lower()
        self._num_poses, self._settled = 1, True
        self._waiting = WaitingNumbers(sensor)
        self.columns: int | None = None
        #: per landmark the keys of the poses that saw it, and its sightings
        self._sightings: dict[int, tuple[list[int], list[Array]]] = {}
        #: per landmark the place of its factor in ISAM2, and the key of its node
        self._slots: dict[int, int] = {}
        self._nodes: dict[int, int] = {}
        #: since the last update: new factors and values, and landmarks with new sightings, and their number before
        self._factors, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._changed: dict[int, int] = {}
        held = None if start_covariance is None else information_of(start_covariance)
        self._anchor = AnchorFactor(X(0), start, held)
        self._factors.add(self._anchor)
        self._values.insert(X(0), gtsam.Pose2(*start))
        self.update()

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """Take back what a call has added where the call is refused before ISAM2 has it."""
        none = {"_factors": gtsam.NonlinearFactorGraph(), "_values": gtsam.Values(), "_changed": {}}
        before = vars(self) | none | {"_nodes": self._nodes.copy(), "_waiting": self._waiting.copy()}
        try:
            yield
        except (GraphError, OptionError):
            for landmark, count in self._changed.items():
                for rows in self._sightings[landmark]:
                    del rows[count:]
            vars(self).update(before)
            raise

    def __reduce_ex__(self, protocol: object) -> Any:
        raise TypeError("GTSAM's ISAM2 can neither be copied nor pickled; the backend 'own' can")

    def relate(self, *relations: Relation) -> None:
        with self._all_or_nothing():
            for relation in relations:
                # a motion leads to a new pose; all other relations may be wrong
                known = max(relation[:2]) < self._num_poses
                self.add_relation(relation, self._kernel if known else None)
            self.update()

    def observe(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        with self._all_or_nothing():
            self.add_sightings(pose, ids, sightings)
            self.update()

    def locate(self, pose: int, measured: Array, information: Array, lever: Array) -> None:
        with self._all_or_nothing():
            self.add_position(pose, measured, information, lever, self._kernel)
            self.update()

    def release(self, motion: Array, position: Callable[[], None]) -> None:
        with self._all_or_nothing():
            values, before, moved = gtsam.Values(), self._isam.calculateEstimate(), gtsam.Pose2(*motion)
            for key in before.keys():  # noqa: SIM118
                if self._is_point(key):
                    values.insert(key, moved.transformFrom(before.atPoint2(key)))
                else:
                    values.insert(key, moved.compose(before.atPose2(key)))
            self._hold_first(values, None)
            position()
            self._hold_first(self._isam.calculateEstimate(), np.diag(1 / np.array(RELEASED_START)))

    def _is_point(self, key: int) -> bool:
        """Whether the value at a key is a landmark without a heading."""
        return chr(gtsam.symbolChr(key)) == "m" and self.columns == 2

    def _hold_first(self, values: gtsam.Values, information: Array | None) -> None:
        """Begin anew at values, with the first pose anchored there with other information."""
        first, factors = values.atPose2(X(0)), gtsam.NonlinearFactorGraph(self._isam.getFactorsUnsafe())
        self._anchor = AnchorFactor(X(0), np.array([first.x(), first.y(), first.theta()]), information)
        # it is the first factor of all
        factors.replace(0, self._anchor)
        self._begin_anew(self._isam.params(), factors, values)

    def _begin_anew(self, params: gtsam.ISAM2Params, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Build the Bayes tree again, without the slots of factors that were removed."""
        full = [slot for slot in range(factors.size()) if factors.at(slot) is not None]
        slots = {before: now for now, before in enumerate(full)}
        self._slots = {landmark: slots[slot] for landmark, slot in self._slots.items()}
        self._isam = gtsam.ISAM2(params)
        self._pass_on(_without_empty_slots(factors), values, [])

    def _pass_on(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, removed: list[int]) -> Any:
        try:
            return self._isam.update(factors, values, removed)
        except RuntimeError as error:
            raise GraphError(f"gtsam's isam2 failed: {str(error).strip().splitlines()[0]}{self._advice}") from None

    def add_position(
        self, pose: int, measured: Array, information: Array, lever: Array, kernel: Kernel | None = None
    ) -> None:
        """Add an absolute position to what the next update passes to ISAM2."""
        self._factors.add(PositionFactor(X(pose), measured, information, lever=lever, kernel=kernel).fastest())

    def add_relation(self, relation: Relation, kernel: Kernel | None = None) -> None:
        """Add a relation to those that the next update passes to ISAM2."""
        first, second, z, information = relation
        self._factors.add(RelativePoseFactor(X(first), X(second), z, information, kernel=kernel))
        if max(first, second) == self._num_poses:
            known, moved = (first, z) if first < second else (second, inverse(z[None])[0])
            self._values.insert(X(self._num_poses), gtsam.Pose2(*compose(self._value(known), moved)))
            self._num_poses += 1

    def add_sightings(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        """Add sightings to those that the next update passes to ISAM2.

        Raises:
            GraphError: virtual-motion edges of sightings without psi, whose information depends on the poses.
        """
        if len(ids):
            self.columns = columns = sightings.shape[1]
            if columns == 2 and self._edges.startswith("virtual") and self._weight != "marginal":
                message = "without psi the information of pairs depends on the poses, which isam2 cannot re-evaluate"
                raise GraphError(f"{message}; use weight='marginal' or edges='landmark+motion'")
        for landmark, z in zip(ids, sightings, strict=True):
            if np.isnan(z).any():
                self._add_single_number(pose, landmark, z)
                continue
            waiting = self._waiting.take(landmark)
            if self._edges.startswith("landmark"):
                if landmark not in self._nodes:
                    self._nodes[landmark] = M(len(self._nodes))
                    y = self._sensor.h_inverse(self._value(pose), z)
                    self._values.insert(self._nodes[landmark], gtsam.Pose2(*y) if len(z) == 3 else gtsam.Point2(*y))
                options: dict[str, Any] = {"residual": self._residual, "kernel": self._kernel}
                factor = ObservationFactor(X(pose), self._nodes[landmark], z, self._sensor, **options)
                self._factors.add(factor.fastest())
            self._add_numbers(landmark, waiting)
            keys, seen = self._sightings.setdefault(landmark, ([], []))
            self._changed.setdefault(landmark, len(keys))
            keys.append(X(pose))
            seen.append(z)

    def _add_single_number(self, pose: int, landmark: int, z: Array) -> None:
        """A range or a bearing alone; those of a landmark without a place wait until they leave one place for it."""
        if not self._edges.startswith("landmark"):
            raise GraphError("ranges and bearings alone need landmarks as nodes: use edges='landmark+motion'")
        row: NumberRow = (pose, *z.tolist())
        if landmark in self._nodes:
            self._add_numbers(landmark, (row,))
            return
        place = self._waiting.add(landmark, row, lambda: np.array([*map(self._value, range(self._num_poses))]))
        if place is not None:
            self._put(landmark, place)

    def place(self, landmark: int, place: Array) -> None:
        self._put(landmark, place)
        self.update()

    def _put(self, landmark: int, place: Array) -> None:
        """A landmark that has been waiting gets a node at a place, and all its numbers."""
        self._nodes[landmark] = M(len(self._nodes))
        self._values.insert(self._nodes[landmark], gtsam.Point2(*place))
        self._add_numbers(landmark, self._waiting.take(landmark))

    def _add_numbers(self, landmark: int, rows: tuple[NumberRow, ...]) -> None:
        """The factors of single numbers of a landmark that is a node."""
        for each in edges_of_rows(landmark, rows, self._sensor, M(0), self._kernel) if rows else ():
            keys = np.array([X(step) for step in each.first.tolist()])
            node = np.full(each.count, self._nodes[landmark])
            for factor in factors_of_single_numbers(replace(each, first=keys, second=node)):
                self._factors.add(factor)

    def _value(self, pose: int) -> Array:
        """The value of a pose, also of one that was added after the last update."""
        key = X(pose)
        x = self._values.atPose2(key) if self._values.exists(key) else self._isam.calculateEstimatePose2(key)
        return np.array([x.x(), x.y(), x.theta()])

    def update(self) -> None:
        """Pass to ISAM2 what was added since the last update.

        Raises:
            GraphError: GTSAM finds the system indeterminate.
        """
        removed, replaced, first_new = [], [], self._factors.size()
        for landmark in self._changed if self._edges.startswith("virtual") else ():
            keys, sightings = self._sightings[landmark]
            if len(set(keys)) < 2:
                continue
            if landmark in self._slots:
                removed.append(self._slots[landmark])
            self._factors.add(LandmarkFactor(keys, np.array(sightings), self._sensor, weight=self._weight))
            replaced.append(landmark)
        result = self._pass_on(self._factors, self._values, removed)
        self._slots |= dict(zip(replaced, list(result.getNewFactorsIndices())[first_new:]))
        self._factors, self._values, self._changed = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}

    def relinearize(self) -> None:
        """Relinearise everything until no pose moves by more than `TOLERANCE`.

        ISAM2's own ``force_relinearize`` skips variables that move by less than its threshold. So the Bayes tree is
        built again from the present estimate, with a threshold of zero, and at the end once more with the user's parameters.
        """
        params = self._isam.params()
        factors, values = gtsam.NonlinearFactorGraph(self._isam.getFactorsUnsafe()), self._isam.calculateEstimate()
        self._begin_anew(_parameters(0.0, 1, self._factorization), factors, values)
        now = self.poses
        for _ in range(MAX_UPDATES):
            self._isam.update()
            before, now = now, self.poses
            self._settled = bool(np.abs(between(before, now)).max() < TOLERANCE)
            if self._settled:
                break
        factors = gtsam.NonlinearFactorGraph(self._isam.getFactorsUnsafe())
        self._begin_anew(params, factors, self._isam.calculateEstimate())

    # -- estimates ---------------------------------------------------------------------------------------------------

    @property
    def num_poses(self) -> int:
        return self._num_poses

    @property
    def landmark_ids(self) -> Sequence[int]:
        return list(self._nodes)

    @property
    def waiting(self) -> dict[int, tuple[NumberRow, ...]]:
        return self._waiting.rows

    @property
    def converged(self) -> bool:
        return self._settled

    @property
    def cost(self) -> float:
        values = self._isam.calculateEstimate()
        return float(2 * (self._isam.getFactorsUnsafe().error(values) - self._anchor.error(values)))

    @property
    def pose(self) -> Array:
        return self._value(self._num_poses - 1)

    @property
    def poses(self) -> Array:
        # sorted by key: landmarks with a heading come first
        found: Array = gtsam.utilities.extractPose2(self._isam.calculateEstimate())[-self._num_poses :]
        return found

    @property
    def landmarks(self) -> dict[int, Array]:
        values = self._isam.calculateEstimate()
        points = gtsam.utilities.extractPoint2(values)
        estimates = points if len(points) else gtsam.utilities.extractPose2(values)[: -self._num_poses]
        return dict(zip(self._nodes, estimates))

    def covariance(self, poses: Sequence[int], landmarks: Sequence[int]) -> Array:
        values, factors = self._isam.calculateEstimate(), _without_empty_slots(self._isam.getFactorsUnsafe())
        keys = [*map(X, poses), *(self._nodes[id] for id in landmarks)]
        if not keys:
            return np.zeros((0, 0))
        try:
            found = gtsam.Marginals(factors, values).jointMarginalCovariance(gtsam.KeyVector(list(dict.fromkeys(keys))))
        except RuntimeError as error:
            raise GraphError(f"there is no covariance: {str(error).strip().splitlines()[0]}") from None
        # GTSAM's are in the axes of each pose
        turns = [np.eye(2) if self._is_point(k) else turn_matrix(values.atPose2(k).theta()) for k in keys]
        return np.block([[A @ found.at(a, b) @ B.T for b, B in zip(keys, turns)] for a, A in zip(keys, turns)])


def _without_empty_slots(factors: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """The factors without the slots of those that were removed."""
    left = gtsam.NonlinearFactorGraph()
    for slot in range(factors.size()):
        if factors.at(slot) is not None:
            left.add(factors.at(slot))
    return left


def _parameters(threshold: float, skip: int, factorization: str) -> gtsam.ISAM2Params:
    """Parameters of ISAM2.

    Raises:
        OptionError: a value is impossible.
    """
    check_choice("factorization", factorization, FACTORIZATIONS)
    check_number(threshold=threshold)
    check_not_negative(threshold=threshold)
    check_count(skip=skip)
    check_positive(skip=skip)
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = skip
    params.setRelinearizeThreshold(float(threshold))
    params.setFactorization(factorization.upper())
    return params
