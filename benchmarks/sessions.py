"""Drives that are cut and joined again: `graphslam.join_logs`.

    python benchmarks/sessions.py [--data ../shared/data/mrclam6]

Robot 3 of MR.CLAM 6 with the noise estimated from its log, cut into 2, 3 and 5 drives without the motions between them, each
in a frame of its own; the ATE after alignment over that of the uncut drive.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from graphslam import Graph, Log, Solution, estimate_robot, join_logs, load, solve
from graphslam.metrics import ate
from graphslam.se2 import between


def solved(log: Log) -> Solution:
    """The graph with landmark nodes and a robust kernel, solved."""
    return solve(Graph.from_log(log, edges="landmark+motion", kernel="cauchy"))


def cut(log: Log, count: int) -> list[Log]:
    """Parts without the motions between them, each in a frame of its own."""
    ends = np.linspace(0, log.num_poses, count + 1).astype(int)
    parts = [log.at_steps(np.arange(*pair)) for pair in zip(ends[:-1], ends[1:])]
    return [part.replace(initial_poses=between(part.initial_poses[0], part.initial_poses)) for part in parts]


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared/data/mrclam6")
    data = parser.parse_args().data
    log = estimate_robot(load(data, robot=3)).log
    assert log.true_poses is not None
    whole = ate(log.true_poses, solved(log).poses)
    print(f"robot 3 uncut: ATE {whole:.4f} m")
    for count in (2, 3, 5):
        begin = time.process_time()
        joined = join_logs(cut(log, count))
        solution = solved(joined.log)
        seconds = time.process_time() - begin
        assert joined.log.true_poses is not None
        error = ate(joined.log.true_poses, solution.poses)
        print(
            f"cut in {count}: {error:.4f} m, {error / whole:.2f} times; {solution.certificate.status}, {seconds:.1f} s"
        )


if __name__ == "__main__":
    main()
