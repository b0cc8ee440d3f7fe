"""Pose graphs solved by this solver, GTSAM and g2o: cost by one evaluator, time, and whether each converged.

The peers are GTSAM with its native factors (`gtsam_peer`) and g2o (`g2o_peer`). Each gets the nodes, edges and initial values
of a `Graph` and returns the state at the end. The between factors are GTSAM's own (C++). Their residual is the logarithm of
g2o's error, which is the same close to the optimum but not far from it, so a peer may end at a slightly different point. The
cost of every state is computed by `Graph.cost`.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib import import_module
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import gtsam
import numpy as np

from graphslam import Certificate, Graph, GraphError, OptionError, certify, solve
from graphslam.edges import RelativePointEdges, RelativePoseEdges
from graphslam.se2 import Array, turned_by
from graphslam.solvers.gtsam_factors import from_values, to_gtsam, to_values
from graphslam.solvers.initialize import starting_state

from ..estimators.attempt import rows_of
from ..options import BackendOptions
from ..results import Count, Displayed, jsonable, of_expected

#: every backend stops when a step changes the cost by less than this part of it
COST_TOLERANCE = 1e-9


@dataclass(frozen=True)
class PeerRun:
    """One optimisation: the state (n, 3) at the end, iterations, seconds, how it ended, chi2 before and after steps."""

    state: Array
    iterations: int
    seconds: float
    converged: bool
    reason: str
    costs: tuple[float, ...] = ()


def _check_pose_graph(graph: Graph) -> None:
    """Raise `OptionError` for edges that are not those of a pose graph."""
    for family in graph.families:
        if not isinstance(family, RelativePoseEdges | RelativePointEdges) or family.state_dependent_information:
            raise OptionError(f"{type(family).__name__} do not belong to a pose graph")


def native_gtsam_graph(graph: Graph) -> gtsam.NonlinearFactorGraph:
    """The graph in GTSAM's own factors: BetweenFactorPose2, a stiff prior per fixed node; our factors for points.

    Raises:
        OptionError: the graph has edges that are not those of a pose graph.
    """
    _check_pose_graph(graph)
    factors = gtsam.NonlinearFactorGraph()
    for family in graph.families:
        if isinstance(family, RelativePoseEdges):
            # GTSAM's residual, as that of g2o, is ours turned by R(theta_z)'
            turned = turned_by(family.information, -family.measured[:, 2])
            for i, j, z, omega in zip(family.first.tolist(), family.second.tolist(), family.measured, turned):
                noise = gtsam.noiseModel.Gaussian.Information(omega)
                factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z), noise))
        else:
            # Python evaluates them, with a copy of all values at each call: many in one factor are few calls
            factors.push_back(to_gtsam(replace(graph, families=(family,), fixed=graph.fixed[:0])))
    stiff = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    for node in graph.fixed.tolist():
        factors.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*graph.initial[node]), stiff))
    return factors


def gtsam_peer(damped: bool, graph: Graph, max_iterations: int) -> Callable[[], PeerRun]:
    """GTSAM's Levenberg-Marquardt (damped) or Gauss-Newton."""
    factors, values = native_gtsam_graph(graph), to_values(graph, graph.initial)
    parameters: Any = gtsam.LevenbergMarquardtParams() if damped else gtsam.GaussNewtonParams()
    if damped:
        parameters.setVerbosityLM("SILENT")
    parameters.setMaxIterations(max_iterations)
    parameters.setRelativeErrorTol(COST_TOLERANCE)
    parameters.setAbsoluteErrorTol(0.0)
    kind: Any = gtsam.LevenbergMarquardtOptimizer if damped else gtsam.GaussNewtonOptimizer
    costs = _gtsam_costs(kind(factors, values, parameters), graph, max_iterations)

    def run() -> PeerRun:
        begin = time.perf_counter()
        optimizer = kind(factors, values, parameters)
        try:
            end = optimizer.optimize()
        except RuntimeError as error:
            reason = f"gave up: {str(error).strip().splitlines()[0]}"
            return PeerRun(graph.initial * np.nan, 0, time.perf_counter() - begin, False, reason)
        seconds = time.perf_counter() - begin
        state, iterations = from_values(graph, end), int(optimizer.iterations())
        if iterations >= max_iterations:
            return PeerRun(state, iterations, seconds, False, f"max_iterations = {max_iterations} reached", costs)
        if np.abs(state - graph.initial).max() < 1e-12:
            return PeerRun(state, iterations, seconds, False, "returned the initial values")
        reason = f"the cost changed by less than {COST_TOLERANCE:g} of it"
        return PeerRun(state, iterations, seconds, True, reason, costs)

    return run


