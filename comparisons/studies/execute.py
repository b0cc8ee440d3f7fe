"""One run of a study, from its description to its row in the SQLite file of the study.

`execute` is the task of every process, wherever it is: this one, local processes, or a Dask cluster (`sweep`).
`StudyDatabase` has the runs that are planned, and one row for each that has ended.

A row is one transaction and is on the disk when `StudyDatabase.add` returns (``synchronous=FULL``): it survives a killed
process and a power cut, and SQLite's journal undoes a row that was half written. The journal is the write-ahead log, which
flushes once for a row instead of three times, and lets ``slam-compare study`` read while a sweep writes. It needs a file
system with shared memory (a local disk). When a study ends, one plain file is left.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from fastslam.particles import FilterResult
from graphslam import FormatError, Log, LogError
from graphslam.errors import printable
from graphslam.files import check_file
from graphslam.metrics import ate

from ..comparison import compare
from ..estimators.attempt import too_long
from ..estimators.config import versions
from ..options import ReadingOptions, RunOptions, options_of
from ..options.reading import read_log, sha256_of
from ..results import Count, Figures, sentence
from .plan import Run, Study, simulated_log

#: a run ended well, raised (or its process died), or took longer than the limit
DONE, ERROR, TIMEOUT = "done", "error", "timeout"


@dataclass(frozen=True, kw_only=True)
class Outcome(Figures):
    """The outcome of a run with its figures; one that does not exist or cannot be known is None.

    Attributes:
        key: of the run, see `plan.Run.key`.
        status: `DONE`, `ERROR` or `TIMEOUT`.
        error: one sentence where the status is not `DONE`.
        proven: whether the end is proven to be the global minimum of J; None where no proof applies.
        mean_ate_m: error of the weighted mean of the histories of a particle filter that have survived [m]. It decreases
            with more particles; the history of one particle is one sample of the posterior, however many there are.
        ess_share: of a particle filter, the mean of ESS / N over the steps with sightings, before resampling.
        ancestors: of a particle filter, how many distinct particles of the step half-way have descendants at the end.
        total_seconds: the whole run, with reading the log, setting up and computing the errors.
        poses_sha256: the first 16 digits of the digest of the estimated poses, equal where the poses are exactly equal.
        process: host and process that did it.
        ended: the time, UTC.
    """

    key: str
    status: str = DONE
    error: str | None = None
    proven: bool | None = None
    mean_ate_m: float | None = None
    ess_share: float | None = None
    ancestors: Count | None = None
    total_seconds: float | None = None
    poses_sha256: str | None = None
    process: str = field(default_factory=lambda: f"{platform.node()}:{os.getpid()}")
    ended: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))


def execute(run: Run, log: Log | None = None) -> Outcome:
    """Do a run, on its own log or on one that is given. Any exception becomes an outcome with the sentence of the error."""
    begin = time.perf_counter()
    try:
        outcome = _execute(run, log_of(run) if log is None else log)
    except Exception as error:
        outcome = {"status": ERROR, "error": sentence(error)}
    return Outcome(key=run.key, total_seconds=time.perf_counter() - begin, **outcome)


@lru_cache(maxsize=4)
def _log(source: str, reading: str, name: str, seed: int | None) -> Log:
    """A log, read or simulated; the last few are kept, because neighbouring runs use the same one."""
    description, options = json.loads(source), ReadingOptions.of(**json.loads(reading))
    if seed is not None:
        return read_log(simulated_log(description["simulate"], seed, name), options)[0]
    file = Path(description["file"])
    if description["sha256"] is not None and description["sha256"] != sha256_of(file):
        raise LogError(f"{file} has changed since the study was begun; start the sweep again to take it as it is")
    return read_log(file, options)[0]


def log_of(run: Run) -> Log:
    """The log of a run.

    Raises:
        SlamError: it cannot be read or made.
    """
    reading = {name: run.options[name] for name in options_of(ReadingOptions) if name in run.options}
    seed = run.seed if "simulate" in run.source else None
    return _log(json.dumps(dict(run.source)), json.dumps(reading), run.log, seed)


def _execute(run: Run, log: Log) -> dict[str, Any]:
    options = {name: value for name, value in run.options.items() if name not in options_of(ReadingOptions)}
    if isinstance(options.get("noise"), Mapping):
        options["noise_content"] = options.pop("noise")
    comparison = compare(log, RunOptions.of(**options, seed=run.seed), estimators=[run.estimator])
    result = comparison.results[0]
    # not the rows of the table: they have NEES, too, for which covariances would be computed
    sources = (result, comparison.metrics[result.name])
    figures = {f.name: getattr(each, f.name) for each in sources for f in fields(Outcome) if hasattr(each, f.name)}
    if (certificate := result.certificate) is not None and certificate.applicable:
        figures["proven"] = certificate.proven
    if isinstance(found := result.origin, FilterResult):
        sighted = np.unique(comparison.log.steps)
        if figures["ate_m"] is not None and (truth := comparison.log.true_poses) is not None:
            figures["mean_ate_m"] = ate(truth, comparison.log.at_truth(found.mean_poses))
        if len(sighted):
            figures["ess_share"] = float(np.mean(found.ess[sighted]) / len(found.log_weights))
        figures["ancestors"] = int(found.ancestors[len(found.ancestors) // 2])
    return figures | {"poses_sha256": hashlib.sha256(result.poses.tobytes()).hexdigest()[:16]}


def stopped(run: Run, reason: str, limit: float | None) -> Outcome:
    """The outcome of a run that took too long, or whose process died; the other runs go on."""
    if limit is None or reason != too_long(limit):
        return Outcome(key=run.key, status=ERROR, error=reason)
    return Outcome(key=run.key, status=TIMEOUT, error=reason, total_seconds=limit)


#: "SLAM" in ASCII, in the head of the file: the place where SQLite keeps the application of a database
APPLICATION = 0x534C414D
VERSION = 4

_TYPES = {"Count | None": "INTEGER", "bool | None": "INTEGER", "float | None": "REAL"}
_FIGURES = [(f.name, _TYPES.get(str(f.type), "TEXT")) for f in fields(Outcome) if f.name != "key"]
#: the columns of the table ``runs``
COLUMNS = ("key", "log", "source", "seed", "estimator", "method", "options", *(name for name, _ in _FIGURES))
_SCHEMA = f"""
BEGIN;
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE planned (key TEXT PRIMARY KEY, position INTEGER NOT NULL);
CREATE TABLE runs (
    key TEXT PRIMARY KEY, log TEXT NOT NULL, source TEXT NOT NULL, seed INTEGER NOT NULL, estimator TEXT NOT NULL,
    method TEXT NOT NULL, options TEXT NOT NULL, {", ".join(f"{name} {kind}" for name, kind in _FIGURES)});
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
COMMIT;
"""


def row_of(run: Run, outcome: Outcome) -> dict[str, Any]:
    """A run with its outcome as {column: value}."""
    return {name: getattr(outcome if hasattr(outcome, name) else run, name) for name in COLUMNS}


class StudyDatabase:
    """An open database; get one from `writing` or `reading`."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._connection = path, connection

    @classmethod
    @contextmanager
    def writing(cls, path: Path) -> Iterator[StudyDatabase]:
        """Open the database for a sweep, alone; make it if there is none.

        Raises:
            FormatError: another sweep has it, it is something else, damaged, or cannot be written.
        """
        if path.is_dir():
            raise FormatError(path, None, "this is a folder; give the name of a database file")
        if not path.parent.is_dir():
            raise FormatError(path, None, f"cannot write into {path.parent}: there is no such folder")
        with _alone(path), _connected(path, "rwc") as connection:
            database = cls(path, connection)
            if connection.execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,):
                connection.executescript(_SCHEMA)
            database._check()
            (state,) = connection.execute("PRAGMA quick_check").fetchone()
            if state != "ok":
                raise FormatError(path, None, f"the database is damaged ({state}); name another one in the study file")
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            yield database
            with suppress(sqlite3.OperationalError):
                # one plain file again, which can be copied, unless another process reads it now
                connection.execute("PRAGMA journal_mode = DELETE")

    @classmethod
    @contextmanager
    def reading(cls, path: Path) -> Iterator[StudyDatabase]:
        """Open the database for reading, also while a sweep writes.

        Raises:
            FormatError: there is no such file, or it is something else, or damaged.
        """
        check_file(path)
        with _connected(path, "rw") as connection:
            database = cls(path, connection)
            database._check()
            yield database

    def _check(self) -> None:
        (application,) = self._connection.execute("PRAGMA application_id").fetchone()
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        if application != APPLICATION:
            raise FormatError(self.path, None, "this SQLite file is no study of slam-compare; name another one")
        if not 1 <= version <= VERSION:
            raise FormatError(self.path, None, f"a study of version {version}; this program reads version {VERSION}")
        # a program with further metrics, or of a later version, has more figures, which are not known of older rows
        present = {row[1] for row in self._connection.execute("PRAGMA table_info(runs)")}
        for name, kind in _FIGURES:
            if name not in present:
                self._connection.execute(f"ALTER TABLE runs ADD COLUMN {name} {kind}")
        self._connection.execute(f"PRAGMA user_version = {VERSION}")

    def plan(self, study: Study) -> None:
        """Store the list of the study's runs. Rows of runs that it no longer has stay, but count in no summary."""
        about = {"study": printable(str(study.path.absolute())), "text": study.text, "versions": ", ".join(versions())}
        positions = [(run.key, position) for position, run in enumerate(study.runs)]
        with self._transaction():
            self._connection.execute("DELETE FROM planned")
            self._connection.executemany("INSERT INTO planned VALUES (?, ?)", positions)
            self._connection.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", about.items())

    def about(self) -> dict[str, str]:
        """The study file's path and text, and the versions that wrote the rows last."""
        return dict(self._connection.execute("SELECT name, value FROM about"))

    def keys(self) -> set[str]:
        """The keys of all runs that have a row."""
        return {key for (key,) in self._connection.execute("SELECT key FROM runs")}

    def add(self, run: Run, outcome: Outcome) -> None:
        """Write the row of a run, in a transaction of its own.

        Raises:
            sqlite3.IntegrityError: the run has a row already.
        """
        row = row_of(run, outcome)
        row |= {name: json.dumps(row[name]) for name in ("source", "options")}
        marks = ", ".join(f":{name}" for name in COLUMNS)
        with self._transaction():
            self._connection.execute(f"INSERT INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})", row)

    def forget_failures(self) -> int:
        """Remove the rows of planned runs that did not end well, so that they run again; how many there were."""
        failures = "DELETE FROM runs WHERE status != ? AND key IN (SELECT key FROM planned)"
        with self._transaction():
            return self._connection.execute(failures, (DONE,)).rowcount

    def rows(self) -> list[dict[str, Any]]:
        """The rows of the planned runs in the order of the study, as {column: value} with options and source as data."""
        names = ", ".join(f"runs.{name}" for name in COLUMNS)
        query = f"SELECT {names} FROM runs JOIN planned ON planned.key = runs.key ORDER BY planned.position"
        return list(map(_row, self._connection.execute(query)))

    def counts(self) -> tuple[int, int]:
        """The number of planned runs, and of rows of runs that are no longer planned."""
        others = "SELECT count(*) FROM runs WHERE key NOT IN (SELECT key FROM planned)"
        queries = ("SELECT count(*) FROM planned", others)
        planned, left = (self._connection.execute(query).fetchone()[0] for query in queries)
        return planned, left

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        # which commits at the end of the block, or rolls back
        with self._connection:
            self._connection.execute("BEGIN IMMEDIATE")
            yield


