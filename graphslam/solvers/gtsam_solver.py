"""The same graph solved by GTSAM: the factor types of this package, and GTSAM's Levenberg-Marquardt.

The two solvers share the noise models, the initial states, the choice among ends, the passes to the noise at estimated ranges
and Anderson acceleration; residuals, Jacobians and linear solvers are separate.

Parameters of vehicle and sensor are one more node, a vector of K numbers, whose key each factor of a motion or of a sighting
gets. With the residual e(x) of the factor at the parameters p_0 where the graph is frozen, and E = de/dp there, its residual
is e(x) + E (p - p_0). An outer loop freezes the graph at the result, until nothing moves. The hand-written solver eliminates
the parameters by a Schur complement instead; both have in common the corrections of measurements, and how a sighting moves
(`graphslam.identification.corrections`).
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, repeat
from typing import Any

import gtsam
import numpy as np

from .. import edges
from .. import factors as factor_types
from ..engine import engine
from ..errors import GraphError, checks
from ..factors.base import POSE, Factor, turned, values_at
from ..graph import Graph, check_graph
from ..identification.corrections import corrected_controls, motion_slopes, moves
from ..models import RANGE_NOISES
from ..se2 import Array, difference, turn_matrix, wrap
from .auto import DAMPED, best_end
from .gtsam_factors import (
    eliminated_landmarks,
    factors_of,
    from_values,
    held_nodes,
    inverse_observations,
    to_gtsam,
    to_values,
    without_turns,
)
from .initialize import image_notes, starting_state
from .iteration import PROMISE, Run, rounding
from .joint import JointGraph, controls_of
from .minimize import FIRST, at_estimated_ranges, best_of_starts, takes_estimated_ranges
from .solution import Solution, doubted, make_solution

#: the most steps between two freezings
STEPS = 10
#: each freezing changes the problem, so it is solved to this part of the last move
FINER = 0.1


def solve_jointly_with_gtsam(joint: JointGraph, run: Run) -> None:
    """Freeze, minimise over nodes and parameters, and freeze again, from ``run.state`` until it moves no more."""
    anderson = engine.AndersonAcceleration()
    while len(run.step_norms) < run.max_iterations:
        inner = max(run.tolerance / 10, FINER * run.step_norms[-1] if run.step_norms else FINER)
        move = _minimum(joint, run.state, inner) - run.state
        nodes, _ = joint.parted(move)  # a view: the headings of the move itself are wrapped
        nodes[:, 2] = wrap(nodes[:, 2])
        run.step_norms.append(float(np.linalg.norm(move)))
        run.state = anderson.next(run.state, move)
        if not np.isfinite(run.step_norms[-1]):
            run.reason = f"diverged after {len(run.step_norms)} steps"
            return
        if run.step_norms[-1] < run.tolerance:
            run.converged = True
            run.reason = f"step norm {run.step_norms[-1]:.1e} below the tolerance {run.tolerance:g}"
            return
    run.reason = f"max_iterations = {run.max_iterations} reached"


def _minimum(joint: JointGraph, state: Array, tolerance: float) -> Array:
    """The minimum of the graph frozen at a state (n + r, 3), as such a state."""
    (graph, nodes, _), (_, values) = joint.at(state), joint.parted(state)
    key = 2 * graph.num_nodes + len(graph.sighting_rows)
    made, start = _factors(graph, without_turns(nodes), key), to_values(graph, nodes)
    start.insert(eliminated_landmarks(graph, nodes, always=True))
    start.insert(key, np.array(values))
    optimizer = _undamped(made, start)
    reached = state
    for _ in range(STEPS):
        try:
            optimizer.iterate()
        except RuntimeError as error:
            raise GraphError(f"gtsam failed: {str(error).strip().splitlines()[0]}") from None
        found = optimizer.values()
        before, reached = reached, joint.joined(from_values(graph, found), found.atVector(key))
        step = reached - before
        step[: graph.num_nodes, 2] = wrap(step[: graph.num_nodes, 2])
        if np.linalg.norm(step) < tolerance:
            break
    return reached


def _factors(graph: Graph, nodes: Array, key: int) -> gtsam.NonlinearFactorGraph:
    """All factors of a graph frozen at its nodes (n, 3), with the parameters at ``key``."""
    parameters, made = graph.estimated, gtsam.NonlinearFactorGraph()
    prior = gtsam.PriorFactorVector(key, parameters.means, gtsam.noiseModel.Diagonal.Precisions(parameters.weights))
    of_edges = (_of_family(graph, family, nodes, key) for family in graph.families)
    for factor in chain(*of_edges, [prior], held_nodes(graph)):
        made.add(factor)
    return made


def _of_family(graph: Graph, family: edges.EdgeFamily, nodes: Array, key: int) -> Iterator[gtsam.NonlinearFactor]:
    """The factors of a family, one for each edge, with the parameters where these move what it measures."""
    parameters, unmoved = graph.estimated, repeat(None)
    ends: tuple[Iterable[Any], ...]
    if isinstance(family, edges.SightingEdges):
        assert isinstance(family, (edges.ObservationEdges, edges.LandmarkSightings))
        pose = family.first if isinstance(family, edges.ObservationEdges) else family.nodes
        # the moves are in the axes of poses, and are turned into those of the world
        X = turn_matrix(nodes[pose, 2]) @ moves(parameters, family.predicted(nodes), controls_of(graph))
    if isinstance(family, edges.VirtualMotionEdges):
        a, b, _ = family.pairs()
        bases, ends = factors_of(family, graph, nodes, "per-edge"), (nodes[pose[a]], nodes[pose[b]], X[a], X[b])
    elif isinstance(family, edges.SightingEdges):
        if isinstance(family, edges.MarginalEdges):
            landmark, places = graph.num_nodes + family.group, family.landmarks(nodes, nodes)[family.group]
        else:
            assert isinstance(family, edges.CartesianObservationEdges)
            landmark, places = family.second, nodes[family.second]
        bases = inverse_observations(family, pose, landmark, nodes)
        ends = nodes[pose], places[:, : family.sightings.shape[1]], X, unmoved
    elif isinstance(family, edges.RelativePoseEdges) and not isinstance(family, edges.RelationEdges):
        _, slopes = motion_slopes(parameters, corrected_controls(parameters))
        bases, behind = factors_of(family, graph, nodes, "per-edge"), turn_matrix(nodes[family.first, 2]) @ -slopes
        ends = nodes[family.first], nodes[family.second], unmoved, behind
    else:
        yield from factors_of(family, graph, nodes, "per-edge")
        return
    for base, x_1, x_2, X_1, X_2 in zip(bases, *ends):
        yield _factor_with_parameters(base, key, (x_1, x_2), (X_1, X_2), parameters.values)


def _factor_with_parameters(
    base: Factor, key: int, at: Sequence[Array], X: Sequence[Array | None], values: Array
) -> gtsam.CustomFactor:
    """A factor with the parameters at another key: e + J (p - p_0), J the sum of the Jacobians at ``at`` times X (3, K)."""
    residual, own, poses = base.residual, base.in_own_axes, [kind == POSE for kind in base.kinds]
    (_, jacobians_at), noise = residual(*at), base.noiseModel()
    J, p_0 = np.zeros((noise.dim(), len(values))), np.array(values)
    for B, x, move in zip(jacobians_at, at, X):
        if move is not None:
            J += np.asarray(B) @ (turn_matrix(-x[2]) @ move if own else move)
    slope, nodes = np.asfortranarray(J), list(zip(base.keys(), base.kinds))

    def callback(_: gtsam.CustomFactor, estimate: gtsam.Values, jacobians: Any) -> Array:
        where = values_at(estimate, nodes)
        e, by = residual(*where)
        if jacobians is not None:
            for k, (B, x, is_pose) in enumerate(zip(by, where, poses)):
                free = own or not is_pose
                jacobians[k] = np.asarray(B if free else turned(B, x[2]), dtype=float, order="F")
            jacobians[len(nodes)] = slope
        return np.asarray(e, dtype=float) + J @ (estimate.atVector(key) - p_0)

    return gtsam.CustomFactor(noise, [*base.keys(), key], callback)


#: after so many freezings of the information, and so many last steps of one of them, without a shorter step there is no end
WAIT, WAIT_INSIDE = 12, 10


def solve_with_gtsam(
    graph: Graph,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 100,
    initialize: str = "auto",
    factors: str = "fastest",
    range_noise: str = "auto",
) -> Solution:
    """Minimise the cost J of a graph with GTSAM's Levenberg-Marquardt on the custom factors.

    GTSAM's noise models are fixed. Where the information depends on the state (``frame="world"``, or no psi) an outer
    loop freezes it, solves, and freezes it again at the result, until that moves by less than the tolerance. As this
    converges slowly, Anderson acceleration mixes its iterates (Anderson 1965). ``iterations`` and ``step_norms``
    count the outer loop then, and GTSAM's own iterations otherwise. ``seconds`` counts the start, as for `solve`, but
    not the first translation of the graph into factors.

    GTSAM calls Python for every factor, so that this takes 10 to 30 times as long as `solve`. To check a solution, it is
    enough to start from it: ``solve_with_gtsam(graph.with_initial(solution.state), initialize="given")``.

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
        range_noise: "auto", "measured" or "estimated", as for `graphslam.solve`.

    Raises:
        GraphError: GTSAM finds the system indeterminate, an edge has information without an inverse, or the edges do not
            allow the start.
        OptionError: an option has an impossible value.
    """
    check_graph(graph)
    checks.check_positive(tolerance=tolerance)
    checks.check_count(max_iterations=max_iterations)
    checks.check_choice("range_noise", range_noise, RANGE_NOISES)
    solved = partial(_solved, max_iterations=max_iterations, factors=factors)
    again, required = takes_estimated_ranges(graph, range_noise), range_noise == "estimated"
    run = partial(at_estimated_ranges, solved=solved, required=required) if again else solved
    return doubted(run(graph, initialize, tolerance), lambda wider: run(wider, "given", tolerance))


def _solved(graph: Graph, initialize: str, tolerance: float, *, factors: str, max_iterations: int = 100) -> Solution:
    """The solution with the noise that the graph has."""
    begin = time.perf_counter()
    if graph.parameters is not None:

        def solved(nodes: Graph) -> Array:
            rough = max(FIRST, tolerance)
            return _solved(nodes, initialize, tolerance=rough, factors=factors).state

        search, begun = solve_jointly_with_gtsam, partial(Run, graph.initial, tolerance, max_iterations)
        found, run = best_of_starts(graph, solved, search, begun)
        images = image_notes(found, run.state)
        return make_solution(found, run, "gtsam", time.perf_counter() - begin, notes=images)
    made = to_gtsam(graph, factors=factors)
    begin = time.perf_counter()

    def run_from(start: Array, _: str = DAMPED, descend: bool = False) -> Run:  # noqa: ARG001  # always lowers J
        run = Run(start, tolerance, max_iterations)
        try:
            if graph.state_dependent_information:
                _refrozen(graph, run, factors)
            else:
                _optimize(graph, made, run)
        except RuntimeError as error:
            raise GraphError(f"gtsam failed: {str(error).strip().splitlines()[0]}") from None
        if run.converged:
            run.reason = f"step norm {run.step_norms[-1]:.1e} below the tolerance {tolerance:g}"
        elif len(run.step_norms) >= max_iterations:
            run.reason = f"max_iterations = {max_iterations} reached"
        elif graph.state_dependent_information:
            run.reason = f"stuck: {WAIT} freezings of the information without a shorter step"
        else:
            run.reason = "stuck: gtsam finds no step that lowers the cost"
        return run

    end = best_end(graph, run_from, DAMPED) if initialize == "auto" else None
    run = run_from(starting_state(graph, initialize)) if end is None else end.run
    notes = _contents(made), *image_notes(graph, run.state)
    seconds, certificate = time.perf_counter() - begin, None if end is None else end.known_certificate
    return make_solution(graph, run, "gtsam", seconds, notes=notes, certificate=certificate)


def _contents(factors: gtsam.NonlinearFactorGraph) -> str:
    """The number of factors of each type, as a note of a solution."""
    each, ours = map(factors.at, range(factors.size())), gtsam.CustomFactor
    kinds = Counter(factor_types.describe(f).kind if isinstance(f, ours) else type(f).__name__ for f in each)
    return "graph: " + ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.items())


def _optimize(graph: Graph, factors: gtsam.NonlinearFactorGraph, run: Run, roughly: float = 0.0) -> None:
    """Levenberg-Marquardt from ``run.state`` until it converges at a minimum.

    A short step alone proves nothing: damping may have shortened it. So the last step is one of Gauss-Newton, and its
    predicted decrease of J must be negligible (`_promises_little`), with the tolerance as the part of J. With ``roughly``
    above 0 that is the part, and a damped step whose predicted decrease is as small is enough.
    """
    part = roughly or run.tolerance
    values = to_values(graph, run.state)
    values.insert(eliminated_landmarks(graph, run.state))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setVerbosityLM("SILENT")
    parameters.setlambdaUpperBound(1e12)
    # Cholesky refuses cliques whose pivots differ by 2^12 even where they are well determined (Huang 8240)
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    optimizer: gtsam.NonlinearOptimizer = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters)
    run.state, norms = from_values(graph, optimizer.values()), run.step_norms
    polishing, damped = False, 0
    while len(norms) < run.max_iterations:
        before = optimizer.error()
        optimizer.iterate()
        moved = from_values(graph, optimizer.values())
        norms.append(float(np.linalg.norm(difference(moved, run.state))))
        run.state = moved
        stalled = before - optimizer.error() <= 1e-10 * before
        short = norms[-1] < run.tolerance and (polishing or (roughly and not stalled))
        if short and _promises_little(graph, moved, factors, optimizer, part):
            run.converged = True
            return
        if not polishing and stalled:
            # The remaining decrease is below the rounding error of the cost, so Levenberg-Marquardt refuses to move.
            # Gauss-Newton, which compares no costs, takes the last steps; damping would hide how long they are.
            polishing, damped = True, len(norms)
            optimizer = _undamped(factors, optimizer.values())
        elif polishing:
            grows = len(norms) > 2 and norms[-1] > 1e3 * max(norms[-2], run.tolerance)
            if grows or _no_shorter(norms[damped:], WAIT_INSIDE):
                break


def _undamped(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.GaussNewtonOptimizer:
    """GTSAM's Gauss-Newton from given values, with QR as for Levenberg-Marquardt."""
    parameters = gtsam.GaussNewtonParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    return gtsam.GaussNewtonOptimizer(factors, values, parameters)