def _gtsam_costs(optimizer: Any, graph: Graph, max_iterations: int) -> tuple[float, ...]:
    """The chi2 before and after each iteration, from a run of its own, for the figure."""
    costs, before = [graph.cost(graph.initial)], optimizer.error()
    with suppress(RuntimeError):
        while len(costs) <= max_iterations:
            optimizer.iterate()
            costs.append(graph.cost(from_values(graph, optimizer.values())))
            if abs(before - optimizer.error()) <= COST_TOLERANCE * before:
                break
            before = optimizer.error()
    return tuple(costs)


def g2o_peer(damped: bool, graph: Graph, max_iterations: int) -> Callable[[], PeerRun]:
    """g2o's Levenberg-Marquardt (damped) or Gauss-Newton, with its sparse Cholesky on Eigen, from the package g2opy.

    It has no stop rule here: it executes the smallest number of iterations that reaches its final cost.
    """
    try:
        g2o = import_module("g2opy")
    except ImportError:
        raise OptionError("the backend g2o needs the package g2opy: pip install -e '.[peers]' in the clone") from None
    _check_pose_graph(graph)
    costs, reaches = _smallest_number(g2o, graph, damped, max_iterations)

    def run() -> PeerRun:
        optimizer = _g2o_optimizer(g2o, graph, damped)
        begin = time.perf_counter()
        optimizer.initialize_optimization()
        optimizer.optimize(reaches)
        seconds = time.perf_counter() - begin
        reason = "diverged" if not np.isfinite(costs[-1]) else f"still moving after {max_iterations} iterations"
        if converged := bool(np.isfinite(costs[-1])) and reaches < max_iterations:
            reason = f"{reaches} iterations reach its final cost"
        return PeerRun(_g2o_state(optimizer, graph), reaches, seconds, converged, reason, costs)

    return run


def _smallest_number(g2o: Any, graph: Graph, damped: bool, max_iterations: int) -> tuple[tuple[float, ...], int]:
    """The chi2 before and after each iteration, and the number of iterations after which the stop rule is met."""
    optimizer = _g2o_optimizer(g2o, graph, damped)
    optimizer.set_compute_batch_statistics(True)
    optimizer.initialize_optimization()
    optimizer.optimize(max_iterations)
    costs = [graph.cost(graph.initial), *(float(step.chi2) for step in optimizer.batch_statistics())]
    for count in range(1, len(costs)):
        if not np.isfinite(costs[count]):
            return tuple(costs[: count + 1]), count
        if abs(costs[count - 1] - costs[count]) <= COST_TOLERANCE * costs[count - 1]:
            # the step before the one that changed nothing had already reached it
            return tuple(costs[:count]), max(count - 1, 1)
    return tuple(costs), max_iterations


def _g2o_optimizer(g2o: Any, graph: Graph, damped: bool) -> Any:
    optimizer = g2o.SparseOptimizer()
    solver = g2o.BlockSolverX(g2o.LinearSolverEigenX())
    algorithm = g2o.OptimizationAlgorithmLevenberg if damped else g2o.OptimizationAlgorithmGaussNewton
    optimizer.set_algorithm(algorithm(solver))
    optimizer.set_verbose(False)
    poses = len(graph.steps)
    # g2o reads its own files; there the ids are the numbers of the nodes
    numbered = replace(graph, pose_ids=np.arange(poses), landmark_ids=np.arange(poses, graph.num_nodes))
    with TemporaryDirectory() as folder:
        numbered.save_g2o(path := f"{folder}/graph.g2o")
        optimizer.load(path)
    return optimizer


def _g2o_state(optimizer: Any, graph: Graph) -> Array:
    estimates = [optimizer.vertex(node).estimate() for node in range(graph.num_nodes)]
    poses, places = estimates[: len(graph.steps)], estimates[len(graph.steps) :]
    return np.array([*(pose.to_vector() for pose in poses), *([*place, 0.0] for place in places)])


#: a peer prepares a graph, before the time is measured, and returns a function that optimises it from the start at each call
PEERS: dict[str, Callable[[Graph, int], Callable[[], PeerRun]]] = {
    "gtsam-lm": partial(gtsam_peer, True),
    "gtsam-gn": partial(gtsam_peer, False),
    "g2o-gn": partial(g2o_peer, False),
    "g2o-lm": partial(g2o_peer, True),
}
#: the names of the backends, ours first
BACKENDS = ("graphslam", *PEERS)


