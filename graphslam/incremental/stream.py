"""A log step by step: `for estimate in online(log)`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..edges import CartesianObservationEdges, RelativePoseEdges
from ..errors import GraphError
from ..graph import Graph
from ..log import Log
from ..se2 import Array
from ..solution import Solution, make_solution
from .solver import OnlineSolver, priors_of

#: the variances [m², m², rad²] of a first pose that only a map holds
ANYWHERE = (1e4, 1e4, 1e2)


@dataclass(frozen=True)
class OnlineEstimate:
    """What is known after a step of a log.

    Attributes:
        step: the number of the newest pose.
        pose: the newest pose (3,).
        solver: gives the other poses, the landmarks, J and covariances; it belongs to the latest step.
    """

    step: int
    pose: Array
    solver: OnlineSolver

    @property
    def poses(self) -> Array:
        """All poses so far, (step + 1, 3); those older than a lag are final."""
        return self.solver.poses

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)}."""
        return self.solver.landmarks


def online(
    log: Log, *, tolerance: float | None = None, lag: int | None = None, **options: Any
) -> Iterator[OnlineEstimate]:
    """Go through a log step by step, as a robot that drives; after every step the estimate is that of the whole graph.

    Args:
        log: with controls.
        tolerance, lag: see `OnlineSolver`.
        options: motion, sensor, motion_weight, kernel and dimensions, as in `Graph.from_log`.

    Raises:
        GraphError: the log lacks what the graph needs.
        OptionError: an option has an impossible value.
    """
    return steps_of(Graph.from_log(log, edges="landmark+motion", **options), tolerance=tolerance, lag=lag)


def solve_by_steps(graph: Graph, *, tolerance: float | None = None, lag: int | None = None) -> Solution:
    """The estimate after the last step of `steps_of`, which has converged if its last step has.

    With a lag, final poses have the last value that they had.
    """
    begin = time.perf_counter()
    (last,) = deque(steps_of(graph, tolerance=tolerance, lag=lag), maxlen=1)
    converged, reason = last.solver.converged, "went through the log once, step by step"
    if last.solver.num_final:
        reason += f"; the first {last.solver.num_final} poses are older than the lag of {lag} steps, and final"
    if not converged:
        reason += ", and did not converge at the last step"
    seconds, state = time.perf_counter() - begin, graph.initial.copy()
    state[: len(graph.steps)] = last.poses
    state[len(graph.steps) :, : graph.landmark_dimension] = list(last.landmarks.values())
    state[graph.fixed] = graph.initial[graph.fixed]
    return make_solution(
        graph, state, step_norms=[], costs=[], converged=converged, reason=reason, seconds=seconds,
        solver="online",
    )  # fmt: skip


def steps_of(graph: Graph, *, tolerance: float | None = None, lag: int | None = None) -> Iterator[OnlineEstimate]:
    """As `online`, for the graph of a log with landmark nodes, motion edges and Cartesian residuals in the body frame.

    Raises:
        GraphError: the graph is another one.
    """
    graph.check_no_parameters("the solver step by step")
    sighted = next((family for family in graph.families if isinstance(family, CartesianObservationEdges)), None)
    motions = next((family for family in graph.families if isinstance(family, RelativePoseEdges)), None)
    if sighted is None or motions is None or sighted.frame != "body":
        raise GraphError(
            "the solver step by step needs a graph of edges='landmark+motion' with residual='cartesian' and frame='body'"
        )
    options: dict[str, Any] = {"sensor": graph.sensor, "kernel": sighted.kernel, "tolerance": tolerance, "lag": lag}
    total = len(graph.steps)
    if graph.map is None:
        solver = OnlineSolver(graph.initial[0], **options)
    else:
        # the map holds the first pose; this says next to nothing
        solver = OnlineSolver(graph.initial[0], start_covariance=np.diag(ANYWHERE), **options)
        known, d = graph.map, graph.landmark_dimension
        if any(len(known[j]) < d for j in graph.landmark_ids.tolist() if j in known):
            raise GraphError(
                "the solver step by step needs the headings of all landmarks of the map where sightings have psi; use "
                "dimensions=2"
            )
        solver._begin_with(*priors_of(known.among(graph.landmark_ids.tolist()), d))
    rows = np.argsort(sighted.first, kind="stable")
    bounds = np.searchsorted(sighted.first[rows], np.arange(total + 1))
    ids = graph.landmark_ids[sighted.second - total]
    seen = sighted.relative
    for step in range(total):
        now = rows[bounds[step] : bounds[step + 1]]
        edge = (step - 1, motions.measured[step - 1], motions.information[step - 1]) if step else None
        solver._add(edge, ids[now].tolist(), seen.measured[now], seen.information[now])
        yield OnlineEstimate(step, solver.pose, solver)
