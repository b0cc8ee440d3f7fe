"""Kill a study at random moments and continue it: every run exactly once, the database intact.

    python -m benchmarks.study_kills [--kills 20] [--runs 200] [--seed 0]

Before the end no row that was there once may change or vanish, and after every kill SQLite's ``PRAGMA integrity_check``
must say ok. Exit status 1 if anything is amiss.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from comparisons.studies.plan import read_study

#: two estimators on small worlds; with so many particles a run takes a tenth of a second or so
STUDY = """\
seeds = {seeds}
estimators = ["graph", "fastslam1"]
[simulate]
world = "book"
[options]
particles = {particles}
"""


#: a sweep of its own process
SWEEP = "import sys; from comparisons import sweep; sweep(sys.argv[1], jobs=int(sys.argv[2]))"


def rows(database: Path) -> dict[str, tuple]:
    """The rows by key, after an integrity check; raises `AssertionError` where the database is not intact."""
    with closing(sqlite3.connect(database)) as connection:
        (found,) = connection.execute("PRAGMA integrity_check").fetchone()
        assert found == "ok", found
        listed = connection.execute("SELECT * FROM runs").fetchall()
    by_key = {row[0]: row for row in listed}
    assert len(by_key) == len(listed), "a run has two rows"
    return by_key


def killed_study(folder: Path, *, kills: int, runs: int, particles: int, seed: int, jobs: int = 2) -> list[int]:
    """Run a study with kills at random moments of its work; returns the number of rows at each kill.

    Raises:
        AssertionError: a row was lost, changed or doubled, or the database is not intact.
    """
    rng = random.Random(seed)
    study_file = folder / "study.toml"
    study_file.write_text(STUDY.format(seeds=runs // 2, particles=particles), encoding="utf-8")
    study = read_study(study_file)
    command = [sys.executable, "-c", SWEEP, str(study_file), str(jobs)]
    known: dict[str, tuple] = {}
    counts = []
    for kill in range(kills):
        process = subprocess.Popen(command, start_new_session=True)
        # a sweep begins with its first new row; wait for it, and for as many more as leave work for the other kills
        share = (len(study.runs) - len(known)) // (kills - kill + 1)
        wanted = len(known) + rng.randint(0, max(1, 2 * share - 1))
        while process.poll() is None and _count(study.database) < wanted:
            time.sleep(0.002)
        time.sleep(rng.uniform(0.0, 0.2))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        found = rows(study.database) if _count(study.database) else {}
        assert all(found.get(key) == row for key, row in known.items()), "a row changed or was lost"
        known = found
        counts.append(len(found))
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    found = rows(study.database)
    assert all(found[key] == row for key, row in known.items()), "a row changed or was lost"
    assert set(found) == {run.key for run in study.runs}, "runs and rows differ"
    return counts


def _count(database: Path) -> int:
    try:
        with closing(sqlite3.connect(f"{database.as_uri()}?mode=rw", uri=True)) as connection:
            (count,) = connection.execute("SELECT count(*) FROM runs").fetchone()
            return int(count)
    except sqlite3.OperationalError:
        # not made yet, or being made at this moment
        return 0


def main() -> None:
    """Parse the options and print the outcome."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--particles", type=int, default=30_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            counts = killed_study(
                Path(folder), kills=options.kills, runs=options.runs, particles=options.particles, seed=options.seed
            )
        except AssertionError as error:
            sys.exit(f"FAILED: {error}")
    print(f"{options.kills} kills at {counts} of {options.runs} rows: every run exactly once, database intact")


if __name__ == "__main__":
    main()