@dataclass(frozen=True)
class BackendRow:
    """One backend on one graph.

    Attributes:
        file, backend: which.
        chi2: the cost of the state it ended in, by `Graph.cost`; NaN if it gave up.
        iterations: their number.
        seconds: of the optimisation alone, from initial values to the stop; median of the repetitions; NaN if it was stopped.
        converged: whether its stop rule was met (for a local minimum, too: compare the chi2).
        reason: how it ended.
        trace: (seconds, chi2) after each iteration, for the figure; empty where a backend does not report them.
        chi2_per_dof: chi2 per degree of freedom, about 1 where the information in the file fits the errors.
        native: whether all factors are evaluated by the backend itself. False where GTSAM calls factors in Python, so that
            the time is mostly that of the callbacks.
        certificate: whether the state is proven to be the global minimum of chi2; None if the backend gave up.
        ratio: the time of graphslam over this time, where both reached the best chi2; only in the JSON.
    """

    file: str
    backend: str
    chi2: float
    iterations: Count
    seconds: float
    converged: bool
    reason: str
    trace: tuple[tuple[float, float], ...] = field(default=(), repr=False)
    chi2_per_dof: float | None = None
    native: bool = True
    certificate: Certificate | None = None
    ratio: float | None = None


@dataclass(frozen=True)
class SkippedBackend:
    """A backend that nobody asked for by name and that is not installed, or does not take the graph of a file, and why."""

    file: str
    backend: str
    reason: str


@dataclass(frozen=True)
class BackendComparison(Displayed):
    """The outcome of `compare_backends`.

    Attributes:
        rows: one for each file and solver.
        skipped: the backends that are left out of a file.
    """

    rows: tuple[BackendRow, ...]
    skipped: tuple[SkippedBackend, ...] = ()
    shown: ClassVar = {"geometric_means": "geometric_means"}

    @property
    def geometric_means(self) -> dict[str, float | None]:
        """The geometric mean of `ratio` over the files, `native` rows only."""
        names = dict.fromkeys(row.backend for row in self.rows if row.backend != "graphslam")
        return {name: self.geometric_mean(name) for name in names}

    def best(self, file: str) -> float:
        """The lowest chi2 that any backend reached on a file."""
        return min((r.chi2 for r in self.rows if r.file == file and not math.isnan(r.chi2)), default=math.nan)

    def reached(self, row: BackendRow) -> bool:
        """Whether a row ended at the lowest chi2 of its file, to a thousandth (the residuals of GTSAM differ a little)."""
        return row.converged and row.chi2 <= self.best(row.file) * (1 + 1e-3) + 1e-12

    def ratio(self, row: BackendRow) -> float | None:
        """Seconds of graphslam over those of a row on the same file; None where either did not reach the best chi2."""
        ours = next((r for r in self.rows if r.file == row.file and r.backend == "graphslam"), None)
        if ours is None or not self.reached(ours) or not self.reached(row):
            return None
        return ours.seconds / row.seconds

    def geometric_mean(self, backend: str) -> float | None:
        """The geometric mean of `ratio` over the files on which both reached the best chi2; native rows only."""
        rows = (r for r in self.rows if r.backend == backend and r.native)
        ratios = [ratio for r in rows if (ratio := self.ratio(r)) is not None]
        return math.exp(statistics.fmean(map(math.log, ratios))) if ratios else None

    def to_json(self) -> dict[str, Any]:
        """The comparison as plain data: {"rows": [fields of `BackendRow` and "ratio"], "geometric_means"}."""
        return jsonable(replace(self, rows=tuple(replace(row, ratio=self.ratio(row)) for row in self.rows)))


