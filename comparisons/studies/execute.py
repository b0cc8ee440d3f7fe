"""One run, from its description to the figures of its row: the task of every process, wherever it is.

The outcome of one run: the columns of a study's table.

The executors of a study: this process, local processes, or a Dask cluster (`cluster`).
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

from graphslam import Log, LogError, OptionError
from graphslam.identification.declared import CORRECTIONS

from ..comparison import compare
from ..estimators.attempt import add_estimators, default_jobs, how_it_ended, processes
from ..options import NoiseOptions, ReadingOptions, RunOptions
from ..options.option import options_of
from ..options.reading import read_log, sha256_of
from ..results import Figures, sentence
from .plan import Run, simulated_log

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
        total_seconds: the whole run, with reading the log, setting up and computing the errors.
        poses_sha256: the first 16 digits of the digest of the estimated poses, equal where the poses are exactly equal.
        process: host and process that did it.
        ended: the time, UTC.
    """

    key: str
    status: str = DONE
    error: str | None = None
    proven: bool | None = None
    total_seconds: float | None = None
    poses_sha256: str | None = None
    process: str = field(default_factory=lambda: f"{platform.node()}:{os.getpid()}")
    ended: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))


def execute(run: Run) -> Outcome:
    """Do a run. Any exception becomes an outcome with the sentence of the error."""
    begin = time.perf_counter()
    try:
        outcome = _execute(run)
    except Exception as error:
        outcome = {"status": ERROR, "error": sentence(error)}
    return Outcome(key=run.key, total_seconds=time.perf_counter() - begin, **outcome)


@lru_cache(maxsize=4)
def _log(source: str, reading: str, name: str, seed: int | None) -> Log:
    """A log, read or simulated; the last few are kept, because neighbouring runs use the same one."""
    description = json.loads(source)
    log: Log | Path
    if seed is not None:
        log = simulated_log(description["simulate"], seed, name)
    else:
        log = Path(description["file"])
        if description["sha256"] is not None and description["sha256"] != sha256_of(log):
            raise LogError(f"{log} has changed since the study was begun; start the sweep again to take it as it is")
    return read_log(log, ReadingOptions.of(**json.loads(reading)))[0]


def log_of(run: Run) -> Log:
    """The log of a run.

    Raises:
        SlamError: it cannot be read or made.
    """
    reading = {name: run.options[name] for name in options_of(ReadingOptions) if name in run.options}
    return _log(
        json.dumps(dict(run.source)), json.dumps(reading), run.log, run.seed if "simulate" in run.source else None
    )


def filter_options(run: Run) -> RunOptions:
    """The options of the particle filters among those of a run."""
    known = options_of(RunOptions)
    return RunOptions.of(**{name: value for name, value in run.options.items() if known[name].model == "filter"})


def _execute(run: Run) -> dict[str, Any]:
    log = log_of(run)
    options = {name: value for name, value in run.options.items() if name not in options_of(ReadingOptions)}
    if isinstance(options.get("noise"), Mapping):
        # single numbers take precedence over those of the noise file, and those over the log's
        noise = NoiseOptions.of(**options.pop("noise"))
        motion, sensor = noise.models(log.motion, log.sensor)
        corrections = {name: getattr(noise, name) for name in CORRECTIONS}
        options = {**corrections, **options, "motion": motion, "sensor": sensor}
    comparison = compare(log, RunOptions.of(**options, seed=run.seed), estimators=[run.estimator])
    result = comparison.results[0]
    # not the rows of the table: they have NEES, too, for which covariances would be computed
    sources = (result, comparison.metrics[result.name])
    figures = {f.name: getattr(each, f.name) for each in sources for f in fields(Outcome) if hasattr(each, f.name)}
    certificate = result.certificate
    if certificate is not None and certificate.applicable:
        figures["proven"] = certificate.proven
    return figures | {"poses_sha256": hashlib.sha256(result.poses.tobytes()).hexdigest()[:16]}


@dataclass(frozen=True)
class Place:
    """An executor of runs.

    Attributes:
        room: how many runs may be there at a time, executing or waiting.
        submit: begins a run with a limit of its time [s].
        outcome: the outcome of a run whose future is done; raises `SlamError` where the place is lost.
    """

    room: int
    submit: Callable[[Run, float], Future[Outcome]]
    outcome: Callable[[Future[Outcome], Run, float], Outcome]


@contextmanager
def this_process() -> Iterator[Place]:
    """This process, for a debugger and for tests: each run is executed as it is submitted, without a limit of time."""

    def submit(run: Run, limit: float) -> Future[Outcome]:  # noqa: ARG001
        future: Future[Outcome] = Future()
        future.set_result(execute(run))
        return future

    yield Place(1, submit, pool_outcome)


@contextmanager
def local_processes(jobs: int | None, estimators: Sequence[str]) -> Iterator[Place]:
    """Processes of this machine, by default one for each core.

    Raises:
        OptionError: jobs is below 1.
    """
    jobs = default_jobs() if jobs is None else jobs
    if jobs < 1:
        raise OptionError(f"jobs must be at least 1, not {jobs}")
    with processes(jobs, estimators) as pool:
        # a run that waits in the pool keeps its process from waiting for the next one
        yield Place(jobs + 1, lambda run, limit: in_pool(pool, run, limit), pool_outcome)


def in_pool(pool: ProcessPool, run: Run, limit: float, added: bytes = b"") -> Future[Outcome]:
    """Begin a run in a pool. Starting a process and compiling do not count towards the limit [s], reading the log does.

    ``added`` are estimators of the user that the processes of the pool may not have, see `attempt.added_estimators`.
    """
    future: Future[Outcome] = pool.schedule(_execute_with, (run, added), timeout=limit)
    return future


def _execute_with(run: Run, added: bytes) -> Outcome:
    add_estimators(added)
    return execute(run)


def pool_outcome(future: Future[Outcome], run: Run, limit: float) -> Outcome:
    """The outcome of a run in a pool; a run that took too long, or whose process died, costs nothing but itself."""
    try:
        return future.result()
    except TimeoutError:
        sentence = f"took longer than the limit of {limit:g} s"
        return Outcome(key=run.key, status=TIMEOUT, error=sentence, total_seconds=limit)
    except ProcessExpired as error:
        return Outcome(key=run.key, status=ERROR, error=how_it_ended(error))
