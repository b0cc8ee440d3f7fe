"""FastSLAM on real logs, over many seeds: against the graph on MR.CLAM 6, against GPS on Victoria Park without ids.

    python benchmarks/real_filters.py mrclam [--data ../shared/data] [--seeds 20] [--particles 500]
    python benchmarks/real_filters.py victoria --seeds 10 --particles 200 [--laser 3.78]

MR.CLAM: median ATE over the seeds, as a ratio to the graph's (Huber, noise by hand). Filters have no robust kernel, so
their sensor noise is also tried several times as large. Victoria Park: FastSLAM 2.0, maximum-likelihood association; root
mean square distance of the antenna to GPS, as it is (the drive starts at the first GPS position) and after rigid alignment.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from comparisons.datasets import data_folder
from fastslam import FastSLAM1, FastSLAM2
from graphslam import Graph, Log, MotionModel, SensorModel, load, solve
from graphslam.metrics import ate
from graphslam.se2 import Array

#: the noise that a native GTSAM graph of MR.CLAM was once tried with, set by hand
MOTION = MotionModel.constant(0.1, 0.3, epsilon=1e-8)
SENSOR = SensorModel(range_rate=0.0, range_std=0.12, bearing_std=0.02)
INFLATED = (1.0, 2.0, 3.0, 4.0)


def correlation_time(log: Log) -> Array:
    """How many sightings of one landmark, one after the other, say as much as one: 1 + 2 sum of the autocorrelation.

    Of range and bearing; errors against the truth, summed up to the first lag at which they no longer correlate.
    """
    assert log.true_poses is not None and log.true_landmarks is not None
    known = np.isfinite(log.true_poses[log.steps, 2])
    places = np.array([log.true_landmarks[j] for j in log.landmarks[known].tolist()])
    e = log.sightings[known] - SENSOR.h(log.true_poses[log.steps[known]], places)
    e[:, 1] = (e[:, 1] + np.pi) % (2 * np.pi) - np.pi
    # ranks: a few sightings of the wrong landmark would drown everything
    e = np.argsort(np.argsort(e, axis=0), axis=0) / len(e) - 0.5
    times = log.times
    assert times is not None
    seen_at, landmark = times[log.steps[known]], log.landmarks[known]
    total = np.ones(2)
    going = np.ones(2, dtype=bool)
    for lag in range(1, 200):
        products = []
        for j in np.unique(landmark):
            mine = np.flatnonzero(landmark == j)
            a, b = mine[:-lag], mine[lag:]
            near = seen_at[b] - seen_at[a] < 2.0 * lag
            products.append(e[a[near]] * e[b[near]])
        rho = np.concatenate(products).mean(axis=0) / np.var(e, axis=0)
        going &= rho > 0
        total += 2 * np.where(going, rho, 0.0)
        if not going.any():
            break
    return total


def mrclam(data: Path, seeds: int, particles: int) -> Iterator[str]:
    """A line per robot, filter and noise."""
    yield "| robot | filter | sensor noise | median ATE [m] | quartiles | / graph |\n|---|---|---|---|---|---|"
    for robot in (1, 3):
        log = load(data / "mrclam6", robot=robot).replace(motion=MOTION, sensor=SENSOR)
        assert log.true_poses is not None
        graph = solve(Graph.from_log(log, edges="landmark+motion", kernel="huber"), initialize="auto")
        reference = ate(log.true_poses, graph.poses)
        tau = correlation_time(log)
        yield f"| {robot} | graph | x 1 | {reference:.3f} | errors correlate over {tau[0]:.1f}, {tau[1]:.1f} sightings | 1 |"
        for factor in INFLATED:
            wider = replace(SENSOR, range_std=factor * SENSOR.range_std, bearing_std=factor * SENSOR.bearing_std)
            for kind in (FastSLAM1, FastSLAM2):
                found = [
                    ate(log.true_poses, kind(log, particles=particles, seed=seed, sensor=wider).run().poses)
                    for seed in range(seeds)
                ]
                low, median, high = np.quantile(found, [0.25, 0.5, 0.75])
                yield (
                    f"| {robot} | {kind.__name__} | x {factor:g} | {median:.3f} | {low:.3f} to {high:.3f} | "
                    f"{median / reference:.2f} |"
                )


def victoria(data: Path, seeds: int, particles: int, laser: float) -> Iterator[str]:
    """A line per seed, and the medians."""
    log = load(data / "victoria_park")
    assert log.true_poses is not None and log.sensor is not None
    log = log.replace(sensor=replace(log.sensor, offset=(laser, log.sensor.offset[1])))
    truth = log.true_poses
    drifted = log.at_truth(log.dead_reckoning())
    yield f"dead reckoning: {distance(truth, drifted, log.covered):.1f} m, aligned {ate(truth, drifted):.1f} m"
    outcomes = []
    for seed in range(seeds):
        begin = time.perf_counter()
        result = FastSLAM2(log, particles=particles, seed=seed, association="maximum-likelihood", threads=1).run()
        antenna = log.at_truth(result.poses)
        outcomes.append((distance(truth, antenna, log.covered), ate(truth, antenna)))
        yield (
            f"seed {seed}: {outcomes[-1][0]:.2f} m, aligned {outcomes[-1][1]:.2f} m, {len(result.landmarks)} landmarks, "
            f"{time.perf_counter() - begin:.0f} s"
        )
    plain, aligned = np.median(outcomes, axis=0)
    yield f"median of {seeds} seeds, {particles} particles, laser {laser:g} m ahead: {plain:.2f} m, aligned {aligned:.2f} m"


def distance(truth: Array, poses: Array, covered: np.ndarray) -> float:
    """Root mean square distance [m] to the true positions, without alignment."""
    off = poses[covered, :2] - truth[covered, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def main() -> None:
    """Run one of the studies and print its lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("mrclam", "victoria"))
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--particles", type=int, default=500)
    parser.add_argument("--laser", type=float, default=3.78, help="how far the laser is ahead of the rear axle [m]")
    arguments = parser.parse_args()
    study = (
        mrclam(arguments.data, arguments.seeds, arguments.particles)
        if arguments.study == "mrclam"
        else victoria(arguments.data, arguments.seeds, arguments.particles, arguments.laser)
    )
    for line in study:
        print(line, flush=True)


if __name__ == "__main__":
    main()
