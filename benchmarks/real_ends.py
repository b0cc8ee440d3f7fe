"""All robots of MR.CLAM and Lost in the Woods at hand: does `slam-compare run` end well, and at the best end known?

    python benchmarks/real_ends.py [--data ../shared/data] [--only "robot 3, by hand"]

Each log is solved by the command line with the default noise and with noise by hand, with the Cauchy kernel, the default on
real data (row `graph`), and without a kernel (`graph-no-kernel`). A row is good if the exit status is 0, all its figures are
finite, and J is at most 1e-6 of it above the best end known: the lowest J at which Gauss-Newton or damped steps converge
from the ground truth, dead reckoning, growing by ten poses, and the other starts of `auto`. The exit status is 1 if a row
is not good.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from comparisons.comparison import compare
from comparisons.datasets import data_folder
from comparisons.options import RunOptions
from graphslam import Graph, GraphError, load, solve
from graphslam.formats.mrclam import robots
from graphslam.solvers.start import place_landmarks
from graphslam.solvers.starting import AUTO, starting_state

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


def main() -> int:
    """Run all logs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--only", default="", help="rows whose log and noise have this in them")
    arguments = parser.parse_args()
    bad = 0
    print("| log | noise | kernel | exit | converged | J | above the best end | ATE [m] | map [m] |", flush=True)
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for path, robot in logs(arguments.data):
        for noise, values in (("default", {}), ("by hand", BY_HAND)):
            title = path.name if robot is None else f"{path.name} robot {robot}"
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
    print(f"{bad} rows are not good")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main())
