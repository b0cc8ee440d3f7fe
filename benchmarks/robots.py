"""Robots that see each other: `graphslam.sessions.join_robots`.

    python benchmarks/robots.py [--data ../shared/data/mrclam6]

The five robots of MR.CLAM 6, each with noise and biases estimated from its own log without the ground truth: alone, joined by
their common landmarks, and with their sightings of each other. The ATE of each robot after its own alignment, and the time of
the solves.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from graphslam import Graph, Log, Solution, solve
from graphslam.identification.robot import known_robot
from graphslam.io.formats import load_robots
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate
from graphslam.sessions import join_robots


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
    for name, log in (("joined by landmarks", joined.replace(relations=None)), ("and by each other", joined)):
        solution, seconds = solved(log)
        errors = [
            ate(joined.true_poses[drive], solution.poses[drive], mask=joined.covered[drive]) for drive in joined.drives
        ]
        report(name, errors, seconds, f", {solution.certificate.status}")


if __name__ == "__main__":
    main()
