"""What `slam-compare run` takes on a long log: reading, building, solving, covariances, tables, figures and files.

    python benchmarks/whole_command.py [--poses 35000] [--record docs/measured]

A robot drives up and down a field 170 m wide with landmarks at random places, which it sees up to 5.55 m ahead and to the
sides: with 35,000 poses about 220,000 sightings of 4,200 landmarks. 2-D sensor, clean noise a tenth of the book's. The log
is solved from dead reckoning. The command runs twice, because the first time loads modules from disk; the second time counts.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from recording import add_option, record

from graphslam import Log, MotionModel, SensorModel, save, simulate

SIDE, LANE = 170.0, 6.0


def long_log(poses: int) -> Log:
    """Simulate the log."""
    lanes = range(int(SIDE / LANE) + 1)
    route = [(x, LANE * k) for k in lanes for x in ((0.0, SIDE) if k % 2 == 0 else (SIDE, 0.0))]
    return simulate(
        steps=poses - 1, dt=1.0, speed=0.25, turn_rate=1.0, way_points=route[1:], start=(0.0, 0.0, 0.0),
        landmarks=np.random.default_rng(0).uniform(-4, SIDE + 4, (4200, 2)), max_range=5.55, field_of_view=3.14,
        orientation=False, clean=True, motion=MotionModel(nn=0.019, no=1e-4, on=0.013, oo=0.02, epsilon=1e-6),
        sensor=SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005), seed=1,
    )  # fmt: skip


def main() -> None:
    """Simulate the log, run the command, print its times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=35_000)
    add_option(parser)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path, log = Path(folder) / "log.npz", long_log(options.poses)
        print(f"{log.num_poses} poses, {len(log.steps)} sightings of {len(log.landmark_ids)} landmarks")
        save(log, path)
        command = [
            sys.executable,
            "-m",
            "comparisons",
            "run",
            str(path),
            "--estimators",
            "graph",
            "--out",
            f"{folder}/out",
        ]
        for turn in range(2):
            before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"run {turn + 1}: {wall:.1f} s, {cpu:.1f} s of processor time")
        print(done.stdout)
    # the largest memory of any child [KiB]: the simulation is in this process
    sizes = {"poses": log.num_poses, "sightings": len(log.steps), "landmarks": len(log.landmark_ids)}
    figures = {"cpu_s": cpu, "clock_s": wall, "peak_mib": after.ru_maxrss / 1024}
    record(options.record, "whole_command", [{"name": f"{log.num_poses:,}"} | sizes | figures])


if __name__ == "__main__":
    main()
