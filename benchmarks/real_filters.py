"""FastSLAM on real logs, over many seeds: against the graph on MR.CLAM 6, against GPS on Victoria Park without ids.

    python benchmarks/real_filters.py mrclam [--data ../shared/data] [--seeds 20] [--particles 500]
    python benchmarks/real_filters.py victoria --seeds 10 --particles 200
    python benchmarks/real_filters.py noise --seeds 2 --particles 200
    python benchmarks/real_filters.py hidden --seeds 4 --particles 100

The first two take ``--record docs/measured``.

MR.CLAM: median ATE over the seeds, as a ratio to the graph's (Huber, noise by hand). Filters have no robust kernel, so
their sensor noise is also tried several times as large.

Victoria Park: FastSLAM 2.0 without ids, on one thread. Our scoring is the root mean square distance of the antenna to GPS
over the whole trajectory that the filter ends with, as it is (the drive starts at the first GPS position) and after rigid
alignment, with the angle of that alignment. The published scoring is that of the programs of PHD-SLAM 3.0 and
GM-PHD-PMAU-SLAM: the mean of the particles at the time of each scan, where a GPS position is within 25 ms, unaligned, and
the root mean square over all seeds.

Noise: the evidence of Victoria Park for the motion noise of the reader, and for that with one number changed, by FastSLAM
2.0 with the ids that `associate` finds. Two sensor noises show that the choice does not depend on it. Nothing uses GPS.

Hidden: MR.CLAM 6, robot 3, and Lost in the Woods up to 5 m, every fifth pose, with their ids hidden: FastSLAM
with and without them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from recording import add_option, record
from scipy.io import loadmat

from comparisons.datasets import data_folder
from fastslam import FastSLAM1, FastSLAM2, associate
from graphslam import Graph, Log, MotionModel, SensorModel, load, solve
from graphslam.association import score
from graphslam.metrics import ate
from graphslam.se2 import Array

#: the noise that a native GTSAM graph of MR.CLAM was once tried with, set by hand
MOTION = MotionModel.constant(0.1, 0.3, epsilon=1e-8)
SENSOR = SensorModel(range_rate=0.0, range_std=0.12, bearing_std=0.02)
#: a sensor noise of Victoria Park near the scatter of its sightings, beside that of the reader
NARROW = {"range_std": 0.2, "bearing_std": np.radians(0.6)}
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


def mrclam(data: Path, seeds: int, particles: int, folder: Path | None) -> Iterator[str]:
    """A line per robot, filter and noise; the rows of robot and noise are recorded."""
    rows = []
    yield "| robot | filter | sensor noise | median ATE [m] | quartiles | / graph |\n|---|---|---|---|---|---|"
    for robot in (1, 3):
        log = load(data / "mrclam6", robot=robot).replace(motion=MOTION, sensor=SENSOR)
        assert log.true_poses is not None
        graph = solve(Graph.from_log(log, edges="landmark+motion", kernel="huber"), initialize="auto")
        reference = ate(log.true_poses, graph.poses)
        tau = correlation_time(log)
        yield f"| {robot} | graph | x 1 | {reference:.3f} | errors correlate over {tau[0]:.1f}, {tau[1]:.1f} sightings | 1 |"
        for factor in INFLATED:
            rows.append({"name": f"robot {robot}, x {factor:g}", "robot": robot, "sensor_noise": f"x {factor:g}"})
            wider = replace(SENSOR, range_std=factor * SENSOR.range_std, bearing_std=factor * SENSOR.bearing_std)
            for kind in (FastSLAM1, FastSLAM2):
                found = [
                    ate(log.true_poses, kind(log, particles=particles, seed=seed, sensor=wider).run().poses)
                    for seed in range(seeds)
                ]
                low, median, high = np.quantile(found, [0.25, 0.5, 0.75])
                rows[-1] |= {f"{kind.__name__}_ate_m": median, f"{kind.__name__}_to_graph": median / reference}
                yield (
                    f"| {robot} | {kind.__name__} | x {factor:g} | {median:.3f} | {low:.3f} to {high:.3f} | "
                    f"{median / reference:.2f} |"
                )
    record(folder, "real_filters", rows)


def victoria(
    data: Path, seeds: int, particles: int, laser: float, keywords: dict[str, Any], folder: Path | None
) -> Iterator[str]:
    """A line per seed, and the medians, which are recorded."""
    log = load(data / "victoria_park")
    assert log.true_poses is not None and log.sensor is not None
    log = log.replace(sensor=replace(log.sensor, offset=(laser, log.sensor.offset[1])))
    truth = log.true_poses
    drifted = log.at_truth(log.dead_reckoning())
    yield f"dead reckoning: {distance(truth, drifted, log.covered):.1f} m, aligned {ate(truth, drifted):.1f} m"
    outcomes = []
    scans, fixes = matched_gps(data, log)
    for seed in range(seeds):
        begin = time.process_time()
        slam = FastSLAM2(log, particles=particles, seed=seed, threads=1, **keywords)
        means = np.array([state.mean_pose for state in slam])
        result = slam.result()
        seconds = time.process_time() - begin
        antenna, live = log.at_truth(result.poses), log.at_truth(means)[scans, :2]
        turn = rotation(truth[log.covered, :2], antenna[log.covered, :2])
        published = float(np.sqrt(np.mean(np.sum((live - fixes) ** 2, axis=1))))
        outcomes.append((distance(truth, antenna, log.covered), ate(truth, antenna), turn, seconds, published))
        yield (
            f"seed {seed}: {outcomes[-1][0]:.2f} m, aligned {outcomes[-1][1]:.2f} m by {turn:.1f} deg, published scoring "
            f"{published:.2f} m, {len(result.landmarks)} landmarks, {seconds:.1f} s of processor time"
        )
    plain, aligned, turn, seconds, _ = np.median(outcomes, axis=0)
    least, most = np.min(outcomes, axis=0), np.max(outcomes, axis=0)
    published = float(np.sqrt(np.mean(np.array(outcomes)[:, 4] ** 2)))
    yield (
        f"median of {seeds} seeds, {particles} particles, {keywords}: {plain:.2f} m, aligned {aligned:.2f} m "
        f"by {turn:.1f} deg, {seconds:.1f} s"
    )
    yield f"published scoring, root mean square over {len(fixes)} GPS positions and the seeds: {published:.2f} m"
    figures = {
        "gps_m": plain, "gps_least_m": least[0], "gps_most_m": most[0], "ate_m": aligned, "ate_least_m": least[1],
        "ate_most_m": most[1], "turn_deg": turn, "published_m": published, "cpu_s": seconds,
    }  # fmt: skip
    row = {"name": "fastslam2", "seeds": seeds, "particles": particles} | keywords
    record(folder, "real_filters_victoria", [row | figures])


def noise(data: Path, seeds: int, particles: int) -> Iterator[str]:
    """A line per sensor noise and number of the motion noise: how the evidence changes where it is multiplied."""
    whole = load(data / "victoria_park")
    first = FastSLAM2(whole, particles=30, seed=0).run()
    assert whole.motion is not None and whole.sensor is not None
    assert first.association is not None and first.unconfirmed is not None
    found = associate(whole, start=(np.where(first.unconfirmed, -1, np.maximum(first.association, -1)), first.poses))
    log = found.log.replace(initial_poses=whole.initial_poses)

    def evidence(sensor: SensorModel, **changes: float) -> float:
        noisy = log.replace(motion=replace(whole.motion, **changes), sensor=sensor)
        runs = [FastSLAM2(noisy, particles=particles, seed=seed).run() for seed in range(seeds)]
        return float(np.mean([each.log_evidence for each in runs]))

    constant = {"nn": 0.0, "on": 0.0, "oo": 0.0, "sigma_v": 2.0, "sigma_omega": np.radians(10.0)}
    for sensor in (whole.sensor, replace(whole.sensor, **NARROW)):
        base = evidence(sensor)
        yield f"range_std {sensor.range_std:g} m, bearing_std {np.degrees(sensor.bearing_std):.1f} deg: {base:.0f}"
        yield f"  2 m/s and 10 deg/s for each control: {evidence(sensor, **constant) - base:+.0f}"
        yield f"  and without slip: {evidence(sensor, **constant, slip=0.0) - base:+.0f}"
        for name in ("nn", "on", "oo", "slip"):
            value = getattr(whole.motion, name)
            changed = {f: evidence(sensor, **{name: f * value}) - base for f in (0.0, 0.5, 0.7, 1.4, 2.0)}
            yield f"  {name} {value:g}: " + ", ".join(f"times {f:g} {e:+.0f}" for f, e in changed.items())


def matched_gps(data: Path, log: Log) -> tuple[np.ndarray, Array]:
    """The scans within 25 ms of a GPS position, and those positions (k, 2)."""
    gps = loadmat(data / "victoria_park" / "aa3_gpsx.mat")
    times, places = gps["timeGps"].ravel() / 1000, np.column_stack([gps["Lo_m"].ravel(), gps["La_m"].ravel()])
    assert log.times is not None
    scans = np.unique(log.steps)
    nearest = np.abs(times - log.times[scans, None]).argmin(axis=1)
    near = np.abs(times[nearest] - log.times[scans]) <= 0.025
    return scans[near], places[nearest[near]]


def rotation(truth: Array, places: Array) -> float:
    """The angle [deg] by which positions (k, 2) turn when they are aligned to the true ones."""
    a, b = places - places.mean(axis=0), truth - truth.mean(axis=0)
    return float(np.degrees(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))))


def hidden(data: Path, seeds: int, particles: int) -> Iterator[str]:
    """A line per log, association and filter: medians over the seeds."""
    robot = load(data / "mrclam6", robot=3).replace(motion=MOTION, sensor=SENSOR)
    woods = load(data / "lost_in_the_woods" / "dataset2.mat").nearer_than(5.0)
    woods = woods.at_steps(np.arange(0, woods.num_poses, 5))
    yield "| log | filter | association | ATE [m] | landmarks | precision | recall | s |\n|---|---|---|---|---|---|---|---|"
    for name, log in (("MR.CLAM 6, robot 3", robot), ("Lost in the Woods", woods)):
        assert log.true_poses is not None
        for kind, association in product((FastSLAM1, FastSLAM2), ("known", "maximum-likelihood")):
            rows = []
            for seed in range(seeds):
                begin = time.process_time()
                result = kind(log, particles=particles, seed=seed, association=association, threads=1).run()
                seconds = time.process_time() - begin
                found = None if result.association is None else score(result.association, log.landmarks)
                shares = (1.0, 1.0) if found is None else (found.precision, found.recall)
                rows.append((ate(log.true_poses, result.poses), len(result.landmarks), *shares, seconds))
            error, marks, precision, recall, seconds = np.median(rows, axis=0)
            yield (
                f"| {name} | {kind.__name__} | {association} | {error:.3f} | {marks:.0f} | {precision:.4f} | {recall:.4f} | "
                f"{seconds:.1f} |"
            )


def distance(truth: Array, poses: Array, covered: np.ndarray) -> float:
    """Root mean square distance [m] to the true positions, without alignment."""
    off = poses[covered, :2] - truth[covered, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def main() -> None:
    """Run one of the studies and print its lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("mrclam", "victoria", "noise", "hidden"))
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--particles", type=int, default=500)
    parser.add_argument("--laser", type=float, default=3.78, help="how far the laser is ahead of the rear axle [m]")
    parser.add_argument("--association", default="auto", help="on Victoria Park, which has no ids")
    parser.add_argument("--threshold", type=float, default=1e-6, help="new_landmark_threshold on Victoria Park")
    add_option(parser)
    a = parser.parse_args()
    if a.study == "victoria":
        keywords = {"association": a.association, "new_landmark_threshold": a.threshold}
        study = victoria(a.data, a.seeds, a.particles, a.laser, keywords, a.record)
    elif a.study == "mrclam":
        study = mrclam(a.data, a.seeds, a.particles, a.record)
    else:
        study = {"noise": noise, "hidden": hidden}[a.study](a.data, a.seeds, a.particles)
    for line in study:
        print(line, flush=True)


if __name__ == "__main__":
    main()
