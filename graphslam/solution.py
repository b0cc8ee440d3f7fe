"""What any solver returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral

import numpy as np

from .errors import OptionError
from .graph import Graph
from .mapping import LandmarkMap, estimate_map
from .se2 import Array, wrap
from .uncertainty import Uncertainty


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a solver on a graph, converged or not.

    Attributes:
        poses: (T+1, 3) [m, m, rad], headings in [-pi, pi); for a pose graph one row per pose id, by increasing id.
        estimated: (T+1,) bool; False for poses that no edge touches: their rows hold the initial guess.
        landmarks: {id: (x, y) or (x, y, heading)}; landmark nodes, or the map that `estimate_map` makes of the poses.
        cost: J at the solution, the sum of e' Omega e (no one half).
        costs: J before the first step and after each one, as far as the solver tells it.
        iterations: the number of steps taken.
        step_norms: (iterations,), the Euclidean norm of each whole correction vector.
        converged: whether the stop rule was met; never True for a run that diverged, got stuck or ran out. What it
            met is a stationary point, which may be a local minimum.
        reason: one sentence on why the iteration ended.
        seconds: time of the optimisation alone [s], from initial values to the stop.
        solver: which solver made it.
        state: (n, 3) the values of the graph's nodes.
        notes: what the user should know about the graph.
        trust: (M,) how far each sighting of the log was trusted, from 0 to 1, where `solve_gnc` decided; NaN for
            sightings that the graph does not use. None elsewhere.
    """

    poses: Array
    estimated: np.ndarray
    landmarks: dict[int, Array]
    cost: float
    costs: Array
    iterations: int
    step_norms: Array
    converged: bool
    reason: str
    seconds: float
    solver: str
    state: Array
    notes: tuple[str, ...] = ()
    trust: Array | None = None
    _graph: Graph | None = field(default=None, repr=False)

    def covariance(self, step: int) -> Array:
        """The covariance (3, 3) of a pose in world axes (x, y, theta): a diagonal block of Omega^-1.

        Raises:
            OptionError: there is no such step, or the graph does not estimate its pose.
            GraphError: the edges do not determine the poses.
        """
        return self._uncertainty.diagonal[self._node(step)].copy()

    def covariances(self) -> Array:
        """The covariances of all poses at once, (T+1, 3, 3); NaN where a pose is not estimated."""
        blocks = np.full((len(self.poses), 3, 3), np.nan)
        blocks[self.estimated] = self._uncertainty.diagonal[: int(self.estimated.sum())]
        return blocks

    def cross_covariance(self, step: int, other: int | None = None, *, landmark: int | None = None) -> Array:
        """The covariance between a pose and another pose (3, 3), or a landmark that is a node (3, d), in world axes.

        Raises:
            OptionError: there is no such pose or landmark in the graph, or not exactly one of the two is asked for.
        """
        if (other is None) == (landmark is None):
            raise OptionError("cross_covariance takes the step of another pose, or landmark=ID, and not both")
        node = self._node(step)
        if other is not None:
            return self._uncertainty.block(node, self._node(other))
        graph = self._solved_graph
        found = np.flatnonzero(graph.landmark_ids == landmark)
        if len(found) == 0:
            raise OptionError(
                f"landmark {landmark} is no node of this graph; edges='landmark+motion' makes nodes of them"
            )
        block = self._uncertainty.block(node, len(graph.steps) + int(found[0]))
        return block[:, : graph.landmark_dimension]

    @cached_property
    def landmark_covariances(self) -> dict[int, Array]:
        """{id: (2, 2) or (3, 3)}: of landmark nodes the marginal, of a map made from the poses that given the poses."""
        if isinstance(self.landmarks, LandmarkMap):
            return self.landmarks.covariances
        if not self.landmarks:
            return {}
        graph = self._solved_graph
        blocks = self._uncertainty.diagonal[len(graph.steps) :]
        d = graph.landmark_dimension
        return {j: block[:d, :d].copy() for j, block in zip(self.landmarks, blocks)}

    @property
    def graph(self) -> Graph:
        """The graph that was solved."""
        return self._solved_graph

    @property
    def _solved_graph(self) -> Graph:
        if self._graph is None:
            raise OptionError(f"the solver {self.solver} left no graph to take covariances from")
        return self._graph

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        return Uncertainty(self._solved_graph, self.state)

    def _node(self, step: int) -> int:
        if not isinstance(step, Integral) or not -len(self.poses) <= step < len(self.poses):
            raise OptionError(f"step must be a whole number between 0 and {len(self.poses) - 1}, not {step!r}")
        if not self.estimated[step]:
            raise OptionError(f"pose {step} is not part of the graph, so it has no covariance")
        return int(np.searchsorted(self._solved_graph.steps, step % len(self.poses)))


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
    notes: tuple[str, ...] = (),
) -> Solution:
    """The `Solution` of a graph from the final state (n, 3) of a solver and the story of its iteration."""
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    cost = graph.cost(state)
    landmarks: dict[int, Array] = {}
    if len(graph.landmark_ids):
        nodes = state[len(graph.steps) :, : graph.landmark_dimension].copy()
        nodes[:, 2:] = wrap(nodes[:, 2:])
        landmarks = dict(zip(graph.landmark_ids.tolist(), nodes))
    elif graph.log is not None and np.all(np.isfinite(poses)):
        landmarks = estimate_map(graph.log, poses, graph.sensor)
    return Solution(
        poses=poses,
        estimated=estimated,
        landmarks=landmarks,
        cost=cost,
        costs=np.array([*costs, cost]),
        iterations=len(step_norms),
        step_norms=np.array(step_norms),
        converged=converged,
        reason=reason,
        seconds=seconds,
        solver=solver,
        state=state,
        notes=(*graph.notes, *notes),
        _graph=graph,
    )
