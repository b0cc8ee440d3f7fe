"""The online solver on real and simulated logs: accuracy against the batch optimum at sampled steps, and time per step.

    python benchmarks/online.py [--data ../shared/data] [--only mrclam6] [--steps 1000] [--sample 0.1] [--isam2]
    python benchmarks/online.py --only long --sample 0     # 35,000 simulated poses
    python benchmarks/online.py --covariances 50       # standard deviations against the batch solution, and time of a call

Each takes ``--record docs/measured``.

Step times are processor times, so that other programs on the machine enter less; they include the passes over the tree,
but not the batch solutions, which start where the estimate is. With --isam2, GTSAM's ISAM2 goes through the same graph with
GTSAM's C++ factors (polar sightings), relinearising what moves by more than 0.01 at every step and at every tenth, by QR.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from recording import add_option, record
from whole_command import long_log

from graphslam import Graph, GraphError, Log, MotionModel, OnlineSolver, SensorModel, load, simulate, solve
from graphslam.edges import AnchorEdges, CartesianObservationEdges, RelativePoseEdges
from graphslam.graph.transform import first_poses
from graphslam.online import replay
from graphslam.se2 import compose, wrap

#: the noise of benchmarks/real_logs.py for MR.CLAM, set by hand
BY_HAND = {
    "motion": MotionModel.constant(0.1, 0.3, epsilon=1e-8),
    "sensor": SensorModel(range_rate=0.0, range_std=0.12, bearing_std=0.02),
}
#: what tables call the logs
TITLES = {
    "mrclam6": "MR.CLAM 6 robot 3, noise by hand, epsilon 1e-8",
    "woods": "Lost in the Woods, sightings up to 5 m",
    "huang": "Huang 8240",
    "city10000": "city10000",
    "long": "a simulated drive, 35,000 poses, 219,860 sightings",
}


def logs(data: Path) -> dict[str, Callable[[], tuple[Log, dict]]]:
    """What reads a log and the options of its graph, by name."""
    return {
        "mrclam6": lambda: (load(data / "mrclam6", robot=3), BY_HAND),
        "woods": lambda: (load(data / "lost_in_the_woods" / "dataset2.mat").nearer_than(5.0), {}),
        "huang": lambda: (load(data / "simulated_8240"), {}),
    }


def so_far(graph: Graph, estimate: OnlineSolver) -> Graph:
    """The graph up to the step of an online solver, with its estimate as initial values."""
    piece, nodes = first_poses(graph, estimate.step + 1)
    state = np.zeros((graph.num_nodes, 3))
    state[: estimate.step + 1] = estimate.poses
    for landmark, mark in estimate.landmarks.items():
        state[len(graph.steps) + np.searchsorted(graph.landmark_ids, landmark), : len(mark)] = mark
    return piece.with_initial(state[nodes])


def excess(graph: Graph, estimate: OnlineSolver) -> float:
    """By how much J of an online solver is above the batch optimum next to it, as a part of that."""
    piece = so_far(graph, estimate)
    best = solve(piece, initialize="given").cost
    return (piece.cost(piece.initial) - best) / max(best, 1e-9)


def report(name: str, seconds: list[float], gaps: list[float], solver: str = "online") -> dict[str, Any]:
    """One line, and a row to record: time per step and accuracy."""
    ms = 1e3 * np.array(seconds)
    gap = f"above batch at most {max(gaps):.1e}, median {np.median(gaps):.1e} ({len(gaps)} steps)" if gaps else ""
    median, most = float(np.median(ms)), float(ms.max())
    high, title = float(np.quantile(ms, 0.99)), name if solver == "online" else f"{name}, {solver}"
    print(f"{title:28} {len(ms):6} steps in {ms.sum() / 1e3:.2f} s, {median:7.3f} ms median,", end=" ")
    print(f"{high:7.2f} ms 99 %, {most:7.1f} ms most; {gap}")
    return {
        "name": title, "log": TITLES[name], "solver": solver, "steps": len(ms), "sampled": len(gaps),
        "above_most": max(gaps, default=None), "above_median": float(np.median(gaps)) if gaps else None,
        "median_ms": median, "p99_ms": high, "most_ms": most, "all_s": float(ms.sum()) / 1e3,
    }  # fmt: skip


def ours(name: str, graph: Graph, steps: int, sampled: set[int]) -> dict[str, Any]:
    """Go through a graph with the online solver; a row to record."""
    seconds, gaps, passes, iterator = [], [], [], replay(graph)
    for _ in range(steps):
        begin = time.process_time()
        estimate = next(iterator)
        seconds.append(time.process_time() - begin)
        passes.append(estimate._backend.passes)
        if estimate.step in sampled:
            gaps.append(excess(graph, estimate))
    three = list(estimate.landmarks)[:3]
    estimate.covariance(estimate.step, three, joint=True)
    begin = time.process_time()
    for _ in range(20):
        estimate.covariance(estimate.step, three, joint=True)
    covariance = (time.process_time() - begin) / 20
    row = report(name, seconds[1:], gaps)
    system = estimate._backend.system
    print(f"{'':28} {np.mean(passes):.2f} passes, {system.batch_solutions} batch solutions", end=", ")
    print(f"{system.bytes / 2**20:.0f} MiB", end=", ")
    print(f"covariance of the pose and three landmarks {1e3 * covariance:.3f} ms")
    return row


def isam2(name: str, graph: Graph, steps: int, skip: int) -> dict[str, Any]:
    """The same log through ISAM2 with native factors; a row to record."""
    import gtsam

    assert graph.log is not None and graph.sensor is not None
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = skip
    params.setRelinearizeThreshold(0.01)
    params.setFactorization("QR")
    smoother, X, L = gtsam.ISAM2(params), gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L
    motions = next(family for family in graph.families if isinstance(family, RelativePoseEdges))
    log, seen, seconds = graph.log, set(), []
    latest = gtsam.Pose2(*graph.initial[0])
    for step in range(steps):
        begin = time.process_time()
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if step:
            z = gtsam.Pose2(*motions.measured[step - 1])
            noise = gtsam.noiseModel.Gaussian.Information(motions.information[step - 1])
            factors.add(gtsam.BetweenFactorPose2(X(step - 1), X(step), z, noise))
            latest = latest.compose(z)
        else:
            factors.add(gtsam.PriorFactorPose2(X(0), latest, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
        values.insert(X(step), latest)
        for row in np.flatnonzero(log.steps == step):
            landmark, (distance, bearing) = int(log.landmarks[row]), log.sightings[row, :2]
            sigmas = np.sqrt(np.diagonal(graph.sensor.Q(log.sightings[row, :2])))[::-1]
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            factors.add(gtsam.BearingRangeFactor2D(X(step), L(landmark), gtsam.Rot2(bearing), distance, noise))
            if landmark not in seen:
                seen.add(landmark)
                towards = np.array([distance * np.cos(bearing), distance * np.sin(bearing)])
                values.insert(L(landmark), latest.transformFrom(towards))
        try:
            smoother.update(factors, values)
            latest = smoother.calculateEstimatePose2(X(step))
        except RuntimeError as error:
            print(f"{name:28} ISAM2 fails at step {step}: {str(error).strip().splitlines()[0]}")
            break
        seconds.append(time.process_time() - begin)
    return report(name, seconds[1:], [], "ISAM2 at every step" if skip == 1 else f"ISAM2 at every {skip}th step")


def pose_graph(path: Path, steps: int, sample: float) -> dict[str, Any]:
    """A pose graph edge by edge in the order of its file: a step is a new pose with all edges to earlier ones. A row."""
    graph = Graph.from_g2o(path)
    edges = next(family for family in graph.families if isinstance(family, RelativePoseEdges))
    later = np.maximum(edges.first, edges.second)
    order = np.argsort(later, kind="stable")
    bounds = np.searchsorted(later[order], np.arange(len(graph.initial) + 1))
    solver, seconds, gaps = OnlineSolver(graph.initial[0]), [], []
    rng, steps = np.random.default_rng(0), min(steps, len(graph.initial))
    for pose in range(1, steps):
        rows = order[bounds[pose] : bounds[pose + 1]]
        forward = [row for row in rows if edges.second[row] == pose]
        row = max(forward, key=lambda k: edges.first[k])
        arriving = [row, *(k for k in rows if k != row)]
        begin = time.process_time()
        solver._backend.relate(
            *((int(edges.first[k]), int(edges.second[k]), edges.measured[k], edges.information[k]) for k in arriving)
        )
        seconds.append(time.process_time() - begin)
        if rng.random() < sample:
            kept, poses = later <= pose, solver.poses
            families = (
                AnchorEdges(np.zeros(1, dtype=int), graph.initial[:1], 1e6 * np.eye(3)[None]),
                RelativePoseEdges(edges.first[kept], edges.second[kept], edges.measured[kept], edges.information[kept]),
            )
            ids = np.arange(pose + 1)
            piece = Graph(poses, families=families, steps=ids, trajectory=poses, pose_ids=ids)
            best = solve(piece, initialize="given").cost
            gaps.append((piece.cost(poses) - best) / max(best, 1e-9))
    return report(path.stem, seconds, gaps)


def endless(steps: int, lag: int | None) -> Iterator[dict[str, Any]]:
    """Rows: time and memory of a robot that drives in a circle among twenty landmarks, and sees those up to 5 m away."""
    rng, sensor, pose, move = np.random.default_rng(0), SensorModel(), np.zeros(3), np.array([0.3, 0.0, 0.05])
    marks, std = rng.uniform((-10, -4), (10, 16), (20, 2)), np.array([0.03, 0.02, 0.02])
    solver, seconds = OnlineSolver(sensor=sensor, lag=lag), []
    for step in range(1, steps + 1):
        pose = compose(pose, move)
        ranges = np.hypot(*(marks - pose[:2]).T)
        ids = np.flatnonzero((ranges > 0.3) & (ranges < 5.0))
        bearings = np.arctan2(*(marks[ids] - pose[:2]).T[::-1]) - pose[2]
        z = np.column_stack([ranges[ids], bearings])
        z *= 1 + np.outer(rng.normal(0, 0.14, len(ids)), (1, 0))
        z[:, 1] += rng.normal(0, 0.05, len(ids))
        z[:, 0] = np.maximum(z[:, 0], 0.1)
        begin = time.process_time()
        solver.move(motion=move + rng.normal(0, std), covariance=np.diag(std**2))
        solver.observe(ids, z)
        seconds.append(time.process_time() - begin)
        if step in (1000, 10_000, 30_000, steps):
            recent, size = 1e3 * np.array(seconds[-1000:]), solver._backend.system.bytes / 2**20
            median, high = np.median(recent), np.quantile(recent, 0.99)
            yield {"name": f"lag {lag}, step {step}", "median_ms": median, "p99_ms": high, "mib": size} | {
                "lag": "none" if lag is None else f"{lag} steps",
                "steps": step,
            }
            print(f"lag {lag}: step {step:6}, {median:.2f} ms median, {high:.1f} ms 99 %", end=", ")
            print(f"nodes, edges and tree {size:.1f} MiB, {np.hypot(*(solver.pose - pose)[:2]):.3f} m off", flush=True)


def lags(name: str, graph: Graph, steps: int) -> Iterator[dict[str, Any]]:
    """Rows: the last pose with a lag, against the one without."""
    poses = {}
    for lag in (None, 200, 50):
        seconds, iterator = [], replay(graph, lag=lag)
        newest = []
        for _ in range(steps):
            begin = time.process_time()
            newest.append(next(iterator).pose)
            seconds.append(time.process_time() - begin)
        poses[lag] = np.array(newest)
        ms, off = 1e3 * np.array(seconds[1:]), poses[lag] - poses[None]
        far, turned = np.hypot(off[:, 0], off[:, 1]), np.abs(wrap(off[:, 2]))
        print(f"{name}, lag {lag}: {np.median(ms):.2f} ms median, newest pose off by", end=" ")
        print(f"{np.median(far):.4f} m median, {far.max():.3f} m most,", end=" ")
        print(f"{np.median(turned):.4f} rad median, {turned.max():.3f} rad most", flush=True)
        yield {
            "name": f"{name}, lag {lag}", "log": TITLES[name], "lag": "none" if lag is None else f"{lag} steps",
            "median_ms": np.median(ms), "off_m": np.median(far), "off_most_m": far.max(), "turn_rad": np.median(turned),
            "turn_most_rad": turned.max(),
        }  # fmt: skip


def covariances(data: Path, count: int, kernel: str | None, steps: int) -> Iterator[dict[str, Any]]:
    """Rows: standard deviations of the newest pose and the whole map against those of the batch solution: five times in each
    of ``count`` clean simulated logs with and without psi, across a corridor, and on the real logs."""
    for orientation in (False, True):
        ratios, times = [], []
        for seed in range(count):
            log = simulate(seed=seed, clean=True, orientation=orientation)
            graph = Graph.from_log(log, edges="landmark+motion", kernel=kernel)
            found, seconds = deviations(graph, log.num_poses, 5)
            ratios += found
            times += seconds
        yield report_ratios(f"{count} simulated logs {'with' if orientation else 'without'} psi", ratios, times)
    for name, read in logs(data).items():
        log, models = read()
        graph = Graph.from_log(log, edges="landmark+motion", kernel=kernel, **models)
        yield report_ratios(f"{name}, first {steps:,} steps", *deviations(graph, min(steps, log.num_poses), 5))


def deviations(graph: Graph, steps: int, samples: int) -> tuple[list[np.ndarray], list[tuple[float, float, float]]]:
    """Standard deviations divided by those of the batch solution at some steps, and processor times in seconds: of a step, of
    the first call after it, for the pose and three landmarks, and of a second one."""
    asked = {steps * (k + 1) // samples - 1 for k in range(samples)}
    ratios, times = [], []
    for estimate in itertools.islice(replay(graph), steps):
        if estimate.step not in asked:
            continue
        solver, ids = estimate, list(estimate.landmarks)
        clock = [time.process_time()]
        for _ in range(2):
            solver.covariance(solver.step, ids[:3], joint=True)
            clock.append(time.process_time())
        times.append(np.diff(clock))
        online = np.diag(solver.covariance(solver.step, ids, joint=True))
        batch = solve(so_far(graph, estimate), initialize="given")
        blocks = [np.diag(batch.covariance(estimate.step)), *map(np.diag, batch.landmark_covariances.values())]
        ratios.append(np.sqrt(online / np.concatenate(blocks)))
    return ratios, times


def report_ratios(name: str, ratios: list[np.ndarray], times: list[np.ndarray]) -> dict[str, Any]:
    """One line, and a row to record: the range of the ratios of poses and of all, and the times of a call."""
    poses, every = np.array([ratio[:3] for ratio in ratios]), np.concatenate(ratios)
    first, again = 1e3 * np.median(times, axis=0)
    print(
        f"{name:32} {len(ratios)} calls, standard deviations of poses {poses.min():.3f} to {poses.max():.3f}, of all "
        f"{every.min():.3f} to {every.max():.3f} times; {first:.2f} ms, again {again:.2f} ms", flush=True,
    )  # fmt: skip
    figures = {"poses_least": poses.min(), "poses_most": poses.max(), "all_least": every.min(), "all_most": every.max()}
    return {"name": name} | figures | {"first_ms": first, "again_ms": again}


def main() -> None:
    """All logs, or one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--only", choices=("mrclam6", "woods", "huang", "long", "city10000"))
    parser.add_argument("--steps", type=int, default=10**9)
    parser.add_argument("--sample", type=float, default=0.1)
    parser.add_argument("--kernel")
    parser.add_argument("--isam2", action="store_true")
    parser.add_argument("--endless", type=int, metavar="STEPS", help="only: time and memory on a known map")
    parser.add_argument("--lag", type=int, help="of --endless")
    parser.add_argument("--lags", action="store_true", help="only: what lags of 50 and 200 steps do")
    parser.add_argument(
        "--covariances", type=int, metavar="LOGS", help="only: standard deviations against the batch solution"
    )
    add_option(parser)
    options = parser.parse_args()
    if options.covariances:
        rows = list(covariances(options.data, options.covariances, options.kernel, options.steps))
        record(options.record, "online_covariances", rows)
        return
    if options.endless:
        record(options.record, "online_endless", list(endless(options.endless, options.lag)))
        return
    rows = list[dict[str, Any]]()
    reads = {"long": lambda: (long_log(35_000), {})} if options.only == "long" else logs(options.data)
    for name, read in reads.items():
        if options.only not in (None, name):
            continue
        log, models = read()
        graph = Graph.from_log(log, edges="landmark+motion", kernel=options.kernel, **models)
        steps = min(options.steps, log.num_poses)
        sampled = set(np.random.default_rng(0).choice(steps, int(options.sample * steps), replace=False).tolist())
        if options.lags:
            rows += lags(name, graph, steps)
            continue
        assert any(isinstance(family, CartesianObservationEdges) for family in graph.families)
        try:
            rows.append(own := ours(name, graph, steps, sampled))
        except GraphError as error:
            print(f"{name:28} fails: {error}")
            continue
        if options.isam2:
            for row in (isam2(name, graph, steps, skip) for skip in (1, 10)):
                # within one run: times vary between runs
                rows.append(row | {"to_online": row["median_ms"] / own["median_ms"]})
    if options.only in (None, "city10000") and not options.lags:
        rows.append(pose_graph(options.data / "posegraph" / "city10000.g2o", options.steps, options.sample))
    record(options.record, "online_lags" if options.lags else "online", rows)


if __name__ == "__main__":
    main()
