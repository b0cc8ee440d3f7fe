"""Many graphs of the same structure with different noise: processor time of `solve_many` and of `solve` one by one.

    python benchmarks/many.py [--data ../shared/data] [--start given] [--copies 200]

The two take turns, graph by graph, in this process. The last column is the processor time that this process spends on a
graph when another process solves it. All results are compared bit by bit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Graph, Log, Solution, load, sample_log_path, solve, solve_many
from graphslam.edges import RelativePointEdges, RelativePoseEdges


def with_other_noise(graph: Graph, random: np.random.Generator, noise: float = 0.01) -> Graph:
    """The same edges with Gaussian noise on the measurements [m, rad], and a system of its own."""
    families = []
    for family in graph.families:
        if isinstance(family, RelativePoseEdges | RelativePointEdges):
            drawn = noise * random.standard_normal(family.measured.shape)
            family = replace(family, measured=family.measured + drawn)
        families.append(family)
    return replace(graph, families=tuple(families))


def of_sample_log(edges: str) -> Callable[[np.random.Generator], Graph]:
    """What makes graphs of the sample log with noise on its sightings."""
    log: Log = load(sample_log_path())

    def make(random: np.random.Generator) -> Graph:
        drawn = 0.01 * random.standard_normal(log.sightings.shape)
        return Graph.from_log(replace(log, sightings=log.sightings + drawn), edges=edges)

    return make


def of_file(path: Path) -> Callable[[np.random.Generator], Graph]:
    """What makes graphs of a pose-graph file with noise on its measurements."""
    graph = Graph.from_g2o(path)
    return lambda random: with_other_noise(graph, random)


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and result."""
    begin = time.process_time()
    result = function()
    return time.process_time() - begin, result


def main() -> None:
    """One line for each structure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--start", default="given", help="initialize of the solver")
    parser.add_argument("--copies", type=int, default=200, help="graphs of the small structures; a tenth of the large")
    options = parser.parse_args()
    files = options.data / "posegraph"
    cases = {
        "sample log, virtual+motion": (of_sample_log("virtual+motion"), 1.0),
        "sample log, landmark+motion": (of_sample_log("landmark+motion"), 1.0),
        "simulation, 77 nodes": (of_file(files / "simulation-pose-landmark.g2o"), 1.0),
        "INTEL": (of_file(files / "input_INTEL_g2o.g2o"), 0.1),
        "M3500": (of_file(files / "input_M3500_g2o.g2o"), 0.1),
        "city10000": (of_file(files / "city10000.g2o"), 0.05),
    }
    print(
        f"{'structure':28} {'copies':>6} {'solve':>8} {'solve_many':>10} {'ratio':>6} {'sending':>8}  (ms each, start {options.start})"
    )
    for name, (make, share) in cases.items():
        copies = max(5, int(share * options.copies))
        keywords = {"initialize": options.start}

        def graphs(make: Callable[[np.random.Generator], Graph] = make, copies: int = copies) -> Iterator[Graph]:
            return (make(np.random.default_rng(seed)) for seed in range(copies))

        solve(next(graphs()), **keywords)
        one, many, ends = 0.0, 0.0, []
        together = solve_many([*graphs()], jobs=0, **keywords)
        for graph in graphs():
            seconds, alone = timed(lambda graph=graph: solve(graph, **keywords))
            one += seconds
            seconds, shared = timed(lambda: next(together))
            many += seconds
            check(alone, shared)
            ends.append(alone.state)
        others = [*graphs()]
        sending, results = timed(lambda others=others: [*solve_many(others, jobs=1, **keywords)])
        for end, result in zip(ends, results, strict=True):
            assert np.array_equal(end, result.state), name
        ms = 1e3 / copies
        print(
            f"{name:28} {copies:6} {ms * one:8.2f} {ms * many:10.2f} {many / one:6.3f} {ms * sending:8.2f}", flush=True
        )


def check(alone: Solution, shared: Solution) -> None:
    """Both solutions are the same to the last bit."""
    assert alone.cost == shared.cost
    assert np.array_equal(alone.state, shared.state)


if __name__ == "__main__":
    main()
