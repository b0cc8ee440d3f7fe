"""How time and memory grow: landmark graphs of 10^3 to 10^5 poses, made by the simulator, solved from dead reckoning.

    python benchmarks/scaling.py [--largest 100000] [--side 50] [--record docs/measured]

A robot mows a strip of a given width among landmarks, about ten in view at each step, seeing the neighbouring lanes
again on its way back; 2-D sensor, clean noise a tenth of the book's. A strip grows in one direction, so elimination
costs the same per pose; a field that grows in both has the n^1.5 of all planar graphs (try --side 250). Each size runs
in a process of its own, so that the peak memory is that size's. "cpu" is the processor time of building and solving;
OMP_NUM_THREADS=1 keeps the factorisation on one thread.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

import numpy as np
from recording import add_option, record


def strip_log(poses: int, side: float):
    """Lanes of ``side`` metres, 4 m apart; landmarks on a jittered grid so that the camera sees about ten."""
    from graphslam import MotionModel, SensorModel, simulate

    stride = 0.5
    rows = max(2, int(np.ceil(poses * stride / side)))
    route = [(x, 4.0 * r) for r in range(rows + 1) for x in ((0.0, side) if r % 2 == 0 else (side, 0.0))]
    rng = np.random.default_rng(0)
    gx, gy = np.meshgrid(np.arange(-5.0, side + 6.0, 3.2), np.arange(-5.0, 4.0 * rows + 6.0, 3.2))
    landmarks = np.column_stack([gx.ravel(), gy.ravel()]) + rng.uniform(-1, 1, (gx.size, 2))
    motion = MotionModel(nn=0.019, no=1e-4, on=0.013, oo=0.02, epsilon=1e-6)
    sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
    log = simulate(
        steps=poses - 1, dt=1.0, speed=stride, turn_rate=1.0, way_points=route[1:], start=(0.0, 0.0, 0.0),
        landmarks=landmarks, max_range=9.0, field_of_view=2.6, orientation=False, clean=True, motion=motion,
        sensor=sensor, seed=1,
    )  # fmt: skip
    return log, motion, sensor


def one(poses: int, side: float) -> dict:
    """Build and solve one size; seconds of each part and the peak memory of the process."""
    from graphslam import Graph, solve

    small, motion, sensor = strip_log(300, side)
    solve(
        Graph.from_log(small, motion=motion, sensor=sensor, edges="landmark+motion", kernel="none"), initialize="auto"
    )  # loads modules
    log, motion, sensor = strip_log(poses, side)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin, cpu = time.perf_counter(), time.process_time()
    graph = Graph.from_log(log, motion=motion, sensor=sensor, edges="landmark+motion", kernel="none")
    built = time.perf_counter()
    solution = solve(graph, initialize="auto", cost_tolerance=1e-9)
    solved, cpu = time.perf_counter(), time.process_time() - cpu
    error = np.linalg.norm(solution.poses[:, :2] - log.true_poses[:, :2], axis=1)
    return {
        "poses": poses,
        "landmarks": len(log.landmark_ids),
        "sightings": len(log.steps),
        "build_s": built - begin,
        "solve_s": solved - built,
        "cpu_s": cpu,
        "iterations": solution.iterations,
        "converged": solution.converged,
        "cost_per_sighting": solution.cost / len(log.steps),
        "rms_error_m": float(np.sqrt(np.mean(error**2))),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "before_mib": before / 1024,
        "reason": solution.reason,
    }


def main() -> None:
    """Run all sizes, print a table and the slopes in log-log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=100_000)
    parser.add_argument("--side", type=float, default=50.0)
    add_option(parser)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(options.one, options.side)))
        return
    sizes = [n for n in (1_000, 3_000, 10_000, 30_000, 100_000) if n <= options.largest]
    rows = []
    print(f"{'poses':>7} {'sightings':>9} {'build':>8} {'solve':>8} {'cpu':>8} {'its':>4} {'peak':>9} {'error':>8}")
    for n in sizes:
        out = subprocess.run(
            [sys.executable, __file__, "--one", str(n), "--side", str(options.side)],
            check=True,
            capture_output=True,
            text=True,
        )
        row = json.loads(out.stdout.splitlines()[-1])
        rows.append({"name": f"{n:,}"} | row)
        print(
            f"{n:7d} {row['sightings']:9d} {row['build_s']:7.2f}s {row['solve_s']:7.2f}s {row['cpu_s']:7.2f}s "
            f"{row['iterations']:4d} {row['peak_mib']:6.0f}MiB {row['rms_error_m']:7.3f}m  {row['reason']}"
        )
    large = [row for row in rows if row["poses"] >= 10_000]
    if len(large) > 1:
        logs = {k: np.log([row[k] for row in large]) for k in ("poses", "cpu_s", "peak_mib")}
        time, memory = (float(np.polyfit(logs["poses"], logs[name], 1)[0]) for name in ("cpu_s", "peak_mib"))
        print(f"slope of processor time from 10^4 poses on: {time:.2f}\nslope of peak memory: {memory:.2f}")
        rows.append({"name": "slope", "poses": None, "cpu_s": time, "peak_mib": memory})
    record(options.record, "scaling" if options.side <= 50 else "scaling_field", rows)


if __name__ == "__main__":
    main()
