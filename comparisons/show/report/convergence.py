"""The same edges iterated in three ways: what the choice of the frame and the anchor does to the iteration.

The lectures re-choose x̂_0 at every step, so the whole graph keeps drifting; with the anchor held the world frame
converges at a constant rate; in the body frame the information does not depend on the state, and a few steps suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphslam import Graph, GraphError, Log, SlamError, solve
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

    @property
    def distances(self) -> Array:
        """|J - J at the end| before every step; NaN below the rounding error of J."""
        apart = np.abs(self.costs - self.costs[-1])[:-1]
        return np.where(apart > 1e-14 * np.max(self.costs), apart, np.nan)


def stories(log: Log, options: RunOptions) -> list[Story]:
    """The iterations on the virtual-motion edges of a log, all from its own initial poses.

    Motion edges are added only where virtual-motion edges alone do not determine the poses: their residuals do not
    vanish together, which slows every variant and hides what the frame does.

    Raises:
        SlamError: the log has no such edges, or far too many; the message says which.
    """
    if (pairs := pair_count(log)) > MOST_PAIRS:
        raise SlamError(f"{log.name} has {pairs} pairs of sightings, more than the {MOST_PAIRS} that are followed here")
    try:
        world, body = _graphs(log, options, "virtual")
    except GraphError:
        world, body = _graphs(log, options, "virtual+motion")
    told = [
        plain_steps("textbook: x̂₀ re-chosen at every step", world, anchored=False),
        plain_steps("world frame, anchor held", world, anchored=True),
    ]
    for name, graph in (("world frame, iterates mixed", world), ("body frame", body)):
        solution = solve(graph, tolerance=TOLERANCE, max_iterations=MOST_STEPS)
        told.append(Story(name, solution.costs, solution.step_norms))
    return told


def _graphs(log: Log, options: RunOptions, edges: str) -> tuple[Graph, Graph]:
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    world, body = (Graph.from_log(log, edges=edges, frame=frame, **models) for frame in ("world", "body"))
    return world, body


def remarks(told: Sequence[Story]) -> list[str]:
    """One sentence on how each iteration ended."""
    sentences = []
    for story in told:
        last = story.step_norms[-1]
        if last < TOLERANCE:
            sentences.append(f"{story.name}: {len(story.step_norms)} steps until the norm is below {TOLERANCE:g}.")
        else:
            sentences.append(f"{story.name}: after {len(story.step_norms)} steps it still moves by {last:.1e} at each.")
    return sentences


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
