"""The webmap world: 21,000 predictions, an observation every eighth, 35 landmarks, N = 1,000. How long is a run?

    python benchmarks/fastslam_webmap.py [../shared/data/fastslam_webmap/webmap.txt]

The world is that of a well-known FastSLAM simulator (35 landmarks, 17 way points, 3 m/s, 40 predictions and 5 scans a
second, range 30 m, half a circle ahead). The run is timed whole, from making the filter to the finished result.
"""

from __future__ import annotations

import argparse
import time
from math import pi
from pathlib import Path

import numpy as np

from fastslam import FastSLAM1, FastSLAM2
from graphslam import Log, MotionModel, SensorModel, simulate
from graphslam.se2 import Array

# 0.3 m/s and 3 degrees of steering in every 1/40 s, over a wheelbase of 4 m; 0.1 m at 20 m and 1 degree
MOTION = MotionModel(nn=0.0274, no=0.0, on=0.0036, oo=0.0, epsilon=1e-8)
SENSOR = SensorModel(range_rate=0.005, bearing_std=pi / 180, orientation_std=pi / 180)


def read_world(path: Path) -> tuple[Array, Array]:
    """Landmarks (35, 2) and way points (17, 2) [m]."""
    numbers = {}
    lines = iter(path.read_text().splitlines())
    for line in lines:
        if line.startswith(("lm", "wp")):
            kind, _, rows = line.split()
            numbers[kind] = np.array([[float(v) for v in next(lines).split()] for _ in range(int(rows))])
    return numbers["lm"], numbers["wp"]


def webmap_log(path: Path, *, steps: int = 21_000, seed: int = 0) -> Log:
    """Drive through the way points; sightings without psi at every eighth step."""
    landmarks, way_points = read_world(path)
    log = simulate(
        steps=steps, dt=0.025, speed=3.0, turn_rate=0.43, way_points=way_points, start=(0.0, 0.0, 0.0),
        landmarks=landmarks, min_range=0.0, max_range=30.0, field_of_view=pi, orientation=False, clean=True,
        motion=MOTION, sensor=SENSOR, seed=seed, name="webmap",
    )  # fmt: skip
    kept = log.steps % 8 == 0
    return log.replace(steps=log.steps[kept], landmarks=log.landmarks[kept], sightings=log.sightings[kept])


def main() -> None:
    """Time both versions and print a line each."""
    default = Path(__file__).parents[2] / "shared" / "data" / "fastslam_webmap" / "webmap.txt"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", type=Path, nargs="?", default=default)
    path = parser.parse_args().path
    if not path.is_file():
        parser.error(f"{path}: no such file; give the path of webmap.txt (35 landmarks, 17 way points) as the argument")
    log = webmap_log(path)
    print(f"{log.num_poses - 1} predictions, {len(np.unique(log.steps))} observation steps, {len(log.steps)} sightings")
    for kind in (FastSLAM1, FastSLAM2):
        kind(webmap_log(path, steps=2000), particles=10, motion=MOTION, sensor=SENSOR).run()  # loads modules
        for threads in (1, 2):
            seconds = []
            for _ in range(5):
                begin = time.perf_counter()
                result = kind(log, particles=1000, motion=MOTION, sensor=SENSOR, threads=threads).run()
                seconds.append(time.perf_counter() - begin)
            error = np.sqrt(np.mean(np.sum((result.poses - log.true_poses)[:, :2] ** 2, axis=1)))
            print(
                f"{kind.__name__}, {threads} threads: median {np.median(seconds):.2f} s, best {min(seconds):.2f} s; "
                f"position error {error:.2f} m, {int(result.resampled.sum())} resamplings, "
                f"{result.ancestors[0]} ancestor(s) at the start"
            )


if __name__ == "__main__":
    main()
