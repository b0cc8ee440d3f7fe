"""The overhead of a study beside its estimators, and the speed-up of more processes.

    python -m benchmarks.study_speed [--dask tcp://host:8786] [--repeats 3]

Overhead: 2,000 short runs in one process; the wall time without the start of the process, minus the ``seconds`` of the
estimators, per run. It consists of simulating or reading logs, building graphs, computing errors, sending to the process
and back, and the row on the disk. Speed-up: 64 longer runs with one process, with two, and on the cluster if there is
one; the time from the first row to the last, and the share of it in which the processes were executing runs. What is
missing to 100 % is overhead of the study; what is missing to a factor of 2 beyond that is due to the machine. All are
repeated in turn and the best is taken, because other work on the machine can only make them slower.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

from comparisons.studies.execute import StudyDatabase
from comparisons.studies.plan import read_study
from comparisons.studies.sweep import sweep

SHORT = """\
seeds = 500
estimators = ["dead-reckoning", "graph", "mcl", "fastslam1"]
[simulate]
world = "book"
[options]
particles = 100
"""
LONG = """\
seeds = 64
estimators = ["fastslam1"]
[simulate]
world = "book"
[options]
particles = 20000
"""


def measure(text: str, **where: object) -> tuple[float, float, float, int]:
    """Seconds from the first row to the last; of these rows the sum of ``seconds`` and of ``total_seconds``; their number."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(text, encoding="utf-8")
        study = read_study(path)
        times: list[float] = []
        sweep(study, progress=lambda *_: times.append(time.perf_counter()), **where)  # type: ignore[arg-type]
        with StudyDatabase.reading(study.database) as database:
            rows = sorted(database.rows(), key=lambda row: row["ended"])[1:]
    # the first call comes before any run, the second with the first row
    wall = times[-1] - times[1]
    return wall, sum(row["seconds"] for row in rows), sum(row["total_seconds"] for row in rows), len(rows)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dask", help="the address of a scheduler with two workers of one thread")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    places: dict[str, dict[str, object]] = {"one process": {"jobs": 1}, "two processes": {"jobs": 2}}
    if options.dask:
        places["cluster"] = {"dask": options.dask}
    print(f"load before: {os.getloadavg()[0]:.1f}")
    overheads, handling = [], []
    seconds: dict[str, list[float]] = {place: [] for place in places}
    busy: dict[str, list[float]] = {place: [] for place in places}
    for _ in range(options.repeats):
        wall, own, whole, count = measure(SHORT, jobs=1)
        overheads.append(1e3 * (wall - own) / count)
        handling.append(1e3 * (wall - whole) / count)
        for place, where in places.items():
            wall, _, whole, _ = measure(LONG, **where)
            seconds[place].append(wall)
            busy[place].append(whole / wall / (1 if place == "one process" else 2))
    print(f"overhead of {count} short runs: {min(overheads):.2f} ms per run (all: {[round(o, 2) for o in overheads]}),")
    print(f"of it {min(handling):.2f} ms outside of the runs: sending, receiving, writing the row")
    for place, measured in seconds.items():
        ratio = min(seconds["one process"]) / min(measured)
        print(
            f"{place}: {min(measured):.2f} s, {ratio:.2f} x, executing runs {max(busy[place]):.0%} "
            f"(all: {[round(s, 2) for s in measured]})"
        )
    print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
