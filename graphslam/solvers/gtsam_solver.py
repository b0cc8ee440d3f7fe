"""The same graph solved by GTSAM: the factor types of this package, and GTSAM's Levenberg-Marquardt.

The two solvers share the noise models, the initial states, the choice among ends and Anderson acceleration; residuals,
Jacobians and linear solvers are separate.
"""

from __future__ import annotations

import time
from collections import Counter

import gtsam
import numpy as np

from .. import factors as factor_types
from ..checks import check_count, check_positive
from ..engine import engine
from ..errors import GraphError
from ..graph import Graph, check_graph
from ..se2 import Array, wrap
from ..solution import Solution, make_solution
from .auto import DAMPED, best_end
from .gtsam_factors import to_gtsam
from .gtsam_parameters import solve_jointly_with_gtsam
from .gtsam_values import eliminated_landmarks, from_values, to_values
from .initialize import starting_state
from .iteration import PROMISE, Run, rounding
from .with_parameters import FIRST, best_of_starts, solve_jointly

#: after so many freezings of the information, and so many last steps of one of them, without a shorter step there is no end
WAIT, WAIT_INSIDE = 12, 10


def solve_with_gtsam(
    graph: Graph,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    factors: str = "fastest",
) -> Solution:
    """Minimise the cost J of a graph with GTSAM's Levenberg-Marquardt on the custom factors.

    GTSAM's noise models are fixed. Where the information depends on the state (``frame="world"``, or no psi) an outer
    loop freezes it, solves, and freezes it again at the result, until that moves by less than the tolerance. As this
    converges slowly, Anderson acceleration mixes its iterates (Anderson 1965). ``iterations`` and ``step_norms``
    count the outer loop then, and GTSAM's own iterations otherwise. ``seconds`` counts the start, as for `solve`, but
    not the first translation of the graph into factors.

    Args:
        graph: what to solve.
        tolerance: converged when the Euclidean norm of a whole correction is below this.
        max_iterations: the most steps to take.
        initialize: the state to start from, as for `graphslam.solve`. "auto" compares the ends of several starts, by
            the same rules.
        factors: "fastest", GTSAM's own factor types where they are exactly equal, one `RelativeEdgesFactor` for the motions
            and Cartesian sightings of some consecutive poses, and one `LandmarkFactor` for all virtual-motion edges of a
            landmark; or "per-edge", which has the same cost and takes about ten times as long. If each virtual-motion edge
            has a robust kernel, their factors are per edge in any case. A note of the solution names the factors that were
            used.

    Raises:
        GraphError: GTSAM finds the system indeterminate, or the edges do not allow the start.
        OptionError: an option has an impossible value.
    """
    check_graph(graph)
    check_positive(tolerance=tolerance)
    check_count(max_iterations=max_iterations)
    if graph.parameters is not None:
        return _with_parameters(graph, tolerance, max_iterations, initialize, factors)
    made = to_gtsam(graph, factors=factors)
    begin = time.perf_counter()

    def run_from(start: Array, _: str = DAMPED, descend: bool = False) -> Run:  # noqa: ARG001  # always lowers J
        started, run = graph.with_initial(start), Run(start, tolerance, max_iterations)
        try:
            if graph.state_dependent_information:
                ends = _refrozen(started, tolerance, max_iterations, factors)
            else:
                ends = _optimize(started, made, tolerance, max_iterations)
        except RuntimeError as error:
            raise GraphError(f"gtsam failed: {str(error).strip().splitlines()[0]}") from None
        run.state, run.step_norms, run.converged = ends
        if run.converged:
            run.reason = f"step norm {run.step_norms[-1]:.1e} below the tolerance {tolerance:g}"
        elif len(run.step_norms) >= max_iterations:
            run.reason = f"max_iterations = {max_iterations} reached"
        elif graph.state_dependent_information:
            run.reason = f"stuck: {WAIT} freezings of the information without a shorter step"
        else:
            run.reason = "stuck: gtsam finds no step that lowers the cost"
        return run

    auto = initialize == "auto"
    run = best_end(graph, run_from, DAMPED).run if auto else run_from(starting_state(graph, initialize))
    seconds = time.perf_counter() - begin
    return make_solution(
        graph, run.state, step_norms=run.step_norms, costs=[], converged=run.converged, reason=run.reason,
        seconds=seconds, solver="gtsam", notes=(_contents(made),),
    )  # fmt: skip


def _with_parameters(graph: Graph, tolerance: float, most: int, initialize: str, factors: str) -> Solution:
    """The solution of a graph with parameters: the nodes alone first, then all together."""
    begin = time.perf_counter()

    def solved(nodes: Graph) -> Array:
        rough = max(FIRST, tolerance)
        return solve_with_gtsam(nodes, tolerance=rough, initialize=initialize, factors=factors).state

    def jointly(start: Graph, state: Array) -> tuple[Graph, Run]:
        run = Run(state, tolerance, most)
        return solve_jointly(start, state, solve_jointly_with_gtsam, run), run

    found, run = best_of_starts(graph, solved, jointly)
    return make_solution(
        found, run.state, step_norms=run.step_norms, costs=[], converged=run.converged, reason=run.reason,
        seconds=time.perf_counter() - begin, solver="gtsam",
    )  # fmt: skip


