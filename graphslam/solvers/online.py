"""Graph SLAM while the robot drives: GTSAM's ISAM2 on the factors of this package, one step of a log after the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from numbers import Real
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..defaults import suitable_for_isam2
from ..edges.robust import Kernel, kernel_of
from ..errors import GraphError, OptionError, quoted
from ..factors import AnchorFactor, LandmarkFactor, MotionFactor, ObservationFactor, RelativePoseFactor
from ..factors.arguments import PoseLike, numbers, positive_definite
from ..factors.landmark import WEIGHTS
from ..graph import Graph
from ..log import Log
from ..models import RESIDUALS, MotionModel, SensorModel
from ..reading import NO_ID, UNIDENTIFIED
from ..se2 import Array, between, compose
from ..solution import Solution, make_solution

EDGES = ("virtual+motion", "landmark+motion")
#: how ISAM2 eliminates nodes
FACTORIZATIONS = ("cholesky", "qr")
#: the most updates that relinearise everything
SETTLE_UPDATES = 50
#: keys of poses by step, and of landmark nodes in the order of their first sightings (ids may be negative)
X, M = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.M


class IncrementalSmoother:
    """ISAM2 fed step by step: call `move`, `observe`, and `update` when a step is complete.

    With ``edges="landmark+motion"`` every sighting is an `ObservationFactor`. With ``edges="virtual+motion"`` every
    landmark has one `LandmarkFactor` of all its sightings, which a larger one replaces whenever the landmark is seen
    again.

    Args:
        start: the first pose, (3,) or a `gtsam.Pose2`; it is anchored.
        motion, sensor: the noise models; default: the book's.
        edges: "virtual+motion" or "landmark+motion".
        weight: of virtual-motion edges: "pairs", "tempered" or "marginal"; see `Graph.from_log`.
        motion_weight: lambda, the factor on the information of the motion edges.
        kernel: a robust kernel on the sightings of landmark nodes.
        residual: of landmark nodes: "cartesian" or "polar"; see `Graph.from_log`.
        params: of ISAM2; default: `isam2_parameters`.

    Raises:
        OptionError: an option has an impossible value.

    Source: Kaess et al., *iSAM2: incremental smoothing and mapping using the Bayes tree*, IJRR 2012.
    """

    def __init__(
        self,
        start: PoseLike = (0.0, 0.0, 0.0),
        *,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        edges: str = EDGES[0],
        weight: str = WEIGHTS[0],
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        residual: str = RESIDUALS[0],
        params: gtsam.ISAM2Params | None = None,
    ) -> None:
        check_choice("edges", edges, EDGES)
        check_choice("weight", weight, WEIGHTS)
        check_choice("residual", residual, RESIDUALS)
        self.kernel, self.residual = kernel_of(kernel), residual
        if self.kernel is not None and edges.startswith("virtual"):
            raise OptionError("isam2 takes a kernel with edges='landmark+motion' only")
        self.motion, self.sensor = motion or MotionModel(), sensor or SensorModel()
        self.edges, self.weight, self.motion_weight = edges, weight, motion_weight
        params = isam2_parameters() if params is None else params
        # a factor that was removed leaves a slot for the next one
        params.findUnusedFactorSlots = True
        self.isam = gtsam.ISAM2(params)
        self._advice = (
            ""
            if params.getFactorization() == "QR"
            else "; factorization='qr' goes on where information is very unequal"
        )
        self.num_poses = 1
        #: per landmark the keys of the poses that saw it, and its sightings
        self._sightings: dict[int, tuple[list[int], list[Array]]] = {}
        #: per landmark the place of its factor in ISAM2, and the key of its node
        self._slots: dict[int, int] = {}
        self._nodes: dict[int, int] = {}
        self._latest = numbers("start", start, (3,))
        #: since the last update: new factors and values, and landmarks with new sightings
        self._factors, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._changed: dict[int, None] = {}
        self._factors.add(AnchorFactor(X(0), self._latest))
        self._values.insert(X(0), gtsam.Pose2(*self._latest))

    def move(self, control: ArrayLike, dt: float) -> None:
        """The robot drives with a control (nu, omega) [m/s, rad/s] for dt [s]: a new pose and its motion factor.

        Raises:
            OptionError: the control or dt is impossible.
        """
        factor = MotionFactor(*self._ends(), control, dt, self.motion, scale=self.motion_weight)
        self._add_pose(self.motion.f(self._latest, control, dt), factor)

    def move_by(self, motion: PoseLike, covariance: ArrayLike) -> None:
        """The robot has moved: a new pose, measured (3,) from the one before with a covariance (3, 3).

        Raises:
            OptionError: the motion is no pose, or the covariance is not symmetric positive definite.
        """
        z, inverse = numbers("motion", motion, (3,)), np.linalg.inv(positive_definite(covariance, 3, "covariance"))
        factor = RelativePoseFactor(*self._ends(), z, self.motion_weight * (inverse + inverse.T) / 2)
        self._add_pose(compose(self._latest, z), factor)

    def _ends(self) -> tuple[int, int]:
        return X(self.num_poses - 1), X(self.num_poses)

    def _add_pose(self, pose: Array, factor: gtsam.NonlinearFactor) -> None:
        self._latest = pose
        self._factors.add(factor)
        self._values.insert(X(self.num_poses), gtsam.Pose2(*pose))
        self.num_poses += 1

    def observe(self, ids: ArrayLike, sightings: ArrayLike) -> None:
        """The robot sees landmarks ids (K,) as sightings (K, 2 or 3) from its latest pose.

        Raises:
            OptionError: ids and sightings do not match, or a sighting is impossible. Nothing is added then.
            GraphError: virtual-motion edges of sightings without psi, whose information depends on the poses.
        """
        pose = X(self.num_poses - 1)
        for landmark, z in self._checked(ids, sightings):
            if self.edges.startswith("landmark"):
                if landmark not in self._nodes:
                    self._nodes[landmark] = M(len(self._nodes))
                    y = self.sensor.h_inverse(self._latest, z)
                    self._values.insert(self._nodes[landmark], gtsam.Pose2(*y) if len(z) == 3 else gtsam.Point2(*y))
                factor = ObservationFactor(
                    pose, self._nodes[landmark], z, self.sensor, residual=self.residual, kernel=self.kernel
                )
                self._factors.add(factor.fastest())
            keys, before = self._sightings.setdefault(landmark, ([], []))
            keys.append(pose)
            before.append(z)
            self._changed[landmark] = None

    def _checked(self, ids: ArrayLike, sightings: ArrayLike) -> list[tuple[int, Array]]:
        landmarks = np.atleast_1d(np.asarray(ids))
        if landmarks.size == 0:
            if np.size(sightings):
                raise OptionError(
                    f"each sighting needs the id of its landmark, but there are none for {quoted(sightings)}"
                )
            return []
        if landmarks.dtype.kind not in "iu" or landmarks.ndim != 1:
            raise OptionError(f"ids must be whole numbers, not {quoted(ids)}")
        if np.any((landmarks == UNIDENTIFIED) | (landmarks == NO_ID)):
            raise OptionError("isam2 takes identified landmarks only: leave out what nobody has identified")
        z = numbers("sightings", sightings, (2, 3), rows=len(landmarks))
        if np.any(z[:, 0] <= 0):
            raise OptionError(f"the ranges of sightings must be above zero: {quoted(sightings)}")
        columns = next((len(before[0]) for _, before in self._sightings.values()), z.shape[1])
        if columns != z.shape[1]:
            raise OptionError(f"the sightings so far have {columns} numbers each, these have {z.shape[1]}")
        if columns == 2 and self.edges.startswith("virtual") and self.weight != "marginal":
            raise GraphError(
                "without psi the information of pairs depends on the poses, which isam2 cannot re-evaluate; use "
                "weight='marginal' or edges='landmark+motion'"
            )
        return list(zip(landmarks.tolist(), z))

    def update(self) -> None:
        """Pass to ISAM2 what was added since the last update.

        Raises:
            GraphError: GTSAM finds the system indeterminate.
        """
        removed, replaced, first_new = [], [], self._factors.size()
        for landmark in self._changed if self.edges.startswith("virtual") else ():
            keys, sightings = self._sightings[landmark]
            if len(set(keys)) < 2:
                continue
            if landmark in self._slots:
                removed.append(self._slots[landmark])
            self._factors.add(LandmarkFactor(keys, np.array(sightings), self.sensor, weight=self.weight))
            replaced.append(landmark)
        try:
            result = self.isam.update(self._factors, self._values, removed)
        except RuntimeError as error:
            raise GraphError(f"gtsam's isam2 failed: {str(error).strip().splitlines()[0]}{self._advice}") from None
        self._slots |= dict(zip(replaced, list(result.getNewFactorsIndices())[first_new:]))
        self._factors, self._values, self._changed = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
        latest = self.isam.calculateEstimatePose2(X(self.num_poses - 1))
        self._latest = np.array([latest.x(), latest.y(), latest.theta()])

    def settle(self, *, tolerance: float = 1e-9, max_updates: int = SETTLE_UPDATES) -> int:
        """Relinearise everything until no pose moves by ``tolerance``; returns the number of updates.

        ISAM2's own ``force_relinearize`` skips variables that move by less than its threshold. So the Bayes tree is
        built again from the present estimate, with a threshold of zero.
        """
        factors, values = gtsam.NonlinearFactorGraph(self.isam.getFactorsUnsafe()), self.isam.calculateEstimate()
        self.isam = gtsam.ISAM2(isam2_parameters(0.0))
        # the empty slots of factors that were removed are passed on, so that every factor keeps its slot
        self.isam.update(factors, values)
        now = self.poses
        for number in range(1, max_updates + 1):
            self.isam.update()
            before, now = now, self.poses
            if np.abs(between(before, now)).max() < tolerance:
                return number
        return max_updates

    @property
    def poses(self) -> Array:
        """The estimate of all poses so far, (t+1, 3)."""
        # sorted by key: landmarks with a heading come first
        return gtsam.utilities.extractPose2(self.isam.calculateEstimate())[-self.num_poses :]

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)} of landmark nodes; empty with virtual-motion edges."""
        values = self.isam.calculateEstimate()
        points = gtsam.utilities.extractPoint2(values)
        estimates = points if len(points) else gtsam.utilities.extractPose2(values)[: -self.num_poses]
        return dict(sorted(zip(self._nodes, estimates)))


