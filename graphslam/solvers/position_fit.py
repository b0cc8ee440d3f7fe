"""Whether absolute positions and the rest of a graph say the same: the point that they measure, and the size of their errors.

An antenna beside the robot's pose, whose lever nobody has stated, moves all positions by R(theta) s, and odometry and
sightings follow them as far as they can. With J = R(theta) the derivative of a residual by s, W its information, C and D the
sums of B' W J and J' W J, and Omega of the graph,

    g = - sum J' W e,     S = D - C' Omega^-1 C,     s = S^-1 g,     its covariance S^-1:

where one Gauss-Newton step of the solution together with s would lead. Where s is large, the solution follows it, and the
steps are repeated. Where the heading does not change, S is small.

A residual has the covariance W^-1 - B P B' at the solution, P that of the pose. The median of its squared Mahalanobis norm,
over that of chi-square, tells the errors of the positions over what their covariances say, also where some are wrong.

Sources: Rao, *Large sample tests of statistical hypotheses concerning several parameters*, 1948; Baarda, *A testing
procedure for use in geodetic networks*, 1968 (the covariance of residuals).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..edges import PositionEdges
from ..errors import GraphError
from ..graph import Graph
from ..linear.cholesky import FactorizationError
from ..se2 import Array, turn_matrix
from .iteration import end_of, levenberg_marquardt
from .uncertainty import Uncertainty

#: the fewest positions that say something, and the part of a position's information that others must have to check it
FEWEST, CHECKED = 10, 0.1
#: a lever is doubtful from so many standard errors on, and covariances whose roots are wrong by more than this factor
SIGNIFICANT, LARGE = 6.0, 2.0
#: the log determines the lever where it has more than this part of the information that exact poses would give
DETERMINED = 1e-6
#: the most rounds in which the solution follows the lever, the damped steps in each, and the squared step in standard errors
#: that is small
ROUNDS, STEPS, SETTLED = 10, 20, 0.01
#: the medians of chi-square by degrees of freedom
MEDIANS = {2: 2 * np.log(2), 3: 2.365974}


def doubt_of_positions(graph: Graph, state: Array) -> str:
    """A sentence where the lever or the covariances of positions are probably wrong; empty otherwise."""
    families = [family for family in graph.families if isinstance(family, PositionEdges)]
    if graph.parameters is not None or sum(family.count for family in families) < FEWEST:
        return ""
    try:
        lever, S = _step(graph, families, state)
        if np.sqrt(lever @ S @ lever) > SIGNIFICANT:
            lever, S, rest = _followed(graph, state, lever)
        else:
            rest = 1.0
        ratio = _misfit(families, state, Uncertainty(graph, state))
    except (FactorizationError, GraphError):
        return ""
    if np.sqrt(lever @ S @ lever) > SIGNIFICANT * rest:
        error = rest * np.sqrt(np.diag(np.linalg.inv(S)).max())
        return (
            f"the positions fit better with the point that they measure {lever[0]:.2g} m ahead and {lever[1]:.2g} m left of "
            f"where the log has it (standard error {error:.1g} m): poses are off by as much. Check the lever of the antenna "
            "(lever_x, lever_y), and whether the times of the positions are late or early"
        )
    if ratio == 0 or 1 / LARGE <= ratio <= LARGE:
        return ""
    return (
        f"the errors of the positions are {ratio:.2g} times what their covariances say (median), so that covariances of "
        "poses are wrong, too: multiply the standard deviations of the positions by this factor, unless they are in another "
        "frame, or the noise models of odometry and sightings are wrong"
    )


def _followed(graph: Graph, state: Array, lever: Array) -> tuple[Array, Array, float]:
    """s, S and how many times as large as stated errors then are, at least 1: the solution follows the lever, step by step.

    Raises:
        FactorizationError, GraphError: the edges do not determine the nodes.
    """
    total = lever
    for _ in range(ROUNDS):
        other = graph.with_families(
            replace(each, levers=each.levers + total) if isinstance(each, PositionEdges) else each
            for each in graph.families
        )
        state = end_of(levenberg_marquardt, other, state, max_iterations=STEPS)
        families = [each for each in other.families if isinstance(each, PositionEdges)]
        step, S = _step(other, families, state)
        if step @ S @ step < SETTLED:
            break
        total = total + step
    return total, S, max(1.0, _misfit(families, state, Uncertainty(other, state)))


def _misfit(families: list[PositionEdges], state: Array, uncertainty: Uncertainty) -> float:
    """The errors of positions that the rest of the graph checks over what their covariances say; 0 where it checks few."""
    found = []
    for family in families:
        linear = family.linearize(state, state)
        (B,), (nodes,) = linear.jacobians, linear.nodes
        L = np.linalg.cholesky(family.information)
        white = np.swapaxes(L, 1, 2) @ B
        left = np.eye(family.dimension) - white @ uncertainty.diagonal[nodes] @ np.swapaxes(white, 1, 2)
        checked = (np.linalg.eigvalsh(left)[:, 0] > CHECKED) & (family.trusted > 0.5)
        e = np.einsum("eji,ej->ei", L, linear.residuals)[checked]
        q = np.einsum("ei,ei->e", e, np.linalg.solve(left[checked], e[:, :, None])[:, :, 0])
        found.append(q / MEDIANS[family.dimension])
    ratios = np.concatenate(found)
    return float(np.sqrt(np.median(ratios))) if len(ratios) >= FEWEST else 0.0


def _step(graph: Graph, families: list[PositionEdges], state: Array) -> tuple[Array, Array]:
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
        J = turn_matrix(state[nodes, 2])[:, : family.dimension, :2]
        # a lever does not act on the heading
        J[:, 2:] = 0.0
        np.add.at(mixed, nodes, np.swapaxes(B, 1, 2) @ W @ J)
        own += np.einsum("eji,ejk,ekl->il", J, W, J)
        g -= np.einsum("eji,ejk,ek->i", J, W, linear.residuals)
    mixed[graph.fixed] = 0.0
    S = own - np.einsum("nik,nil->kl", mixed, system.own_factor().solve(mixed))
    determined = np.linalg.eigvalsh(S)[0] > DETERMINED * np.trace(own)
    return np.linalg.solve(S, g) if determined else np.zeros(2), S
