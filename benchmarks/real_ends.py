"""All robots of MR.CLAM and Lost in the Woods at hand: does `slam-compare run` end well, and at the best end known?

    python benchmarks/real_ends.py [--data ../shared/data] [--only "robot 3, by hand"] [--record docs/measured]
    python benchmarks/real_ends.py --parts 2,5           # every robot's drive cut into 2 and into 5 drives, as further logs
    python benchmarks/real_ends.py --wrong 0.03 --logs 25 --seed 5    # simulated logs with wrong ids

Each log is solved by the command line with the default noise and with noise by hand, with the Cauchy kernel, the default on
real data (row `graph`), and without a kernel (`graph-no-kernel`). A row is good if the exit status is 0, all its figures are
finite, and J is at most 1e-6 of it above the best end known: the lowest J at which Gauss-Newton or damped steps converge
from the ground truth, dead reckoning, growing by ten poses, and the other starts of `auto`. With a kernel J must not be above
that of the plain optimum either. The exit status is 1 if a row is not good. Parts of drives and simulated logs are solved by
the same functions in this process, with the Cauchy kernel.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hard_logs import hard_log
from recording import add_option, record

from comparisons.comparison import compare
from comparisons.datasets import data_folder
from comparisons.options import RunOptions
from graphslam import Graph, GraphError, Log, MotionModel, SensorModel, load, solve
from graphslam.io.mrclam import robots
from graphslam.solvers.initialize import AUTO, place_landmarks, starting_state

#: docs/results.md
BY_HAND = {
    "sigma_v": 0.1,
    "sigma_omega": 0.3,
    "range_std": 0.12,
    "bearing_std": 0.02,
    "range_rate": 0.0,
    "epsilon": 1e-8,
}
ROWS = ("graph", "graph-no-kernel")
#: J may be above the best end known by this part
PART = 1e-6


def logs(data: Path) -> Iterator[tuple[Path, int | None]]:
    """The logs below a folder, and their robots."""
    for folder in sorted(path for path in data.glob("*mrclam*") if path.is_dir()):
        for robot in robots(folder):
            if (folder / f"Robot{robot}_Odometry.dat").exists():
                yield folder, robot
    if (woods := data / "lost_in_the_woods" / "dataset2.mat").exists():
        yield woods, None


def best_end(graph: Graph) -> float:
    """The lowest J at which a run converges from the truth or any other start."""
    states, ends = [graph.initial], [math.inf]
    log = graph.log
    assert log is not None
    if (truth := log.robot_truth) is not None:
        known = np.isfinite(truth[graph.steps]).all(axis=1)
        poses = np.where(known[:, None], truth[graph.steps], solve(graph).state[: len(graph.steps)])
        states.append(place_landmarks(graph, poses))
    for name in ("dead-reckoning", *AUTO, "grow"):
        try:
            states.append(starting_state(graph, name))
        except GraphError:
            continue
    for state in states:
        for method in ("gauss-newton", "levenberg-marquardt"):
            try:
                run = solve(graph.with_initial(state), method=method, initialize="given", max_iterations=300)
            except GraphError:
                continue
            if run.converged:
                ends.append(run.cost)
                break
    return min(ends)


def parts(log: Log, count: int) -> Iterator[Log]:
    """A drive cut into ``count`` drives, without those of fewer than 20 sightings."""
    length = log.num_poses // count
    for first in range(0, length * count, length):
        part = log.at_steps(np.arange(first, min(first + length + 1, log.num_poses)))
        if len(part.steps) >= 20:
            yield part


def with_wrong_ids(log: Log, part: float, seed: int) -> Log:
    """The first 250 steps of a log, in which a part of the sightings has the id of any landmark."""
    rng = np.random.default_rng([seed, 77])
    landmarks = log.landmarks.copy()
    wrong = rng.random(len(landmarks)) < part
    landmarks[wrong] = rng.choice(log.landmark_ids, int(wrong.sum()))
    return log.replace(landmarks=landmarks).at_steps(np.arange(min(250, log.num_poses)))


def check_kernel(title: str, log: Log, noise: dict[str, MotionModel | SensorModel]) -> bool:
    """Whether the end with the Cauchy kernel is above neither the plain optimum nor an end from the truth; prints a row."""
    graph = Graph.from_log(log, edges="landmark+motion", kernel="cauchy", **noise)  # type: ignore[arg-type]
    begin = time.process_time()
    solution = solve(graph)
    seconds, plain = time.process_time() - begin, solve(graph.without_kernel).cost
    truth = log.robot_truth
    assert truth is not None
    known = np.isfinite(truth[graph.steps]).all(axis=1)
    poses = np.where(known[:, None], truth[graph.steps], solution.state[: len(graph.steps)])
    start, best = graph.with_initial(place_landmarks(graph, poses)), math.inf
    for method in ("gauss-newton", "levenberg-marquardt"):
        end = solve(start, method=method, initialize="given", max_iterations=300)
        if end.converged:
            best = end.cost
            break
    good = bool(solution.converged and solution.cost <= min(best, plain) * (1 + PART))
    print(
        f"| {title} | {solution.cost:.6g} | {solution.cost / best - 1:.0e} | {plain:.6g} | {solution.certificate.status} "
        f"| {seconds:.2f} | {'yes' if good else 'no'} |",
        flush=True,
    )
    return good


def command(path: Path, robot: int | None, noise: dict[str, float]) -> tuple[int, dict[str, dict[str, float]]]:
    """The exit status of `slam-compare run`, and the rows of its JSON by name."""
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "comparisons", "run", str(path), "--estimators", ",".join(ROWS), "--out", folder]
        words += ["--json", f"{folder}/run.json"] + ([] if robot is None else ["--robot", str(robot)])
        for name, value in noise.items():
            words += [f"--{name.replace('_', '-')}", repr(value)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            print(done.stdout, done.stderr, file=sys.stderr)
            return done.returncode, {}
        document = json.loads(Path(folder, "run.json").read_text(encoding="utf-8"))
    return 0, {row["name"]: row for row in document["estimators"]}


def finite(row: dict[str, object]) -> bool:
    """Whether the figures of a row are finite numbers."""
    poses = np.array(row["poses"], dtype=float)
    figures = [row[name] for name in ("cost", "ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m")]
    return bool(np.isfinite(poses).all()) and all(isinstance(f, float) and math.isfinite(f) for f in figures)


def kernels(arguments: argparse.Namespace) -> int:
    """The table of parts of drives and of simulated logs."""
    print("| log | J | above the end from the truth | J without kernel | status | seconds | good |", flush=True)
    print("|---|---|---|---|---|---|---|", flush=True)
    bad, count = 0, 0
    by_hand = {"motion": MotionModel.constant(0.1, 0.3, epsilon=1e-8), "sensor": SensorModel.constant(0.12, 0.02)}
    for number in range(arguments.logs if arguments.wrong else 0):
        log = with_wrong_ids(hard_log(number, arguments.seed), arguments.wrong, number)
        bad, count = bad + (not check_kernel(f"simulated {number}", log, {})), count + 1
    for path, robot in logs(arguments.data) if arguments.parts else ():
        for pieces in map(int, arguments.parts.split(",")):
            for number, log in enumerate(parts(load(path, robot=robot), pieces)):
                for noise, values in (("default", {}), ("by hand", by_hand)):
                    title = f"{path.name} robot {robot}, part {number + 1} of {pieces}, {noise}"
                    if arguments.only in title:
                        bad, count = bad + (not check_kernel(title, log, values)), count + 1  # type: ignore[arg-type]
    print(f"{bad} of {count} rows are not good")
    return bad > 0


def main() -> int:
    """Run all logs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--only", default="", help="rows whose log and noise have this in them")
    parser.add_argument("--parts", default="", help="numbers of drives into which each drive is cut")
    parser.add_argument("--wrong", type=float, default=0.0, help="simulated logs with this part of wrong ids")
    parser.add_argument("--logs", type=int, default=25, help="the number of simulated logs")
    parser.add_argument("--seed", type=int, default=5, help="the seed of the simulated logs; they were tuned on 3")
    add_option(parser)
    arguments, kept = parser.parse_args(), []
    if arguments.parts or arguments.wrong:
        return kernels(arguments)
    bad = 0
    print("| log | noise | kernel | exit | converged | J | above the best end | ATE [m] | map [m] |", flush=True)
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for path, robot in logs(arguments.data):
        for noise, values in (("default", {}), ("by hand", BY_HAND)):
            title = "Lost in the Woods" if robot is None else f"{path.name} robot {robot}"
            if arguments.only not in f"{title}, {noise}":
                continue
            status, rows = command(path, robot, values)
            for name in ROWS:
                kernel = "none" if name == "graph-no-kernel" else "cauchy"
                if name not in rows:
                    bad += 1
                    print(f"| {title} | {noise} | {kernel} | {status} | – | – | – | – | – |", flush=True)
                    continue
                row = rows[name]
                # the same graph again, to start it elsewhere
                log = load(path, robot=robot)
                graph = compare(log, RunOptions.of(kernel=kernel, **values), estimators=["graph"])["graph"].graph
                assert graph is not None
                best = best_end(graph)
                above = row["cost"] / best - 1
                bad += not (row["converged"] and finite(row) and above <= PART)
                print(
                    f"| {title} | {noise} | {kernel} | {status} | {'yes' if row['converged'] else 'no'} | {row['cost']:.6g} "
                    f"| {above:.0e} | {row['ate_m']:.3f} | {row['landmark_rmse_m']:.3f} |",
                    flush=True,
                )
                figures = {key: row[key] for key in ("converged", "cost", "ate_m", "landmark_rmse_m")}
                given = {"log": title, "noise": noise, "kernel": kernel, "exit": status, "above": above}
                kept.append({"name": f"{title}, {noise}, {kernel}"} | given | figures)
    record(arguments.record, "real_ends", kept)
    print(f"{bad} rows are not good")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main())
