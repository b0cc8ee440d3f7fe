"""The hand-written solver against GTSAM, on every graph that a log allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from os import PathLike
from typing import Any, ClassVar

import numpy as np

from graphslam import Certificate, Graph, GraphError, Log, LogError, Solution, simulate, solve, solve_with_gtsam
from graphslam.models import FRAMES, WEIGHTS
from graphslam.se2 import difference
from graphslam.solvers.initialize import starting_state

from ..estimators.attempt import rows_of
from ..options import GraphOptions, SolverCheckOptions, options_of
from ..options.reading import prepare
from ..results import Count, Displayed, of_expected

#: what two solvers may differ by: any x, y [m] or heading [rad], and J relative to itself
POSE_TOLERANCE, COST_TOLERANCE = 1e-6, 1e-9

#: both solvers stop at a step norm below this, well inside `POSE_TOLERANCE` also where convergence is linear
STEP_TOLERANCE, MAX_ITERATIONS = 1e-10, 500


@dataclass(frozen=True, kw_only=True)
class Variant(GraphOptions):
    """One way to make a graph of a log: the options of the graph, and the dimensions of its sightings."""

    dimensions: int = 3

    @property
    def name(self) -> str:
        """The variant in words, unique among the variants."""
        edges = str(self.edges)
        weight = f" {self.weight}" if edges.startswith("virtual") else ""
        lam = " lambda=" + format(self.motion_weight, "g") if edges.endswith("+motion") else ""
        return f"{edges} {self.frame}{weight} {self.dimensions}-D{lam}{'' if self.plain else f' {self.kernel}'}"

    @property
    def plain(self) -> bool:
        """Whether the graph has plain squares, without a robust kernel."""
        return self.kernel == "none"


#: re-weighted plain steps may end on a saddle, or repeat; damped ones decrease the cost
ROBUST_METHOD = "levenberg-marquardt"


@dataclass(frozen=True)
class VariantResult:
    """The results of both solvers on one graph.

    Attributes:
        name: of the variant.
        pose_difference: the largest difference in any x, y [m] or heading [rad] (wrapped).
        cost_difference: |J - J_gtsam| / max(J, J_gtsam).
        cost, cost_per_dof: J of the hand-written solver, and J per degree of freedom (`results.of_expected`).
        iterations, gtsam_iterations, seconds, gtsam_seconds, converged, gtsam_converged: of each.
        certificate, gtsam_certificate: whether the end of each is proven to be the global minimum of J.
        failure: the error of a solver that failed where the other did not; its figures are NaN or 0 then.
    """

    name: str
    pose_difference: float = np.nan
    cost_difference: float = np.nan
    cost: float = np.nan
    iterations: Count = 0
    gtsam_iterations: Count = 0
    seconds: float = np.nan
    gtsam_seconds: float = np.nan
    converged: bool = False
    gtsam_converged: bool = False
    failure: str | None = None
    cost_per_dof: float | None = None
    certificate: Certificate | None = None
    gtsam_certificate: Certificate | None = None
    shown: ClassVar = {"agree": "agree"}

    @property
    def agree(self) -> bool:
        """Whether poses differ by less than 1e-6, J by less than 1e-9 of it, and both solvers converged."""
        return self.problem is None

    @property
    def problem(self) -> str | None:
        """The difference between both solvers in a sentence, or None where both converged to the same answer."""
        if self.failure is not None:
            return self.failure
        if not (self.converged and self.gtsam_converged):
            names = [n for n, done in (("graphslam", self.converged), ("gtsam", self.gtsam_converged)) if not done]
            return f"{' and '.join(names)} did not converge"
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
    """The outcome of `compare_solvers`.

    Attributes:
        variants: the graphs that were solved.
        skipped: the graphs that the log does not determine, or that took too long.
    """

    variants: tuple[VariantResult, ...]
    skipped: tuple[SkippedVariant, ...] = ()

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each variant in which the solvers do not agree; empty if all is well."""
        return tuple(f"{v.name}: {v.problem}" for v in self.variants if v.problem is not None)


def variants(log: Log, options: SolverCheckOptions | None = None) -> Iterator[Variant]:
    """Every variant of a log: edges x frame x weight x sensor dimension x kernel x lambda where there are motion edges."""
    options = options or SolverCheckOptions()
    dimensions = (3, 2) if log.has_orientation else (2,)
    for kind, frame, weight, d, kernel in product(options.edges, FRAMES, WEIGHTS, dimensions, options.kernel):
        if not kind.startswith("virtual") and weight != WEIGHTS[0]:
            # only pairs of sightings can be weighted differently
            continue
        plain = Variant(edges=kind, frame=frame, weight=weight, kernel=kernel, dimensions=d)
        yield from plain.weighed(options.motion_weights)


