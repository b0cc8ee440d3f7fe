# %% estimator
import time

import numpy as np

import comparisons
from comparisons.estimators import ESTIMATORS, Estimator
from comparisons.options import RunOptions
from comparisons.results import EstimatorResult
from graphslam import Graph, Log


def one_factor(log: Log, options: RunOptions) -> EstimatorResult:
    """Dead reckoning, with the speed multiplied by the one factor that makes J of the sightings smallest."""
    begin, best = time.perf_counter(), (np.inf, log.initial_poses)
    graph = Graph.from_log(log, motion=options.motion, sensor=options.sensor, edges="virtual")
    for factor in np.linspace(0.7, 1.3, 61):
        poses = log.replace(controls=log.controls * [factor, 1.0]).dead_reckoning(options.motion)
        best = min(best, (graph.cost(poses[graph.steps]), poses), key=lambda pair: pair[0])
    return EstimatorResult(
        name="one-factor",
        poses=best[1],
        estimated=np.ones(log.num_poses, dtype=bool),
        cost=best[0],
        seconds=time.perf_counter() - begin,
    )


# %% use
ESTIMATORS["one-factor"] = Estimator(one_factor)
comparison = comparisons.run(estimators=["dead-reckoning", "one-factor", "graph"])
for row in comparison.table:
    print(f"{row.name:15} ATE {row.ate_m:.3f} m")
errors = {row.name: row.ate_m for row in comparison.table}
assert 0.9 < errors["one-factor"] / errors["dead-reckoning"] < 1
assert errors["graph"] < 0.2 * errors["one-factor"]

# %% picture
comparison.figure()

# %% edge
from dataclasses import dataclass, replace

from graphslam import load, sample_log_path, solve
from graphslam.edges.base import EdgeFamily, Linearization


@dataclass(frozen=True, eq=False)
class FixEdges(EdgeFamily):
    """Positions z (E, 2) [m] measured at nodes (E,), as by GPS: e = (x, y) - z, B = [I, 0]."""

    nodes: np.ndarray
    measured: np.ndarray
    information: np.ndarray

    @property
    def count(self):
        return len(self.nodes)

    def cliques(self):
        return np.arange(self.count + 1), self.nodes  # groups of one node each

    def linearize(self, state, reference):
        B = np.broadcast_to(np.eye(2, 3), (self.count, 2, 3))
        return Linearization(state[self.nodes, :2] - self.measured, self.information, (self.nodes,), (B,))


# %% edge_used
log = load(sample_log_path())
graph = Graph.from_log(log)
measured = np.arange(0, log.num_poses, 10)  # every tenth pose is measured to 0.05 m
gps = FixEdges(measured, log.true_poses[measured, :2], np.tile(400 * np.eye(2), (len(measured), 1, 1)))
errors = []
for name, families in (("without", graph.families), ("with", (*graph.families, gps))):
    poses = solve(replace(graph, families=families)).poses
    errors.append(np.hypot(*(poses - log.true_poses)[:, :2].T).mean())
    print(f"{name} positions: mean error {errors[-1]:.3f} m")
assert errors[1] < 0.6 * errors[0]
