"""`Solution`: what every solver of a graph returns, and the map that it leaves for other logs.

The map has the joint covariance of its landmarks. The inverse of that covariance is the Schur complement of all poses in
Omega: all that the log says about the landmarks, at the linearisation of the solution. A graph of another log with this prior
has the same solution as one of both logs together, as far as they are linear.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from numbers import Integral
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..edges import LandmarkSightings, SightingEdges
from ..errors import GraphError, OptionError, checks, quoted
from ..graph import Graph
from ..graph.transform import with_landmark_nodes
from ..identification.declared import ParameterEstimate
from ..linear.cholesky import FactorizationError
from ..log import Log
from ..maps.landmark_map import LandmarkMap
from ..maps.stretch import Stretch
from ..maps.tracker import beyond, inflation, presence
from ..metrics import pose_nees
from ..se2 import Array, difference, wrap
from . import contradictions
from .certificate import Certificate, prove
from .iteration import Run
from .joint import motion_edges
from .position_errors import doubt_of_frame, doubt_of_positions, with_lasting_errors
from .scan_errors import errors_of_scans
from .uncertainty import Uncertainty, doubts, ids_of, shaped

#: above so many numbers of the solves that joint covariances take (400 MB), each landmark has only its own
MAX_JOINT_NUMBERS = 50_000_000


def _datum_of(graph: Graph) -> Array | None:
    """The datum of the frame of a graph: that of its map, or else of its absolute positions."""
    if graph.map is not None:
        return graph.map.datum
    return None if graph.log is None or graph.log.positions is None else graph.log.positions.datum


def solved_map(graph: Graph, state: Array, uncertainty: Uncertainty) -> LandmarkMap:
    """The map at a solution (n, 3), in the frame of the graph: that of its map, or else of its absolute positions.

    Landmarks of the graph's own map that are exact stay so. Graphs without landmark nodes get them: their covariances then
    count each sighting once, also where the weight "pairs" counts it more often.

    Raises:
        OptionError: the graph has no landmarks. GraphError: its edges do not determine them.
    """
    log = graph.log
    if not len(graph.landmark_ids):
        if log is None or not len(graph.sighting_rows) or graph.sighted is None:
            raise OptionError("the solution has no map: its graph has no landmark nodes and no edges from sightings")
        graph, state = _with_nodes(graph, log, state)
        uncertainty = Uncertainty(graph, state)
    poses, d = len(graph.steps), graph.landmark_dimension
    free = np.setdiff1d(np.arange(poses, graph.num_nodes), graph.fixed)
    places = state[free, :d].copy()
    places[:, 2:] = wrap(places[:, 2:])
    ids = graph.landmark_ids[free - poses].tolist()
    known = LandmarkMap({}, datum=_datum_of(graph)) if graph.map is None else graph.map
    if 9 * len(free) * graph.num_nodes <= MAX_JOINT_NUMBERS and len(free):
        kept = np.tile(np.arange(3) < d, len(free))
        found = known.updated(ids, places, uncertainty.joint(free)[np.ix_(kept, kept)])
    else:
        of_each = zip(ids, places, uncertainty.diagonal[free, :d, :d])
        alone = {j: known.among([j]).updated([j], place[None], C) for j, place, C in of_each}
        means = dict(known) | {j: each[j] for j, each in alone.items()}
        covariances = known.covariances | {j: each.covariances[j] for j, each in alone.items()}
        found = LandmarkMap(
            means, covariances, classes=known.classes, correlated=known.correlated or len(free) > 1, datum=known.datum
        )
    found.classes |= _classes(log)
    return found


def _with_nodes(graph: Graph, log: Log, state: Array) -> tuple[Graph, Array]:
    """The graph with landmark nodes in place of virtual-motion or marginal edges, and a state of all its nodes."""
    sighted = next(family for family in graph.families if isinstance(family, LandmarkSightings))
    nodes = with_landmark_nodes(graph)
    assert nodes is not None
    ids = np.unique(log.landmarks[graph.sighting_rows])
    marks = sighted.marginal.landmarks(state, state)
    return replace(nodes, landmark_ids=ids), np.concatenate([state, marks])


def _classes(log: Log | None) -> dict[int, str | int]:
    """The class that most sightings of each landmark have, where the log has classes."""
    if log is None or log.classes is None:
        return {}
    seen: dict[int, Counter[str | int]] = {}
    known = log.classified
    for j, kind in zip(log.landmarks[known].tolist(), log.classes[known].tolist()):
        seen.setdefault(j, Counter())[kind] += 1
    return {j: kinds.most_common(1)[0][0] for j, kinds in seen.items()}


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a solver on a graph, converged or not.

    The arrays are read-only. Methods name a pose by its id: the step for the graph of a log, the number in the file for a
    pose graph.

    Attributes:
        poses: (T+1, 3) [m, m, rad], headings in [-pi, pi); for a pose graph one row per pose id, by increasing id.
        estimated: (T+1,) bool; False for poses that are not part of the graph: their rows hold the initial guess.
        landmarks: {id: (x, y) or (x, y, heading)}; landmark nodes, or the map that `estimate_map` makes from the poses,
            with the graph's robust kernel, its trust in the sightings and their noise.
        cost: J at the solution, the sum of e' Omega e (without a factor 1/2), with the priors of estimated parameters; NaN
            with a lag, see `solve_online`.
        costs: J before the first step and after each one, as far as the solver reports it.
        iterations: the number of steps taken.
        step_norms: (iterations,), the Euclidean norm of each whole correction vector.
        converged: whether a stop rule was met; never True for a run that diverged, could not lower J, or took all its
            iterations. The solution is then a stationary point, which may be a local minimum.
        reason: one sentence on why the iteration ended.
        seconds: time of the solution [s]: the choice of a start and the iteration, without the proof.
        solver: the name of the solver.
        state: (n, 3) the values of the graph's nodes.
        notes: remarks on the graph and the solver, one sentence each.
        trust: (M,) the trust in each sighting of the log, from 0 to 1, where the method "gnc" determined it; NaN for
            sightings that the graph does not use. None for other solvers.
        other_trust: the same for {"relations": (R,), "positions": (N,)}, as far as the graph has them. In a pose graph the
            relations are its loop closures, in their order.
        graph: the graph that was solved, with the final trust in its sightings.
        scan_errors: (3, 3) the covariance, diagonal, in the robot's axes, of the error that all sightings of a scan have in
            common, as far as the log surely shows one (`solvers.scan_errors`), else zero. The noise models do not have it.
    """

    poses: Array
    estimated: np.ndarray
    landmarks: dict[int, Array]
    cost: float
    costs: Array
    iterations: int
    step_norms: Array
    converged: bool
    reason: str
    seconds: float
    solver: str
    state: Array
    notes: tuple[str, ...] = ()
    trust: Array | None = None
    other_trust: dict[str, Array] = field(default_factory=dict)
    graph: Graph | None = None
    scan_errors: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        checks.make_read_only(self, "poses", "estimated", "costs", "step_norms", "state", "trust", "scan_errors")
        for place in self.landmarks.values():
            place.flags.writeable = False

    def __repr__(self) -> str:
        """One line: solver, outcome, cost and sizes."""
        outcome = "converged" if self.converged else "not converged"
        if self.iterations:
            outcome += f" after {self.iterations} iterations"
        return checks.singular(
            f"<Solution by {self.solver}: {outcome}, J = {self.cost:.6g}, {len(self.poses)} poses, "
            f"{len(self.landmarks)} landmarks, {self.seconds:.3g} s>"
        )

    @cached_property
    def certificate(self) -> Certificate:
        """Whether the solution is proven to be the global minimum of J, and how far below J any state may lie at most.

        Computed at the first use. Estimated parameters are held at their values, which the status states: a lower J with
        other values is not excluded. The status of a run that has not converged is "not proven", also where the bound is
        tight.
        """
        return prove(self._solved_graph, self.state).of_run(self.converged, self.reason)

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Covariances in world axes (x, y, theta): blocks of Omega^-1.

        With a robust kernel they are those of the robust estimate; see `Graph.information`. Those of poses contain
        `scan_errors`.

        Args:
            poses: the id of a pose, which gives (3, 3), or a list of P ids, which gives (P, 3, 3). An id is the step for
                the graph of a log, the number in the file for a pose graph.
            landmarks: the id of a landmark, which gives (d, d), d = 2 or 3, or a list of L ids, which gives (L, d, d). For
                a map made from the poses they are those given the poses.
            joint: return one matrix (3 P + d L, 3 P + d L) of poses and landmark nodes, poses first, instead of a block
                for each. Without it, poses and landmarks together give a pair (blocks of poses, blocks of landmarks).

        Without arguments, the covariances of all rows of ``poses``, (T+1, 3, 3); NaN where a pose is not estimated.

        Raises:
            OptionError: there is no such pose or landmark, or the graph does not estimate it.
            GraphError: the edges do not determine the poses.
        """
        if poses is None and landmarks is None and not joint:
            blocks = np.full((len(self.poses), 3, 3), np.nan)
            blocks[self.estimated] = self._uncertainty.of_poses
            return blocks
        graph = self._solved_graph
        if poses is None and landmarks is None:
            poses = graph.pose_ids
        nodes = [self._node(id) for id in ids_of("poses", poses)]
        ids, first, d = ids_of("landmarks", landmarks), len(graph.steps), graph.landmark_dimension
        if unknown := [id for id in ids if id not in self.landmarks]:
            raise OptionError(f"there is no landmark {unknown[0]} in the solution")
        if not joint:
            of_landmarks = [self.landmark_covariances[id] for id in ids]
            return shaped(poses, landmarks, [self._uncertainty.of_poses[node] for node in nodes], of_landmarks, d)
        if ids and not len(graph.landmark_ids):
            message = f"landmark {ids[0]} is no node of this graph; edges='landmark+motion' makes nodes of landmarks"
            raise OptionError(message)
        if not nodes and not ids:
            return np.zeros((0, 0))
        sizes = [3] * len(nodes) + [d] * len(ids)
        nodes += [first + int(np.searchsorted(graph.landmark_ids, id)) for id in ids]
        different, places = np.unique(nodes, return_inverse=True)
        rows = np.concatenate([3 * place + np.arange(size) for place, size in zip(places, sizes)])
        return self._uncertainty.joint(different)[np.ix_(rows, rows)]

    @cached_property
    def landmark_covariances(self) -> dict[int, Array]:
        """{id: (2, 2) or (3, 3)}: marginal covariances of landmark nodes; for a map from the poses, given the poses."""
        if isinstance(self.landmarks, LandmarkMap):
            return self.landmarks.covariances
        if not self.landmarks:
            return {}
        graph = self._solved_graph
        blocks = self._uncertainty.diagonal[len(graph.steps) :]
        d = graph.landmark_dimension
        return {j: block[:d, :d].copy() for j, block in zip(self.landmarks, blocks)}

    @cached_property
    def map(self) -> LandmarkMap:
        """The map with the joint covariance of its landmarks, to localise other logs in; see `solved_map`.

        Raises:
            OptionError: the solution has no landmarks. GraphError: the edges do not determine them.
        """
        return solved_map(self._solved_graph, self.state, self._uncertainty)

    @property
    def datum(self) -> Array | None:
        """Latitude, longitude [degrees, WGS 84] and height [m] of the origin of poses and landmarks; None where not known."""
        return None if self.graph is None else _datum_of(self.graph)

    def nees(self, true_poses: ArrayLike) -> Array:
        """The normalised estimation error squared e' P^-1 e / 3 of every pose, (T+1,); 1 on average if consistent.

        The poses are not aligned: the truth must be in the frame of the graph. NaN where the truth is unknown, or the
        pose is not estimated or fixed. `metrics.pose_nees` has the source.

        Raises:
            GraphError: the edges do not determine the poses.
        """
        return pose_nees(difference(self.poses, true_poses), self.covariance())

    def joint_nees(self, true_poses: ArrayLike) -> float:
        """e' Omega e / (3 T) of all poses together but the first, given the first; 1 on average if consistent.

        Landmark nodes and estimated parameters are eliminated, so that their uncertainty counts; `scan_errors` do not count.
        The truth must be in the frame of the graph, and known for all its poses. NaN for a single pose.
        """
        graph = self._solved_graph
        errors = difference(self.state[: len(graph.steps)], np.asarray(true_poses, dtype=float)[graph.steps])
        return self._uncertainty.joint_square(errors) / errors[1:].size if len(errors) > 1 else np.nan

    @property
    def residual_inflation(self) -> float:
        """By how much the variances of sightings are larger than the noise models say, at least 1; from their median.

        Raises:
            GraphError: the edges do not determine the poses.
        """
        sighted = next((f for f in self._solved_graph.families if isinstance(f, SightingEdges) and f.count), None)
        if sighted is None or len((edges := sighted.linearize(self.state, self.state)).nodes) != 2:
            return 1.0
        # a residual follows the noise by the covariance of the estimate
        rows, followed = edges.residuals.shape[1], self._uncertainty.of_edges(edges)
        free = rows - np.einsum("eij,eji->e", edges.information, followed)
        return inflation(edges.mahalanobis * rows / np.maximum(free, 0.1 * rows), rows)

    def integrity_risk(self, metres: float, radians: float = np.inf) -> Array:
        """The probability (T+1,) that a pose is off by more than the bounds; NaN where it is not estimated.

        In a map it counts that the robot may have been elsewhere; without one, errors are those against the first pose.
        Covariances grow where residuals are larger than the noise models say. `maps.tracker` has the equations. It is as
        right as the map's covariances, which `solve` widens where most landmarks contradict them (``notes``). A map of
        another drive needs its joint covariance; as "own" or "fixed" (`LandmarkMap.used_as`) too little is said.

        Args:
            metres: the bound on the position.
            radians: the bound on the heading.

        Raises:
            OptionError: a bound is not positive. GraphError: the edges do not determine the poses.
        """
        graph, covariances = self._solved_graph, self.covariance() * self.residual_inflation
        log, moved, sensor = graph.log, motion_edges(graph), graph.sensor
        risk = np.full(len(self.poses), np.nan)
        risk[self.estimated] = beyond(covariances[self.estimated], metres, radians)
        if graph.map and log is not None and moved is not None and sensor is not None:
            noise = np.linalg.inv(moved.information)
            drive = Stretch(log.name, moved.measured, noise, log.steps, log.landmarks, log.sightings, sensor)
            risk = 1 - presence(drive, self.poses, graph.map) * (1 - risk)
        return risk

    @cached_property
    def expected_ate(self) -> float:
        """The ATE [m] that the covariances predict, with the uncertainty of biases: the truth is not needed.

        It is as right as the noise models are. `Uncertainty.expected_ate` has the equation.

        Raises:
            GraphError: the edges do not determine the poses.
        """
        return self._uncertainty.expected_ate(len(self._solved_graph.steps))

    @cached_property
    def parameters(self) -> ParameterEstimate | None:
        """The parameters of vehicle and sensor that the graph estimates, with their covariance; None for none.

        Raises:
            GraphError: the edges do not determine them.
        """
        unknown = None if self.graph is None else self.graph.parameters
        if unknown is None:
            return None
        priors = zip(unknown.names, unknown.means.tolist(), unknown.deviations.tolist())
        return ParameterEstimate(
            unknown.names, unknown.values, self._uncertainty.of_parameters,
            {name: (mean, deviation) for name, mean, deviation in priors if np.isfinite(deviation)},
            doubts(self._solved_graph, self.state, self._uncertainty),
        )  # fmt: skip

    @property
    def _solved_graph(self) -> Graph:
        if self.graph is None:
            raise OptionError(f"the solver {self.solver} left no graph to take covariances from")
        return self.graph

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        return Uncertainty(self._solved_graph, self.state, self.scan_errors)

    def _node(self, id: int) -> int:
        """The node of a pose."""
        graph, whole = self._solved_graph, isinstance(id, Integral)
        ids = graph.pose_ids
        matches = np.flatnonzero((ids == id) & whole)
        if len(matches):
            return int(matches[0])
        if graph.log is None:
            what = f"{len(ids)} whole numbers from {ids.min()} to {ids.max()}, such as {', '.join(map(str, ids[:3]))}"
        elif whole and 0 <= id < len(self.poses):
            raise OptionError(f"pose {id} is not part of the graph, so it has no covariance")
        else:
            what = f"the steps of the log, 0 to {len(self.poses) - 1}"
        raise OptionError(f"there is no pose {quoted(id)}; the ids of the poses are {what}")


def make_solution(
    graph: Graph,
    run: Run,
    solver: str,
    seconds: float,
    *,
    notes: tuple[str, ...] = (),
    cost: float | None = None,
    certificate: Certificate | None = None,
) -> Solution:
    """The `Solution` of a graph from the run of a solver.

    Its ``cost`` and ``certificate`` are taken over where the solver knows them.
    """
    state = run.state
    if graph.kernel is not None and not run.converged:
        notes += (
            f"with the kernel {graph.kernel.name} solvers may converge slowly where many sightings are wrong: raise "
            "max_iterations of solve, or use its method gnc (kernel='gnc' of run), which decides which sightings are wrong",
        )
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    cost = graph.cost(state) if cost is None else cost
    landmarks: dict[int, Array] = {}
    if len(graph.landmark_ids):
        nodes = state[len(graph.steps) :, : graph.landmark_dimension].copy()
        if graph.landmark_dimension == 3:
            nodes[:, 2] = wrap(nodes[:, 2])
        landmarks = dict(zip(graph.landmark_ids.tolist(), nodes))
    elif graph.log is not None and np.all(np.isfinite(poses)):
        landmarks = graph.map_from(poses)
    solution = Solution(
        poses, estimated, landmarks, cost, np.array([*run.costs, cost]), len(run.step_norms), np.array(run.step_norms),
        run.converged, run.reason, seconds, solver, state, notes=(*graph.notes, *notes), graph=graph,
    )  # fmt: skip
    if certificate is not None:
        # the value of the cached property, which would repeat the same proof
        solution.__dict__["certificate"] = certificate.of_run(run.converged, run.reason)
    return solution


#: a last step that leaves at least this part of J has hardly lowered it
STILL_FALLS = 0.9
T = TypeVar("T")


def _found(otherwise: T, check: Callable[..., T], *arguments: Any, **options: Any) -> T:
    """What a check of a solution finds; ``otherwise`` where the edges do not determine what it needs."""
    try:
        return check(*arguments, **options)
    except (FactorizationError, GraphError, np.linalg.LinAlgError):
        return otherwise


def _falls(costs: Array) -> bool:
    """Whether J still falls, so that it says little about the measurements."""
    return len(costs) < 2 or bool(costs[-1] < STILL_FALLS * costs[-2])


def doubted(solution: Solution, again: Callable[[Graph], Solution] | None = None) -> Solution:
    """A solution with notes on what contradicts it: its map, its positions, its odometry, and edges among each other.

    Where single landmarks of its map have surely moved, it is solved ``again`` without them in the map, and where most
    contradict it, with the errors that the log shows in them; not without a kernel, where wrong sightings and a biased robot
    look like a wrong map. Where the odometry of a stretch contradicts it, it is solved again with more noise of the controls
    there.
    """
    graph, notes = solution.graph, []
    if graph is None or (not solution.converged and _falls(solution.costs)):
        return solution
    if not solution.converged:
        return replace(
            solution, notes=(*solution.notes, *contradictions.doubt_of_cost(solution._solved_graph, solution.cost))
        )
    # positions of another frame make the map look wrong, and their errors as if they lasted
    if not (of_frame := _found("", doubt_of_frame, graph, solution.state)):
        solution, of_map = contradictions.in_doubted_map(solution, again if graph.reweighted else None)
        notes += of_map
    solution, of_odometry = _found((solution, tuple[str, ...]()), contradictions.without_slips_of, solution, again)
    solution, lasting = _found((solution, ""), with_lasting_errors, solution, again)
    graph = solution._solved_graph
    of_positions = of_frame or _found("", doubt_of_positions, graph, solution.state, lasting=bool(lasting))
    common, of_scans = _found((np.zeros((3, 3)), ""), errors_of_scans, graph, solution.state)
    of_relations = _found("", contradictions.doubt_of_relations, graph, solution.state)
    notes += filter(None, (of_positions, of_relations, lasting, *of_odometry, of_scans))
    notes += contradictions.doubt_of_cost(graph, solution.cost)
    if not notes:
        return solution
    known, noted = vars(solution), replace(solution, notes=(*solution.notes, *notes), scan_errors=common)
    # `replace` does not keep what a solution has already computed
    computed = known.keys() - {each.name for each in fields(solution)}
    # covariances are other ones with errors of scans
    vars(noted).update((name, known[name]) for name in (computed & {"certificate"} if common.any() else computed))
    return noted