def compare_solvers(
    log: Log | str | PathLike[str] | None = None,
    *,
    progress: Callable[[VariantResult | SkippedVariant], None] | None = None,
    **options: Any,
) -> SolverComparison:
    """Solve every variant of a log's graph by hand and with GTSAM.

    Where a robust kernel gives a graph several minima, both solvers start from Huber's solution.

    Args:
        log: a log, the file or folder of one, or None for the sample log of the package.
        progress: called after each variant.
        options: the fields of `options.SolverCheckOptions`: motion_weights, edges, kernel, jobs, and those that read
            the log and change its noise models.

    Raises:
        FormatError: a file cannot be read.
        GraphError: no variant at all can be solved on this log.
        OptionError: an option has an impossible value.
    """
    data, _, given = prepare(log, SolverCheckOptions.of(**options))
    if len(data.steps) == 0:
        raise GraphError(f"{data.name} has no sightings of range and bearing, on which solvers are compared")
    work = partial(_solve_both, log=data, models={"motion": given.motion, "sensor": given.sensor})
    outcomes = rows_of(
        work, variants(data, given), jobs=given.jobs, progress=progress, limit=given.time_limit,
        instead=lambda variant, reason: SkippedVariant(variant.name, reason),
    )  # fmt: skip
    solved = tuple(each for each in outcomes if isinstance(each, VariantResult))
    skipped = tuple(each for each in outcomes if isinstance(each, SkippedVariant))
    if not solved:
        raise GraphError(f"no variant can be solved on {data.name}; the first: {skipped[0].name}: {skipped[0].reason}")
    return SolverComparison(solved, skipped)


def _graph(variant: Variant, log: Log, models: dict[str, Any]) -> Graph:
    """The graph of a variant.

    Raises:
        GraphError, LogError: the log does not determine it.
    """
    if log.sightings.shape[1] != variant.dimensions:
        log = log.without_orientation()
    keywords = {name: getattr(variant, name) for name in options_of(GraphOptions) if name != "initialize"}
    return Graph.from_log(log, **keywords, **models)


@cache
def _warm_up(variant: Variant) -> None:
    """Solve a variant on a tiny log with both solvers, so that loading is outside of the measured time."""
    with suppress(GraphError, LogError):
        graph = _graph(variant, simulate(steps=20), {})
        for solver in (solve, solve_with_gtsam):
            _attempt(solver, graph, max_iterations=1)


def _solve_both(variant: Variant, log: Log, models: dict[str, Any]) -> VariantResult | SkippedVariant:
    try:
        graph = _graph(variant, log, models)
        # landmark graphs have many minima, and pose graphs some: the solvers are compared on the way to one of them
        start = starting_state(graph, "auto")
        if not variant.plain:
            huber = _graph(replace(variant, kernel="huber"), log, models)
            start = solve(huber.with_initial(start), tolerance=1e-3, initialize="given").state
        graph = graph.with_initial(start)
    except (GraphError, LogError) as error:
        return SkippedVariant(variant.name, str(error))
    _warm_up(variant)
    ours, our_error = _attempt(solve, graph, method="gauss-newton" if variant.plain else ROBUST_METHOD)
    if not variant.plain and ours is not None and not ours.converged:
        ours, our_error = _attempt(solve, graph)
    theirs, their_error = _attempt(solve_with_gtsam, graph)
    if ours is None or theirs is None:
        if ours is theirs:
            return SkippedVariant(variant.name, str(our_error))
        # that one solver finds the graph underdetermined and the other does not is a difference, not a reason to skip
        failure = f"graphslam gave up: {our_error}" if ours is None else str(their_error)
        return VariantResult(variant.name, failure=failure, **_one(ours), **_one(theirs, "gtsam_"))
    compare = compare_solutions if variant.plain else partial(_compare_robust, graph=graph)
    outcome = compare(variant.name, ours=ours, theirs=theirs)
    if isinstance(outcome, SkippedVariant):
        return outcome
    outcome = replace(outcome, certificate=ours.certificate, gtsam_certificate=theirs.certificate)
    return replace(outcome, cost_per_dof=of_expected(ours.cost, graph))


def _compare_robust(name: str, graph: Graph, ours: Solution, theirs: Solution) -> VariantResult | SkippedVariant:
    """Two solutions of a graph whose robust kernel gives it many minima, so that the solvers may end in different ones.

    Where they do, GTSAM starts again from our solution and has to stay there, and we start again from GTSAM's and must
    not end higher. (We may end lower: the position of an eliminated landmark has several minima, too.)
    """
    if not ours.converged and not theirs.converged:
        return SkippedVariant(name, "neither solver converges")
    result = compare_solutions(name, ours, theirs)
    if result.problem is None or not (ours.converged and theirs.converged):
        return result
    stayed, _ = _attempt(solve_with_gtsam, graph.with_initial(ours.state))
    if stayed is None:
        return result
    if not graph.state_dependent_information:
        # where the information is re-evaluated, J does not compare two states
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
    off = difference(ours.poses, theirs.poses)[ours.estimated & theirs.estimated]
    # a cost of (numerically) zero, as noise-free logs have, has no relative error
    scale = max(abs(ours.cost), abs(theirs.cost), 1e-6)
    return VariantResult(
        name, float(np.max(np.abs(off), initial=0.0)), abs(ours.cost - theirs.cost) / scale, ours.cost,
        **_one(ours), **_one(theirs, "gtsam_"),
    )  # fmt: skip


def _one(solution: Solution | None, of: str = "") -> dict[str, Any]:
    """The figures of one solver; none where it failed."""
    names = () if solution is None else ("iterations", "seconds", "converged")
    return {f"{of}{name}": getattr(solution, name) for name in names}
