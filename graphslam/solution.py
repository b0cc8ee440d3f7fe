"""What any solver returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from .errors import OptionError
from .graph import Graph
from .mapping import LandmarkMap, estimate_map
from .se2 import Array, wrap


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a solver on a graph, converged or not.

    Attributes:
        poses: (T+1, 3) [m, m, rad], headings in [-pi, pi).
        estimated: (T+1,) bool; False for poses that no edge touches: their rows hold the initial guess.
        landmarks: {id: (x, y) or (x, y, heading)}; landmark nodes, or the map that `estimate_map` makes of the poses.
        landmark_covariances: {id: (2, 2) or (3, 3)} of the same landmarks.
        cost: J at the solution, the sum of e' Omega e (no one half).
        costs: (iterations + 1,), J before the first and after each iteration.
        iterations: the number of steps taken.
        step_norms: (iterations,), the Euclidean norm of each whole correction vector.
        converged: whether the stop rule was met; never True for a run that diverged, got stuck or ran out.
        reason: one sentence on why the iteration ended.
        seconds: time of the optimisation alone [s], from initial values to the stop.
        solver: which solver made it.
        notes: what the user should know about the graph.
    """

    poses: Array
    estimated: np.ndarray
    landmarks: dict[int, Array]
    landmark_covariances: dict[int, Array]
    cost: float
    costs: Array
    iterations: int
    step_norms: Array
    converged: bool
    reason: str
    seconds: float
    solver: str
    notes: tuple[str, ...] = ()
    _covariance: Callable[[int], Array] | None = field(default=None, repr=False)

    def covariance(self, step: int) -> Array:
        """The covariance (3, 3) of the pose at a step, in world axes (x, y, theta): a diagonal block of Omega^-1.

        Raises:
            OptionError: there is no such step, the graph does not estimate it, or the solver kept no factorisation.
        """
        if not -len(self.poses) <= step < len(self.poses):
            raise OptionError(f"step must lie between 0 and {len(self.poses) - 1}, not {step}")
        if not self.estimated[step]:
            raise OptionError(f"pose {step} is not part of the graph, so it has no covariance")
        if self._covariance is None:
            raise OptionError(f"the solver {self.solver} kept no factorisation to take covariances from")
        return self._covariance(step % len(self.poses))


def make_solution(
    graph: Graph,
    state: Array,
    *,
    step_norms: list[float],
    costs: list[float],
    converged: bool,
    reason: str,
    seconds: float,
    solver: str,
) -> Solution:
    """The `Solution` of a graph from the final state (n, 3) of a solver and the story of its iteration."""
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    cost = graph.cost(state)
    landmarks = LandmarkMap({}, {})
    if graph.log is not None and np.all(np.isfinite(poses)):
        landmarks = estimate_map(graph.log, poses, graph.sensor)
    node_of = dict(zip(graph.steps.tolist(), range(len(graph.steps))))

    @cache
    def inverse() -> Array:
        system, _ = graph.linearize(state)
        return system.factorize().diagonal_covariances()

    return Solution(
        poses=poses,
        estimated=estimated,
        landmarks=dict(landmarks),
        landmark_covariances=landmarks.covariances,
        cost=cost,
        costs=np.array([*costs, cost]),
        iterations=len(step_norms),
        step_norms=np.array(step_norms),
        converged=converged,
        reason=reason,
        seconds=seconds,
        solver=solver,
        notes=graph.notes,
        _covariance=lambda step: inverse()[node_of[step]].copy(),
    )
