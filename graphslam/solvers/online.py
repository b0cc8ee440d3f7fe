"""Graph SLAM while the robot drives: ISAM2 on our factors, one step of a log after the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..edges.robust import Kernel, kernel_of
from ..errors import GraphError, OptionError
from ..factors import AnchorFactor, LandmarkFactor, MotionFactor, ObservationFactor, RelativePoseFactor
from ..factors.layer import positive_definite
from ..graph import Graph
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, compose, wrap
from ..solution import Solution, make_solution

EDGES = ("virtual+motion", "landmark+motion")
#: the most updates that relinearise everything
SETTLE_UPDATES = 50
WEIGHTS = ("pairs", "tempered", "marginal")


class IncrementalSmoother:
    """ISAM2 fed by hand: `move`, `observe`, and `update` when a step is whole.

    With ``edges="landmark+motion"`` every sighting is an `ObservationFactor`. With ``edges="virtual+motion"`` every
    landmark has one `LandmarkFactor` of all its sightings, exchanged for a larger one whenever it is seen again.

    Args:
        start: the first pose (3,), anchored.
        motion, sensor: the noise models; default: the book's.
        edges: "virtual+motion" or "landmark+motion".
        weight: of virtual edges: "pairs", "tempered" or "marginal"; see `Graph.from_log`.
        motion_weight: lambda, the factor on the motion edges.
        kernel: of landmark nodes' sightings.
        params: of ISAM2; default: relinearise what moves by more than 0.01 at every step. (GTSAM's own, 0.1 at every
            tenth, ends up to 0.05 m from the batch answer on the sample log.)

    Raises:
        OptionError: an option has an impossible value.

    Source: Kaess et al., *iSAM2: incremental smoothing and mapping using the Bayes tree*, IJRR 2012.
    """

    def __init__(
        self,
        start: ArrayLike = (0.0, 0.0, 0.0),
        *,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        edges: str = "virtual+motion",
        weight: str = "pairs",
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        params: gtsam.ISAM2Params | None = None,
    ) -> None:
        check_choice("edges", edges, EDGES)
        check_choice("weight", weight, WEIGHTS)
        self.kernel = kernel_of(kernel)
        if self.kernel is not None and edges.startswith("virtual"):
            raise OptionError("isam2 takes a kernel with edges='landmark+motion' only")
        self.motion, self.sensor = motion or MotionModel(), sensor or SensorModel()
        self.edges, self.weight, self.motion_weight = edges, weight, motion_weight
        if params is None:
            params = gtsam.ISAM2Params()
            params.relinearizeSkip = 1
            params.setRelinearizeThreshold(0.01)
        # a factor that has been exchanged leaves a slot for the next one
        params.findUnusedFactorSlots = True
        self.isam = gtsam.ISAM2(params)
        self.num_poses = 1
        self._seen: dict[int, tuple[list[int], list[Array]]] = {}
        self._slot: dict[int, int] = {}
        # GTSAM's symbols count from zero, ids of landmarks may be negative
        self._numbers: dict[int, int] = {}
        self._latest = np.array(start, dtype=float)
        self._factors, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._factors.add(AnchorFactor(_pose(0), self._latest))
        self._values.insert(_pose(0), gtsam.Pose2(*self._latest))
        self._touched: list[int] = []

    def move(self, control: ArrayLike, dt: float) -> None:
        """The robot drives: a new pose, with a motion factor from the one before."""
        self._reach(
            self.motion.f(self._latest, control, dt),
            MotionFactor(*self._ends(), control, dt, self.motion, weight=self.motion_weight),
        )

    def move_by(self, motion: ArrayLike, covariance: ArrayLike) -> None:
        """The robot has moved: a new pose, as seen (3,) from the one before with a covariance (3, 3).

        Raises:
            OptionError: the motion is no three finite numbers, or the covariance not symmetric positive definite.
        """
        try:
            inverse = np.linalg.inv(np.asarray(covariance, dtype=float))
            information = positive_definite(self.motion_weight * (inverse + inverse.T) / 2)
        except (np.linalg.LinAlgError, TypeError, ValueError, OptionError):
            raise OptionError("covariance must be a symmetric positive definite 3 x 3 matrix") from None
        factor = RelativePoseFactor(*self._ends(), motion, information)
        self._reach(compose(self._latest, np.asarray(motion, dtype=float)), factor)

    def _ends(self) -> tuple[int, int]:
        return _pose(self.num_poses - 1), _pose(self.num_poses)

    def _reach(self, pose: Array, factor: gtsam.NonlinearFactor) -> None:
        self._latest = pose
        self._factors.add(factor)
        self._values.insert(_pose(self.num_poses), gtsam.Pose2(*pose))
        self.num_poses += 1

    def observe(self, ids: ArrayLike, sightings: ArrayLike) -> None:
        """The robot sees landmarks ids (K,) as sightings (K, 2 or 3) from its latest pose.

        Raises:
            OptionError: ids and sightings do not belong together, or a sighting is impossible; nothing is taken then.
            GraphError: virtual edges of sightings without psi, whose information depends on the poses.
        """
        named, seen = self._checked(ids, sightings)
        for landmark, z in zip(named, seen):
            if self.edges.startswith("landmark"):
                key = _landmark(self._numbers.setdefault(landmark, len(self._numbers)))
                if landmark not in self._seen:
                    y = self.sensor.h_inverse(self._latest, z)
                    self._values.insert(key, gtsam.Pose2(*y) if len(z) == 3 else gtsam.Point2(*y))
                self._factors.add(ObservationFactor(_pose(self.num_poses - 1), key, z, self.sensor, kernel=self.kernel))
            else:
                self._touched.append(landmark)
            keys, all_seen = self._seen.setdefault(landmark, ([], []))
            keys.append(_pose(self.num_poses - 1))
            all_seen.append(z)

    def _checked(self, ids: ArrayLike, sightings: ArrayLike) -> tuple[list[int], Array]:
        named = np.atleast_1d(np.asarray(ids))
        if named.size == 0:
            return [], np.zeros((0, 3))
        try:
            seen = np.atleast_2d(np.array(sightings, dtype=float))
        except (TypeError, ValueError):
            seen = np.zeros((0, 0))
        if named.dtype.kind not in "iu" or named.ndim != 1:
            raise OptionError(f"ids must be whole numbers, not {ids!r}")
        if seen.shape not in ((len(named), 2), (len(named), 3)):
            raise OptionError(f"{len(named)} ids need as many sightings (l, phi) or (l, phi, psi), not {sightings!r}")
        if not np.isfinite(seen).all() or np.any(seen[:, 0] <= 0):
            raise OptionError(f"sightings must be finite, and their ranges above zero: {sightings!r}")
        before = next((all_seen[0] for _, all_seen in self._seen.values()), seen[0])
        if len(before) != seen.shape[1]:
            raise OptionError(f"the sightings so far have {len(before)} numbers each, these have {seen.shape[1]}")
        if seen.shape[1] == 2 and self.edges.startswith("virtual") and self.weight != "marginal":
            raise GraphError(
                "without psi the information of pairs depends on the poses, which isam2 cannot re-evaluate; use "
                "weight='marginal' or edges='landmark+motion'"
            )
        return named.tolist(), seen

    def update(self) -> None:
        """Give ISAM2 what is new.

        Raises:
            GraphError: GTSAM finds the system indeterminate.
        """
        removed, placed, first_new = [], [], self._factors.size()
        for landmark in dict.fromkeys(self._touched):
            keys, seen = self._seen[landmark]
            if len(set(keys)) < 2:
                continue
            if landmark in self._slot:
                removed.append(self._slot[landmark])
            self._factors.add(LandmarkFactor(keys, np.array(seen), self.sensor, "body", self.weight))
            placed.append(landmark)
        try:
            result = self.isam.update(self._factors, self._values, removed)
        except RuntimeError as error:
            raise GraphError(f"gtsam's isam2 gave up: {str(error).strip().splitlines()[0]}") from None
        new_slots = list(result.getNewFactorsIndices())
        self._slot |= dict(zip(placed, new_slots[first_new:]))
        self._factors, self._values, self._touched = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        latest = self.isam.calculateEstimatePose2(_pose(self.num_poses - 1))
        self._latest = np.array([latest.x(), latest.y(), latest.theta()])

    def settle(self, tolerance: float = 1e-9, max_updates: int = SETTLE_UPDATES) -> int:
        """Relinearise everything until nothing moves by ``tolerance``; the number of updates it took.

        ISAM2's own ``force_relinearize`` leaves alone what moves by less than its threshold; so the tree is built anew,
        with the threshold at zero, from the present estimate.
        """
        params = gtsam.ISAM2Params()
        params.findUnusedFactorSlots = True
        params.relinearizeSkip = 1
        params.setRelinearizeThreshold(0.0)
        held, values = self.isam.getFactorsUnsafe(), self.isam.calculateEstimate()
        factors, slots = gtsam.NonlinearFactorGraph(), {}
        for slot in range(held.size()):
            factor = held.at(slot)
            if factor is not None:
                slots[slot] = factors.size()
                factors.add(factor)
        self.isam = gtsam.ISAM2(params)
        self.isam.update(factors, values)
        self._slot = {landmark: slots[slot] for landmark, slot in self._slot.items()}
        before = self.poses
        for number in range(1, max_updates + 1):
            self.isam.update()
            now = self.poses
            moved = now - before
            moved[:, 2] = wrap(moved[:, 2])
            if np.abs(moved).max() < tolerance:
                return number
            before = now
        return max_updates

    @property
    def poses(self) -> Array:
        """The estimate of all poses so far, (t+1, 3)."""
        values = self.isam.calculateEstimate()
        at = [values.atPose2(_pose(k)) for k in range(self.num_poses)]
        return np.array([(pose.x(), pose.y(), pose.theta()) for pose in at])

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)} of landmark nodes; empty with virtual edges."""
        if not self.edges.startswith("landmark"):
            return {}
        values, found = self.isam.calculateEstimate(), {}
        for landmark, (_, seen) in sorted(self._seen.items()):
            if len(seen[0]) == 3:
                pose = values.atPose2(_landmark(self._numbers[landmark]))
                found[landmark] = np.array([pose.x(), pose.y(), pose.theta()])
            else:
                found[landmark] = values.atPoint2(_landmark(self._numbers[landmark]))
        return found


