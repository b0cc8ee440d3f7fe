"""One iteration, taken apart, against the book's program, GTSAM and g2o; the accuracy of the linear solve; the inverse.

    python benchmarks/iteration.py [FOLDER WITH lnpr/ AND posegraph/] [--record docs/measured]

The folder defaults to ../shared/data or the environment variable SLAM_DATA. GTSAM iterates with its native factors.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import gtsam
import numpy as np
from recording import add_option, record

from comparisons.studies.backends import native_gtsam_graph
from graphslam import Graph, load, solve, textbook
from graphslam.edges import RelativePointEdges
from graphslam.solvers.gtsam_solver import to_values

HERE = Path(__file__).parents[2] / "shared" / "data"
GRAPHS = {
    "INTEL": "input_INTEL_g2o.g2o",
    "CSAIL": "CSAIL.g2o",
    "M3500": "input_M3500_g2o.g2o",
    "dlr": "dlr.g2o",
    "cityTrees10000": "cityTrees10000.txt",
    "city10000": "city10000.g2o",
}


def median(function: Callable[[], object], repeat: int = 15) -> float:
    """The median time of a warm call [s]."""
    function()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def g2o_iteration(graph: Graph) -> float | None:
    """One iteration of g2o's Gauss-Newton [s], from five less none, where g2opy is installed."""
    try:
        import g2opy

        from comparisons.studies.backends import _g2o_optimizer
    except ImportError:
        return None

    def seconds(count: int) -> float:
        optimizer = _g2o_optimizer(g2opy, graph, damped=False)
        optimizer.initialize_optimization()
        begin = time.perf_counter()
        optimizer.optimize(count)
        return time.perf_counter() - begin

    seconds(1)
    return (statistics.median(seconds(6) for _ in range(3)) - statistics.median(seconds(1) for _ in range(3))) / 5


def main() -> None:
    """Print the tables of docs/benchmarks.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", default=os.environ.get("SLAM_DATA", HERE))
    add_option(parser)
    arguments = parser.parse_args()
    data, rows = Path(arguments.data), []
    log = load(data / "lnpr/log2_for_book.txt")
    graph = Graph.from_log(log, edges="virtual+motion", kernel="none")
    solve(graph, initialize="given")
    runs = [solve(graph, initialize="given") for _ in range(30)]
    ours = statistics.median(run.seconds / run.iterations for run in runs)
    book = median(lambda: textbook.solve(log, edges="virtual+motion", max_iterations=1), 3)
    print(f"book's log2, {graph.num_edges} edges: {ours * 1e3:.2f} ms per iteration; textbook.py {book * 1e3:.0f} ms")
    rows.append({"name": "book", "total_ms": 1e3 * ours, "textbook_ms": 1e3 * book})
    print(f"{'graph':24s} {'sums':>7} {'factor':>7} {'solve':>7} {'all':>7} {'gtsam':>8} {'g2o':>8} {'inverse/factor':>15}"
          f" {'residual given':>15} {'at the optimum':>15}")  # fmt: skip
    for name, file in GRAPHS.items():
        graph = Graph.from_g2o(data / "posegraph" / file)
        system, _ = graph.linearize(graph.initial)
        sums = median(lambda g=graph: g.linearize(g.initial))
        graph.linearize(graph.initial)
        factor = median(system.factorize)
        kept = system.factorize()
        back = median(lambda k=kept, s=system: k.solve(s.xi))

        def inverse(s=system) -> None:
            s.factorize().diagonal_covariances()

        inverted = median(inverse, 7) - factor
        residuals = []
        for state in (graph.initial, solve(graph, initialize="auto").state):
            system, _ = graph.linearize(state)
            omega, xi = system.to_sparse(), system.xi.ravel()
            delta = system.factorize().solve(system.xi).ravel()
            residuals.append(np.linalg.norm(omega @ delta - xi) / np.linalg.norm(xi))
        gtsams = None
        # points would be factors in Python
        if not any(isinstance(family, RelativePointEdges) for family in graph.families):
            optimizer = gtsam.GaussNewtonOptimizer(native_gtsam_graph(graph), to_values(graph, graph.initial))
            with suppress(RuntimeError):
                gtsams = median(optimizer.iterate, 3)
        total, g2os = sums + factor + back, g2o_iteration(graph)
        theirs = " ".join("       -" if t is None else f"{1e3 * t:8.2f}" for t in (gtsams, g2os))
        print(
            f"{name:24s} {sums * 1e3:7.2f} {factor * 1e3:7.2f} {back * 1e3:7.2f} {total * 1e3:7.2f} "
            f"{theirs} {inverted / factor:15.1f} {residuals[0]:15.1e} {residuals[1]:15.1e}"
        )
        times = {"sums": sums, "factorisation": factor, "solution": back, "total": total, "gtsam": gtsams, "g2o": g2os}
        rows.append(
            {"name": name, "graph": name} | {f"{part}_ms": None if t is None else 1e3 * t for part, t in times.items()}
            | {"inverse_to_factor": inverted / factor}
            | {"residual_initial": residuals[0], "residual_optimum": residuals[1]}
        )  # fmt: skip
    record(arguments.record, "iteration", rows)


if __name__ == "__main__":
    main()
