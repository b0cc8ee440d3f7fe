"""Victoria Park without ids: FastSLAM 2.0, the association from its ids, and the graph, against GPS at the antenna.

    python benchmarks/victoria_park.py --runs 30:0 10:0 10:1 10:2 [--estimate turn_scale,range_bias,bearing_bias]
    python benchmarks/victoria_park.py --ids [--record docs/measured]     # only the text file of iSAM, with known ids

Nothing is tuned on GPS. Root mean square distances over all GPS positions, aligned and not; processor times.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np
from real_filters import matched_gps
from recording import add_option, record

from fastslam import FastSLAM2, associate
from fastslam.options import FilterOptions
from graphslam import Graph, Log, load, solve
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate
from graphslam.se2 import Array

DATA = Path(os.environ.get("SLAM_DATA", Path(__file__).parents[1] / "../shared/data"))


def errors(log: Log, poses: Array) -> str:
    """The errors at the antenna, 'aligned / unaligned', and that in the scoring of `real_filters`."""
    assert log.true_poses is not None
    here = log.covered
    at, truth = log.at_truth(poses)[here], log.true_poses[here]
    unaligned = np.sqrt(np.mean(np.sum((at - truth)[:, :2] ** 2, axis=1)))
    scans, fixes = matched_gps(DATA, log)
    published = np.sqrt(np.mean(np.sum((log.at_truth(poses)[scans, :2] - fixes) ** 2, axis=1)))
    return f"{ate(truth, at):.2f} / {unaligned:.2f} m, published scoring {published:.2f} m"


def main() -> None:
    """Print a line for each run and each graph."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="+", default=["30:0"], metavar="PARTICLES:SEED")
    parser.add_argument("--estimate", default="")
    parser.add_argument("--ids", action="store_true", help="only: iterations and J of the text file of iSAM")
    add_option(parser)
    given = parser.parse_args()
    if given.ids:
        found = solve(Graph.from_g2o(DATA / "victoria_park" / "victoriaPark_isam.txt"))
        print(f"J {found.cost:.3f} after {found.iterations} iterations")
        figures = {"iterations": found.iterations, "converged": found.converged, "cost": found.cost}
        record(given.record, "victoria_park", [{"name": "isam"} | figures])
        return
    log = load(DATA / "victoria_park")
    for run in given.runs:
        particles, seed = map(int, run.split(":"))
        begin = time.process_time()
        options = FilterOptions(particles=particles, seed=seed, association="maximum-likelihood")
        result = FastSLAM2(log, options=options).run()
        filtered = time.process_time()
        assert result.association is not None and result.unconfirmed is not None
        lost = (result.association == UNIDENTIFIED) | result.unconfirmed
        start = (np.where(lost, -1, result.association), result.poses)
        print(f"{particles} particles, seed {seed}: {errors(log, result.poses)}, {filtered - begin:.1f} s", flush=True)
        begin = time.process_time()
        found = associate(log, start=start, estimate=given.estimate)
        middle = time.process_time()
        print(f"  {found.landmarks} landmarks, slip {found.motion.slip:.2g} m/√m, {middle - begin:.1f} s")
        for kernel in ("none", "cauchy"):
            begin = time.process_time()
            solution = solve(Graph.from_log(found.log, edges="landmark+motion", kernel=kernel, estimate=given.estimate))
            seconds = time.process_time() - begin
            dof = solution.cost / solution.graph.degrees_of_freedom if solution.graph else np.nan
            what = f"kernel {kernel}, J / dof {dof:.3f}, {seconds:.1f} s"
            print(f"  graph {errors(log, solution.poses)}, {what}, {solution.parameters or ''}", flush=True)


if __name__ == "__main__":
    main()
