"""The tables of `slam-compare backends` in docs/benchmarks.md: all backends on five graphs, and g2o alone on seven.

    python benchmarks/backends.py [--data ../shared/data/posegraph] [--record docs/measured]
    python benchmarks/backends.py --g2o [--repeat 51]

The rows are those of `comparisons.compare_backends`, and the geometric means of the native rows.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from iteration import GRAPHS
from recording import add_option, record

from comparisons import compare_backends
from comparisons.datasets import data_folder

FILES = {"simulation": "simulation-pose-landmark.g2o"} | GRAPHS
#: the graphs that all backends solve; GTSAM has no native factors for the others
COMMON = ("INTEL", "M3500", "CSAIL", "simulation", "city10000")
FIGURES = ("chi2", "iterations", "seconds", "converged", "reason", "native", "ratio")


def main() -> None:
    """Run the backends, print a line for each row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder() / "posegraph")
    parser.add_argument("--g2o", action="store_true", help="all graphs, with g2o's Gauss-Newton alone")
    parser.add_argument("--repeat", type=int, help="default: 5, with --g2o 51")
    add_option(parser)
    options = parser.parse_args()
    names = {str(options.data / FILES[graph]): graph for graph in (FILES if options.g2o else COMMON)}
    found = compare_backends(
        list(names), repeat=options.repeat or (51 if options.g2o else 5),
        backends=("graphslam", "g2o-gn") if options.g2o else None,
        progress=lambda row: print(f"{names[row.file]:15} {row.backend:10} {row.seconds:.3g} s: {row.reason}", flush=True),
    )  # fmt: skip
    plain = found.to_json()["rows"]
    ours = {row["file"]: row["seconds"] for row in plain if row["backend"] == "graphslam"}
    rows = [
        {"graph": names[row["file"]], "backend": row["backend"], "graphslam_s": ours[row["file"]]}
        | {figure: row[figure] for figure in FIGURES}
        for row in plain
    ]
    for name, mean in found.geometric_means.items():
        print(f"geometric mean of graphslam / {name}: {mean}")
        rows.append(dict.fromkeys(rows[0]) | {"graph": "geometric mean", "backend": name, "ratio": mean})
    rows = [{"name": f"{row['graph']} {row['backend']}"} | row for row in rows]
    record(options.record, "backends_g2o" if options.g2o else "backends", rows)


if __name__ == "__main__":
    main()