def _row(values: Iterable[Any]) -> dict[str, Any]:
    row = dict(zip(COLUMNS, values, strict=True))
    for name in ("converged", "proven"):
        row[name] = None if row[name] is None else bool(row[name])
    return row | {"source": json.loads(row["source"]), "options": json.loads(row["options"])}


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold the lock ``path.lock``, which the operating system releases when the process ends, however it ends.

    SQLite's own locks would not do: held for hours, they would shut out readers, too.

    Raises:
        FormatError: another process holds it, or the file cannot be made.
    """
    lock = FileLock(path.with_name(path.name + ".lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout:
        message = "another study is at work on this database; wait for it, or name another database"
        raise FormatError(path, None, message) from None
    except OSError as error:
        raise FormatError(path, None, f"cannot write into {path.parent}: {error.strerror}") from None
    try:
        yield
    finally:
        # while it is held: whoever opened the file before finds that it is gone, and is refused
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


@contextmanager
def _connected(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """A connection whose errors with the file become `FormatError`."""
    uri = f"{path.absolute().as_uri()}?mode={mode}"
    try:
        with closing(sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30)) as connection:
            yield connection
    except sqlite3.IntegrityError:
        raise
    except sqlite3.DatabaseError as error:
        raise FormatError(path, None, f"SQLite cannot use this file as the database of a study: {error}") from None
