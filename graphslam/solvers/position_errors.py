"""Errors of absolute positions: a lever or a frame other than the stated one, and errors that last, which a solution counts.

**Lever and frame** are checked by the score test of `contradictions`. An antenna beside the robot's pose, whose lever nobody
has stated, moves all positions by R(theta) s, and odometry and sightings follow them as far as they can: J = R(theta), and
the sum of B' W e over all measurements is zero at the solution. Where s is large, the graph is solved again with it, and the
step repeated. Where the heading does not change, S is small. In a map, positions of another frame are off by s in its axes,
J = I.

**Errors that last**, as those of satellite receivers. The covariances of positions are those of independent errors. Where
the error of a position is nearly that of the one before, n positions say no more than one, and covariances with independent
errors are too small by this factor. The variances of the errors of single positions, of those that last over L positions
each, of motions and of sightings follow from the residuals as in `scan_errors`. Over times that are long against the errors,
positions then are as good as independent ones with

    m = sum over L of L theta_L

times their variances, so that the graph is solved again with the information of positions divided by m. The equations hold
for any weights, and say more with those of the next solution: m is found in a few rounds. For a first-order Gauss-Markov
process with the correlation time tau, sampled every dt, n = m / sum theta_L = (1 + a) / (1 - a), a = exp(-dt / tau).

Without sightings only the odometry is compared with the positions. Poses then follow slow errors, so that the windows tell
too little of them. The errors of single positions, the variance s times the stated one, are what the process changes from
one position to the next, s = 1 - a, if the stated variance is that of the whole error. This gives m = 2 / s - 1.

A lever that nobody has stated, another scale of the world, of the wheels or of the turns, and a bias of the turn rate leave
residuals that last, too. The estimate is free to follow these here, so that they do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..edges import PositionEdges, SightingEdges
from ..graph import Graph
from ..linear.cholesky import Bordered
from ..se2 import Array, turn_matrix
from .contradictions import FEWEST_CHECKED, MISJUDGED, SIGNIFICANT, doubt_of_map, misfit_of_edges
from .iteration import end_of, levenberg_marquardt
from .joint import motion_edges
from .map_errors import DETERMINED
from .scan_errors import SHARE, Whitened, counted_once, equations, settled, variances

if TYPE_CHECKING:
    from .solution import Solution

#: lasting errors count whose variance is so many standard errors above zero. Squares of ten windows are larger by chance once
#: in 100,000 drives; without lasting errors at most 5.4 was found on 200 drives, and with 2 s of it at 1 Hz 18
SURELY = 7.0
#: the fewest positions that say something; the number of lengths L, each half of the one before, and the part of the
#: positions that the longest one is; the windows of a length that overlap
FEWEST, LENGTHS, LONGEST, OVERLAP = 20, 10, 5, 4
#: positions that the kernel gives less than this weight are wrong, and have it; others count as a whole
WRONG = 0.25
#: the same without sightings, where at most 2.8 was found on 168 drives; and the part of their variance that the errors of
#: single positions then have at most: 0.78 and more where instead the odometry has three times the noise that is stated
SURELY_UNSEEN, APART = 4.5, 0.7
#: without sightings, the part of the squared errors of single positions that the estimate does not follow has at least this
#: size, so that odometry checks them: with less, white errors looked like lasting ones on up to 16 of 20 drives
CHECKED = 0.5
#: below this part, odometry alone does not tell lasting errors from covariances that are too large (white errors: 0.34)
LITTLE = 0.25
#: the rounds in which the scale of single errors is found, and its smallest value
SCALED, SMALLEST = 3, 1e-3
#: the rounds in which m is found, and the smallest m that is said
ROUNDS, LEAST = 4, 1.5
#: above this factor, positions are in another frame rather than noisier than they say
OTHER_FRAME = 100.0
#: no antenna is farther from the robot's pose than this [m]
FARTHEST = 30.0
#: the most rounds in which the solution follows the lever or the frame, the damped steps in each, and the squared step in
#: standard errors that is small
FOLLOWED, STEPS, SMALL = 10, 20, 0.01


def with_lasting_errors(solution: Solution, again: Callable[[Graph], Solution] | None) -> tuple[Solution, str]:
    """The solution that counts the errors of positions as lasting as the log surely shows, and a sentence.

    The solution stays, and the sentence is empty, where the log does not show it.

    Args:
        again: the solution of another graph; without it, the sentence only says what is wrong.
    """
    graph = solution.graph
    if graph is None or not _may_last(graph):
        return solution, ""
    assert graph.log is not None and graph.log.times is not None
    families = [f for f in graph.families if isinstance(f, PositionEdges) and f.count]
    nodes = np.concatenate([f.nodes for f in families])
    squares = np.concatenate([f.linearize(solution.state, solution.state).mahalanobis for f in families])
    if np.median(squares) > OTHER_FRAME**2:
        return solution, ""
    m, n, part = lasting_errors(graph, solution.state)
    if part < LITTLE:
        return solution, (
            f"the errors of absolute positions change from one to the next by {part**0.5:.2g} times what their "
            "covariances say: either these are too large, or errors last, as those of satellite receivers do, which "
            "odometry alone does not tell apart. If they last, covariances of poses are too small: compare with "
            "sightings of landmarks"
        )
    if m < LEAST:
        return solution, ""
    if again is not None:
        wider = again(replace(_wider(graph, solution.state, m), initial=solution.state.copy()))
        if not wider.converged:
            again = None
    step = float(np.median(np.diff(graph.log.times[graph.steps[np.unique(nodes)]])))
    text = (
        f"errors of absolute positions last for about {step / np.log1p(2 / max(n - 1, 0.1)):.2g} s, as those of satellite "
        f"receivers do, so that {m:.2g} positions count as one. "
    )
    if again is None:
        return solution, text + (
            "Covariances take them for independent, and are too small: multiply the standard deviations of the positions "
            f"by {m**0.5:.2g}"
        )
    # the trust in positions is part of the information that the last solution began with
    trust = wider.other_trust | {k: each for k, each in solution.other_trust.items() if k == "positions"}
    wider = replace(wider, seconds=solution.seconds + wider.seconds, other_trust=trust)
    return wider, text + "Poses, covariances and risks contain it"


def _may_last(graph: Graph) -> bool:
    """Whether a graph has what shows lasting errors: enough positions, and odometry with times."""
    count = sum(f.count for f in graph.families if isinstance(f, PositionEdges))
    timed = graph.log is not None and graph.log.times is not None
    return timed and count >= FEWEST and motion_edges(graph) is not None and counted_once(graph)


def lasting_errors(graph: Graph, state: Array, *, shifted: bool = False) -> tuple[float, float, float]:
    """m, by which the information of positions is too large, and the number n of positions over which errors last.

    Both are 1 where the log does not surely show lasting errors, or odometry alone does not check positions. Where it checks
    them, the last number is the part of their variance that errors of positions have without sightings; else it is 1.
    Where positions were ``shifted`` to fit, what is left of their mean does not count.

    Raises:
        FactorizationError, GraphError: the edges do not determine the nodes.
    """
    m, seen = 1.0, any(isinstance(f, SightingEdges) and f.count for f in graph.families)
    count = sum(f.count * f.dimension for f in graph.families if isinstance(f, PositionEdges))
    for _ in range(SCALED):
        lengths, q, S = _equations(_wider(graph, state, m), state, shifted)
        if m == 1.0 and not seen and S[len(lengths), len(lengths)] < CHECKED * count:
            return 1.0, 1.0, 1.0
        m *= max(_positive(q, S, list(range(len(lengths), len(q))))[0], SMALLEST)
    of_single = m
    lengths, q, S = _equations(_wider(graph, state, m), state, shifted)
    # lengths share their errors, so each is tried alone
    alone = [[i, *range(len(lengths), len(q))] for i in range(len(lengths))]
    found = [variances(q[rows], S[np.ix_(rows, rows)]) for rows in alone]
    kind = int(np.argmax([z[0] for _, z, _ in found]))
    _, z, share = found[kind]
    if z[0] < (SURELY if seen else SURELY_UNSEEN) or share[0] < SHARE or not (seen or of_single < APART):
        return 1.0, 1.0, 1.0 if seen else of_single
    for _ in range(ROUNDS):
        lasting, single = _positive(q, S, alone[kind])[:2]
        m = max(1.0, m * (lengths[kind] * lasting + single))
        lengths, q, S = _equations(_wider(graph, state, m), state, shifted)
    n = (lengths[kind] * lasting + single) / max(lasting + single, 1e-300)
    if not seen:
        whole = 2 / of_single - 1
        m, n = max((m, n), (whole, whole))
    return m, n, 1.0


def _positive(q: Array, S: Array, rows: list[int]) -> Array:
    """theta (P,) of some kinds, none of them negative."""
    from scipy.optimize import nnls

    size = np.sqrt(np.diag(S))[rows]
    return np.asarray(nnls(S[np.ix_(rows, rows)] / size[:, None] / size, q[rows] / size)[0] / size)


def _wider(graph: Graph, state: Array, m: float) -> Graph:
    """The graph with the information of positions divided by m; wrong ones keep the weights of a kernel at a state."""

    def changed(f: PositionEdges) -> PositionEdges:
        weights = f.kernel_weights(state)
        trust = f.trusted * np.where(weights < WRONG, weights, 1.0)
        return replace(f, information=f.information * trust[:, None, None] / m, kernel=None, trust=None)

    return graph.with_changed(PositionEdges, changed)


def _equations(graph: Graph, state: Array, shifted: bool) -> tuple[np.ndarray, Array, Array]:
    """Lengths L (K,), and q and S of errors of positions with these lengths, and then of other errors."""
    from scipy.sparse import hstack

    moved, log = motion_edges(graph), graph.log
    assert moved is not None and log is not None and log.times is not None
    positions = [f for f in graph.families if isinstance(f, PositionEdges) and f.count]
    changed = graph.with_changed(SightingEdges, lambda f: settled(f, state))
    seen = [f for f in changed.families if isinstance(f, SightingEdges) and f.count]
    drive = Whitened(changed, [replace(moved, frame="body"), *positions, *seen], state)
    # scales of the wheels and of the turns, a bias of the turn rate, the scale of the world, the lever, and the shift
    by_motions = np.zeros((moved.count, 3, 3))
    by_motions[:, :2, 0], by_motions[:, 2, 1] = moved.measured[:, :2], moved.measured[:, 2]
    by_motions[:, 2, 2] = log.times[graph.steps[moved.second]] - log.times[graph.steps[moved.first]]
    unknown = [drive.rows(0, by_motions, np.zeros(moved.count, dtype=int), 1)]
    centre, at_places = np.mean(np.concatenate([f.points(state) for f in positions]), axis=0), 0
    for k, f in enumerate(positions, 1):
        J = np.zeros((f.count, f.dimension, 5 if shifted else 3))
        J[:, :2, 0], J[:, :2, 1:3] = f.points(state) - centre, turn_matrix(state[f.nodes, 2])[:, :2, :2]
        J[:, :2, 3:] = np.eye(2)[:, : J.shape[2] - 3]
        at_places = at_places + drive.rows(k, J, np.zeros(f.count, dtype=int), 1)
    drive.free(hstack([*unknown, at_places]).toarray())
    single = [drive.single(k) for k in range(1, len(drive.edges))]
    # x and y of the positions, in the order of time
    order = np.argsort(np.concatenate([f.nodes for f in positions]), kind="stable")
    x, y = (hstack([A[:, axis :: f.dimension] for A, f in zip(single, positions)]).tocsc()[:, order] for axis in (0, 1))
    lengths = [length for k in range(LENGTHS) if (length := len(order) // (LONGEST * 2**k)) > 1]
    windows = [_windows(len(order), length) for length in lengths]
    drive.kinds = [hstack([x @ each, y @ each]).tocsr() for each in windows]
    drive.kinds += [hstack(single[: len(positions)]).tocsr(), *drive.motions(0), *single[len(positions) :]]
    return np.array(lengths), *equations(drive, len(graph.steps))


def _windows(count: int, length: int) -> Any:
    """(count, K) errors over windows of a length, which overlap; the sum of all of them has the variance 1 at each row."""
    from scipy.sparse import csr_matrix

    starts = np.arange(1 - length, count, max(1, length // OVERLAP))
    row = starts[:, None] + np.arange(length)
    column = np.broadcast_to(np.arange(len(starts))[:, None], row.shape)
    inside = (row >= 0) & (row < count)
    windows = np.bincount(row[inside], minlength=count)
    return csr_matrix((windows[row[inside]] ** -0.5, (row[inside], column[inside])), (count, len(starts)))


def doubt_of_frame(graph: Graph, state: Array) -> str:
    """A sentence where positions are probably in another frame than the map; empty otherwise."""
    families = _checked(graph)
    if not families or not graph.map:
        return ""
    shift, S, rest, moved = _fitted(graph, families, state, in_world=True)
    z = float(np.sqrt(shift @ S @ shift)) / rest
    # where they, or the map, do not fit with it either, there is more than a shift
    if not z > SIGNIFICANT or rest > MISJUDGED:
        return ""
    if doubt_of_map(moved, moved.initial, suspected=graph.reweighted)[0]:
        return ""
    # the mean of errors that last is no shift
    z /= lasting_errors(moved, moved.initial, shifted=True)[0] ** 0.5 if _may_last(moved) else 1.0
    lever, T, other, _ = _fitted(graph, families, state, in_world=False)
    if not z > max(SIGNIFICANT, float(np.sqrt(lever @ T @ lever)) / other):
        return ""
    error = rest * np.linalg.eigvalsh(S)[0] ** -0.5
    return (
        f"the positions lie {shift[0]:.2g} m along x and {shift[1]:.2g} m along y from where the map has them (standard "
        f"error {error:.1g} m), and pull the poses along: they are probably in another frame, such as metres east and "
        "north of another first fix, or all have one error. Put them into the frame of the map, or leave them out"
    )


def doubt_of_positions(graph: Graph, state: Array, *, lasting: bool = False) -> str:
    """A sentence where the lever or the covariances of positions are probably wrong; empty otherwise.

    Args:
        lasting: whether the covariances are those of lasting errors, so that they say nothing of single ones.
    """
    if not (families := _checked(graph)):
        return ""
    lever, S, rest, _ = _fitted(graph, families, state, in_world=False)
    ratio = misfit_of_edges(graph, state, PositionEdges)
    if np.sqrt(lever @ S @ lever) > SIGNIFICANT * rest and np.hypot(*lever) < FARTHEST:
        error = rest * np.linalg.eigvalsh(S)[0] ** -0.5
        return (
            f"the positions fit better with the point that they measure {lever[0]:.2g} m ahead and {lever[1]:.2g} m left of "
            f"where the log has it (standard error {error:.1g} m): poses are off by as much. Check the lever of the antenna "
            "(lever_x, lever_y), and whether the times of the positions are late or early"
        )
    if lasting or ratio == 0 or 1 / MISJUDGED <= ratio <= MISJUDGED:
        return ""
    if ratio > OTHER_FRAME:
        return (
            f"the errors of the positions are {ratio:.2g} times what their covariances say (median): they are probably in "
            "another frame or unit than the map, the landmarks or the first pose, and pull the poses along. Put them into "
            "that frame; only where they are in it already, multiply their standard deviations by this factor"
        )
    return (
        f"the errors of the positions are {ratio:.2g} times what their covariances say (median), so that covariances of "
        "poses are wrong, too: multiply the standard deviations of the positions by this factor, unless they are in another "
        "frame, or the noise models of odometry and sightings are wrong"
    )


def _checked(graph: Graph) -> list[PositionEdges]:
    """The positions of a graph where these are enough to check them, else none."""
    families = [family for family in graph.families if isinstance(family, PositionEdges)]
    few = graph.parameters is not None or sum(family.count for family in families) < FEWEST_CHECKED
    return [] if few else families


def _fitted(
    graph: Graph, families: list[PositionEdges], state: Array, *, in_world: bool
) -> tuple[Array, Array, float, Graph]:
    """The lever s, or the shift s in axes of the world, S, and the errors over the stated ones with s, at least 1.

    The last is the graph with s, at its solution. Where s is large, the solution follows it. Where the kernel gives most
    positions little weight, their median is the first s.

    Raises:
        FactorizationError, GraphError: the edges do not determine the nodes.
    """
    total, S = _step(graph, families, state, in_world)
    if np.median(np.concatenate([f.kernel_weights(state) for f in families])) < WRONG:
        total = np.median(np.concatenate([_ways(f, state, in_world) for f in families]), axis=0)
    elif total @ S @ total <= SIGNIFICANT**2:
        return total, S, 1.0, graph.with_initial(state)

    def moved(edges: PositionEdges) -> PositionEdges:
        if in_world:
            return replace(edges, measured=edges.measured - np.append(total, 0.0)[: edges.dimension])
        return replace(edges, levers=edges.levers + total)

    for _ in range(FOLLOWED):
        other = graph.with_changed(PositionEdges, moved)
        state = end_of(levenberg_marquardt, other, state, max_iterations=STEPS)
        step, S = _step(other, [f for f in other.families if isinstance(f, PositionEdges)], state, in_world)
        if step @ S @ step < SMALL:
            break
        total = total + step
    return total, S, max(1.0, misfit_of_edges(other, state, PositionEdges)), other.with_initial(state)


def _ways(family: PositionEdges, state: Array, in_world: bool) -> Array:
    """The ways (E, 2) from where the estimate has the points to where they were measured, in axes of world or robot."""
    turns = turn_matrix(0.0 * family.nodes if in_world else -state[family.nodes, 2])[:, :2, :2]
    return np.einsum("eij,ej->ei", turns, family.measured[:, :2] - family.points(state))


def _step(graph: Graph, families: list[PositionEdges], state: Array, in_world: bool) -> tuple[Array, Array]:
    """s (2,) and S (2, 2).

    Raises:
        FactorizationError: the edges do not determine the nodes.
    """
    system, _ = graph.linearize(state)
    mixed, own, g = np.zeros((*state.shape, 2)), np.zeros((2, 2)), np.zeros(2)
    for family in families:
        linear = family.linearize(state, state)
        (B,), (nodes,) = linear.jacobians, linear.nodes
        W = linear.information * family.kernel_weights(state)[:, None, None]
        J = turn_matrix(0.0 * nodes if in_world else state[nodes, 2])[:, : family.dimension, :2]
        # a lever does not act on the heading
        J[:, 2:] = 0.0
        np.add.at(mixed, nodes, np.swapaxes(B, 1, 2) @ W @ J)
        own += np.einsum("eji,ejk,ekl->il", J, W, J)
        g -= np.einsum("eji,ejk,ek->i", J, W, linear.residuals)
    mixed[graph.fixed] = 0.0
    S = Bordered(system.own_factor(), mixed, own).schur
    determined = np.linalg.eigvalsh(S)[0] > DETERMINED * np.trace(own)
    return np.linalg.solve(S, g) if determined else np.zeros(2), S
