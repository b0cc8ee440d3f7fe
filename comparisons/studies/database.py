"""The SQLite file of a study: the runs that are planned, and one row for each that has ended.

A row is one transaction and is on the disk when `StudyDatabase.add` returns (``synchronous=FULL``): it survives a killed
process and a power cut, and SQLite's journal undoes a row that was half written. The journal is the write-ahead log, which
flushes once for a row instead of three times, and lets ``slam-compare study`` read while a sweep writes. It needs a file
system with shared memory (a local disk). When a study ends, one plain file is left.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from graphslam.errors import FormatError, printable
from graphslam.files import check_file

from ..estimators.config import versions
from .execute import DONE, Outcome
from .plan import Run, Study

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
        raise FormatError(
            path, None, "another study is at work on this database; wait for it, or name another database"
        ) from None
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