def solve_online(
    log: Log,
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    edges: str = "virtual+motion",
    weight: str = "pairs",
    motion_weight: float = 1.0,
    kernel: Kernel | str | None = None,
    dimensions: int | None = None,
    settle: bool = False,
    callback: Callable[[IncrementalSmoother], None] | None = None,
) -> Solution:
    """Go through a log step by step with ISAM2, and return where it is at the end.

    Args:
        log: with controls.
        motion, sensor, edges, weight, motion_weight, kernel: see `IncrementalSmoother`.
        dimensions: 2 ignores psi.
        settle: relinearise everything at the end, to the batch answer.
        callback: called after each step.

    Raises:
        GraphError: the log has no controls, or what it asks for does not go online.
        OptionError: an option has an impossible value.

    ``converged`` says whether everything was relinearised until nothing moved; without ``settle`` nothing is iterated.
    """
    common: dict[str, Any] = {
        "motion": motion, "sensor": sensor, "edges": edges, "weight": weight, "motion_weight": motion_weight,
        "kernel": kernel,
    }  # fmt: skip
    if edges not in EDGES:
        raise GraphError(f"isam2 needs motion edges: edges must be {' or '.join(EDGES)}, not {edges!r}")
    graph = Graph.from_log(log, **common, dimensions=dimensions)
    seen = log.without_orientation() if dimensions == 2 and log.has_orientation else log
    motion, sensor = motion or log.motion or MotionModel(), graph.sensor
    motions, covariances = log.motions(motion)
    smoother = IncrementalSmoother(log.initial_poses[0], **(common | {"motion": motion, "sensor": sensor}))
    order = np.argsort(log.steps, kind="stable")
    bounds = np.searchsorted(log.steps[order], np.arange(log.num_poses + 1))
    begin = time.perf_counter()
    for step in range(log.num_poses):
        if step:
            smoother.move_by(motions[step - 1], covariances[step - 1])
        now = order[bounds[step] : bounds[step + 1]]
        smoother.observe(seen.landmarks[now], seen.sightings[now])
        smoother.update()
        if callback is not None:
            callback(smoother)
    updates, reason, settled = log.num_poses, "went over the log once", not settle
    if settle:
        last = smoother.settle()
        updates, settled = updates + last, last < SETTLE_UPDATES
        reason = f"went over the log once, and relinearised everything {last} times at the end"
    state = graph.initial.copy()
    state[: log.num_poses] = smoother.poses
    for row, landmark in enumerate(graph.landmark_ids.tolist(), start=log.num_poses):
        state[row, : graph.landmark_dimension] = smoother.landmarks[landmark]
    return make_solution(
        graph, state, step_norms=[], costs=[], converged=settled, reason=reason, seconds=time.perf_counter() - begin,
        solver="isam2", notes=(f"took {updates} updates",),
    )  # fmt: skip


def _pose(step: int) -> int:
    return gtsam.symbol("x", step)


def _landmark(number: int) -> int:
    return gtsam.symbol("m", number)
