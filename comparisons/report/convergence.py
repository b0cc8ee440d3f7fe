"""The same edges iterated in three ways: what the choice of the frame and the anchor does to the iteration.

The lectures re-choose x̂_0 at every step, so the whole graph keeps drifting; with the anchor held the world frame
converges at a constant rate; in the body frame the information does not depend on the state, and a few steps suffice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam import Graph, Log, SlamError, solve
from graphslam.edges import ANCHOR_INFORMATION
from graphslam.se2 import Array, wrap

from ..estimator import RunOptions
from ..estimators import pair_count

#: steps that each iteration is followed for, and the step norm below which there is nothing more to see
MOST_STEPS, TOLERANCE = 40, 1e-11
#: with more pairs the page would take longer than the comparison
MOST_PAIRS = 200_000


@dataclass(frozen=True, eq=False)
class Story:
    """One iteration: its name, J before every step and at the end, the norm of every correction."""

    name: str
    costs: Array
    step_norms: Array


def stories(log: Log, options: RunOptions) -> list[Story]:
    """The iterations on the virtual-motion (and motion) edges of a log, all from its own initial poses.

    Raises:
        SlamError: the log has no such edges, or far too many; the message says which.
    """
    if (pairs := pair_count(log)) > MOST_PAIRS:
        raise SlamError(f"{log.name} has {pairs} pairs of sightings, more than the {MOST_PAIRS} that are followed here")
    edges = "virtual" if log.controls is None else "virtual+motion"
    world, body = (
        Graph.from_log(log, motion=options.motion, sensor=options.sensor, edges=edges, frame=frame)
        for frame in ("world", "body")
    )
    told = [
        plain_steps("textbook: x̂₀ re-chosen at every step", world, anchored=False),
        plain_steps("world frame, anchor held", world, anchored=True),
    ]
    for name, graph in (("world frame, iterates mixed", world), ("body frame", body)):
        solution = solve(graph, tolerance=TOLERANCE, max_iterations=MOST_STEPS)
        told.append(Story(name, solution.costs, solution.step_norms))
    return told


def plain_steps(name: str, graph: Graph, *, anchored: bool) -> Story:
    """Omega Delta = xi, x̂ += Delta, again and again, the information re-evaluated at each step and nothing mixed.

    Args:
        name: of the story.
        graph: whose first family anchors node 0.
        anchored: whether x̂_0 is held. In the lectures it is the current x_0 at every step: Omega_0 stays in Omega, and
            the anchor's pull - Omega_0 (x_0 - x̂_0) never enters xi, nor its cost J.

    Raises:
        GraphError: the edges do not determine the poses.
    """
    state, anchor = graph.initial.copy(), graph.initial[0].copy()
    costs: list[float] = []
    norms: list[float] = []
    while len(norms) < MOST_STEPS and not (norms and norms[-1] < TOLERANCE):
        system, cost = graph.linearize(state)
        xi = system.xi.copy()
        if not anchored:
            off = state[0] - anchor
            off[2] = wrap(off[2])
            xi[0] += ANCHOR_INFORMATION @ off
            cost -= float(off @ ANCHOR_INFORMATION @ off)
        if not np.isfinite(cost):
            break
        delta = system.factorize().solve(xi)
        state = state + delta
        costs.append(cost)
        norms.append(float(np.linalg.norm(delta)))
    return Story(name, np.array(costs), np.array(norms))
