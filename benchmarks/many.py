"""Many graphs of the same structure with different noise: the time of `solve_many` by the number of its threads.

    python benchmarks/many.py [--data ../shared/data] [--start given] [--copies 200]

All results are compared bit by bit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Graph, Log, load, sample_log_path, solve_many
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
        return Graph.from_log(replace(log, sightings=log.sightings + drawn), edges=edges, kernel="none")

    return make


def of_file(path: Path) -> Callable[[np.random.Generator], Graph]:
    """What makes graphs of a pose-graph file with noise on its measurements."""
    graph = Graph.from_g2o(path)
    return lambda random: with_other_noise(graph, random)


def measured(
    make: Callable[[np.random.Generator], Graph], copies: int, start: str, jobs: int
) -> tuple[float, list[Any]]:
    """The time [s] for each graph with a number of threads, and the states."""
    graphs = [make(np.random.default_rng(seed)) for seed in range(copies)]
    begin = time.perf_counter()
    states = [solution.state for solution in solve_many(graphs, jobs=jobs, initialize=start)]
    return (time.perf_counter() - begin) / copies, states


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
        "city10000": (of_file(files / "city10000.g2o"), 0.1),
    }
    print(f"{'structure':28} {'copies':>6} {'caller':>8} {'1':>8} {'2':>8}  (ms for each graph, start {options.start})")
    for name, (make, share) in cases.items():
        copies = max(6, int(share * options.copies))
        seconds, states = zip(*(measured(make, copies, options.start, jobs) for jobs in (0, 1, 2)))
        assert all(np.array_equal(a, b) for others in states[1:] for a, b in zip(states[0], others, strict=True))
        print(f"{name:28} {copies:6} " + " ".join(f"{1e3 * each:8.2f}" for each in seconds), flush=True)


if __name__ == "__main__":
    main()
