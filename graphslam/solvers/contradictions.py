"""Whether a solution contradicts what it takes for right: map, stated covariances, odometry, and the noise models.

The map is checked by score tests, as are the lever and the frame of positions in `position_errors`. Let s be the numbers by
which they may be wrong, zero where they are right, and J the derivative of the residuals e by s. With W the information of
e, B the Jacobian by the nodes, Omega the information matrix of the graph, and M the sum of B' W J over the measurements,

    g = - sum J' W e + M' Omega^-1 sum B' W e,     S = sum J' W J - M' Omega^-1 M,     s = S^-1 g,     its covariance S^-1:

this s is the result of one Gauss-Newton step of the nodes and s together.

**Map.** s moves landmarks along a direction d (n, 3): all of them away from their centre, d_j = m_j - c, where 1 + s is the
scale of the map; or one landmark along x or y. The measurements are all but the map, with the information matrix H, so that
J' W J = d' H d and M = H d. If the map is right, s is zero up to its standard error, and q = g' S^-1 g of a landmark has the
median 2 log 2. Biases of the robot whose uncertainty the graph holds (`Graph.held`) are solved for as well. Sightings have
the polar residual and the noise at predicted ranges here, because the Cartesian one and noise that grows with measured ranges
change the size of a world by a little.

**Covariances.** A residual of a position or a relation has the covariance W^-1 - B P B' at the solution, P that of its nodes.
The median of its squared Mahalanobis norm, over that of chi-square, tells how much larger the errors are than their
covariances say, also where some positions or relations are wrong.

**Odometry.** Stretches on which wheels slip or a gyroscope misreads are found by `identification.slips`, and the graph is
solved again with more noise of the controls there.

**Noise models.** J is chi-square, with its degrees of freedom as the expected value, if all covariances are right.

Sources: Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948; Baarda, *A testing
procedure for use in geodetic networks*, 1968 (the covariance of residuals).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..edges import (
    AnchorEdges,
    LandmarkPriors,
    ObservationEdges,
    PolarObservationEdges,
    PositionEdges,
    PriorEdges,
    RelationEdges,
    RelativePoseEdges,
)
from ..errors import GraphError
from ..graph import Graph
from ..identification.odometry import NOTHING, STILL, Edges
from ..identification.slips import SLIPPED, SLIPPED_GIVEN, Found, Motions, largest_slip, without_slips
from ..linear.cholesky import Bordered, FactorizationError
from ..linear.information import BlockSystem
from ..log import Log
from ..maps.localization import SURE
from ..maps.registration import evenly
from ..models import additional_variances
from ..se2 import Array
from .joint import JointFactor, JointGraph, motion_edges, times
from .map_errors import (
    FEWEST,
    displacements,
    in_map,
    in_wider_map,
    likeliest_deviation,
    misfit,
    said_of_moved,
    said_of_wider,
)
from .uncertainty import Uncertainty

if TYPE_CHECKING:
    from .solution import Solution

#: the most landmarks that are tested, evenly spread, and of the others those that their sightings pull hardest
MOST, PULLED = 40, 20
#: of the numbers that are tested in a map, the coordinates of those that are evenly spread: medians of all would be too large
EVEN = slice(1, 1 + 2 * MOST)
#: doubtful is a median of q above so many times 2 log 2, and a scale so many standard errors from 1, at most 2.1 and 4.6 of
#: which were found on 90 drives in the right map; or a lever of so many standard errors
LARGE, SIGNIFICANT = 6.0, 6.0
#: above this root of it the errors of the places that are likeliest are looked for
SUSPECT = 1.3
#: a landmark has moved from this q on. On 24 drives with the kernel cauchy, in maps with joint and with own covariances, at
#: most 7 was found where none had moved, and 40 for one that had not among some that had
MOVED = 60.0
#: where more than this part of the landmarks of the map that are seen has moved, it is the map that is wrong
MOST_MOVED = 0.34
#: the scale of a map that is doubtful by its landmarks is said from so many standard errors on
TELLING = 3.0
#: the fewest positions or relations that say something, and the part of the information of one that the rest must have to
#: check it
FEWEST_CHECKED, CHECKED = 10, 0.1
#: what a solution does with a map that is doubtful, where it is not solved again
TAKEN_FOR_RIGHT = "Poses and their covariances take the map for right"
#: covariances of positions and relations are doubtful whose roots are wrong by more than this factor
MISJUDGED = 2.0
#: the most rounds in which moved landmarks are left out
ROUNDS = 10
#: the medians of chi-square by degrees of freedom
MEDIANS = np.array([0.0, 0.454936, 2 * np.log(2), 2.365974])
#: a coordinate is not measured whose standard deviation is so many times its errors
UNMEASURED = 100.0
#: slips are looked for where constant errors over long cells have a z above this
SUSPECTED = 4.0
#: where J is more than so many times its expected value, a slip explains at least this part of what is too much; where other
#: measurements are wrong, it explains less
MISFIT, EXPLAINED = 2.0, 0.2
#: the fewest motions of a drive that are tested
FEWEST_MOTIONS = 20
#: a part of the variance of motions that rounding may leave
LITTLE = 1e-12


def in_doubted_map(solution: Solution, again: Callable[[Graph], Solution] | None) -> tuple[Solution, list[str]]:
    """The solution in its map as far as the log bears that out, if it can be solved ``again``, and notes on the map."""
    notes = []
    if again is not None:
        solution, of_moved = without_moved(solution, again)
        notes += [of_moved] * bool(of_moved)
    graph = solution.graph
    assert graph is not None
    found, deviation, sure = doubt_of_map(graph, solution.state, suspected=again is not None)
    wider = in_wider_map(solution, deviation, again) if deviation and again is not None else None
    if wider is None and not sure:
        found, *_ = doubt_of_map(graph, solution.state, suspected=False)
    if found and wider is not None:
        solution, deviation = wider
        found = found.replace(TAKEN_FOR_RIGHT, said_of_wider(deviation))
    return solution, [*notes, *[found] * bool(found)]


def doubt_of_map(graph: Graph, state: Array, *, suspected: bool = True) -> tuple[str, float, bool]:
    """A sentence where the log contradicts the size of the map, its landmarks, or some of them; empty otherwise.

    With it the standard deviation by which the places are off [m], where that is most of them, and 0 otherwise; and whether
    this is sure already, without a solution in a wider map. Where landmarks are off by more than the models allow,
    the standard error of the scale counts as so much larger.

    Args:
        suspected: whether places that only such a solution can tell from noise are said, too.
    """
    if (scores := _scores_of_map(graph, state)) is None:
        return "", 0.0, True
    tested, _, g, S, alone = scores
    try:
        ratio, size = misfit(g[EVEN], S[EVEN, EVEN], alone[EVEN, EVEN])
        deviation, gain = likeliest_deviation(S[EVEN, EVEN], g[EVEN])
    except np.linalg.LinAlgError:
        return "", 0.0, True
    sure = ratio**2 > LARGE
    off = sure or (suspected and ratio > SUSPECT and gain > np.log(SURE))
    scale, error = 1 + g[0] / S[0, 0], max(1.0, ratio) / np.sqrt(S[0, 0])
    found = []
    if off:
        found.append(
            f"its landmarks seem to be off by {size:.2g} m in the median, {ratio:.1f} times what its covariances and the "
            "noise models allow"
        )
    if abs(scale - 1) > (TELLING if found else SIGNIFICANT) * error:
        found.append(
            f"they fit each other better with the map at {scale:.4f} times its size (standard error {error:.1g}), so that "
            "either the map or the ranges have a wrong scale"
        )
    if not found:
        return _moved(graph, tested, g[1:], S[1:, 1:], alone[1:, 1:], ratio), 0.0, True
    text = (
        f"the log contradicts the map: {', and '.join(found)}. {TAKEN_FOR_RIGHT}; check its unit and its source, whether "
        "landmarks have moved (map_states) or ids are misread, and whether the robot has biases or more noise than its "
        "models (estimate=, noise='auto')"
    )
    return text, deviation if off else 0.0, sure or not off


def _scores_of_map(graph: Graph, state: Array) -> tuple[np.ndarray, int, Array, Array, Array] | None:
    """The nodes of the landmarks of the map that are tested, and the number of all that the log sees.

    Then `_scores` of the scale of the map and of two axes of each node. None where there is nothing to test.
    """
    if graph.map is None or graph.log is None or graph.parameters is not None:
        return None
    nodes = graph.mapped
    nodes = np.sort(nodes[np.isin(graph.landmark_ids[nodes - len(graph.steps)], graph.log.landmarks)])
    if len(nodes) < FEWEST:
        return None
    tested = nodes[evenly(len(nodes), MOST)]
    try:
        unbiased = _unbiased(graph, state)
        others = np.setdiff1d(nodes, tested)
        tested = np.concatenate([tested, others[np.argsort(-_pulls(unbiased, state, others))[:PULLED]]])
        directions = np.zeros((*state.shape, 1 + 2 * len(tested)))
        directions[nodes, :2, 0] = state[nodes, :2] - state[nodes, :2].mean(axis=0)
        for axis in (0, 1):
            directions[tested, axis, 1 + axis + 2 * np.arange(len(tested))] = 1.0
        return tested, len(nodes), *_scores(unbiased, state, directions)
    except (FactorizationError, GraphError, np.linalg.LinAlgError):
        return None


def _pulls(graph: Graph, state: Array, nodes: np.ndarray) -> Array:
    """How hard sightings pull landmarks (k,), in squared standard deviations from exact poses; at most q."""
    system = _of_measurements(graph, state, graph.linearize(state)[0])
    own, forces = system.values[system.diagonal_slots[nodes], :2, :2], system.xi[nodes, :2]
    return np.asarray(np.einsum("ki,kij,kj->k", forces, np.linalg.pinv(own, hermitian=True), forces))


def without_moved(solution: Solution, again: Callable[[Graph], Solution]) -> tuple[Solution, str]:
    """The solution in its map without the landmarks that have surely moved, and a sentence on them.

    Those that contradict the map most are left out first, because they pull others along. Where they are many, it is the
    map that is wrong, and the solution stays as it is.

    Args:
        again: solves a graph from its initial values.
    """
    first, graph, away, largest = solution, solution.graph, list[int](), 0.0
    for _ in range(ROUNDS):
        if graph is None or (scores := _scores_of_map(graph, solution.state)) is None:
            break
        tested, count, g, S, alone = scores
        try:
            q, size, determined = displacements(g[1:], S[1:, 1:], alone[1:, 1:])
            least = MOVED * max(1.0, misfit(g[EVEN], S[EVEN, EVEN], alone[EVEN, EVEN])[0] ** 2)
            if not len(q) or q.max() <= least:
                break
            most = q > max(least, q.max() / 2)
            largest = max(largest, size[most].max())
            seen = count + len(away)
            away += graph.landmark_ids[tested[determined][most] - len(graph.steps)].tolist()
            if len(away) > MOST_MOVED * seen:
                return first, ""
            assert graph.map is not None
            left = graph.map.among(set(graph.map) - set(away))
            seconds, solution = solution.seconds, again(in_map(graph, left, solution.state))
        except (GraphError, np.linalg.LinAlgError):
            return first, ""
        if not solution.converged:
            return first, ""
        solution, graph = replace(solution, seconds=seconds + solution.seconds), solution.graph
    if not away:
        return first, ""
    return solution, said_of_moved(away, largest, left_out=True)


def _moved(graph: Graph, tested: np.ndarray, g: Array, S: Array, alone: Array, ratio: float) -> str:
    """A sentence on single landmarks, the nodes ``tested``, that have surely moved in a map that is right otherwise."""
    q, size, determined = displacements(g, S, alone)
    moved = q > MOVED * max(1.0, ratio**2)
    if not moved.any():
        return ""
    if all(getattr(family, "kernel", None) is None for family in graph.families):
        # without a kernel they pull others along
        return (
            "single landmarks contradict the map: they have moved, or sightings are wrong. They pull the poses along; take a "
            "robust kernel (kernel='cauchy'), and ask map_states what has changed"
        )
    ids = graph.landmark_ids[tested[determined][moved] - len(graph.steps)]
    return said_of_moved(ids.tolist(), float(size[moved].max()), left_out=False)


def _unbiased(graph: Graph, state: Array) -> Graph:
    """The graph with polar residuals, and the noise at the ranges that the state predicts."""

    def changed(f: ObservationEdges) -> PolarObservationEdges:
        polar = PolarObservationEdges(f.first, f.second, f.sightings, f.sensor, kernel=f.kernel, trust=f.trust)
        return polar.with_noise_at(f.predicted(state))

    return graph.with_changed(ObservationEdges, changed)


def _scores(graph: Graph, state: Array, directions: Array) -> tuple[Array, Array, Array]:
    """g (K,), S (K, K) and d' H d (K, K) of K directions (n, 3, K).

    Raises:
        FactorizationError, GraphError: the edges do not determine the nodes, or the parameters beside them.
    """
    system, _ = graph.linearize(state)
    xi, factor = system.xi.copy(), system.own_factor()
    mixed = times(_of_measurements(graph, state, system), directions)
    g, alone = np.einsum("nik,ni->k", directions, system.xi), np.einsum("nik,nil->kl", directions, mixed)
    mixed[graph.fixed] = 0.0
    moved = Bordered(factor, mixed, alone)
    reach, S = moved.reach, moved.schur
    g -= np.einsum("nik,ni->k", reach, xi)
    if graph.held is not None:
        joint = JointGraph(replace(graph, parameters=graph.held))
        # the directions move nodes that are held, too
        border = joint.border(replace(joint.graph, fixed=graph.fixed[:0]), state, state)
        crossed = np.einsum("nip,nik->pk", border.mixed, directions)
        border.mixed[graph.fixed] = 0.0
        beside = JointFactor(joint, factor, border)
        crossed -= np.einsum("nip,nik->pk", border.mixed, reach)
        gradient = border.gradient - np.einsum("nip,ni->p", beside.reach, xi)
        g -= crossed.T @ beside.covariance @ gradient
        S -= crossed.T @ beside.covariance @ crossed
    return g, S, alone


def _of_measurements(graph: Graph, state: Array, system: BlockSystem) -> BlockSystem:
    """The system of all edges but the map."""
    system.clear()
    for family in graph.families:
        if not isinstance(family, (LandmarkPriors, PriorEdges)):
            family.accumulate(state, state, system)
    return system


def misfit_of_edges(graph: Graph, state: Array, kind: type[PositionEdges] | type[RelationEdges]) -> float:
    """The errors of edges that the rest of the graph checks over what their covariances say; 0 where it checks few."""
    # where the edges are noisier than they say, the weights of a kernel would be those of other covariances
    plain = graph.with_changed(kind, lambda family: replace(family, kernel=None))
    found, uncertainty = [], Uncertainty(plain, state)
    for family in plain.families:
        if not isinstance(family, kind) or not family.count:
            continue
        linear, L = family.linearize(state, state), np.linalg.cholesky(family.information)
        left = np.eye(L.shape[1]) - np.swapaxes(L, 1, 2) @ uncertainty.of_edges(linear) @ L
        checked = (np.linalg.eigvalsh(left)[:, 0] > CHECKED) & (family.trusted > 0.5)
        e = np.einsum("eji,ej->ei", L, linear.residuals)[checked]
        q = np.einsum("ei,ei->e", e, np.linalg.solve(left[checked], e[:, :, None])[:, :, 0])
        # axes that are not measured have a huge variance, and add nothing
        variances = np.diagonal(np.linalg.inv(family.information[checked]), axis1=1, axis2=2)
        axes = np.sum(variances < UNMEASURED**2 * np.median(linear.residuals**2, axis=0), axis=1)
        found.append(q[axes > 0] / MEDIANS[axes[axes > 0]])
    ratios = np.concatenate(found)
    return float(np.sqrt(np.median(ratios))) if len(ratios) >= FEWEST_CHECKED else 0.0


def doubt_of_relations(graph: Graph, state: Array) -> str:
    """A sentence where the covariances of the relations of a log are probably wrong; empty otherwise."""
    count = sum(family.count for family in graph.families if isinstance(family, RelationEdges))
    if graph.log is None or graph.parameters is not None or count < FEWEST_CHECKED:
        return ""
    ratio = misfit_of_edges(graph, state, RelationEdges)
    if ratio == 0 or 1 / MISJUDGED <= ratio <= MISJUDGED:
        return ""
    return (
        f"the errors of the relations are {ratio:.2g} times what their covariances say (median), so that covariances of "
        "poses are wrong, too: multiply the standard deviations of the relations by this factor, unless they are between "
        "other poses, or the noise models of odometry and sightings are wrong"
    )


def _tested_motions(graph: Graph) -> tuple[RelativePoseEdges, Array] | None:
    """The motion edges of a log with times, and their variances (E, 3); None where there are too few."""
    edges, log = motion_edges(graph), graph.log
    if edges is None or log is None or log.times is None or edges.count < FEWEST_MOTIONS:
        return None
    try:
        return edges, np.diagonal(np.linalg.inv(edges.information), axis1=1, axis2=2)
    except np.linalg.LinAlgError:
        # a motion of which nothing is known
        return None


def without_slips_of(solution: Solution, again: Callable[[Graph], Solution] | None) -> tuple[Solution, tuple[str, ...]]:
    """The solution with more noise of the controls where the odometry is wrong, and a sentence on each such stretch.

    Args:
        again: the solution of another graph; without it, the sentences only say what is wrong.
    """
    graph = solution.graph
    if graph is None or graph.log is None or _tested_motions(graph) is None:
        return solution, ()
    if again is None or graph.parameters is not None:
        slip, usual = _largest_slip(solution, SUSPECTED)
        found = slip is not None and slip.z > SLIPPED * max(1.0, usual)
        return solution, (slip.sentence(graph.log, corrected=False),) if slip is not None and found else ()

    def solved(before: Solution, noisier: Log) -> Solution | None:
        assert before.graph is not None
        after = again(_with_controls(before.graph, noisier, before.state))
        if not after.converged or after.graph is None:
            raise GraphError(f"{noisier.name}: there is no solution without the slip")
        ratios = [each.cost / max(each.graph.expected_cost, 1.0) for each in (before, after) if each.graph]
        if ratios[0] > MISFIT and ratios[1] - 1 > (1 - EXPLAINED) * (ratios[0] - 1):
            # other measurements are wrong
            return None
        return replace(after, seconds=before.seconds + after.seconds)

    first = solution
    solution, log, slips, left = without_slips(
        solution, graph.log, lambda each: _largest_slip(each, SUSPECTED if each is first else 0.0), solved,
        limit=SLIPPED_GIVEN if graph.log.uncertain is None else SLIPPED,
    )  # fmt: skip
    sentences = [slip.sentence(log) for slip in slips]
    sentences += [left.sentence(log, corrected=False)] if left is not None else []
    return solution, tuple(sentences)


def _largest_slip(solution: Solution, least: float) -> Found:
    """`identification.slips.largest_slip` of a solution.

    Raises:
        FactorizationError: the edges do not determine the nodes.
    """
    graph, state = solution.graph, solution.state
    assert graph is not None and graph.log is not None and graph.log.times is not None
    if (found := _tested_motions(graph)) is None:
        return None, 1.0
    edges, variances = found
    linear, nothing = replace(edges, frame="body").linearize(state, state), np.zeros((edges.count, 3, 0))
    B, A = linear.jacobians
    motions = Edges(edges.first, edges.second, linear.residuals, B, A, nothing, {}, edges.information)
    times = graph.log.times[graph.steps[np.append(edges.first, edges.second[-1:])]]
    system, _ = graph.linearize(state)
    return largest_slip(motions, Motions(edges.measured, variances, times), system.own_factor(), graph.fixed, least)


def _with_controls(graph: Graph, noisier: Log, state: Array) -> Graph:
    """The graph with more noise of the controls, beginning at a state (n, 3)."""
    log, edges = graph.log, motion_edges(graph)
    assert log is not None and edges is not None and log.controls is not None and noisier.dt is not None
    before, after = (additional_variances(each.control_variances, len(log.controls)) for each in (log, noisier))
    only = replace(STILL, epsilon=NOTHING)
    _, more = only.accumulate(log.controls, noisier.dt, log.control_starts, after - before)
    changed = np.trace(more, axis1=1, axis2=2) > LITTLE * np.trace(more, axis1=1, axis2=2).max()
    information = edges.information.copy()
    information[changed] = np.linalg.inv(np.linalg.inv(information[changed]) + more[changed])
    noisy = replace(edges, information=information)
    families = (noisy if family is edges else family for family in graph.families)
    return graph.with_families(families, log=noisier, initial=state.copy())


#: a J of so many times its expected value is said: of pose graphs, of which of seven public ones the largest has 2.1, and of
#: logs, of which the largest of 60 drives of unknown robots has 1.1 and of the real logs 1.0
MISFIT_OF_GRAPHS, MISFIT_OF_LOGS = 10.0, 2.0
#: and if chance does not explain it: chi-square is beyond what a Gaussian has at so many standard deviations
BEYOND_CHANCE = 4.0
#: what a note on the J of a log says
BEYOND_NOISE = "times what the noise models predict"


def misfit_of_noise(cost: float, expected: float) -> str:
    """A sentence where J is clearly above its expected value in a log, or while driving; empty otherwise.

    With few measurements chi-square has a long tail: its quantile is that of Wilson and Hilferty, *The distribution of
    chi-square*, 1931.
    """
    expected = max(expected, 1.0)
    v = 2 / (9 * expected)
    # J is NaN where it is not known, and infinite after a run that has diverged (`Solution.reason`)
    if not max(MISFIT_OF_LOGS, (1 - v + BEYOND_CHANCE * np.sqrt(v)) ** 3) * expected < cost < np.inf:
        return ""
    return (
        f"J is {cost / expected:,.1f} {BEYOND_NOISE}: they assume less noise than there is, or measurements or ids are "
        "wrong, so that covariances are too small; compare with the noise that the log itself shows (estimate_robot)"
    )


def doubt_of_cost(graph: Graph, cost: float) -> tuple[str, ...]:
    """A sentence where J is clearly above its expected value."""
    # families that do not say how many numbers they measure leave the expected cost open
    if not all(f.numbers[0] or isinstance(f, AnchorEdges) or not f.count for f in graph.families):
        return ()
    expected = max(graph.expected_cost, 1.0)
    if graph.log is not None:
        return tuple(filter(None, [misfit_of_noise(cost, expected)]))
    if not MISFIT_OF_GRAPHS * expected < cost < np.inf:
        return ()
    return (
        f"J is {cost / expected:,.0f} times what the information of the edges predicts: edges are wrong, which method gnc "
        "leaves out of Graph.with_closures, or their information is too large, or of other units",
    )