def _promises_little(
    graph: Graph, state: Array, factors: gtsam.NonlinearFactorGraph, optimizer: gtsam.NonlinearOptimizer, part: float
) -> bool:
    """Whether an undamped step from the optimizer's values, a state (n, 3), promises a negligible decrease of J.

    Negligible is `PROMISE` of J, or ``part`` of J where that is greater, or what rounding errors of 1e-15 of the coordinates
    make of J, as for `solve`.
    """
    values = optimizer.values()
    linear = factors.linearize(values)
    step = _undamped(factors, values)
    step.iterate()
    delta = values.localCoordinates(step.values())
    predicted = 2 * (linear.error(values.zeroVectors()) - linear.error(delta))
    if abs(predicted) <= 2 * max(PROMISE, part) * optimizer.error():
        return True
    system, _ = graph.linearize(state)
    return abs(predicted) <= rounding(state, system)


def _refrozen(graph: Graph, run: Run, factors: str) -> None:
    """Freeze the information, solve, and freeze it again, from ``run.state`` until the solution does not change."""
    norms, anderson = run.step_norms, engine.AndersonAcceleration()
    while len(norms) < run.max_iterations:
        # every freezing changes the inner problem, so there is no use in solving it much more closely than that
        inner = Run(run.state, max(run.tolerance / 10, 0.1 * norms[-1] if norms else 0.1), run.max_iterations)
        _optimize(graph, to_gtsam(graph, run.state, factors=factors), inner, roughly=run.tolerance)
        move = difference(inner.state, run.state)
        norms.append(float(np.linalg.norm(move)))
        run.state = anderson.next(run.state, move)
        run.converged = norms[-1] < run.tolerance and inner.converged
        if run.converged or _no_shorter(norms, WAIT):
            break


def _no_shorter(norms: list[float], last: int) -> bool:
    """Whether none of the last steps is clearly shorter than all before them: they wander about and do not converge."""
    return len(norms) > last and min(norms[-last:]) > 0.9 * min(norms[:-last])
