"""Real logs, all estimators, against their truth: the tables and figures of docs/results.md.

    python benchmarks/real_logs.py [--data ../shared/data] [--only mrclam6] [--figures docs/img]
                                   [--leave-out gtsam isam2] [--record docs/measured]

For each data set at hand: which noise, then a row per estimator with the errors of `graphslam.metrics`, NEES of the
graph, and time. The reference row `gtsam-native` is the same problem in GTSAM's own factors (`native_gtsam`), from the
same start. Calibrated noise is that of ``slam-compare calibrate`` on the log that the column names. With our factors in
Python, GTSAM takes a quarter of an hour on robot 3.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from native_gtsam import native_gtsam
from recording import add_option, record

from comparisons.comparison import Comparison, compare
from comparisons.datasets import data_folder
from comparisons.options import RunOptions
from comparisons.results.results import Row
from graphslam import Log, MotionModel, SensorModel, load
from graphslam.calibration import Calibration, calibrate

FILTERS = ("mcl", "fastslam1", "fastslam2")
ALL = ("dead-reckoning", "graph", "gtsam", "isam2", *FILTERS)

#: the logs, as rows of the results name them
SHORT = {
    "mrclam6": "mrclam",
    "lost_in_the_woods/dataset2.mat": "woods",
    "simulated_535": "huang535",
    "simulated_8240": "huang8240",
}
#: the noise that a native GTSAM graph of MR.CLAM was once tried with, set by hand
BY_HAND = {
    "motion": MotionModel.constant(0.1, 0.3, epsilon=1e-8),
    "sensor": SensorModel(range_rate=0.0, range_std=0.12, bearing_std=0.02),
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A log, how it is read, and with which noise it is solved.

    Attributes:
        folder: below the data; robot, stride, max_range: see `slam-compare run`.
        noise: "published", "by hand", or "<source> of <robot>", calibrated on that robot's log.
        kernel: robust kernel of the graphs.
        estimators: which run, besides the native GTSAM graph.
        figure: name of a figure in docs/img, if one is drawn.
    """

    folder: str
    noise: str
    robot: int | None = None
    stride: int = 1
    max_range: float | None = None
    kernel: str = "none"
    estimators: tuple[str, ...] = ALL
    figure: str | None = None

    @property
    def title(self) -> str:
        """What the table is called."""
        extra = [f"robot {self.robot}"] if self.robot is not None else []
        extra += [f"every {self.stride}th pose"] if self.stride > 1 else []
        extra += [f"up to {self.max_range:g} m"] if self.max_range is not None else []
        return ", ".join([self.folder.split("/")[0], *extra, f"noise {self.noise}", f"kernel {self.kernel}"])


#: what is recorded of each estimator
FIGURES = ("ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m", "nees", "cost", "iterations", "converged", "seconds")
GRAPHS = ("graph",)
CASES = (
    Case(folder="mrclam6", robot=1, noise="by hand", kernel="huber", figure="real-mrclam6-1"),
    Case(folder="mrclam6", robot=1, noise="truth of 1", kernel="huber", estimators=GRAPHS),
    Case(folder="mrclam6", robot=1, noise="truth of 3", kernel="huber", estimators=GRAPHS),
    Case(folder="mrclam6", robot=1, noise="residuals of 1", kernel="cauchy", estimators=GRAPHS),
    Case(folder="mrclam6", robot=3, noise="by hand", kernel="huber", figure="real-mrclam6-3"),
    Case(folder="mrclam6", robot=3, noise="truth of 3", kernel="huber", estimators=GRAPHS),
    Case(folder="mrclam6", robot=3, noise="truth of 1", kernel="huber", estimators=GRAPHS),
    Case(folder="mrclam6", robot=3, noise="residuals of 3", kernel="cauchy", estimators=GRAPHS),
    Case(
        folder="lost_in_the_woods/dataset2.mat", noise="published", stride=5, max_range=5.0,
        figure="real-lost-in-the-woods",
    ),
    Case(folder="simulated_535", noise="published", figure="real-huang-535"),
    # GTSAM's ISAM2 fails on this one by Cholesky (indeterminate system), and takes many minutes by QR
    Case(
        folder="simulated_8240", noise="published", estimators=tuple(name for name in ALL if name not in ("isam2", "gtsam")),
        figure="real-huang-8240",
    ),
)  # fmt: skip


