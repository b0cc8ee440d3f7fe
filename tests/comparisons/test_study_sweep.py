"""Sweeps: every run once, whatever ends them; the same numbers wherever they run."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from comparisons.estimator import Estimator, EstimatorResult, RunOptions

from comparisons.estimators import ESTIMATORS
from comparisons.studies.child import Child, ChildDied, TimeLimit
from comparisons.studies.database import COLUMNS, StudyDatabase
from comparisons.studies.executors import Crew
from comparisons.studies.outcome import DONE, ERROR, TIMEOUT, Outcome
from comparisons.studies.plan import Study, read_study
from comparisons.studies.sweep import SweepOutcome, sweep
from graphslam import FormatError, Log, OptionError, save, simulate

ROOT = Path(__file__).parents[2]
SMALL = """\
seeds = 3
estimators = ["dead-reckoning", "graph", "fastslam1"]
[simulate]
steps = 12
[options]
particles = 20
"""
#: columns that differ from one execution to the next
OF_THE_MOMENT = {"seconds", "total_seconds", "process", "ended"}


@pytest.fixture
def make(tmp_path: Path) -> Callable[[str], Study]:
    def write(text: str, name: str = "study.toml") -> Study:
        (tmp_path / name).write_text(text)
        return read_study(tmp_path / name)

    return write


def rows(database: Path) -> list[dict[str, Any]]:
    with StudyDatabase.reading(database) as found:
        return found.rows()


def numbers(database: Path) -> list[dict[str, Any]]:
    return [{k: v for k, v in row.items() if k not in OF_THE_MOMENT} for row in rows(database)]


def intact(database: Path) -> bool:
    with closing(sqlite3.connect(database)) as connection:
        return bool(connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)])


def test_one_row_for_each_run(make: Callable[..., Study]) -> None:
    study = make(SMALL)
    seen: list[tuple[int, int]] = []
    outcome = sweep(study, jobs=0, progress=lambda done, planned, *_: seen.append((done, planned)))
    assert outcome == SweepOutcome(study.database, 9, 0, 9, 0, False)
    assert seen == [(done, 9) for done in range(10)]
    found = rows(study.database)
    assert [row["key"] for row in found] == [run.key for run in study.runs]
    assert {row["status"] for row in found} == {DONE}
    graph = next(row for row in found if row["estimator"] == "graph" and row["seed"] == 2)
    assert graph["converged"] is True
    assert graph["source"] == {"simulate": {"steps": 12}}
    assert graph["total_seconds"] > graph["seconds"] > 0
    # one plain file is left: no write-ahead log, no lock
    assert sorted(p.name for p in study.database.parent.iterdir()) == ["study.sqlite", "study.toml"]


def test_the_row_is_what_a_run_by_hand_gives(make: Callable[..., Study]) -> None:
    from comparisons.comparison import compare

    study = make(SMALL)
    sweep(study, jobs=0)
    row = next(row for row in rows(study.database) if row["estimator"] == "fastslam1" and row["seed"] == 1)
    by_hand = compare(simulate(steps=12, seed=1), ["fastslam1"], RunOptions(particles=20, seed=1)).table[0]
    for figure in ("ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m"):
        assert row[figure] == getattr(by_hand, figure)


def test_a_second_sweep_does_only_what_is_new(make: Callable[..., Study]) -> None:
    study = make(SMALL)
    sweep(study, jobs=0)
    before = rows(study.database)
    assert sweep(study, jobs=0).ran == 0
    more = make(SMALL.replace("seeds = 3", "seeds = 4"))
    assert sweep(more, jobs=0) == SweepOutcome(study.database, 12, 9, 3, 0, False)
    assert [row for row in rows(study.database) if row["seed"] < 3] == before
    # fewer: the rows stay, and are not shown
    fewer = make(SMALL.replace("seeds = 3", "seeds = 1"))
    assert sweep(fewer, jobs=0).ran == 0
    with StudyDatabase.reading(study.database) as database:
        assert (database.counts(), len(database.rows())) == ((3, 9), 3)


def test_the_same_numbers_from_this_process_and_from_two_others(make: Callable[..., Study], tmp_path: Path) -> None:
    here, there = make(SMALL, "here.toml"), make(SMALL, "there.toml")
    sweep(here, jobs=0)
    sweep(there, jobs=2)
    assert numbers(here.database) == numbers(there.database)
    assert {row["process"].rsplit(":")[-1] for row in rows(there.database)}.isdisjoint({str(os.getpid())})


def test_a_run_that_raises_is_a_row_and_stops_nothing(
    make: Callable[..., Study], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(log: Log, options: RunOptions) -> EstimatorResult:
        raise ZeroDivisionError("one\nover nothing")

    monkeypatch.setitem(ESTIMATORS, "gtsam", Estimator(broken))
    study = make(SMALL.replace('"fastslam1"', '"gtsam"'))
    assert sweep(study, jobs=0).failed == 3
    found = rows(study.database)
    assert {(row["estimator"], row["status"]) for row in found} == {
        ("dead-reckoning", DONE), ("graph", DONE), ("gtsam", ERROR),
    }  # fmt: skip
    assert {row["error"] for row in found if row["status"] == ERROR} == {"ZeroDivisionError: one over nothing"}
    # not again unless asked for
    assert sweep(study, jobs=0).ran == 0
    monkeypatch.undo()
    outcome = sweep(study, jobs=0, retry=True)
    assert (outcome.before, outcome.ran, outcome.failed) == (6, 3, 0)


def test_logs_that_fail_to_load_among_many(make: Callable[..., Study], tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        save(simulate(seed=ord(name), steps=10), tmp_path / f"{name}.npz")
    (tmp_path / "b.npz").write_bytes((tmp_path / "b.npz").read_bytes()[:300])
    study = make('logs = ["a.npz", "b.npz", "gone.npz", "c.npz"]\nestimators = ["dead-reckoning", "graph"]\n')
    (tmp_path / "c.npz").write_bytes((tmp_path / "a.npz").read_bytes())
    assert sweep(study, jobs=0).failed == 6
    errors = {row["log"]: row["error"] for row in rows(study.database)}
    assert errors["a.npz"] is None
    assert "b.npz" in errors["b.npz"]
    assert "no such file" in errors["gone.npz"]
    assert "has changed since the study was begun" in errors["c.npz"]


def test_the_time_limit_ends_one_run_and_no_other(make: Callable[..., Study]) -> None:
    # a billion moves of particles do not fit into two seconds
    text = "seeds = 1\ntime_limit = 2\nestimators = ['fastslam1', 'dead-reckoning']\n[simulate]\nsteps = 5000\n"
    study = make(text + "[options]\nparticles = 300000\n")
    outcome = sweep(study, jobs=1)
    assert outcome.failed == 1
    slow, quick = rows(study.database)
    assert (slow["status"], slow["error"]) == (TIMEOUT, "took longer than the limit of 2 s")
    assert quick["status"] == DONE


def test_a_child_that_dies_says_how() -> None:
    child = Child()
    assert child.call(abs, -3) == 3
    with pytest.raises(ChildDied, match="TypeError"):
        child.call(abs, "x")
    assert child.fresh
    with pytest.raises(ChildDied, match="SIGSEGV"):
        child.call(os.kill, child._process.pid, signal.SIGSEGV)
    assert not child.fresh
    child.close()
    child = Child()
    with pytest.raises(TimeLimit):
        child.call(time.sleep, 60, limit=0.2)
    assert not child.fresh
    child.close()


def test_a_run_whose_process_dies_is_an_error(make: Callable[..., Study]) -> None:
    text = "estimators = ['fastslam1', 'dead-reckoning']\n[simulate]\nsteps = 5000\n[options]\nparticles = 300000\n"
    slow, quick = make(text).runs
    crew = Crew(patience=60)

    def strike() -> None:
        while not any("fastslam1" in child.warmed for child in crew._children):
            time.sleep(0.05)
        time.sleep(0.3)
        (child,) = crew._children
        child._process.send_signal(signal.SIGSEGV)

    thread = threading.Thread(target=strike)
    thread.start()
    try:
        first, second = crew.attempt([slow, quick], 300)
    finally:
        thread.join()
        crew.close()
    assert (first.status, second.status) == (ERROR, DONE)
    assert "SIGSEGV" in str(first.error)
    with pytest.raises(RuntimeError):
        crew.attempt([quick], 60)


def test_two_sweeps_on_one_database_are_refused(make: Callable[..., Study]) -> None:
    study = make(SMALL)
    with StudyDatabase.writing(study.database), pytest.raises(FormatError, match="another study is at work"):
        sweep(study, jobs=0)
    assert sweep(study, jobs=0).ran == 9


def test_what_is_no_database_of_a_study(make: Callable[..., Study], tmp_path: Path) -> None:
    study = make(SMALL)
    study.database.write_text("something that somebody wants to keep, long enough for a head")
    with pytest.raises(FormatError, match="not a database"):
        sweep(study, jobs=0)
    assert study.database.read_text().startswith("something")
    study.database.unlink()
    with closing(sqlite3.connect(study.database)) as other:
        other.execute("CREATE TABLE mine (a)")
        other.commit()
    with pytest.raises(FormatError, match="no study"):
        sweep(study, jobs=0)
    with pytest.raises(FormatError, match="no such folder"):
        sweep(make('database = "no/where.sqlite"\n' + SMALL), jobs=0)
    with pytest.raises(FormatError, match="no such file"):
        rows(tmp_path / "nowhere.sqlite")


def test_a_run_cannot_have_two_rows(make: Callable[..., Study]) -> None:
    study = make(SMALL)
    run = study.runs[0]
    with StudyDatabase.writing(study.database) as database:
        database.plan(study)
        database.add(run, Outcome(key=run.key, ate_m=1.0))
        with pytest.raises(sqlite3.IntegrityError):
            database.add(run, Outcome(key=run.key, ate_m=2.0))
        assert database.keys() == {run.key}
        (row,) = database.rows()
    assert (row["ate_m"], row["status"], list(row)) == (1.0, DONE, list(COLUMNS))


def test_jobs_or_a_cluster(make: Callable[..., Study]) -> None:
    with pytest.raises(OptionError, match="not both"):
        sweep(make(SMALL), jobs=1, dask="tcp://127.0.0.1:1")


def command(study: Study, *options: str) -> list[str]:
    return [sys.executable, "-m", "comparisons", "sweep", str(study.path), *options]


def wait_for_rows(process: subprocess.Popen[str], study: Study, count: int) -> None:
    """Until the database has so many rows; the process must still be at work then."""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        assert process.poll() is None, "the sweep ended too early for this test"
        if study.database.exists():
            with closing(sqlite3.connect(study.database)) as connection:
                try:
                    if connection.execute("SELECT count(*) FROM runs").fetchone()[0] >= count:
                        return
                except sqlite3.OperationalError:
                    pass  # its tables are being made this moment
        time.sleep(0.01)
    raise AssertionError("no rows within two minutes")


LONGER = SMALL.replace("seeds = 3", "seeds = 40").replace("particles = 20", "particles = 20000")


def test_killed_and_continued(make: Callable[..., Study]) -> None:
    study = make(LONGER)
    known: list[dict[str, Any]] = []
    for count in (1, 30, 65):
        process = subprocess.Popen(command(study, "--jobs", "2"), cwd=ROOT, stdout=subprocess.DEVNULL, text=True)
        wait_for_rows(process, study, count)
        process.kill()
        process.wait()
        assert intact(study.database)
        found = rows(study.database)
        assert [row for row in found if row["key"] in {old["key"] for old in known}] == known
        known = found
    assert 65 <= len(known) < 120
    done = subprocess.run(command(study), cwd=ROOT, capture_output=True, text=True, check=True)
    assert f"120 of 120 runs, {120 - len(known)} done now" in done.stdout
    assert [row["key"] for row in rows(study.database)] == [run.key for run in study.runs]
    assert intact(study.database)


def test_ctrl_c_keeps_what_is_finished(make: Callable[..., Study]) -> None:
    study = make(LONGER)
    process = subprocess.Popen(
        command(study, "--jobs", "2"), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    wait_for_rows(process, study, 5)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr == ""
    kept = len(rows(study.database))
    assert 5 <= kept < 120
    assert f"{kept} of 120 runs" in stdout
    assert f"To go on: slam-compare sweep {study.path}" in stdout
