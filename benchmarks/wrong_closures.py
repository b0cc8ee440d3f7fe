"""Wrong loop closures in public pose graphs: graduated non-convexity against GTSAM's `GncLMOptimizer` and plain squares.

    python benchmarks/wrong_closures.py [--data ../shared/data/posegraph] [--graphs INTEL M3500] [--shares 0.2 0.4]
                                        [--seeds 10] [--first 0] [--methods own gtsam plain known]
                                        [--record docs/measured]

A share of the loop closures is replaced by relative poses at random: any heading, and a place within a fifth of the
trajectory's largest extent. Both methods trust the odometry, truncate squares at the quantile 0.99 of chi-square and start
from the values of the file. GTSAM has its own BetweenFactorPose2, the odometry as known inliers, and its default parameters.
"known" is the optimum of plain squares without the wrong closures: what a method reaches that knows them.
The ATE is that to the optimum of the graph without wrong closures, whose first pose is held, too. Each row has the median and
the largest ATE over the seeds, the median of the processor time, and the closures that were wrongly rejected and wrongly
kept, on average; then in how many seeds the ATE is at most that of GTSAM, to a hundredth of it, and in how many J with
truncated squares, which both minimise, is. Each row is recorded when it is done.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from recording import add_option, record
from scipy.stats import chi2

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

#: poses (P, 3), the trust in each closure (R,), and the processor time [s]
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


def truncated(graph: Graph, poses: Array) -> float:
    """J, in which the squares of each closure count as the quantile at most."""
    limit = chi2.ppf(PROBABILITY, 3)
    return float(
        sum(
            np.minimum(family.squares(poses), limit).sum()
            if isinstance(family, RelationEdges)
            else family.cost(poses, poses)
            for family in graph.families
        )
    )


def closures_of(graph: Graph) -> RelationEdges:
    """The loop closures of a graph."""
    return next(family for family in graph.families if isinstance(family, RelationEdges))


def own(graph: Graph) -> Outcome:
    """The solver of this project."""
    begin = time.process_time()
    found = solve(graph, method="gnc", probability=PROBABILITY)
    return found.poses, found.other_trust["relations"], time.process_time() - begin


def plain(graph: Graph) -> Outcome:
    """Least squares, without any defence."""
    begin = time.process_time()
    found = solve(graph, method="levenberg-marquardt", initialize="given")
    return found.poses, np.ones(closures_of(graph).count), time.process_time() - begin


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
    begin = time.process_time()
    optimizer = gtsam.GncLMOptimizer(factors, to_values(graph, graph.initial), parameters)
    optimizer.setInlierCostThresholdsAtProbability(PROBABILITY)
    values = optimizer.optimize()
    seconds = time.process_time() - begin
    doubted = np.setdiff1d(np.arange(factors.size()), known)
    return from_values(graph, values), np.asarray(optimizer.getWeights())[doubted], seconds


def known(graph: Graph, wrong: np.ndarray) -> Outcome:
    """Plain squares without the wrong closures."""
    closures, begin = closures_of(graph), time.process_time()
    right = closures.with_trust(np.where(wrong, 0.0, 1.0))
    changed = replace(graph, families=tuple(right if f is closures else f for f in graph.families))
    found = solve(changed, initialize="given")
    return found.poses, right.trusted, time.process_time() - begin


METHODS: dict[str, Callable[[Graph, np.ndarray], Outcome]] = {
    "own": lambda graph, _: own(graph),
    "gtsam": lambda graph, _: gtsams(graph),
    "plain": lambda graph, _: plain(graph),
    "known": known,
}


@dataclass(frozen=True)
class Result:
    """One method on one graph with one seed: ATE [m], processor time [s], closures wrongly rejected and wrongly kept, J."""

    graph: str
    share: float
    method: str
    seed: int
    ate: float
    seconds: float
    rejected: int
    kept: int
    cost: float

    @classmethod
    def of(cls, graph: str, share: float, method: str, seed: int, clean: Array, extent: float, source: Graph) -> Result:
        """Compute it; ``clean`` (P, 3) is the optimum of the graph ``source`` without wrong closures."""
        changed, wrong = with_wrong_closures(source, share, seed, extent)
        poses, trust, seconds = METHODS[method](changed, wrong)
        error = float(np.sqrt(np.mean(np.sum((poses - clean)[:, :2] ** 2, axis=1))))
        rejected, kept = int(np.sum(trust[~wrong] < 0.5)), int(np.sum(trust[wrong] >= 0.5))
        return cls(graph, share, method, seed, error, seconds, rejected, kept, truncated(changed, poses))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/posegraph"))
    parser.add_argument("--graphs", nargs="+", choices=list(GRAPHS), default=list(GRAPHS))
    parser.add_argument("--shares", nargs="+", type=float, default=[0.2, 0.4])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    add_option(parser)
    options = parser.parse_args()
    print(f"{'graph':10} {'wrong':>5}  {'method':6} {'ATE [m]':>9} {'largest':>9} {'time [s]':>9}  rejected  kept")
    for name in options.graphs:
        graph = Graph.from_g2o(options.data / GRAPHS[name]).with_closures()
        clean = solve(graph).poses
        extent = float(np.ptp(clean[:, :2], axis=0).max())
        for share in options.shares:
            rows = dict[str, list[Result]]()
            figures: dict[str, Any] = {
                "name": f"{name} {share:.0%}",
                "graph": name,
                "share": share,
                "seeds": options.seeds,
            }
            for method in options.methods:
                seeds = range(options.first, options.first + options.seeds)
                rows[method] = [Result.of(name, share, method, seed, clean, extent, graph) for seed in seeds]
                errors, seconds = [r.ate for r in rows[method]], [r.seconds for r in rows[method]]
                rejected, kept = [r.rejected for r in rows[method]], [r.kept for r in rows[method]]
                print(
                    f"{name:10} {share:5.0%}  {method:6} {np.median(errors):9.3f} {max(errors):9.3f} "
                    f"{np.median(seconds):9.2f}  {np.mean(rejected):8.1f}  {np.mean(kept):4.1f}",
                    flush=True,
                )  # fmt: skip
                figures |= {
                    f"{method}_ate_m": np.median(errors), f"{method}_largest_m": max(errors),
                    f"{method}_s": np.median(seconds), f"{method}_rejected": np.mean(rejected),
                    f"{method}_kept": np.mean(kept),
                }  # fmt: skip
            if {"own", "gtsam"} <= rows.keys():
                pairs = list(zip(rows["own"], rows["gtsam"]))
                good = sum(a.ate <= 1.01 * b.ate for a, b in pairs)
                ratio = np.median([b.seconds / a.seconds for a, b in pairs])
                lower = sum(a.cost <= b.cost for a, b in pairs)
                print(
                    f"{name:10} {share:5.0%}  own at most gtsam in {good} of {len(pairs)}, in J in {lower}, "
                    f"{ratio:.1f} times as fast"
                )
                figures |= {"at_most": good, "lower": lower, "times_as_fast": ratio}
            record(options.record, "wrong_closures", [figures])


if __name__ == "__main__":
    main()