@cache
def read(data: Path, folder: str, robot: int | None, stride: int, max_range: float | None) -> Log:
    """A log of a case."""
    log = load(data / folder, robot=robot)
    log = log.at_steps(np.arange(0, log.num_poses, stride)) if stride > 1 else log
    return log if max_range is None else log.nearer_than(max_range)


@cache
def calibrated(data: Path, folder: str, robot: int, source: str) -> Calibration:
    """The noise of a robot's log."""
    return calibrate(read(data, folder, robot, 1, None), source=source)


def prepared(case: Case, data: Path) -> tuple[Log, RunOptions]:
    """The log of a case, with its ranges corrected where the noise says so, and the options of the estimators."""
    log = read(data, case.folder, case.robot, case.stride, case.max_range)
    models = BY_HAND if case.noise == "by hand" else {}
    if case.noise not in ("by hand", "published"):
        source, _, robot = case.noise.partition(" of ")
        log = calibrated(data, case.folder, int(robot), source).apply(log)
    return log, RunOptions.of(kernel=case.kernel, particles=500, **models)


def run(case: Case, data: Path) -> Comparison:
    """All estimators of a case, the native graph among them."""
    log, options = prepared(case, data)
    outcome = compare(log, options, estimators=case.estimators)
    return replace(outcome, results=(*outcome.results, native_gtsam(log, options)))


def lines(case: Case, outcome: Comparison) -> Iterator[str]:
    """A table in Markdown."""
    log = outcome.log
    yield f"\n**{case.title}** ({log.num_poses} poses, {len(log.steps)} sightings, {len(log.landmark_ids)} landmarks)\n"
    yield "| estimator | ATE [m] | RPE [m] | RPE [rad] | heading [rad] | map [m] | NEES / 3 | J | time [s] |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for row in outcome.table:
        heading = outcome.metrics[row.name].heading_rad
        figures = [row.ate_m, row.rpe_m, row.rpe_rad, heading, row.landmark_rmse_m, row.nees]
        cells = ["–" if f is None else f"{f:.3f}" for f in figures]
        cost = "–" if row.cost is None else f"{row.cost:.6g}"
        stopped = "" if row.converged in (True, None) else " (not converged)"
        yield f"| {row.name}{stopped} | {' | '.join(cells)} | {cost} | {row.seconds:.2f} |"


def recorded(case: Case, outcome: Comparison, row: Row) -> dict[str, object]:
    """A row for `recording`; its name is "mrclam1 graph", or "mrclam1 truth of 3 graph" with calibrated noise."""
    log = f"{SHORT[case.folder]}{case.robot or ''}"
    noise = "" if case.noise in ("by hand", "published") else f" {case.noise}"
    given = {"name": f"{log}{noise} {row.name}", "log": log, "noise": case.noise, "kernel": case.kernel}
    sizes = {"robot": case.robot, "poses": outcome.log.num_poses, "sightings": len(outcome.log.steps)}
    figures = {name: getattr(row, name) for name in FIGURES}
    return given | {"estimator": row.name} | sizes | figures | {"heading_rad": outcome.metrics[row.name].heading_rad}


def main() -> None:
    """Run the cases whose data are at hand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--only", default="", help="cases whose title has this in it")
    parser.add_argument("--figures", type=Path, help="folder for figures")
    parser.add_argument("--leave-out", nargs="+", default=(), choices=ALL, help="estimators that do not run")
    add_option(parser)
    arguments = parser.parse_args()
    rows = []
    for case in CASES:
        if arguments.only not in case.title:
            continue
        if not (arguments.data / case.folder).exists():
            print(f"\n{case.title}: not below {arguments.data}, left out", flush=True)
            continue
        kept = tuple(name for name in case.estimators if name not in arguments.leave_out)
        outcome = run(replace(case, estimators=kept), arguments.data)
        print("\n".join(lines(case, outcome)), flush=True)
        rows += [recorded(case, outcome, row) for row in outcome.table]
        if arguments.figures is not None and case.figure is not None:
            # the native graph lies on ours
            shown = replace(outcome, results=tuple(r for r in outcome.results if r.name != "gtsam-native"))
            shown.save_figure([arguments.figures / f"{case.figure}.png"])
    record(arguments.record, "real_logs", rows)


if __name__ == "__main__":
    main()
