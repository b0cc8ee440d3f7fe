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
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pebble import ProcessExpired

from comparisons.comparison import run as run_by_hand
from comparisons.estimators import ESTIMATORS, Estimator
from comparisons.estimators.attempt import rows_of
from comparisons.options import RunOptions
from comparisons.results import EstimatorResult
from comparisons.studies.execute import COLUMNS, DONE, ERROR, TIMEOUT, Outcome, StudyDatabase
from comparisons.studies.plan import Study, read_study
from comparisons.studies.sweep import SweepOutcome, sweep
from graphslam import FormatError, Log, OptionError, SlamError, save, simulate
from graphslam.processes import how_it_ended, processes
from graphslam.simulation.drives import Drive

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
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
    calls: list[tuple[int, int]] = []
    outcome = sweep(study.path, jobs=0, progress=lambda done, planned, *_: calls.append((done, planned)))
    assert outcome == SweepOutcome(
        study=study.path, database=study.database, planned=9, before=0, ran=9, failed=0, interrupted=False
    )
    assert outcome.to_json()["missing"] == 0
    assert calls == [(done, 9) for done in range(10)]
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
    study = make(SMALL)
    sweep(study, jobs=0)
    row = next(row for row in rows(study.database) if row["estimator"] == "fastslam1" and row["seed"] == 1)
    by_hand = run_by_hand(simulate(steps=12, seed=1), estimators=["fastslam1"], particles=20, seed=1).table[0]
    for figure in ("ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m"):
        assert row[figure] == getattr(by_hand, figure)


def test_a_second_sweep_does_only_what_is_new(make: Callable[..., Study]) -> None:
    study = make(SMALL)
    sweep(study, jobs=0)
    before = rows(study.database)
    assert sweep(study, jobs=0).ran == 0
    more = make(SMALL.replace("seeds = 3", "seeds = 4"))
    again = sweep(more, jobs=0)
    assert (again.planned, again.before, again.ran, again.missing) == (12, 9, 3, 0)
    assert [row for row in rows(study.database) if row["seed"] < 3] == before
    # fewer: the rows stay, and are not shown
    fewer = make(SMALL.replace("seeds = 3", "seeds = 1"))
    assert sweep(fewer, jobs=0).ran == 0
    with StudyDatabase.reading(study.database) as database:
        assert (database.counts(), len(database.rows())) == ((3, 9), 3)


@pytest.mark.slow
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
    reason = "no estimator has a result; gtsam failed: ZeroDivisionError: one over nothing"
    assert {row["error"] for row in found if row["status"] == ERROR} == {reason}
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


@pytest.mark.nightly
def test_the_time_limit_ends_one_run_and_no_other(make: Callable[..., Study]) -> None:
    # more than a billion moves of particles do not fit into six seconds, and dead reckoning does on a busy machine, too
    text = "seeds = 1\ntime_limit = 6\nestimators = ['fastslam1', 'dead-reckoning']\n[simulate]\nsteps = 5000\n"
    study = make(text + "[options]\nparticles = 300000\n")
    outcome = sweep(study, jobs=1)
    assert outcome.failed == 1
    slow, quick = rows(study.database)
    assert (slow["status"], slow["error"]) == (TIMEOUT, "it was stopped at the time limit of 6 s")
    assert quick["status"] == DONE


@pytest.mark.nightly
def test_a_task_that_dies_or_takes_too_long_costs_only_itself() -> None:
    with processes(1) as pool:
        assert pool.schedule(os.getenv, ("OMP_NUM_THREADS",)).result() == "1"
        died = pool.schedule(os.kill, (pool.schedule(os.getpid).result(), signal.SIGSEGV))
        with pytest.raises(ProcessExpired) as caught:
            died.result()
        assert how_it_ended(caught.value) == "the process ended with signal SIGSEGV"
        with pytest.raises(TimeoutError):
            pool.schedule(time.sleep, (60,), timeout=0.2).result()
        assert pool.schedule(abs, (-3,)).result() == 3


@pytest.mark.nightly
def test_results_come_in_order_and_a_death_is_an_error() -> None:
    numbers = list(range(-9, 0))
    assert rows_of(abs, numbers, jobs=2) == list(map(abs, numbers)) == rows_of(abs, numbers, jobs=0)
    with pytest.raises(SlamError, match="exit status 3"):
        rows_of(os._exit, [3], jobs=1)


@pytest.mark.nightly
def test_a_script_without_a_guard_can_use_the_pool(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(
        # more processes than tasks: some are still starting when the work is done, and must be silent then
        "from comparisons.estimators.attempt import rows_of\nprint('once')\nprint(rows_of(abs, [-1, -2], jobs=3))\n"
    )
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, env=ENVIRONMENT)
    assert (done.stdout, done.stderr) == ("once\n[1, 2]\n", "")


