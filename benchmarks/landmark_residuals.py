"""The two residuals of landmark nodes, Cartesian and polar, on simulated and real logs: errors, ANEES and bias.

Simulated logs also with the Cartesian residual and the noise at the estimated ranges (``range_noise="estimated"``).

    python benchmarks/landmark_residuals.py [--logs 200] [--jobs 2] [--data ../shared/data] [--only simulated | real]
                                            [--record docs/measured]

Simulated logs: the book's world, 62 motions, noise as in the models that the graph is given. ``scale`` is the mean over the
logs of the scale of the best similarity from the true map to the estimated one, minus 1, with its standard error: weights
that depend on the measured range favour short measurements, so a bias of the ranges shows there. ATE and its paired
difference are means over the logs that both residuals solve. Real logs: the table's noise, with and without a kernel.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from real_logs import BY_HAND
from recording import add_option, record

from comparisons.comparison import compare
from comparisons.datasets import data_folder
from comparisons.options import RunOptions
from comparisons.studies.consistency import models
from graphslam import Graph, Log, MotionModel, SensorModel, load, simulate, solve
from graphslam.errors import SlamError
from graphslam.metrics import ate
from graphslam.models import RESIDUALS
from graphslam.se2 import Array
from graphslam.simulation.worlds import World

#: the residual and the range at which the noise is taken
WAYS = (*((residual, "measured") for residual in RESIDUALS), ("cartesian", "estimated"))
#: what the table of the real logs has of each
FIGURES = ("cost", "ate_m", "landmark_rmse_m", "nees", "seconds")
#: factor on the book's noise, or the models themselves; and the numbers of a sighting
CASES = (
    *product((0.1, 0.5, 1.0), (3, 2)),
    ("ranges 14 %, the rest 0.1", 3),
    ("ranges 14 %, the rest 0.1", 2),
)


def noise_of(case: float | str) -> tuple[MotionModel, SensorModel]:
    """The models of a case; in words: the ranges of the book, everything else a tenth of it."""
    if not isinstance(case, str):
        return models(case)
    motion, sensor = models(0.1)
    return motion, replace(sensor, range_rate=0.14)


def scale_of(estimated: Array, true: Array) -> float:
    """The scale of the similarity that carries the true points (L, 2) to the estimated ones in the least squares."""
    a, b = ((points - points.mean(axis=0)) @ [1, 1j] for points in (true, estimated))
    return float(abs(np.vdot(a, b)) / np.vdot(a, a).real)


def one_log(case: float | str, dimensions: int, seed: int) -> Array:
    """For each of `WAYS`: ATE [m], mean NEES of the poses, joint NEES, scale - 1; NaN where it did not converge. (3, 4)"""
    motion, sensor = noise_of(case)
    log = simulate(World(clean=True, orientation=dimensions == 3), seed=seed, motion=motion, sensor=sensor)
    assert log.true_poses is not None and log.true_landmarks is not None
    rows = np.full((len(WAYS), 4), np.nan)
    for row, (residual, range_noise) in zip(rows, WAYS):
        try:
            solution = solve(
                Graph.from_log(
                    log, edges="landmark+motion", motion=motion, sensor=sensor, residual=residual, kernel="none"
                ),
                max_iterations=500,
                range_noise=range_noise,
            )
            if solution.converged:
                places = [
                    (solution.landmarks[j][:2], m[:2]) for j, m in log.true_landmarks.items() if j in solution.landmarks
                ]
                row[:] = (
                    ate(log.true_poses, solution.poses), np.mean(solution.nees(log.true_poses)[1:]),
                    solution.joint_nees(log.true_poses), scale_of(*map(np.array, zip(*places))) - 1,
                )  # fmt: skip
        except SlamError:
            pass
    return rows


def simulated(logs: int, jobs: int) -> Iterator[str]:
    """The table of the simulated logs."""
    yield "| noise, times the book's | psi | residual, noise | solved | ATE [m] | ANEES | joint, median | scale - 1 [%] |"
    yield "|---|---|---|---|---|---|---|---|"
    with ProcessPoolExecutor(jobs) as pool:
        for case, dimensions in CASES:
            table = np.array(list(pool.map(partial(one_log, case, dimensions), range(logs), chunksize=4)))
            both = np.isfinite(table[..., 0]).all(axis=1)
            psi = "yes" if dimensions == 3 else "no"
            for (residual, range_noise), values in zip(WAYS, np.moveaxis(table, 1, 0)):
                error, nees, joint, scale = values[both].T
                solved, spread = np.isfinite(values[:, 0]).sum(), scale.std() / len(scale) ** 0.5
                how, middle = f"{residual}, {range_noise}", np.median(joint)
                yield (
                    f"| {case} | {psi} | {how} | {solved} of {logs} | {error.mean():.4f} | {nees.mean():.3f} | "
                    f"{joint.mean():.3f}, {middle:.3f} | {100 * scale.mean():+.2f} ± {100 * spread:.2f} |"
                )
            difference = table[both, 0, 0] - table[both, 1, 0]
            yield (
                f"| {case} | {psi} | Cartesian - polar | | {difference.mean():+.4f} ± "
                f"{difference.std() / len(difference) ** 0.5:.4f} | | | |"
            )


def real_logs(data: Path) -> Iterator[tuple[str, str, Log, dict[str, Any]]]:
    """The logs with ground truth that are there: title, noise, log, and the models where they are not its own."""
    for robot in (1, 3):
        if (data / "mrclam6").exists():
            log = load(data / "mrclam6", robot=robot)
            yield f"MR.CLAM 6 robot {robot}", "the book's", log, {"noise": "book"}
            yield f"MR.CLAM 6 robot {robot}", "by hand", log, BY_HAND
    for folder in ("simulated_535", "simulated_8240", "lost_in_the_woods"):
        if (data / folder).exists():
            yield folder, "published", load(data / folder), {}


def real(data: Path, folder: Path | None) -> Iterator[str]:
    """The table of the real logs, and of Huang's, whose rows are recorded."""
    rows = []
    yield "| log | noise | kernel | residual | converged | J | ATE [m] | map [m] | NEES / 3 | time [s] |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for title, noise, log, numbers in real_logs(data):
        for kernel, residual in product(("none", "cauchy"), RESIDUALS):
            options = RunOptions.of(edges="landmark+motion", kernel=kernel, residual=residual, **numbers)
            row = compare(log, options, estimators="graph").table["graph"]
            figures = {key: getattr(row, key) for key in FIGURES}
            given = {"log": title, "noise": noise, "kernel": kernel, "residual": residual, "converged": row.converged}
            rows.append({"name": ", ".join((title, noise, kernel, residual))} | given | figures)
            texts = ("-" if x is None else f"{x:.{d}f}" for x, d in zip(figures.values(), (1, 3, 3, 2, 2)))
            yield (
                f"| {title} | {noise} | {kernel} | {residual} | {'yes' if row.converged else 'no'} | {' | '.join(texts)} |"
            )
    record(folder, "landmark_residuals", rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--logs", type=int, default=200, help="simulated logs of each case")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", choices=("simulated", "real"))
    add_option(parser)
    arguments = parser.parse_args()
    if arguments.only != "real":
        for line in simulated(arguments.logs, arguments.jobs):
            print(line, flush=True)
    if arguments.only != "simulated":
        for line in real(arguments.data, arguments.record):
            print(line, flush=True)


if __name__ == "__main__":
    main()
