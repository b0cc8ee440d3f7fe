"""Robots that see each other: `graphslam.sessions.join_robots`.

    python benchmarks/robots.py [--data ../shared/data/mrclam6]

The five robots of MR.CLAM 6, each with noise and biases estimated from its own log without the ground truth: alone, joined by
their common landmarks, and with their sightings of each other; and with clocks that were set off, which are estimated or
not. The ATE of each robot after its own alignment, and the processor time of the solves.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from graphslam import Graph, Log, Solution, solve
from graphslam.identification.known import known_robot
from graphslam.io.formats import load_robots
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate
from graphslam.sessions import clock_offsets, join_robots

#: how many seconds the clocks are set behind
OFF = {2: 0.5, 3: -1.0, 4: 2.0, 5: 3.0}


def solved(log: Log) -> tuple[Solution, float]:
    """The graph with landmark nodes and a robust kernel, solved, and the processor time [s]."""
    begin = time.process_time()
    solution = solve(Graph.from_log(log, edges="landmark+motion", kernel="cauchy"))
    return solution, time.process_time() - begin


def report(name: str, errors: list[float], seconds: float, remark: str = "") -> None:
    """A line of the comparison."""
    each = " ".join(f"{error:.3f}" for error in errors)
    print(f"{name:22} {each}  mean {np.mean(errors):.3f} m, {seconds:.1f} s{remark}")


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared/data/mrclam6")
    robots = {number: known_robot(log)[0] for number, log in load_robots(parser.parse_args().data).items()}
    errors, total = [], 0.0
    for log in robots.values():
        log = log.with_sightings(log.landmarks != UNIDENTIFIED)
        solution, seconds = solved(log)
        assert log.true_poses is not None
        errors.append(ate(log.true_poses, solution.poses, mask=log.covered))
        total += seconds
    report("each robot alone", errors, total)
    joined = join_robots(robots).log
    assert joined.true_poses is not None
    late = {n: log.replace(start_time=log.start_time - OFF.get(n, 0.0)) for n, log in robots.items()}
    begin = time.process_time()
    right, found = clock_offsets(robots), clock_offsets(late)
    print(f"clocks: {right.sentence}; set off by {OFF}, of which are found", end=" ")
    print({n: round(found.seconds[n] - right.seconds[n], 3) for n in OFF}, f"{(time.process_time() - begin) / 2:.1f} s")
    for name, log in (
        ("joined by landmarks", joined.replace(relations=None)),
        ("and by each other", joined),
        ("clocks set off", join_robots(late).log),
        ("and estimated", found.joined(late).log),
    ):
        solution, seconds = solved(log)
        errors = [ate(log.true_poses[drive], solution.poses[drive], mask=log.covered[drive]) for drive in log.drives]
        report(name, errors, seconds, f", {solution.certificate.status}")


if __name__ == "__main__":
    main()