@pytest.mark.nightly
def test_an_estimator_of_a_script_runs_in_the_processes_of_a_study(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text('seeds = 2\nestimators = ["still", "dead-reckoning"]\n[simulate]\nsteps = 8\n')
    (tmp_path / "script.py").write_text(
        "from comparisons.studies.sweep import sweep\n"
        "import numpy as np\n"
        "from comparisons.estimators import ESTIMATORS, Estimator\n"
        "from comparisons.results import EstimatorResult\n"
        "place = np.array([1.0, 2.0, 0.5])\n"
        "def still(log, options):\n"
        "    poses = np.tile(place, (log.num_poses, 1))\n"
        "    return EstimatorResult(name='still', poses=poses, estimated=np.ones(len(poses), bool), seconds=0.0, cost=7.5)\n"
        "ESTIMATORS['still'] = Estimator(still)\n"
        "outcome = sweep('study.toml', jobs=2)\n"
        "print(outcome.ran, outcome.failed)\n"
        "import comparisons\n"
        "print(comparisons.run(estimators=['still'], time_limit=60).table['still'].cost)\n"
    )
    done = subprocess.run(
        [sys.executable, "script.py"], capture_output=True, text=True, env=ENVIRONMENT, cwd=tmp_path, check=False
    )
    assert (done.stdout, done.stderr) == ("4 0\n7.5\n", "")
    assert {row["cost"] for row in rows(tmp_path / "study.sqlite") if row["estimator"] == "still"} == {7.5}


def test_an_estimator_that_cannot_be_sent_is_named(make: Callable[..., Study], monkeypatch: pytest.MonkeyPatch) -> None:
    lock = threading.Lock()

    def locked(log: Log, options: RunOptions) -> EstimatorResult:
        with lock:
            return ESTIMATORS["dead-reckoning"].run(log, options)

    monkeypatch.setitem(ESTIMATORS, "locked", Estimator(locked))
    study = make("estimators = ['locked']\n[simulate]\nsteps = 8\n")
    with pytest.raises(OptionError, match="the estimator 'locked' cannot be sent to another process .*jobs=0"):
        sweep(study, jobs=2)
    assert sweep(study, jobs=0).failed == 0


@pytest.mark.slow
def test_a_run_whose_process_dies_is_an_error(make: Callable[..., Study], monkeypatch: pytest.MonkeyPatch) -> None:
    def deadly(log: Log, options: RunOptions) -> EstimatorResult:
        # processes of a sweep try each estimator first on a log of six motions
        if log.num_poses > 7:
            os.kill(os.getpid(), signal.SIGSEGV)
        return ESTIMATORS["dead-reckoning"].run(log, options)

    monkeypatch.setitem(ESTIMATORS, "deadly", Estimator(deadly))
    study = make("estimators = ['deadly', 'dead-reckoning']\n[simulate]\nsteps = 8\n")
    assert sweep(study, jobs=1).failed == 1
    first, second = rows(study.database)
    assert (first["status"], first["error"]) == (ERROR, "the process ended with signal SIGSEGV")
    assert second["status"] == DONE


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


def test_options_of_the_study_reach_the_estimator(make: Callable[..., Study], tmp_path: Path) -> None:
    save(simulate(seed=5, steps=20), tmp_path / "a.npz")
    (tmp_path / "noise.toml").write_text("[sensor]\nbearing_std = 0.07\nrange_rate = 0.2\n[ranges]\nscale = 1.02\n")
    text = "logs = ['a.npz']\nestimators = ['graph']\n[options]\nstride = 2\nmax_range = 5\nnoise = 'noise.toml'\n"
    study = make(text + "sensor.range_std = 0.3\n")
    sweep(study, jobs=0)
    (row,) = rows(study.database)
    options = {"stride": 2, "max_range": 5, "noise": tmp_path / "noise.toml", "range_std": 0.3}
    by_hand = run_by_hand(tmp_path / "a.npz", estimators=["graph"], **options).table[0]
    assert (row["cost"], row["ate_m"]) == (by_hand.cost, by_hand.ate_m)
    # range_std alone replaces range_rate
    by_numbers = {"bearing_std": 0.07, "range_std": 0.3, "range_rate": 0.0, "range_scale": 1.02}
    again = run_by_hand(tmp_path / "a.npz", estimators=["graph"], stride=2, max_range=5, **by_numbers).table[0]
    assert row["cost"] == again.cost


def test_a_noise_file_does_in_a_study_what_it_does_in_a_run(make: Callable[..., Study], tmp_path: Path) -> None:
    """It checks ids, and corrects of a log without controls its sightings alone."""
    text = "[motion]\nnn = 0.05\noo = 0.01\n[sensor]\nrange_std = 0.02\n[odometry]\nwheel_scale = 1.02\n"
    (tmp_path / "noise.toml").write_text(text)
    log = Drive(seed=5, duration=70.0, landmarks=20, misread=0.05).simulate()[0]
    save(log, tmp_path / "a.npz")
    bare = simulate(seed=5, steps=20, landmarks=60).replace(controls=None, control_starts=None, dt=None)
    save(bare, tmp_path / "b.npz")
    study = make("logs = ['a.npz', 'b.npz']\nestimators = ['graph']\n[options]\nnoise = 'noise.toml'\n")
    sweep(study, jobs=0)
    for name, row in zip(("a.npz", "b.npz"), rows(study.database)):
        by_hand = run_by_hand(tmp_path / name, estimators=["graph"], noise=tmp_path / "noise.toml")
        assert by_hand.options.check_ids
        assert row["cost"] == by_hand.table[0].cost


def test_a_study_knows_changes_within_rows_without_a_check_of_ids(make: Callable[..., Study], tmp_path: Path) -> None:
    (tmp_path / "noise.toml").write_text("[motion]\nnn = 0.01\n[odometry]\nwheel_scale = 1.02\n")
    save(Drive(seed=4, duration=60.0, landmarks=20, odometry_rate=1.0).simulate()[0], tmp_path / "a.npz")
    study = make("logs = ['a.npz']\nestimators = ['graph']\n[options]\nnoise = 'noise.toml'\ncheck_ids = false\n")
    sweep(study, jobs=0)
    by_hand = run_by_hand(tmp_path / "a.npz", estimators=["graph"], noise=tmp_path / "noise.toml", check_ids=False)
    assert rows(study.database)[0]["cost"] == by_hand.table[0].cost


def test_jobs_or_a_cluster(make: Callable[..., Study]) -> None:
    with pytest.raises(OptionError, match="not both"):
        sweep(make(SMALL), jobs=1, dask="tcp://127.0.0.1:1")


#: sweeps a study in two processes, and prints how many runs it did and whether it was interrupted
SCRIPT = """\
import sys
from comparisons.studies.sweep import sweep
outcome = sweep(sys.argv[1], jobs=2)
print(outcome.ran, outcome.interrupted)
"""


def command(study: Study) -> list[str]:
    return [sys.executable, "-c", SCRIPT, str(study.path)]


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


LONGER = SMALL.replace("seeds = 3", "seeds = 10").replace("particles = 20", "particles = 20000")


@pytest.mark.nightly
def test_killed_and_continued(make: Callable[..., Study]) -> None:
    study = make(LONGER)
    known: list[dict[str, Any]] = []
    for count in (1, 12):
        process = subprocess.Popen(command(study), env=ENVIRONMENT, stdout=subprocess.DEVNULL, text=True)
        wait_for_rows(process, study, count)
        process.kill()
        process.wait()
        assert intact(study.database)
        found = rows(study.database)
        assert [row for row in found if row["key"] in {old["key"] for old in known}] == known
        known = found
    assert 12 <= len(known) < 30
    done = subprocess.run(command(study), env=ENVIRONMENT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(30 - len(known)), "False"]
    assert [row["key"] for row in rows(study.database)] == [run.key for run in study.runs]
    assert intact(study.database)


@pytest.mark.nightly
def test_ctrl_c_keeps_what_is_finished(make: Callable[..., Study]) -> None:
    study = make(LONGER)
    # in a group of its own, so that Ctrl-C reaches all of its processes, as on a terminal
    process = subprocess.Popen(
        command(study), env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0,
        # a suite that runs in the background ignores Ctrl-C, and its children would, too
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    wait_for_rows(process, study, 5)
    os.killpg(process.pid, signal.SIGINT)
    try:
        stdout, stderr = process.communicate(timeout=60)
    finally:
        process.kill()
    kept = len(rows(study.database))
    assert 5 <= kept < 30
    assert (stdout.split(), stderr, process.returncode) == ([str(kept), "True"], "", 0)
    assert intact(study.database)


def test_a_database_of_version_1_gains_the_new_figure(make: Callable[..., Study]) -> None:
    study = make('seeds = 1\nestimators = ["dead-reckoning"]\n[simulate]\nsteps = 5\n')
    sweep(study, jobs=0)
    with closing(sqlite3.connect(study.database)) as connection:
        connection.execute("ALTER TABLE runs DROP COLUMN cost_per_dof")
        connection.execute("ALTER TABLE runs DROP COLUMN proven")
        connection.execute("PRAGMA user_version = 1")
        connection.commit()
    with StudyDatabase.reading(study.database) as old:
        assert [(row["cost_per_dof"], row["proven"]) for row in old.rows()] == [(None, None)]