def _contents(factors: gtsam.NonlinearFactorGraph) -> str:
    """The number of factors of each type, as a note of a solution."""
    each = [factors.at(k) for k in range(factors.size())]
    kinds = Counter(
        factor_types.describe(f).kind if isinstance(f, gtsam.CustomFactor) else type(f).__name__ for f in each
    )
    return "graph: " + ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.items())


def _difference(a: Array, b: Array) -> Array:
    d = a - b
    d[:, 2] = wrap(d[:, 2])
    return d


def _optimize(
    graph: Graph,
    factors: gtsam.NonlinearFactorGraph,
    tolerance: float,
    max_iterations: int,
    roughly: float = 0.0,
) -> tuple[Array, list[float], bool]:
    """Levenberg-Marquardt until it converges: the state, the norm of every step, and whether the end is a minimum.

    A short step alone proves nothing: damping may have shortened it. The last step is one of Gauss-Newton, and where J is
    steep it must promise to lower it by a negligible part only (`_promises_little`), which is ``tolerance``, or ``roughly``
    where that is above 0. A damped step that promises as little is enough then.
    """
    part = roughly or tolerance
    values = to_values(graph, graph.initial)
    values.insert(eliminated_landmarks(graph, graph.initial))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setVerbosityLM("SILENT")
    parameters.setlambdaUpperBound(1e12)
    # Cholesky refuses cliques whose pivots differ by 2^12 even where they are well determined (Huang 8240)
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    optimizer: gtsam.NonlinearOptimizer = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters)
    state = from_values(graph, optimizer.values())
    norms: list[float] = []
    polishing, damped = False, 0
    while len(norms) < max_iterations:
        before = optimizer.error()
        optimizer.iterate()
        moved = from_values(graph, optimizer.values())
        norms.append(float(np.linalg.norm(_difference(moved, state))))
        state = moved
        stalled = before - optimizer.error() <= 1e-10 * before
        short = norms[-1] < tolerance and (polishing or (roughly and not stalled))
        if short and _promises_little(graph, state, factors, optimizer, part):
            return state, norms, True
        if not polishing and stalled:
            # The remaining decrease is below the rounding error of the cost, so Levenberg-Marquardt refuses to move.
            # Gauss-Newton, which compares no costs, takes the last steps; damping would hide how long they are.
            polishing, damped = True, len(norms)
            plain = gtsam.GaussNewtonParams()
            plain.setLinearSolverType("MULTIFRONTAL_QR")
            optimizer = gtsam.GaussNewtonOptimizer(factors, optimizer.values(), plain)
        elif polishing:
            grows = len(norms) > 2 and norms[-1] > 1e3 * max(norms[-2], tolerance)
            if grows or _no_shorter(norms[damped:], WAIT_INSIDE):
                break
    return state, norms, False


def _promises_little(
    graph: Graph,
    state: Array,
    factors: gtsam.NonlinearFactorGraph,
    optimizer: gtsam.NonlinearOptimizer,
    part: float,
) -> bool:
    """Whether an undamped step from the optimizer's values, a state (n, 3), promises a negligible decrease of J.

    Negligible is ``part`` of J, or what rounding errors of 1e-15 of the coordinates make of it, as for `solve`.
    """
    values = optimizer.values()
    linear = factors.linearize(values)
    plain = gtsam.GaussNewtonParams()
    plain.setLinearSolverType("MULTIFRONTAL_QR")
    step = gtsam.GaussNewtonOptimizer(factors, values, plain)
    step.iterate()
    delta = values.localCoordinates(step.values())
    predicted = 2 * (linear.error(values.zeroVectors()) - linear.error(delta))
    if abs(predicted) <= 2 * max(PROMISE, part) * optimizer.error():
        return True
    system, _ = graph.linearize(state)
    return abs(predicted) <= rounding(state, system)


def _refrozen(graph: Graph, tolerance: float, max_iterations: int, factors: str) -> tuple[Array, list[float], bool]:
    """Freeze the information, solve, and freeze it again, until the solution no longer moves."""
    state, mixing = graph.initial.copy(), engine.AndersonMixing()
    norms: list[float] = []
    while len(norms) < max_iterations:
        # every freezing changes the inner problem, so there is no use in solving it much more closely than that
        inner = max(tolerance / 10, 0.1 * norms[-1] if norms else 0.1)
        here = graph.with_initial(state)
        solved, _, settled = _optimize(here, to_gtsam(here, factors=factors), inner, max_iterations, roughly=tolerance)
        move = _difference(solved, state)
        norms.append(float(np.linalg.norm(move)))
        state = mixing.next(state, move)
        if norms[-1] < tolerance and settled:
            return state, norms, True
        if _no_shorter(norms, WAIT):
            break
    return state, norms, False


def _no_shorter(norms: list[float], last: int) -> bool:
    """Whether none of the last steps is clearly shorter than all before them: they wander about and do not converge."""
    return len(norms) > last and min(norms[-last:]) > 0.9 * min(norms[:-last])
