"""Wrong loop closures in public pose graphs: graduated non-convexity against GTSAM's `GncLMOptimizer` and plain squares.

    python benchmarks/wrong_closures.py [--data ../shared/data/posegraph] [--graphs INTEL M3500] [--shares 0.2 0.4]
                                        [--seeds 10] [--without-gtsam]

A share of the loop closures is replaced by relative poses at random: any heading, and a place within a fifth of the
trajectory's largest extent. Both methods trust the odometry, truncate squares at the quantile 0.99 of chi-square and start
from the values of the file. GTSAM has its own BetweenFactorPose2, the odometry as known inliers, and its default parameters.
The ATE is that to the optimum of the graph without wrong closures, whose first pose is held, too. Each row has the median and
the largest ATE over the seeds, the median time, and the closures that were wrongly rejected and wrongly kept, on average.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np

from graphslam import Graph, solve
from graphslam.edges import RelationEdges, RelativePoseEdges
from graphslam.factors import RelativePoseFactor
from graphslam.se2 import Array
from graphslam.solvers.gtsam_factors import from_values, to_values

GRAPHS = {
    "INTEL": "input_INTEL_g2o.g2o",
    "CSAIL": "CSAIL.g2o",
    "M3500": "input_M3500_g2o.g2o",
    "city10000": "city10000.g2o",
}
#: where squares are truncated, and how far wrong closures lead, as a part of the extent
PROBABILITY, REACH = 0.99, 0.2

#: poses (P, 3), the trust in each closure (R,), and the time [s]
Outcome = tuple[Array, Array, float]


def with_wrong_closures(graph: Graph, share: float, seed: int, extent: float) -> tuple[Graph, np.ndarray]:
    """The graph with a share of its closures replaced, and which ones (R,)."""
    rng, closures = np.random.default_rng(seed), closures_of(graph)
    wrong = np.zeros(closures.count, dtype=bool)
    wrong[rng.choice(closures.count, int(share * closures.count), replace=False)] = True
    count, reach = int(wrong.sum()), REACH * extent
    measured = closures.measured.copy()
    measured[wrong, :2] = rng.uniform(-reach, reach, (count, 2))
    measured[wrong, 2] = rng.uniform(-np.pi, np.pi, count)
    changed = replace(closures, measured=measured)
    return replace(graph, families=tuple(changed if f is closures else f for f in graph.families)), wrong


def closures_of(graph: Graph) -> RelationEdges:
    """The loop closures of a graph."""
    return next(family for family in graph.families if isinstance(family, RelationEdges))


def own(graph: Graph) -> Outcome:
    """The solver of this project."""
    begin = time.perf_counter()
    found = solve(graph, method="gnc", probability=PROBABILITY)
    return found.poses, found.other_trust["relations"], time.perf_counter() - begin


def plain(graph: Graph) -> Outcome:
    """Least squares, without any defence."""
    begin = time.perf_counter()
    found = solve(graph, method="levenberg-marquardt", initialize="given")
    return found.poses, np.ones(closures_of(graph).count), time.perf_counter() - begin


def gtsams(graph: Graph) -> Outcome:
    """GTSAM's graduated non-convexity; the making of the factors is not timed."""
    factors, known = gtsam.NonlinearFactorGraph(), [0]
    held = gtsam.noiseModel.Isotropic.Precision(3, 1e6)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.initial[0]), held))
    for family in graph.families:
        assert isinstance(family, RelativePoseEdges)
        for i, j, z, omega in zip(family.first.tolist(), family.second.tolist(), family.measured, family.information):
            if not isinstance(family, RelationEdges):
                known.append(factors.size())
            factors.add(RelativePoseFactor(i, j, z, omega).to_between())
    parameters = gtsam.GncLMParams()
    parameters.setVerbosityGNC(gtsam.GncLMParams.Verbosity.SILENT)
    parameters.setKnownInliers(known)
    begin = time.perf_counter()
    optimizer = gtsam.GncLMOptimizer(factors, to_values(graph, graph.initial), parameters)
    optimizer.setInlierCostThresholdsAtProbability(PROBABILITY)
    values = optimizer.optimize()
    seconds = time.perf_counter() - begin
    doubted = np.setdiff1d(np.arange(factors.size()), known)
    return from_values(graph, values), np.asarray(optimizer.getWeights())[doubted], seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/posegraph"))
    parser.add_argument("--graphs", nargs="+", choices=list(GRAPHS), default=list(GRAPHS))
    parser.add_argument("--shares", nargs="+", type=float, default=[0.2, 0.4])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--without-gtsam", action="store_true")
    options = parser.parse_args()
    methods: dict[str, Callable[[Graph], Outcome]] = {"own": own, "gtsam": gtsams, "plain": plain}
    if options.without_gtsam:
        del methods["gtsam"]
    print(f"{'graph':10} {'wrong':>5}  {'method':6} {'ATE [m]':>9} {'largest':>9} {'time [s]':>9}  rejected  kept")
    for name in options.graphs:
        graph = Graph.from_g2o(options.data / GRAPHS[name]).with_closures()
        clean = solve(graph).poses
        extent = float(np.ptp(clean[:, :2], axis=0).max())
        for share in options.shares:
            for method, run in methods.items():
                errors, seconds, rejected, kept = list[float](), list[float](), list[int](), list[int]()
                for seed in range(options.seeds):
                    changed, wrong = with_wrong_closures(graph, share, seed, extent)
                    poses, trust, lasting = run(changed)
                    errors.append(float(np.sqrt(np.mean(np.sum((poses - clean)[:, :2] ** 2, axis=1)))))
                    seconds.append(lasting)
                    rejected.append(int(np.sum(trust[~wrong] < 0.5)))
                    kept.append(int(np.sum(trust[wrong] >= 0.5)))
                print(
                    f"{name:10} {share:5.0%}  {method:6} {np.median(errors):9.3f} {max(errors):9.3f} "
                    f"{np.median(seconds):9.2f}  {np.mean(rejected):8.1f}  {np.mean(kept):4.1f}",
                    flush=True,
                )  # fmt: skip


if __name__ == "__main__":
    main()
