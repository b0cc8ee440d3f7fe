"""What the factor types cost: Levenberg-Marquardt on the book's log2 by kind of factor, and the memory of many factors.

    python benchmarks/factors.py LOG2 [--million]

First the processor time of making each kind of factor. LOG2 is `log2_for_book.txt` of LNPR. The same optimiser,
initial values and stop rule for one Python callback per edge, one factor per landmark, and GTSAM's own between
factors (whose cost differs: their error is a logarithm); the three in turn, median of several. ``--million`` makes
and drops 10^6 factors and shows the resident memory.
"""

from __future__ import annotations

import argparse
import gc
import os
import time
from pathlib import Path

import gtsam
import numpy as np

from graphslam import Graph, MotionModel, SensorModel, load
from graphslam.factors import (
    AnchorFactor,
    InverseObservationFactor,
    MotionFactor,
    ObservationFactor,
    RelativePointFactor,
    RelativePoseFactor,
    ResidualFactor,
    VirtualMotionFactor,
    describe,
)
from graphslam.solvers.gtsam_solver import from_values, to_gtsam, to_values


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--million", action="store_true")
    options = parser.parse_args()
    construction(options.runs)
    speed(options.log, options.runs)
    if options.million:
        memory(10**6)


def construction(runs: int) -> None:
    """Processor time of making one factor of each kind."""
    z, sensor, motion, unit = [2.0, 0.3, 1.2], SensorModel(), MotionModel(), np.eye(3)
    kinds = {
        "VirtualMotionFactor": lambda: VirtualMotionFactor(1, 2, z, [1.6, 0.1, 1.3], sensor),
        "VirtualMotionFactor, kernel": lambda: VirtualMotionFactor(1, 2, z, [1.6, 0.1, 1.3], sensor, kernel="cauchy"),
        "MotionFactor": lambda: MotionFactor(1, 2, [0.2, 0.1], 3.0, motion),
        "ObservationFactor": lambda: ObservationFactor(1, 2, z, sensor),
        "InverseObservationFactor": lambda: InverseObservationFactor(1, 2, z, sensor),
        "RelativePoseFactor": lambda: RelativePoseFactor(1, 2, z, unit),
        "RelativePointFactor": lambda: RelativePointFactor(1, 2, z[:2], unit[:2, :2]),
        "AnchorFactor": lambda: AnchorFactor(1, z),
        "ResidualFactor": lambda: ResidualFactor([1], lambda x: x, unit),
    }
    for name, make in kinds.items():
        times = []
        for _ in range(runs + 1):
            begin = time.process_time()
            for _ in range(200):
                make()
            times.append((time.process_time() - begin) / 200)
        print(f"made {name:28}{np.median(times[1:]) * 1e6:6.1f} us")


def speed(path: Path, runs: int) -> None:
    """Time to convergence by kind of factor."""
    graph = Graph.from_log(load(path), edges="virtual+motion", kernel="none")
    per_edge = to_gtsam(graph, factors="per-edge")
    native = gtsam.NonlinearFactorGraph()
    for k in range(per_edge.size()):
        factor = describe(per_edge.at(k)).build()
        native.add(factor.to_between() if hasattr(factor, "to_between") else factor)
    kinds = {"one callback per edge": per_edge, "one factor per landmark": to_gtsam(graph)}
    kinds["native between factors"] = native
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    params.setAbsoluteErrorTol(1e-12)
    seconds: dict[str, list[float]] = {name: [] for name in kinds}
    ends = {}
    for run in range(runs + 1):
        for name, factors in kinds.items():
            values = to_values(graph, graph.initial)
            begin = time.perf_counter()
            optimizer = gtsam.LevenbergMarquardtOptimizer(factors, values, params)
            result = optimizer.optimize()
            if run:  # the first warms up
                seconds[name].append(time.perf_counter() - begin)
            ends[name] = (optimizer.iterations(), from_values(graph, result))
    base, reference = np.median(seconds["one callback per edge"]), ends["one callback per edge"][1]
    for name, times in seconds.items():
        iterations, state = ends[name]
        ratio, off = base / np.median(times), np.abs(state - reference)[:, :2].max()
        print(
            f"{name:26}{np.median(times) * 1e3:8.1f} ms, {iterations} iterations, 1/{ratio:.1f} of one callback per edge; "
            f"J of the exact edges {graph.cost(state):.4f}; positions differ by up to {off:.1e} m"
        )


def memory(count: int) -> None:
    """Resident memory before and after that many factors were made, evaluated and dropped."""
    x1, x2 = gtsam.symbol("x", 1), gtsam.symbol("x", 2)
    values = gtsam.Values()
    values.insert(x1, gtsam.Pose2(0, 0, 0))
    values.insert(x2, gtsam.Pose2(1, 0, 0.1))

    def batch(size: int) -> None:
        graph = gtsam.NonlinearFactorGraph()
        for _ in range(size // 2):
            graph.add(VirtualMotionFactor(x1, x2, [1, 0, 0], [1, 0.1, 0]))
            graph.add(MotionFactor(x1, x2, [1, 0], 1.0))
        graph.error(values)

    batch(10_000)
    gc.collect()
    before = resident()
    for _ in range(count // 10_000):
        batch(10_000)
    gc.collect()
    after = resident()
    print(f"{count} factors made and dropped: resident {before:.0f} MiB before, {after:.0f} MiB after")


def resident() -> float:
    """The resident memory of this process [MiB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main()