def solve_online(
    log: Log,
    *,
    settle: bool = False,
    callback: Callable[[IncrementalSmoother], None] | None = None,
    threshold: float = 0.01,
    skip: int = 1,
    factorization: str = FACTORIZATIONS[0],
    **options: Any,
) -> Solution:
    """Go through a log step by step with ISAM2, and return the estimate at the end.

    Args:
        log: with controls.
        settle: relinearise everything at the end, which gives the batch solution.
        callback: called after each step.
        threshold, skip, factorization: of ISAM2; see `isam2_parameters`.
        options: those of `Graph.from_log`; see `IncrementalSmoother` for what ISAM2 can do. Edges and kernel that are not
            named are those of `suitable_for_isam2`.

    Raises:
        GraphError: the log has no controls, or ISAM2 cannot do what an option asks for.
        OptionError: an option has an impossible value.

    With ``settle``, ``converged`` says whether the last relinearisation moved nothing. Without it nothing is iterated,
    and ``converged`` is true.
    """
    params = isam2_parameters(threshold, skip, factorization)
    if isinstance(log, Log):
        names = options.get("edges"), options.get("kernel")
        options["edges"], options["kernel"] = suitable_for_isam2(log, *names)
    if options.get("edges", EDGES[0]) not in EDGES:
        raise GraphError(
            f"isam2 needs motion edges: edges must be {' or '.join(EDGES)}, not {quoted(options['edges'])}"
        )
    if options.get("frame", "body") == "world":
        raise GraphError("isam2 cannot re-evaluate the information of the world frame; use frame='body'")
    graph = Graph.from_log(log, **options)
    graph.check_no_parameters("ISAM2")
    assert graph.log is not None
    # with the noise, the ids and without the biases that were estimated, where the noise of the robot was not known
    log = graph.log
    motion, sensor = options.get("motion") or log.motion or MotionModel(), graph.sensor
    motions, covariances = log.motions(motion)
    sightings = log.sightings[:, :2] if options.get("dimensions") == 2 else log.sightings
    own = {name: value for name, value in options.items() if name not in ("frame", "dimensions")}
    smoother = IncrementalSmoother(
        log.initial_poses[0], **(own | {"motion": motion, "sensor": sensor, "params": params})
    )
    order = np.argsort(log.steps, kind="stable")
    bounds = np.searchsorted(log.steps[order], np.arange(log.num_poses + 1))
    begin = time.perf_counter()
    for step in range(log.num_poses):
        if step:
            smoother.move_by(motions[step - 1], covariances[step - 1])
        now = order[bounds[step] : bounds[step + 1]]
        smoother.observe(log.landmarks[now], sightings[now])
        smoother.update()
        if callback is not None:
            callback(smoother)
    updates, reason, settled = log.num_poses, "went through the log once", not settle
    if settle:
        last = smoother.settle()
        updates, settled = updates + last, last < SETTLE_UPDATES
        reason = f"went through the log once, and relinearised everything {last} times at the end"
    state, landmarks = graph.initial.copy(), smoother.landmarks
    state[: log.num_poses] = smoother.poses
    for row, landmark in enumerate(graph.landmark_ids.tolist(), start=log.num_poses):
        state[row, : graph.landmark_dimension] = landmarks[landmark]
    return make_solution(
        graph, state, step_norms=[], costs=[], converged=settled, reason=reason, seconds=time.perf_counter() - begin,
        solver="isam2", notes=(f"took {updates} updates",),
    )  # fmt: skip


def isam2_parameters(
    threshold: float = 0.01, skip: int = 1, factorization: str = FACTORIZATIONS[0]
) -> gtsam.ISAM2Params:
    """Parameters of ISAM2.

    GTSAM's own, a threshold of 0.1 at every tenth update, end up to 0.05 m from the batch solution on the sample log.

    Args:
        threshold: a node is linearised again where one of its coordinates has moved by this much [m, rad].
        skip: only every so many updates.
        factorization: "cholesky", or "qr", which takes two to three times as long and goes on where a little information
            stands beside a lot, and Cholesky finds the system indeterminate.

    Raises:
        OptionError: a value is impossible.
    """
    check_choice("factorization", factorization, FACTORIZATIONS)
    if not (isinstance(threshold, Real) and np.isfinite(threshold) and threshold >= 0):
        raise OptionError(f"threshold must be zero or a positive number, not {quoted(threshold)}")
    if not (isinstance(skip, int) and skip >= 1):
        raise OptionError(f"skip must be a whole number from 1 on, not {quoted(skip)}")
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = skip
    params.setRelinearizeThreshold(float(threshold))
    params.setFactorization(factorization.upper())
    return params
