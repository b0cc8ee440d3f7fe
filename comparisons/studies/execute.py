"""One run of a study, from its description to the columns of its row, and the executors of runs.

A run is the task of every process, wherever it is: this one, local processes, or a Dask cluster (`sweep`).
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Generic

import numpy as np

from fastslam.particles import FilterResult
from graphslam import Log, LogError, OptionError
from graphslam.identification.declared import CORRECTIONS
from graphslam.metrics import ate
from graphslam.processes import default_jobs, processes

from ..comparison import compare
from ..estimators import warm_up
from ..estimators.attempt import Row, Task, ended, loading, too_long
from ..options import NoiseOptions, ReadingOptions, RunOptions
from ..options.declaration import options_of
from ..options.reading import read_log, sha256_of
from ..results import Figures, sentence
from ..results.documents import Count
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


@dataclass(frozen=True)
class Place(Generic[Task, Row]):
    """An executor of the tasks of a study.

    Attributes:
        room: how many tasks may be there at a time, executing or waiting.
        submit: begins a task.
        row: what a task gives whose future is done; raises `SlamError` where the place is lost.
    """

    room: int
    submit: Callable[[Task], Future[Row]]
    row: Callable[[Future[Row], Task], Row]


@contextmanager
def place_of(
    work: Callable[[Task], Row], *, jobs: int | None = None, estimators: Sequence[str] = (),
    prepare: Callable[[], object] = list, limit: float | None = None, instead: Callable[[Task, str], Row] | None = None,
) -> Iterator[Place[Task, Row]]:  # fmt: skip
    """Processes of this machine. Starting one and loading its modules do not count towards the limit, reading a log does.

    Args:
        work: of a module, so that it can be named to a process; tasks are plain data.
        jobs: how many processes; None for one on each core; 0 for this process, for a debugger and for tests: each task is
            then done as it is submitted, without a limit.
        estimators: whose modules are loaded before the first task.
        prepare: called in each process after that.
        limit: of the time of each task [s]; None for no limit.
        instead: makes the row of a task that took longer, or whose process died, from the task and the reason. Without
            it they are errors.

    Raises:
        SlamError: a process died, or a task took too long, where nothing stands instead of its row.
    """
    if jobs == 0:
        for name in estimators:
            warm_up(name)
        yield Place(1, partial(_done, work), lambda future, _: future.result())
        return
    jobs = jobs or default_jobs()
    with processes(jobs, loading(estimators, prepare)) as pool:
        # a task that waits in the pool keeps its process from waiting for the next one
        yield Place(
            jobs + 1, lambda task: pool.schedule(work, (task,), timeout=limit),
            lambda future, task: ended(future, task, limit, instead),
        )  # fmt: skip


def _done(work: Callable[[Task], Row], task: Task) -> Future[Row]:
    future: Future[Row] = Future()
    future.set_result(work(task))
    return future


#: futures that are done, and None, which ends the work
Events = SimpleQueue[Future[Row] | None]


def as_they_end(place: Place[Task, Row], tasks: Iterable[Task], events: Events[Row]) -> Iterator[tuple[int, Row]]:
    """The number of each task among all, and its row, as they end; after None among the events those that have ended."""
    waiting = enumerate(tasks)
    pending: dict[Future[Row], tuple[int, Task]] = {}

    def submit(count: int) -> None:
        for k, task in islice(waiting, count):
            future = place.submit(task)
            pending[future] = k, task
            future.add_done_callback(events.put)

    submit(place.room)
    while pending:
        event = events.get()
        for future in [event] if event is not None else [future for future in pending if future.done()]:
            k, task = pending.pop(future)
            yield k, place.row(future, task)
        if event is None:
            return
        submit(1)


def rows_of(
    work: Callable[[Task], Row], tasks: Iterable[Task], *, jobs: int | None,
    progress: Callable[[Row], object] | None = None, **keywords: Any,
) -> list[Row]:  # fmt: skip
    """``map(work, tasks)`` in a place, rows in the order of the tasks.

    Args:
        work, jobs, keywords: see `place_of`.
        progress: called with each row as its task ends.

    Raises:
        OptionError: there is a limit and no process to stop.
        SlamError: see `place_of`, or ``work`` raised it.
    """
    if jobs == 0 and keywords.get("limit") is not None:
        raise OptionError("time_limit needs local processes, which can be stopped: jobs must be at least 1, not 0")
    rows: dict[int, Row] = {}
    with place_of(work, jobs=jobs, **keywords) as place:
        for k, rows[k] in as_they_end(place, tasks, SimpleQueue()):
            if progress is not None:
                progress(rows[k])
    return [rows[k] for k in sorted(rows)]