def compare_backends(
    files: Sequence[str | PathLike[str]] | str | PathLike[str],
    *,
    progress: Callable[[BackendRow | SkippedBackend], None] | None = None,
    **options: Any,
) -> BackendComparison:
    """Optimise pose graphs with several backends: first pose fixed, the file's initial values, the same stop rule.

    Each backend runs ``repeat`` times, after a run on a tiny graph that loads its modules; its time is the
    median. GTSAM and g2o prepare their graph before the time is measured; our pattern, ordering and start count.

    Args:
        files: pose graphs, see `Graph.from_g2o`; one, or several.
        progress: called after each row.
        options: the fields of `options.BackendOptions`: backends, initialize, same_start, repeat, max_iterations, format,
            time_limit [s], which holds for all runs of one backend on one file, its certificate included.

    Raises:
        OptionError: an option has an impossible value, or a backend asked for is not installed.
        FormatError, GraphError: a file is not a graph that can be solved.
    """
    given = BackendOptions.of(**options)
    names = given.backends or BACKENDS
    paths = [files] if isinstance(files, (str, PathLike)) else files
    graphs = ((str(path), *_graph(path, given)) for path in paths)
    found = rows_of(
        partial(_measured, options=given), ((name, *of_file) for of_file in graphs for name in names),
        jobs=0 if given.time_limit is None else 1, prepare=partial(_warm_up_all, tuple(names)), limit=given.time_limit,
        progress=progress, instead=_stopped,
    )  # fmt: skip
    rows = tuple(each for each in found if isinstance(each, BackendRow))
    return BackendComparison(rows, tuple(each for each in found if isinstance(each, SkippedBackend)))


def _graph(path: str | PathLike[str], options: BackendOptions) -> tuple[Graph, str]:
    """The graph of a file, and where graphslam starts."""
    graph = Graph.from_g2o(path, format=options.format)
    if options.same_start:
        return graph.with_initial(starting_state(graph, "auto")), "given"
    return graph, options.initialize


#: the backend, the file, its graph, and where graphslam starts
Task = tuple[str, str, Graph, str]


def _stopped(task: Task, reason: str) -> BackendRow:
    return BackendRow(task[1], task[0], math.nan, 0, math.nan, False, reason)


def _measured(task: Task, options: BackendOptions) -> BackendRow | SkippedBackend:
    """The row of a backend, or why it is left out where it was not asked for by name."""
    name, file, graph, initialize = task
    try:
        run = _backend(name, graph, initialize, options.max_iterations)
    except OptionError as error:
        if options.backends is None:
            return SkippedBackend(file, name, str(error))
        raise
    _warm_up(name)
    runs = [run() for _ in range(options.repeat)]
    seconds, last = statistics.median(run.seconds for run in runs), runs[-1]
    steps = max(len(last.costs) - 1, 1)
    chi2 = graph.cost(last.state)
    return BackendRow(
        file, name, chi2, last.iterations, seconds, last.converged, last.reason,
        trace=tuple((seconds * k / steps, cost) for k, cost in enumerate(last.costs)),
        chi2_per_dof=of_expected(chi2, graph),
        # GTSAM has no factor of its own for a point in Cartesian coordinates
        native=not (name.startswith("gtsam") and any(isinstance(f, RelativePointEdges) for f in graph.families)),
        certificate=certify(graph, last.state).of_run(last.converged, last.reason) if math.isfinite(chi2) else None,
    )  # fmt: skip


def _warm_up_all(names: Sequence[str]) -> None:
    for name in names:
        with suppress(OptionError):
            _warm_up(name)


def _backend(name: str, graph: Graph, initialize: str, max_iterations: int) -> Callable[[], PeerRun]:
    """A function that optimises the graph from the start at every call."""
    if name != "graphslam":
        return PEERS[name](graph, max_iterations)

    def run() -> PeerRun:
        # a fresh graph, so that pattern and ordering count in the time
        fresh = graph.with_initial(graph.initial)
        try:
            solution = solve(fresh, initialize=initialize, cost_tolerance=COST_TOLERANCE, max_iterations=max_iterations)
        except GraphError as error:
            return PeerRun(graph.initial * math.nan, 0, math.nan, False, str(error))
        return PeerRun(
            solution.state, solution.iterations, solution.seconds, solution.converged, solution.reason,
            tuple(solution.costs.tolist()),
        )  # fmt: skip

    return run


@cache
def _warm_up(name: str) -> None:
    """Solve a square with a landmark, so that a backend loads its modules before the measurement."""
    lines = [f"VERTEX_SE2 {k} {k % 2} {k // 2} 0\nEDGE_SE2 {k} {(k + 1) % 4} 1 0 1.57 1 0 0 1 0 1" for k in range(4)]
    lines += ["VERTEX_XY 4 2 2", "EDGE_SE2_XY 0 4 2 2 1 0 1", "EDGE_SE2_XY 1 4 2 -1 1 0 1"]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "square.g2o"
        path.write_text("\n".join(lines), encoding="utf-8")
        _backend(name, Graph.from_g2o(path), "auto", 5)()
