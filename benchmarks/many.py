"""Many graphs of the same structure with different noise: processor time of `solve_many` and of `solve` one by one.

    python benchmarks/many.py [--data ../shared/data] [--start given] [--copies 200]

The two take turns, graph by graph, in this process. The last column is the processor time that this process spends on a
graph when another process solves it. All results are compared bit by bit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Graph, Log, load, sample_log_path, solve, solve_many
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


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and result."""
    begin = time.process_time()
    result = function()
    return time.process_time() - begin, result


def measured(make: Callable[[np.random.Generator], Graph], copies: int, start: str) -> tuple[float, float, float]:
    """Processor times [s] of a graph alone, in `solve_many`, and for this process when another one solves it."""

    def graphs() -> list[Graph]:
        return [make(np.random.default_rng(seed)) for seed in range(copies)]

    alone = (solve(graph, initialize=start) for graph in graphs())
    together = solve_many(graphs(), jobs=0, initialize=start)
    solve(graphs()[0], initialize=start)
    seconds, states = {id(alone): 0.0, id(together): 0.0}, []
    for number in range(copies):
        # the second of a pair finds warmer caches
        pair = (alone, together) if number % 2 else (together, alone)
        first, second = (timed(partial(next, solutions)) for solutions in pair)
        for solutions, (spent, _) in zip(pair, (first, second), strict=True):
            seconds[id(solutions)] += spent
        assert first[1].cost == second[1].cost
        assert np.array_equal(first[1].state, second[1].state)
        states.append(first[1].state)
    others = graphs()
    sending, results = timed(lambda: [*solve_many(others, jobs=1, initialize=start)])
    assert all(np.array_equal(state, result.state) for state, result in zip(states, results, strict=True))
    return seconds[id(alone)] / copies, seconds[id(together)] / copies, sending / copies


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
    columns = f"{'copies':>6} {'solve':>8} {'solve_many':>10} {'ratio':>6} {'sending':>8}"
    print(f"{'structure':28} {columns}  (ms for each graph, start {options.start})")
    for name, (make, share) in cases.items():
        copies = max(6, int(share * options.copies))
        one, many, sending = measured(make, copies, options.start)
        row = f"{1e3 * one:8.2f} {1e3 * many:10.2f} {many / one:6.3f} {1e3 * sending:8.2f}"
        print(f"{name:28} {copies:6} {row}", flush=True)


if __name__ == "__main__":
    main()
