"""The online solver of the project: a minimum of J over all edges so far after every call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ..edges import ANCHOR_INFORMATION
from ..edges.robust import Kernel, code_and_width
from ..engine import engine
from ..errors import GraphError
from ..errors.checks import check_count, check_positive
from ..graph.landmark_map import LandmarkMap, as_map
from ..linear.precision import inverses
from ..models import SensorModel
from ..se2 import Array
from .backend import Backend, Relation, information_of

#: kinds of edges: to a new pose, a sighting of a landmark, another relation of poses
MOTION, SIGHTING, RELATION = range(3)
#: the most passes of one update, after which the batch solver takes over
PASSES = 15
#: the standard deviation [m, rad] of landmarks that are exact in a map
EXACT = 1e-5
#: the part of J below which updates leave it
TOLERANCE = 3e-8
#: the fewest steps from one pose that stays a node, with a lag, to the next
STRETCH = 20


class OwnBackend(Backend):
    """The nodes and edges of an `OnlineSolver` in the engine; see `engine/include/vmslam/online`.

    The estimate follows the nearest minimum from one update to the next, and `converged` says whether it was reached.
    Only those nodes that a change concerns are eliminated again.

    Args:
        start, sensor, kernel: checked by `OnlineSolver`.
        tolerance: an update ends where the next pass would lower J by less than this part of it; default: `TOLERANCE`, and
            a thirtieth of it with a lag, because later steps cannot correct what a prior was made of. Together with what
            passes leave out, J was at most 3e-7 above that of the batch solver at the steps that were compared,
            but for one that has a lower minimum next to it (`docs/benchmarks.md`).
        lag: poses that are older than so many steps are final. They are marginalised: their edges, at their last
            linearisation and with their last robust weights, become a dense prior on what they are tied to. Landmarks stay
            nodes, and so does one pose in each stretch of ``lag`` steps, at least `STRETCH`, in which landmarks were new:
            the prior of a stretch is relative to it. None keeps all poses.
        map: landmarks that are known beforehand, in a form that `Graph.from_log` takes; exact ones have a standard deviation
            of `EXACT`. Sightings have psi where all its landmarks have headings, and else not. Give ``start`` in its frame.
        start_covariance: (3, 3) of the first pose; default: it is anchored. After a first fix, four times its covariance.

    Raises:
        OptionError: an option has an impossible value.
    """

    def __init__(
        self,
        start: Array,
        sensor: SensorModel,
        kernel: Kernel | None,
        *,
        tolerance: float | None = None,
        lag: int | None = None,
        map: Any = None,
        start_covariance: ArrayLike | None = None,
    ) -> None:
        if tolerance is None:
            tolerance = TOLERANCE if lag is None else TOLERANCE / 30
        check_positive(tolerance=tolerance)
        if lag is not None:
            check_count(lag=lag)
            check_positive(lag=lag)
        self._sensor, self._kernel, self.lag = sensor, kernel, lag
        self.system = engine.OnlineSystem(tolerance, PASSES)
        #: the nodes of the poses that are not final, and the values of those that are
        self._poses: list[int] = [self.system.add_node()]
        self._final = np.zeros((64, 3))
        self.num_final = 0
        self._landmarks: dict[int, int] = {}
        #: the number of landmarks when a final pose was kept last
        self._mapped = 0
        self.columns: int | None = None
        held = ANCHOR_INFORMATION if start_covariance is None else information_of(start_covariance)
        self.system.add_prior([0], start, np.ascontiguousarray(held), False)
        self.system.solve(self._poses, self._poses)
        if map is not None:
            known = as_map(map)
            self.begin_with(known, 3 if known.oriented else 2)

    def begin_with(self, known: LandmarkMap, columns: int) -> None:
        """Add the landmarks of a map as nodes with their priors, for sightings of ``columns`` values."""
        ids, places, information = _priors_of(known, columns)
        self.columns = columns
        self._use_kernel(columns)
        self._landmarks = {j: self.system.add_node() for j in ids}
        nodes = list(self._landmarks.values())
        if known.joint is not None:
            self.system.add_prior(nodes, places, np.ascontiguousarray(information), columns == 2)
        else:
            # one prior of all of them would tie them together
            for k, node in enumerate(nodes):
                own = np.ascontiguousarray(information[3 * k : 3 * k + 3, 3 * k : 3 * k + 3])
                self.system.add_prior([node], places[k], own, columns == 2)
        self.system.solve(nodes, self._poses)

    def _use_kernel(self, dimension: int | None) -> None:
        """Set the robust kernel of sightings with residuals of a dimension; none as long as there are no sightings."""
        kernel, gain = None, 1.0
        if self._kernel is not None and dimension is not None:
            kernel = self._kernel.of_dimension(dimension)
            gain = kernel.information_per_weight(dimension)
        self.system.use_kernel(*code_and_width(kernel), gain)

    # -- measurements ------------------------------------------------------------------------------------------------

    def relate(self, relation: Relation) -> None:
        self.update(relation)

    def observe(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        # a range beyond floating point has no inverse covariance, and is refused for that
        with np.errstate(over="ignore", invalid="ignore"):
            measured, covariances = self._sensor.places(sightings)
        self.update(None, pose, ids, measured, inverses(covariances, "sighting", "check the noise of the sensor"))

    def update(
        self,
        relation: Relation | None,
        pose: int = 0,
        landmarks: Sequence[int] = (),
        measured: Array | None = None,
        information: Array | None = None,
    ) -> None:
        """Add a relation, and landmarks measured in the axes of a pose (K, 2 or 3) with their information; then solve.

        Raises:
            GraphError: a pose or landmark is not determined. Nothing is added then.
        """
        system, k, moved = self.system, len(landmarks), int(relation is not None)
        known, poses, columns = system.num_nodes, len(self._poses), self.columns
        ends, kinds = np.empty((moved + k, 2), np.int32), np.empty(moved + k, np.int8)
        z, W, rows = np.zeros((moved + k, 3)), np.zeros((moved + k, 6)), np.full(moved + k, 3, np.int8)
        fresh: list[int] = []
        if relation is not None:
            first, second, z[0], omega = relation
            if created := max(first, second) == self.num_poses:
                self._poses.append(system.add_node())
            ends[0] = self._node(first), self._node(second)
            kinds[0], W[0] = MOTION if created and first < second else RELATION, _packed(omega)
        if k:
            assert measured is not None and information is not None
            d = measured.shape[1]
            if columns is None:
                self.columns = d
                self._use_kernel(d)
            for row, landmark in enumerate(landmarks, start=moved):
                end = self._landmarks.get(landmark)
                if end is None:
                    end = self._landmarks[landmark] = system.add_node()
                    fresh.append(landmark)
                ends[row] = self._node(pose), end
            kinds[moved:], rows[moved:], z[moved:, :d] = SIGHTING, d, measured
            W[moved:, : 3 if d == 2 else 6] = _packed(information)
        if not system.add(known, ends, kinds, rows, z, W, self._poses[-1:]):
            for landmark in fresh:
                del self._landmarks[landmark]
            del self._poses[poses:]
            if columns is None:
                self.columns = None
                self._use_kernel(None)
            raise GraphError("the call leaves a pose or landmark undetermined, so that nothing was added")
        while self.lag is not None and len(self._poses) > self.lag + 1:
            self._marginalize()

    def _marginalize(self) -> None:
        """Make the oldest pose final."""
        if self.num_final == len(self._final):
            self._final = np.concatenate([self._final, np.zeros_like(self._final)])
        oldest = self._poses.pop(0)
        # where the map grows, one at intervals stays a node: what others leave is then relative to a pose nearby
        due = self.num_final % max(self.lag or 0, STRETCH) == 0
        if due and (self.num_final == 0 or len(self._landmarks) > self._mapped):
            self._mapped = len(self._landmarks)
            self._final[self.num_final] = self.system.values([oldest])[0]
        else:
            self._final[self.num_final] = self.system.marginalize(oldest, self._poses[-1:])
        self.num_final += 1
        if self.system.crowded():
            number = self.system.renumber()
            self._poses = [number[node] for node in self._poses]
            self._landmarks = {key: number[node] for key, node in self._landmarks.items()}

    def _node(self, pose: int) -> int:
        return self._poses[pose - self.num_final]

    def relinearize(self) -> None:
        self.system.relinearize(self._poses[-1:])

    # -- estimates ---------------------------------------------------------------------------------------------------

    @property
    def num_poses(self) -> int:
        return self.num_final + len(self._poses)

    @property
    def landmark_ids(self) -> Sequence[int]:
        return list(self._landmarks)

    @property
    def passes(self) -> int:
        """The number of passes of the last update: solutions of the tree after edges were evaluated again."""
        return int(self.system.passes)

    @property
    def converged(self) -> bool:
        # otherwise neither the passes nor those after a batch solution ended
        return bool(self.system.converged)

    @property
    def cost(self) -> float:
        return float(self.system.cost())

    @property
    def pose(self) -> Array:
        return np.asarray(self.system.values(self._poses[-1:])[0])

    @property
    def poses(self) -> Array:
        self.system.complete()
        return np.concatenate([self._final[: self.num_final], self.system.places(self._poses)])

    @property
    def landmarks(self) -> dict[int, Array]:
        x = self.system.values(list(self._landmarks.values()))
        return {key: row[: self.columns] for key, row in zip(self._landmarks, x, strict=True)}

    def covariance(self, poses: Sequence[int], landmarks: Sequence[int]) -> Array:
        nodes = [*map(self._node, poses), *(self._landmarks[key] for key in landmarks)]
        block = self.system.covariance(nodes, self._poses[-1:])
        if block is None:
            raise GraphError("there is no covariance: the edges do not determine all nodes to double precision")
        ends = 3 * np.arange(len(poses), len(nodes))[:, None] + np.arange(self.columns or 2)
        kept = np.concatenate([np.arange(3 * len(poses)), ends.ravel()])
        return np.asarray(block[np.ix_(kept, kept)])


def _priors_of(known: LandmarkMap, columns: int) -> tuple[list[int], Array, Array]:
    """The ids, places (K, 3) and information (3K, 3K) of the landmarks of a map, with ``columns`` coordinates each."""
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
    return ids, places, information


def _packed(information: Array) -> Array:
    """The entries (..., 3 or 6) of symmetric matrices as in `edges::Symmetric`."""
    if information.shape[-1] == 2:
        return information[..., [0, 0, 1], [0, 1, 1]]
    return information[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
