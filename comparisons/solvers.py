"""The hand-written solver against GTSAM, on every graph that a log allows."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from graphslam import (
    Graph,
    GraphError,
    Log,
    LogError,
    MotionModel,
    OptionError,
    SensorModel,
    Solution,
    solve,
    solve_with_gtsam,
)
from graphslam.checks import check_choice
from graphslam.edges.robust import KERNELS
from graphslam.graph import EDGES, FRAMES, WEIGHTS
from graphslam.se2 import wrap
from graphslam.solvers.solve import starting_state

from .display import Displayed
from .saving import jsonable

#: what two solvers may differ by: any x, y [m] or heading [rad], and J relative to itself
POSE_TOLERANCE, COST_TOLERANCE = 1e-6, 1e-9

#: the motion weights lambda that are tried: the model's own, and one far from it
MOTION_WEIGHTS = (1.0, 10.0)

#: both solvers stop at a step norm below this, well inside `POSE_TOLERANCE` also where convergence is linear
STEP_TOLERANCE, MAX_ITERATIONS = 1e-10, 500


@dataclass(frozen=True)
class Variant:
    """One way to make a graph of a log."""

    edges: str
    frame: str
    weight: str
    dimensions: int
    motion_weight: float = 1.0
    kernel: str | None = None

    @property
    def name(self) -> str:
        """The variant in words, unique among the variants."""
        weight = f" {self.weight}" if self.edges.startswith("virtual") else ""
        lam = f" lambda={self.motion_weight:g}" if self.edges.endswith("+motion") else ""
        return f"{self.edges} {self.frame}{weight} {self.dimensions}-D{lam}{f' {self.kernel}' if self.kernel else ''}"


#: re-weighted plain steps may end on a saddle, or run in circles; damped ones go down
ROBUST_METHOD = "levenberg-marquardt"


@dataclass(frozen=True)
class VariantResult:
    """What both solvers made of one graph.

    Attributes:
        name: of the variant.
        pose_difference: the largest difference in any x, y [m] or heading [rad] (wrapped).
        cost_difference: |J - J_gtsam| / max(J, J_gtsam).
        cost: J of the hand-written solver.
        iterations, gtsam_iterations; seconds, gtsam_seconds; converged, gtsam_converged: of each.
        failure: the error of a solver that gave up where the other did not; the figures are NaN or 0 then.
    """

    name: str
    pose_difference: float
    cost_difference: float
    cost: float
    iterations: int
    gtsam_iterations: int
    seconds: float
    gtsam_seconds: float
    converged: bool
    gtsam_converged: bool
    failure: str | None = None

    @property
    def problem(self) -> str | None:
        """What is wrong, one sentence, or None where both converged to the same answer."""
        if self.failure is not None:
            return self.failure
        if not (self.converged and self.gtsam_converged):
            who = [n for n, done in (("graphslam", self.converged), ("gtsam", self.gtsam_converged)) if not done]
            return f"{' and '.join(who)} did not converge"
        # written so that a NaN counts as a difference
        if not self.pose_difference <= POSE_TOLERANCE:
            return f"poses differ by {self.pose_difference:.1e}, more than {POSE_TOLERANCE:g}"
        if not self.cost_difference <= COST_TOLERANCE:
            return f"costs differ by {self.cost_difference:.1e} relative, more than {COST_TOLERANCE:g}"
        return None


@dataclass(frozen=True)
class SkippedVariant:
    """A variant that the log does not determine, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class SolverComparison(Displayed):
    """The outcome of `compare_solvers`."""

    variants: tuple[VariantResult, ...]
    skipped: tuple[SkippedVariant, ...] = field(default=())

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each variant in which the solvers do not agree; empty if all is well."""
        return tuple(f"{v.name}: {v.problem}" for v in self.variants if v.problem is not None)

    def to_json(self) -> dict[str, Any]:
        """The comparison as plain data: {"variants": [...], "skipped": [{"name", "reason"}]}."""
        variants = [vars(v) | {"agree": v.problem is None} for v in self.variants]
        return jsonable({"variants": variants, "skipped": [vars(s) for s in self.skipped]})


def variants(
    log: Log,
    motion_weights: tuple[float, ...] = MOTION_WEIGHTS,
    edges: tuple[str, ...] = EDGES,
    kernels: tuple[str, ...] = ("none",),
) -> Iterator[Variant]:
    """Every variant of a log: edges x frame x weight x sensor dimension x kernel x lambda where there are motion edges."""
    dimensions = (3, 2) if log.has_orientation else (2,)
    for kind, frame, weight, d, kernel in product(edges, FRAMES, WEIGHTS, dimensions, kernels):
        if not kind.startswith("virtual") and weight != WEIGHTS[0]:
            # only pairs of sightings can be weighted differently
            continue
        for motion_weight in motion_weights if kind.endswith("+motion") else (1.0,):
            yield Variant(kind, frame, weight, d, motion_weight, None if kernel == "none" else kernel)


def compare_solvers(
    log: Log,
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    motion_weights: tuple[float, ...] = MOTION_WEIGHTS,
    edges: tuple[str, ...] = EDGES,
    kernels: tuple[str, ...] = ("none",),
    jobs: int = 1,
    progress: Callable[[VariantResult | SkippedVariant], None] | None = None,
) -> SolverComparison:
    """Solve every variant of a log's graph by hand and with GTSAM.

    Args:
        log: what the robot did and saw.
        motion, sensor: the noise models; default: the book's.
        motion_weights: the lambdas to try.
        edges: the kinds of graph to try; default: all there are.
        kernels: the robust kernels to try, "none" for plain squares. Both solvers start from Huber's solution where the
            kernel has several minima.
        jobs: how many variants to solve at a time, each in a process of its own.
        progress: called after each variant.

    Raises:
        GraphError: no variant at all can be solved on this log.
        OptionError: an option has an impossible value.
    """
    for kind in edges:
        check_choice("edges", kind, EDGES)
    for kernel in kernels:
        check_choice("kernels", kernel, ("none", *KERNELS))
    if jobs < 1:
        raise OptionError(f"jobs must be at least 1, not {jobs}")
    if len(log.steps) == 0:
        raise GraphError(f"{log.name} has no sightings at all, so there is nothing to solve")
    results: list[VariantResult] = []
    skipped: list[SkippedVariant] = []
    work = partial(_solve_both, log=log, motion=motion, sensor=sensor)
    with mapping(jobs) as run:
        for outcome in run(work, list(variants(log, motion_weights, edges, kernels))):
            if isinstance(outcome, SkippedVariant):
                skipped.append(outcome)
            else:
                results.append(outcome)
            if progress is not None:
                progress(outcome)
    if not results:
        raise GraphError(f"no variant can be solved on {log.name}; the first: {skipped[0].name}: {skipped[0].reason}")
    return SolverComparison(tuple(results), tuple(skipped))


@contextmanager
def mapping(jobs: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """``map``, or the same over so many processes, which end with the block, however it ends."""
    if jobs == 1:
        yield map
        return
    # spawned, not forked: a fork would copy the locks of whatever threads the numeric libraries have started
    context = multiprocessing.get_context("spawn")
    # Ctrl-C reaches the whole group of processes; this one answers it, and ends the others
    with context.Pool(jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        yield pool.imap


def _solve_both(
    variant: Variant, log: Log, motion: MotionModel | None, sensor: SensorModel | None
) -> VariantResult | SkippedVariant:
    seen = log if log.sightings.shape[1] == variant.dimensions else log.without_orientation()
    try:
        make = partial(
            Graph.from_log, seen, motion=motion, sensor=sensor, edges=variant.edges, frame=variant.frame,
            weight=variant.weight, motion_weight=variant.motion_weight,
        )  # fmt: skip
        graph = make(kernel=variant.kernel)
    except (GraphError, LogError) as error:
        return SkippedVariant(variant.name, str(error))
    try:
        # Landmark graphs have many minima, and pose graphs some: the two are compared on the way to one of them.
        start = starting_state(graph, "auto")
        if variant.kernel is not None:
            start = solve(make(kernel="huber").with_initial(start), tolerance=1e-3, initialize="given").state
        graph = graph.with_initial(start)
    except GraphError as error:
        return SkippedVariant(variant.name, str(error))
    # one step ahead of the clock: whatever compiles at its first use compiles now
    _attempt(solve, graph, max_iterations=1)
    ours, our_error = _attempt(solve, graph, method="gauss-newton" if variant.kernel is None else ROBUST_METHOD)
    if variant.kernel is not None and ours is not None and not ours.converged:
        ours, our_error = _attempt(solve, graph)
    theirs, their_error = _attempt(solve_with_gtsam, graph)
    if ours is not None and theirs is not None:
        if variant.kernel is None:
            return compare_solutions(variant.name, ours, theirs)
        return _compare_robust(variant.name, graph, ours, theirs)
    if ours is None and theirs is None:
        return SkippedVariant(variant.name, str(our_error))
    # that one solver finds the graph underdetermined and the other does not is a difference, not a reason to skip
    failure = f"graphslam gave up: {our_error}" if ours is None else str(their_error)
    return VariantResult(
        name=variant.name, pose_difference=np.nan, cost_difference=np.nan, cost=np.nan,
        iterations=0 if ours is None else ours.iterations, gtsam_iterations=0 if theirs is None else theirs.iterations,
        seconds=np.nan, gtsam_seconds=np.nan, converged=ours is not None and bool(ours.converged),
        gtsam_converged=theirs is not None and bool(theirs.converged), failure=failure,
    )  # fmt: skip


def _compare_robust(name: str, graph: Graph, ours: Solution, theirs: Solution) -> VariantResult | SkippedVariant:
    """Two solutions of a graph whose robust kernel gives it many minima, in which solvers may part on their way.

    Where they do, GTSAM is handed our end and has to stay there, and from GTSAM's we must not climb. (With a landmark
    eliminated its own place has minima, too, so that from GTSAM's end there may be a way down.)
    """
    if not ours.converged and not theirs.converged:
        return SkippedVariant(name, "neither solver comes to an end")
    result = compare_solutions(name, ours, theirs)
    if result.problem is None or not (ours.converged and theirs.converged):
        return result
    stayed, _ = _attempt(solve_with_gtsam, graph.with_initial(ours.state))
    if stayed is None:
        return result
    if not graph.frozen_information:
        # with information that is re-evaluated J is no measure from one state to another
        back, _ = _attempt(solve, graph.with_initial(theirs.state), method=ROBUST_METHOD)
        if back is None or back.cost > theirs.cost * (1 + COST_TOLERANCE):
            return result
    return replace(compare_solutions(name, ours, stayed), gtsam_iterations=theirs.iterations + stayed.iterations)


def _attempt(
    solver: Callable[..., Solution], graph: Graph, max_iterations: int = MAX_ITERATIONS, **options: str
) -> tuple[Solution | None, GraphError | None]:
    try:
        start = {"initialize": "given"} | options
        return solver(graph, tolerance=STEP_TOLERANCE, max_iterations=max_iterations, **start), None
    except GraphError as error:
        return None, error


def compare_solutions(name: str, ours: Solution, theirs: Solution) -> VariantResult:
    """Two solutions of one graph side by side."""
    off = (ours.poses - theirs.poses)[ours.estimated & theirs.estimated]
    off[:, 2] = wrap(off[:, 2])
    # a cost of (numerically) zero, as noise-free logs have, has no relative error
    scale = max(abs(ours.cost), abs(theirs.cost), 1e-6)
    return VariantResult(
        name=name,
        pose_difference=float(np.max(np.abs(off), initial=0.0)) if not np.isnan(off).any() else float("nan"),
        cost_difference=abs(ours.cost - theirs.cost) / scale,
        cost=ours.cost,
        iterations=ours.iterations,
        gtsam_iterations=theirs.iterations,
        seconds=ours.seconds,
        gtsam_seconds=theirs.seconds,
        converged=bool(ours.converged),
        gtsam_converged=bool(theirs.converged),
    )
