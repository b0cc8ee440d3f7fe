"""Drives that are cut and joined again: `graphslam.join_logs`.

    python benchmarks/sessions.py [--data ../shared/data/mrclam6]
    python benchmarks/sessions.py --without-ids 20

Robot 3 of MR.CLAM 6 with the noise estimated from its log, cut into 2, 3 and 5 drives without the motions between them, each
in a frame of its own; the ATE after alignment over that of the uncut drive. Or simulated worlds of 30 to 40 landmarks in
16 m x 16 m, seen from three starts without ids, joined and compared with the same logs with ids.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from graphslam import (
    Graph,
    GraphError,
    Log,
    MotionModel,
    SensorModel,
    Solution,
    estimate_robot,
    join_logs,
    load,
    simulate,
    solve,
)
from graphslam.log import UNIDENTIFIED
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


def visits(seed: int) -> list[Log]:
    """Three drives of one world from random starts, each in a frame of its own."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-8, 8, (40, 2))
    away = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    places = places[~np.any(np.triu(away < 0.8, 1), axis=0)]
    motion = MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05)
    sensor = SensorModel(range_rate=0.02, bearing_std=0.01)
    logs = []
    for k in range(3):
        log = simulate(
            seed=10 * seed + k, steps=80, clean=True, start=(*rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi)),
            landmarks=places, orientation=False, motion=motion, sensor=sensor, max_range=6.0, name=f"visit {k}",
        )  # fmt: skip
        own = between(log.initial_poses[0], log.initial_poses)
        logs.append(log.replace(initial_poses=own, motion=motion, sensor=sensor))
    return logs


def without_ids(worlds: int) -> None:
    """Print how many worlds are joined without ids, and the ATE over that with ids."""
    ratios, refused = [], 0
    begin = time.process_time()
    for seed in range(worlds):
        logs = visits(seed)
        with_ids = join_logs(logs).log
        try:
            bare = join_logs([log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)) for log in logs]).log
        except GraphError as error:
            refused += 1
            print(f"world {seed}: {error}")
            continue
        errors = []
        for log in (bare, with_ids):
            assert log.true_poses is not None
            errors.append(ate(log.true_poses, solve(Graph.from_log(log, edges="landmark+motion")).poses))
        ratios.append(errors[0] / errors[1])
    seconds = (time.process_time() - begin) / worlds
    print(
        f"{worlds} worlds: {len(ratios)} joined, {refused} refused; ATE over that with ids: median {np.median(ratios):.3f}, "
        f"at most 1.1 in {sum(ratio <= 1.1 for ratio in ratios)}, at most {max(ratios):.2f}; {seconds:.1f} s each"
    )


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared/data/mrclam6")
    parser.add_argument("--without-ids", type=int, metavar="N", help="join N simulated worlds without ids instead")
    options = parser.parse_args()
    if options.without_ids:
        without_ids(options.without_ids)
        return
    data = options.data
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
