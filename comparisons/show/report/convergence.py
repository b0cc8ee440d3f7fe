"""The same edges iterated in four ways: what the choice of the frame and the anchor does to the iteration.

The lectures reset the anchor x̂_0 at every step, so the whole graph keeps drifting; with a fixed anchor the world frame
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

from ...estimators import pair_count
from ...options import RunOptions

#: the most steps of each variant, and the norm of the correction below which it has ended
MOST_STEPS, TOLERANCE = 40, 1e-11
#: with more pairs of sightings this would take longer than the comparison
MOST_PAIRS = 200_000


@dataclass(frozen=True, eq=False)
class Iterations:
    """One variant: its name, J before every step and at the end, the norm of every correction."""

    name: str
    costs: Array
    step_norms: Array

    @property
    def distances(self) -> Array:
        """|J - J at the end| before every step; NaN below the rounding error of J."""
        apart = np.abs(self.costs - self.costs[-1])[:-1]
        return np.where(apart > 1e-14 * np.max(self.costs), apart, np.nan)


def iterations(log: Log, options: RunOptions) -> list[Iterations]:
    """The four variants on the virtual-motion edges of a log, all from its own initial poses.

    Motion edges are added only where virtual-motion edges alone do not determine the poses: their residuals do not
    vanish together, which slows every variant and hides what the frame does.

    Raises:
        SlamError: the log has no such edges, or too many of them.
    """
    if (pairs := pair_count(log)) > MOST_PAIRS:
        raise SlamError(f"{log.name} has {pairs} pairs of sightings, more than the limit of {MOST_PAIRS}")
    try:
        world, body = _graphs(log, options, "virtual")
    except GraphError:
        world, body = _graphs(log, options, "virtual+motion")
    variants = [
        plain_steps("textbook: anchor reset at every step", world, anchored=False),
        plain_steps("world frame, fixed anchor", world, anchored=True),
    ]
    for name, graph in (("world frame, Anderson acceleration", world), ("body frame", body)):
        solution = solve(graph, initialize="given", tolerance=TOLERANCE, max_iterations=MOST_STEPS)
        variants.append(Iterations(name, solution.costs, solution.step_norms))
    return variants


def _graphs(log: Log, options: RunOptions, edges: str) -> list[Graph]:
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    return [Graph.from_log(log, edges=edges, frame=frame, kernel="none", **models) for frame in ("world", "body")]


def remarks(variants: Sequence[Iterations]) -> list[str]:
    """One sentence on how each variant ended."""
    sentences = []
    for variant in variants:
        count, last = len(variant.step_norms), variant.step_norms[-1]
        end = f"below {TOLERANCE:g}" if last < TOLERANCE else f"still {last:.1e}"
        sentences.append(f"{variant.name}: after {count} steps the norm of the correction is {end}.")
    return sentences


def plain_steps(name: str, graph: Graph, *, anchored: bool) -> Iterations:
    """Solve Omega Delta = xi and add Delta, the information re-evaluated at each step, without acceleration.

    Args:
        name: of the variant.
        graph: its first family anchors node 0.
        anchored: whether x̂_0 is fixed. In the lectures it is the current x_0 at every step: Omega_0 stays in Omega, and
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
    return Iterations(name, np.array(costs), np.array(norms))
