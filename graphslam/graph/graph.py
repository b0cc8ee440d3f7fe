"""A graph: nodes with initial values, and the families of edges that connect them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar

import numpy as np

from ..edges import (
    AnchorEdges,
    DoubtedEdges,
    EdgeFamily,
    LandmarkPriors,
    LandmarkSightings,
    PositionEdges,
    PriorEdges,
    SightingEdges,
)
from ..edges.base import is_of_engine
from ..edges.robust import Kernel, expected_cost, kernel_of
from ..engine import engine
from ..errors import GraphError, OptionError, quoted
from ..errors.checks import array_of, make_read_only, singular
from ..identification.declared import OF_SIGHTINGS, Parameters, declared
from ..linear.information import BlockSystem, Structure, SystemOfThread
from ..log import Log, check_is_log
from ..log_checks import mistakes_of, single_pose
from ..maps.landmark_map import LandmarkMap, as_map
from ..maps.tracking import in_frame_of
from ..models import EdgeOptions, MotionModel, SensorModel
from ..se2 import Array
from .build import estimate_map, graph_of_log, node_names, noise_in_map, with_closures, with_dimensions
from .defaults import edges_for_map, in_frame_of_positions, notes_on_options, suitable_edges, suitable_kernel


def _none() -> np.ndarray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False, repr=False)
class Graph:
    """Nodes 0 to n-1 with initial values, and edges. Build one with `from_log` or `from_g2o`.

    The first P nodes are poses, the other L landmarks. The arrays are read-only; `with_initial` makes another graph.

    Attributes:
        initial: (n, 3) initial values of the nodes; a landmark without heading uses the first two columns.
        families: the edges, family by family.
        steps: (P,) the row of the trajectory that each pose node belongs to, increasing.
        trajectory: (T+1, 3) the initial guess of all poses, including those that are no nodes.
        pose_ids: (P,) the ids of the poses: the steps of a log, or the ids of a file.
        landmark_ids, landmark_dimension: (L,) the ids of the landmarks; 2, or 3 where these have a heading.
        fixed: (F,) nodes that do not move.
        log, motion, sensor: what the graph was made from, where it was made from a log.
        notes: what the user should know, one sentence each.
        sighting_rows: (M,) the row of the log's sightings that each sighting of the edges comes from.
        parameters: unknown parameters of vehicle and sensor, or None; the edges are those at its values.
        held: parameters that were estimated before and are not solved for; covariances contain their uncertainty.
        map: the map whose landmarks are fixed or have priors, in the place of an anchor; None where there is none.
    """

    initial: Array
    _: KW_ONLY
    families: tuple[EdgeFamily, ...]
    steps: np.ndarray
    trajectory: Array
    pose_ids: np.ndarray
    landmark_ids: np.ndarray = field(default_factory=_none)
    landmark_dimension: int = 2
    fixed: np.ndarray = field(default_factory=_none)
    log: Log | None = None
    motion: MotionModel | None = None
    sensor: SensorModel | None = None
    notes: tuple[str, ...] = ()
    sighting_rows: np.ndarray = field(default_factory=_none)
    parameters: Parameters | None = None
    held: Parameters | None = None
    map: LandmarkMap | None = None
    #: reader and writer of pose-graph files, which `graph.g2o` adds, and the graph of several logs, added by `sessions`
    from_g2o: ClassVar[Callable[..., Graph]]
    save_g2o: ClassVar[Callable[..., None]]
    from_logs: ClassVar[Callable[..., Graph]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "initial", array_of("initial", self.initial))
        if self.initial.ndim != 2 or self.initial.shape[1] != 3:
            raise GraphError(f"initial must have the shape (n, 3), one row for each node, not {self.initial.shape}")
        last, fixed = len(self.initial) - 1, np.asarray(self.fixed)
        if len(wrong := fixed[(fixed < 0) | (fixed > last)]):
            raise GraphError(f"node {wrong[0]} cannot be fixed: the nodes of the graph are 0 to {last}")
        for family in self.families:
            if not isinstance(family, EdgeFamily):
                raise GraphError(f"families must be objects of EdgeFamily, not {quoted(family)}")
            lowest, highest = family.node_range
            if lowest < 0 or highest > last:
                node = lowest if lowest < 0 else highest
                raise GraphError(f"{type(family).__name__} tie node {node}, but the nodes of the graph are 0 to {last}")
        make_read_only(self, "initial", "steps", "trajectory", "pose_ids", "landmark_ids", "fixed", "sighting_rows")

    def __repr__(self) -> str:
        nodes = singular(f"{len(self.steps)} poses, {len(self.landmark_ids)} landmarks")
        edges = ", ".join(f"{family.count} {type(family).__name__}" for family in self.families)
        return f"<Graph: {nodes}; {edges}{f'; kernel {self.kernel.name}' if self.kernel else ''}>"

    def __getstate__(self) -> dict[str, Any]:
        # the system is made again where it is needed: it finds edges by the addresses of their arrays, which another
        # process gives to other arrays, and its factor is many times larger than the graph
        return {name: value for name, value in vars(self).copy().items() if name != "_systems"}

    @classmethod
    def from_log(
        cls,
        log: Log,
        *,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        edges: str | None = None,
        frame: str = "body",
        weight: str = "pairs",
        motion_weight: float = 1.0,
        kernel: Kernel | str | None = None,
        dimensions: int | None = None,
        residual: str = "cartesian",
        estimate: str | Iterable[str] | Mapping[str, float | None] | None = None,
        noise: str | None = None,
        map: LandmarkMap | Mapping[int, Array] | str | PathLike[str] | None = None,
    ) -> Graph:
        """The graph of a log: an anchor at the first node, edges from what was measured, and motion edges where asked for.

        With a map the graph is in its frame, and has no anchor. The first fix needs no start pose (`first_fix`). Absolute
        positions of the log determine the frame, too: then the anchor holds at most the heading of the first pose, where
        they leave the direction open (`graphslam.graph.defaults`).

        Args:
            log: the controls and sightings of the robot.
            motion, sensor: the noise models; default: as ``noise`` says.
            edges: "virtual" (poses that saw nothing are left out), "virtual+motion", or "landmark+motion", in which
                landmarks are nodes and every sighting is one edge. Default: what suits the log, which is "virtual" without
                controls, "virtual+motion" with psi and the noise of the lectures, and "landmark+motion" otherwise.
            frame: "world" (the lectures: information re-evaluated at every step) or "body" (constant information).
            weight: of virtual edges: "pairs" (the book: each of K sightings enters K-1 edges, so a landmark weighs up
                to K/2 times what it should), "tempered" (each pair times 2/K: exact where sightings are alike) or
                "marginal" (the landmark eliminated: each sighting counts once, exactly).
            motion_weight: lambda, the factor on the motion edges.
            kernel: against wrong sightings, relations and positions: `Huber`, `Cauchy`, `GemanMcClure` or their names, or
                "none". Default: what suits the log, "none" where `simulate` made it and "cauchy" otherwise. It acts on every
                pair of "pairs" and "tempered", and on every measurement otherwise. The default width has 95 % of the
                efficiency of least squares. See also `solve` with the method "gnc".
            dimensions: 3: require orientation psi; 2: ignore it; default: use psi where the log has it.
            residual: of landmark nodes: "cartesian" (the sighting as a position in the robot's axes, the landmark's heading
                with it) or "polar" (range and bearing, h(x, m) - z, whose cost has false minima).
            estimate: parameters of vehicle and sensor to estimate with the poses, names of `declared.PARAMETERS`:
                ["wheel_scale", "range_bias"]. "wheel_scale:0.1" gives a prior with this standard deviation about the
                ideal value; {"wheel_scale": 0.1, "range_bias": None} is the same for both. Default: none is estimated.
            noise: "auto": estimate noise and biases of the robot and misread ids from the log, and take them out of it
                (`graphslam.estimate_robot`); "book": the values of the lectures. Default: the models of the log, the book's
                for logs of `simulate`, and else "auto" where the log determines them. Where one of ``motion`` and ``sensor``
                is given, its noise is kept (the place of the sensor is estimated from the given one), and the other one is as
                said here; with both there is nothing left to choose.
            map: a `LandmarkMap`, {id: (x, y)}, the path of its file, or a solution of another log. Its landmarks are nodes:
                without a covariance they are fixed, otherwise they have priors, together where the map has a joint
                covariance. Landmarks that it does not have are added. psi is not used where a fixed landmark that is seen
                has no heading.

        Raises:
            GraphError: the log lacks what the options need, or the edges cannot determine the poses; the message names
                the poses and a remedy.
            OptionError: an option has an impossible value.
        """
        check_is_log(log)
        options = EdgeOptions(edges=edges, frame=frame, weight=weight, motion_weight=motion_weight, residual=residual)
        recorded = with_dimensions(log, dimensions)
        known_map = None if map is None else as_map(map)
        log, motion, sensor, robot = noise_in_map(recorded, known_map, motion, sensor, noise)
        # what was estimated, or why that could not be
        notes = [note for note in log.notes if note not in recorded.notes]
        if robot is not None:
            # noise and biases that were found for numbers read in the wrong way are wrong, too
            notes = [*(each.message for each in mistakes_of(recorded)), *notes]
        if known_map is None:
            notes += [each.message for each in single_pose(log)]
            log = in_frame_of_positions(log)
        else:
            options = replace(options, edges=edges_for_map(log, edges))
            log, known_map, found = in_frame_of(log, known_map, motion=motion, sensor=sensor)
            notes += found
        options = replace(options, edges=options.edges or suitable_edges(log, motion, sensor))
        kernel = suitable_kernel(log) if kernel is None else kernel
        parameters, held = declared(estimate, log, motion, sensor, options), None
        once = options.landmark_nodes or (options.with_motion and weight == "marginal")
        if parameters is None and once and residual == EdgeOptions.residual:
            # edges of single numbers have no derivatives by biases of the sensor
            stated = {k: v for k, v in (log.uncertain or {}).items() if len(log.steps) or k not in OF_SIGHTINGS}
            held = declared(stated, log, motion, sensor, options)
        known = parameters or held
        missing = [name for name in log.uncertain or () if known is None or name not in known.names]
        notes += notes_on_options(log, sensor, options, missing)
        return graph_of_log(
            cls, log, motion=motion, sensor=sensor, options=options, kernel=kernel_of(kernel), landmark_map=known_map,
            notes=notes, parameters=parameters, held=held,
        )  # fmt: skip

    def with_closures(self, kernel: Kernel | str | None = None) -> Graph:
        """The same pose graph with its loop closures as `edges.RelationEdges`, which may be wrong.

        Loop closures are the relative poses that do not lead from a pose to the next one. Their order stays.

        Args:
            kernel: a robust kernel on them, or its name; default: none, so that the cost stays the same.
        """
        return replace(self, families=with_closures(self.families, kernel_of(kernel)))

    def with_initial(self, initial: Array) -> Graph:
        """The same graph with other initial values (n, 3), of the poses and then of the landmarks."""
        values = array_of("initial", initial)
        if values.shape != self.initial.shape:
            raise OptionError(f"initial must have shape {self.initial.shape}, poses first, not {values.shape}")
        if not np.isfinite(values).all():
            raise OptionError("initial must be finite numbers")
        return replace(self, initial=values.copy())

    def with_trust(self, trust: Array) -> Graph:
        """The same graph with another trust (M,) in the sightings of edges, or all `measurements`; see `with_families`."""
        families, start = list[EdgeFamily](), 0
        for f in self.families:
            if isinstance(f, DoubtedEdges) and start < len(trust):
                end = start + f.measurements
                f, start = f.with_trust(trust[start:end]) if end <= len(trust) else f, end
            families.append(f)
        if start != len(trust):
            raise OptionError(
                f"trust has {len(trust)} numbers for {self.measurements} measurements: it needs one for each sighting, or "
                "one for each of `measurements`"
            )
        return self.with_families(families)

    @property
    def measurements(self) -> int:
        """The number of measurements that may be wrong: sightings first, then relations, then positions."""
        return sum(family.measurements for family in self.families if isinstance(family, DoubtedEdges))

    def with_wider_kernel(self, factor: float) -> Graph:
        """The same graph with ``factor`` times the width of its kernels. Both write Omega and xi into one `system`."""
        return self.with_changed(DoubtedEdges, lambda f: replace(f, kernel=f.kernel and f.kernel.scaled(factor**2)))

    def with_noise_at(self, state: Array) -> Graph:
        """The same graph with the noise of the sensor at the sightings that a state (n, 3) predicts; see `with_families`.

        ``solve(graph, range_noise="estimated")`` repeats this. Single ranges and bearings keep their information.
        """
        self._check_states(state)
        return self.with_changed(SightingEdges, lambda f: f.with_noise_at(f.predicted(state)))

    def with_families(self, families: Iterable[EdgeFamily], **others: Any) -> Graph:
        """The same graph with other edges between the same groups of nodes, ``others`` changed; both have one `system`."""
        changed = replace(self, families=tuple(families), **others)
        vars(changed)["_systems"] = self._systems
        return changed

    def with_changed(self, kind: type, change: Callable[[Any], EdgeFamily]) -> Graph:
        """The same graph with other edges in the place of families of one kind; see `with_families`."""
        return self.with_families(change(f) if isinstance(f, kind) else f for f in self.families)

    @property
    def estimated(self) -> Parameters:
        """The parameters of a graph that has some.

        Raises:
            GraphError: it estimates none.
        """
        if self.parameters is None:
            raise GraphError("the graph estimates no parameters: give their names to Graph.from_log (estimate=)")
        return self.parameters

    def check_no_parameters(self, solver: str) -> None:
        """Raise `GraphError` where the graph has parameters, which this solver cannot estimate."""
        if self.parameters is not None:
            raise GraphError(
                f"{solver} cannot estimate parameters ({', '.join(self.parameters.names)}): use solve or solve_with_gtsam"
            )

    @property
    def num_nodes(self) -> int:
        """The number n of nodes."""
        return len(self.initial)

    @property
    def num_edges(self) -> int:
        """The number of edges, anchors not counted."""
        return sum(family.count for family in self.families if not isinstance(family, AnchorEdges))

    @cached_property
    def state_dependent_information(self) -> bool:
        """Whether some information depends on the state, so that it has to be re-evaluated between linear solves."""
        return any(family.state_dependent_information for family in self.families)

    @cached_property
    def kernel(self) -> Kernel | None:
        """The robust kernel of the first edges that have one; None where none do."""
        kernels = (getattr(family, "kernel", None) for family in self.families)
        return next((kernel for kernel in kernels if kernel is not None), None)

    @property
    def reweighted(self) -> bool:
        """Whether some edges have a robust kernel, which re-weights them at every step."""
        return self.kernel is not None

    @property
    def system(self) -> BlockSystem:
        """Omega and xi of this thread: the pattern is made at the first use and shared, the numbers by `linearize`."""
        return self._systems.system

    @cached_property
    def _systems(self) -> SystemOfThread:
        cliques = [family.cliques() for family in self.families]
        made = SystemOfThread(Structure.of_cliques(self.num_nodes, cliques, self.without_heading))
        # of two threads that make one at once, both use the first
        return vars(self).setdefault("_systems", made)

    @property
    def objective(self) -> Any:
        """The edges with the `system`, as the engine iterates them (``engine/include/vmslam/solve/objective.hpp``)."""
        system = self.system
        factor, objective = system.factor_in_engine, system.objectives.get(self)
        # a family in NumPy may refer to its graph, and the engine's objects are unknown to the collector of garbage, which
        # would never free the two
        if objective is None:
            own = [family if is_of_engine(family) else None for family in self.families]
            others = BlockSystem.of_arrays, self.initial.size
            both = zip(self.families, own)
            families = tuple(engine.PythonFamily(f, *others) if e is None else e.in_engine for f, e in both)
            pairs = tuple(_none() if family is None else family.blocks(system) for family in own)
            held = np.ascontiguousarray(self.fixed, dtype=np.int64), self.without_heading
            objective = engine.GraphObjective((families, pairs, system.arrays, held, factor), self.prior_cost)
            objective.state_dependent, objective.reweighted = self.state_dependent_information, self.reweighted
            if None not in own:
                system.objectives[self] = objective
        return objective

    def cost(self, state: Array, reference: Array | None = None) -> float:
        """J = the sum of e' Omega e at a state (n, 3), with state-dependent information taken at ``reference``.

        The priors of the parameters are part of it.
        """
        reference = state if reference is None else reference
        self._check_states(state, reference)
        return sum(family.cost(state, reference) for family in self.families) + self.prior_cost

    @property
    def prior_cost(self) -> float:
        """The part of J from the priors of the parameters at their values; 0 without parameters."""
        return 0.0 if self.parameters is None else self.parameters.prior_cost

    @property
    def without_kernel(self) -> Graph:
        """The same graph with plain squares in place of robust kernels. Both write Omega and xi into one `system`."""
        return self if not self.reweighted else self.with_changed(DoubtedEdges, lambda f: replace(f, kernel=None))

    @cached_property
    def degrees_of_freedom(self) -> int:
        """The independent numbers that the edges measure, minus the unknowns: not above zero where nothing is checked."""
        rows = sum(family.numbers[0] for family in self.families) + self._priors
        of_nodes = 3 * len(self.steps) + self.landmark_dimension * len(self.landmark_ids)
        of_nodes -= self.landmark_dimension * int(np.count_nonzero(self.fixed >= len(self.steps)))
        return rows - of_nodes + self._gauge - len(self.parameters or ())

    @property
    def _gauge(self) -> int:
        """The coordinates held without a measurement: of fixed poses, or one pose, unless a map or positions are there."""
        fixed = 3 * int(np.count_nonzero(self.fixed < len(self.steps)))
        if self.map is not None:
            return fixed
        if not any(isinstance(family, PositionEdges) for family in self.families):
            return max(3, fixed)
        held = [family.information for family in self.families if type(family) is AnchorEdges]
        return fixed + min(3, sum(int(np.linalg.matrix_rank(each).sum()) for each in held))

    @property
    def mapped(self) -> np.ndarray:
        """The landmark nodes that a map gives: those that are fixed, or have priors."""
        of_map = [family.nodes for family in self.families if isinstance(family, (LandmarkPriors, PriorEdges))]
        return np.concatenate([self.fixed[self.fixed >= len(self.steps)], *of_map]).astype(np.int64)

    @property
    def _priors(self) -> int:
        """The number of priors of parameters, each of which measures one number."""
        return 0 if self.parameters is None else int(np.isfinite(self.parameters.deviations).sum())

    @cached_property
    def expected_cost(self) -> float:
        """About what J is at the optimum if the noise models are right: its degrees of freedom.

        Pairs count every sighting of a landmark up to K/2 times, and their J grows likewise.
        """
        rows = sum(family.numbers[0] for family in self.families) + self._priors
        expected = sum(expected_cost(family) for family in self.families) + self._priors
        return expected * max(self.degrees_of_freedom / max(rows, 1), 1e-3)

    def linearize(self, state: Array, reference: Array | None = None) -> tuple[BlockSystem, float]:
        """Omega and xi at a state (n, 3), written into `system`, and the cost J."""
        reference = state if reference is None else reference
        self._check_states(state, reference)
        self.system.clear()
        total = 0.0
        for family in self.families:
            total += family.accumulate(state, reference, self.system)
        self._hold()
        return self.system, total + self.prior_cost

    def information(self, state: Array) -> BlockSystem:
        """The matrix whose inverse is the covariance of the estimate at a state (n, 3), written into `system`.

        Without robust kernels it is Omega. The weight of a kernel is no information: each of its edges enters with
        w Omega_e times `EdgeFamily.information_per_weight`. The covariance is then that of the kernel's estimate
        (the sandwich), up to the difference between an estimate that weighs edges with and without a kernel as the graph does
        and one that weighs them by their efficiencies.
        """
        information = np.zeros_like(self.system.values)
        for family in self.families:
            self.system.clear()
            family.accumulate(state, state, self.system)
            information += family.information_per_weight * self.system.values
        self.system.values[:] = information
        self._hold()
        return self.system

    def _check_states(self, *states: Array) -> None:
        shape = self.initial.shape
        for state in states:
            if getattr(state, "shape", None) != shape:
                raise OptionError(f"the state must have shape {shape}, one row for each node, not {np.shape(state)}")

    def _hold(self) -> None:
        """Take out of the system what does not move: fixed nodes, and the third coordinate of landmarks without one."""
        if len(self.without_heading):
            self.system.rest(self.without_heading, 2)
        if len(self.fixed):
            self.system.hold(self.fixed)

    @property
    def without_heading(self) -> np.ndarray:
        """The landmarks whose third coordinate is not used."""
        flat = len(self.landmark_ids) and self.landmark_dimension == 2
        return np.arange(len(self.steps), self.num_nodes) if flat else _none()

    def names(self, nodes: np.ndarray) -> str:
        """The names of nodes in a sentence: 'poses 3 and 4', 'landmark 7', 'pose 2 and landmark 5'."""
        return node_names(nodes, self.pose_ids, self.landmark_ids)

    @property
    def sighted(self) -> SightingEdges | None:
        """The edges from sightings, or None."""
        return next((family for family in self.families if isinstance(family, SightingEdges)), None)

    def sighting_weights(self, state: Array) -> Array:
        """The weights (M,) that the robust kernel gives the sightings of the edges at a state (n, 3); 1 without a kernel.

        With pairs these are not the weights of the edges: each sighting is compared with the place of its landmark.
        """
        if (family := self.sighted) is None or family.kernel is None:
            return np.ones(0 if family is None else len(family.sightings))
        if isinstance(family, LandmarkSightings):
            squares = family.marginal.squares(state)
        else:
            squares = family.linearize(state, state).mahalanobis
        return family.kernel.weight(squares)

    @property
    def verdict(self) -> tuple[Kernel | None, Array, Array]:
        """The robust kernel on the edges from sightings, the trust (M,) in each sighting of the log, 1 by default, and the
        sightings (M, 2 or 3) at which their noise is evaluated."""
        assert self.log is not None
        trust, noisy = np.ones(len(self.log.steps)), self.log.sightings.copy()
        if (family := self.sighted) is not None:
            trust[self.sighting_rows], noisy[self.sighting_rows] = family.trusted, family.noisy
        return None if family is None else family.kernel, trust, noisy

    def map_from(self, poses: Array) -> LandmarkMap:
        """The map of the log from a trajectory (T+1, 3), with the graph's sensor, kernel, trust and noise."""
        assert self.log is not None
        kernel, trust, noisy = self.verdict
        return estimate_map(self.log, poses, sensor=self.sensor, kernel=kernel, trust=trust, noise_at=noisy)

    def trajectory_of(self, state: Array) -> tuple[Array, np.ndarray]:
        """All poses (T+1, 3) of a state, with the initial guess where a pose is no node, and which ones are (T+1,)."""
        poses, estimated = self.trajectory.copy(), np.zeros(len(self.trajectory), dtype=bool)
        poses[self.steps] = state[: len(self.steps)]
        estimated[self.steps] = True
        return poses, estimated


def check_graph(graph: object, name: str = "graph") -> None:
    """Raise `OptionError` unless the argument ``name`` is a graph; a log, for example, is none."""
    if not isinstance(graph, Graph):
        given = type(graph).__name__
        raise OptionError(f"{name} must be a Graph, not a {given}; Graph.from_log and Graph.from_g2o make graphs")
