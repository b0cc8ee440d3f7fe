"""Memory and time of a long run: N = 10,000 particles, 10,000 steps, 1,000 landmarks, full trajectories at the end.

python benchmarks/fastslam_memory.py
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from fastslam import FastSLAM1
from graphslam import MotionModel, SensorModel, simulate


def main() -> None:
    """Run and print the largest resident size of the process before and after."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    motion = MotionModel(nn=0.04, no=0.0005, on=0.01, oo=0.01, epsilon=1e-5)
    sensor = SensorModel(range_rate=0.03, bearing_std=0.01)
    # lanes up and down a square of 100 m
    lanes = [(x, y) for k, x in enumerate(range(-45, 46, 10)) for y in ((-45, 45) if k % 2 == 0 else (45, -45))]
    log = simulate(
        steps=10_000, dt=1.0, speed=0.1, turn_rate=0.5, way_points=lanes, start=(-45.0, -45.0, 0.0), landmarks=1000,
        arena=50.0, min_range=0.0, max_range=6.0, orientation=False, clean=True, motion=motion, sensor=sensor, seed=1,
    )  # fmt: skip
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    begin = time.perf_counter()
    slam = FastSLAM1(log, particles=10_000, motion=motion, sensor=sensor, threads=1)
    result = slam.run()
    histories = [slam.trajectory(i) for i in range(0, 10_000, 100)]
    seconds = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"{len(result.landmarks)} landmarks seen in {len(log.steps)} sightings, {int(result.resampled.sum())} resamplings"
    )
    print(
        f"{seconds:.0f} s; {after:.2f} GiB at most ({before:.2f} before), tree {slam._engine.history_bytes / 2**20:.0f} MiB"
    )
    print(f"{len(histories)} whole histories of {len(histories[0])} poses; distinct ancestors: ", end="")
    print(", ".join(f"{int(result.ancestors[t])} at {t}" for t in np.linspace(0, 10_000, 5).astype(int)))


if __name__ == "__main__":
    main()
