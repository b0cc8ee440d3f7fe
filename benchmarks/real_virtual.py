"""Virtual-motion edges on a real log without psi: what the weight of the pairs does, beside landmark nodes.

    python benchmarks/real_virtual.py [--data ../shared/data] [--record docs/measured]

MR.CLAM 6, noise by hand (as in `real_logs`), with motion edges. Without psi one shared landmark ties two poses in two of
three coordinates; the motion edges do the rest. A row per weight and kernel: errors, NEES of the poses, and time.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from real_logs import BY_HAND, read
from recording import add_option, record

from comparisons.comparison import compare
from comparisons.datasets import data_folder
from comparisons.estimators import pair_count
from comparisons.options import RunOptions

VARIANTS = (
    {"edges": "landmark+motion"},
    {"edges": "virtual+motion", "weight": "marginal"},
    {"edges": "virtual+motion", "weight": "tempered"},
    {"edges": "virtual+motion", "weight": "pairs"},
)
FIGURES = ("converged", "ate_m", "landmark_rmse_m", "nees", "iterations", "seconds")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="default: SLAM_DATA, else ../shared/data")
    parser.add_argument("--robots", type=int, nargs="+", default=[1], help="robot 3 has 700,000 pairs: minutes")
    add_option(parser)
    arguments, rows = parser.parse_args(), []
    print("| robot | pairs | edges | kernel | converged | ATE [m] | map [m] | NEES / 3 | iterations | time [s] |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for robot in arguments.robots:
        log = read(arguments.data, "mrclam6", robot, 1, None)
        for variant in VARIANTS:
            for kernel in ("none", "huber"):
                options = RunOptions.of(kernel=kernel, **variant, **BY_HAND)
                row = compare(log, options, estimators="graph").table["graph"]
                name = variant.get("weight", "landmark nodes")
                print(
                    f"| {robot} | {pair_count(log)} | {name} | {kernel} | {'yes' if row.converged else 'no'} | "
                    f"{row.ate_m:.3f} | {row.landmark_rmse_m:.3f} | {row.nees:.1f} | {row.iterations} | "
                    f"{row.seconds:.2f} |",
                    flush=True,
                )
                figures = {key: getattr(row, key) for key in FIGURES}
                given = {"robot": robot, "pairs": pair_count(log), "edges": name, "kernel": kernel}
                rows.append({"name": f"robot {robot}, {name}, {kernel}"} | given | figures)
    record(arguments.record, "real_virtual", rows)


if __name__ == "__main__":
    main()
