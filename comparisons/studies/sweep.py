"""Execute the runs that a study lacks, here or on a Dask cluster, and write a row as each run ends; `study_particles`.

On an existing cluster (the extra ``cluster``) each worker of the cluster has a pool of local processes:
a worker of Dask cannot stop a run or survive its crash, so its pool does, as on a single machine.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import signal
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count, product
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, ClassVar
from urllib.parse import urlsplit

from pebble import ProcessPool

from graphslam import Log, OptionError, SlamError
from graphslam.errors import quoted
from graphslam.processes import default_jobs, process_pool

from ..estimators import ESTIMATORS, attempt
from ..estimators.config import versions
from ..estimators.filters import FILTERS, Announce, announce_memory
from ..options import JobsOptions, ParticleStudyOptions, RunOptions, SweepOptions, options_of
from ..options.reading import prepare
from ..results import Count, Displayed, jsonable, sentence
from .execute import DONE, ERROR, Outcome, StudyDatabase, execute, log_of, row_of, stopped
from .plan import Run, Study, read_study
from .summary import MethodSummary, Summary, summarise

#: how long to wait for a connection, and again for an answer [s]; with importing Dask it stays below 10 s
PATIENCE = 4.0
SCHEMES = ("tcp", "tls", "ws", "wss")

_lock = Lock()
_pools: list[ProcessPool] = []


def _pool_of_worker() -> ProcessPool:
    """The pool of this worker, which serves all studies on the cluster and ends with the worker."""
    from distributed import get_worker

    with _lock:
        if not _pools:
            # Dask runs its workers as daemons, which may otherwise not have processes of their own
            multiprocessing.current_process().daemon = False
            _pools.append(process_pool(get_worker().state.nthreads, attempt.loading(ESTIMATORS)))
        return _pools[0]


def _execute_added(run: Run, added: bytes) -> Outcome:
    """Do a run in a process that may not have the user's estimators, see `attempt.added_estimators`."""
    attempt.add_estimators(added)
    return execute(run)


def execute_on_worker(run: Run, limit: float, added: bytes = b"") -> Outcome:
    """The task of the cluster: a run in the pool of its worker; ``added`` are the user's own estimators."""
    future = _pool_of_worker().schedule(_execute_added, (run, added), timeout=limit)
    return attempt.ended(future, run, limit, partial(stopped, limit=limit))


@contextmanager
def dask_cluster(address: str, limit: float) -> Iterator[attempt.Place[Run, Outcome]]:
    """The cluster of a Dask scheduler, tcp://host:8786 or the like, with a limit of the time of each run [s].

    Raises:
        OptionError: Dask is not installed, the address is no address, it does not answer within 10 s, there is no
            worker, or the workers have another version of this project.
    """
    check_answers(address)
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise OptionError("--dask needs Dask; install it with: pip install -e '.[cluster]' in the clone") from None
    from distributed.comm import CommClosedError
    from distributed.scheduler import KilledWorker

    # a lost cluster is reported in one sentence of ours; Dask's loggers, whose levels are set when it is imported, would
    # add theirs on the terminal
    for name in [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    _check_handshake(address)

    def outcome(future: Future[Outcome], run: Run) -> Outcome:
        try:
            return future.result()
        except KilledWorker as error:
            return Outcome(key=run.key, status=ERROR, error=f"given up by the cluster: {sentence(error)}")
        except (CancelledError, CommClosedError) as error:
            gone = f"the cluster at {address} is gone ({type(error).__name__})"
            raise SlamError(f"{gone}; finished runs are kept, and the same command continues") from None

    with Client(address, timeout=PATIENCE, set_as_default=False) as client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise OptionError(f"the cluster at {address} has no workers; start some with: dask worker {address}")
        _check_versions(client, address)
        executor = client.get_executor(pure=False)
        try:
            # several runs wait on each worker, so that short ones do not wait for the network
            added = attempt.added_estimators()
            yield attempt.Place(8 * threads, lambda run: executor.submit(execute_on_worker, run, limit, added), outcome)
        finally:
            # without waiting, which cancels the runs that have not begun
            executor.shutdown(wait=False)


def check_answers(address: str) -> None:
    """Raise `OptionError` unless a server accepts a connection at ``address``; needs no Dask."""
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if parts.scheme not in SCHEMES or host is None or port is None:
        raise OptionError(f"{quoted(address)} is no address of a Dask scheduler; write tcp://host:8786")
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError as error:
        raise _no_scheduler(address, error.strerror or str(error)) from None


def _check_handshake(address: str) -> None:
    """Raise `OptionError` unless it is a Dask scheduler that answers.

    This comes before a `Client` is made, because closing one that cannot connect takes 16 s, and an answer of another
    kind of server breaks it in various ways.
    """
    from distributed.comm import connect

    async def greet() -> None:
        await (await connect(address, timeout=PATIENCE)).close()

    try:
        # in a thread of its own: notebooks have a running loop in this one
        with ThreadPoolExecutor(1) as thread:
            thread.submit(lambda: asyncio.run(asyncio.wait_for(greet(), PATIENCE))).result()
    except Exception as error:
        raise _no_scheduler(address, type(error).__name__) from None


def _no_scheduler(address: str, reason: str) -> OptionError:
    return OptionError(f"no Dask scheduler answers at {address} ({reason}); start one with: dask scheduler")


def _check_versions(client: Any, address: str) -> None:
    try:
        theirs = {project for project, *_ in client.run(versions).values()}
    except Exception as error:
        imports = f"the workers at {address} cannot import this project"
        raise OptionError(f"{imports}; install the same version there ({error})") from None
    ours, *_ = versions()
    if theirs != {ours}:
        have = f"the workers at {address} have {', '.join(sorted(theirs))}"
        raise OptionError(f"{have}, but this is {ours}; install the same version there")


#: fewer particles never need much memory
MANY = 50_000


@dataclass(frozen=True, kw_only=True)
class SweepOutcome:
    """The result of a sweep.

    Attributes:
        study: the study file.
        database: where the rows are.
        planned: the number of runs of the study.
        before: how many of them had a row already.
        ran: how many were done now.
        failed: how many of those done now ended in an error or took too long.
        interrupted: whether Ctrl-C ended it.
    """

    study: Path
    database: Path
    planned: Count
    before: Count
    ran: Count
    failed: Count
    interrupted: bool
    shown: ClassVar = {"missing": "missing"}

    @property
    def missing(self) -> Count:
        """The number of runs without a row."""
        return self.planned - self.before - self.ran

    def to_json(self) -> dict[str, Any]:
        """The outcome as plain data: the attributes, and "missing"."""
        return jsonable(self)


#: called with (number of rows, runs planned, the run and its outcome) after each row, and once before the first
Progress = Callable[[int, int, Run | None, Outcome | None], None]


def sweep(
    study: Study | str | PathLike[str], *, progress: Progress | None = None, announce: Announce | None = None,
    **options: Any,
) -> SweepOutcome:  # fmt: skip
    """Execute the runs of a study that have no row in its database yet.

    Args:
        study: a study file, or what `plan.read_study` made of it.
        progress: called after each row.
        announce: called before the first run with a sentence, where runs need much memory.
        options: the fields of `options.SweepOptions`: jobs, dask, retry.

    Returns:
        what was done; Ctrl-C ends a sweep early (in the main thread), with all finished runs written.

    Raises:
        FormatError: the study file is wrong, or the database is in use, no study's, damaged, or cannot be written.
        OptionError: the cluster cannot be reached, jobs and dask are both given, or so many runs at a time need more memory
            than there is.
        SlamError: the cluster is gone before the study's end; finished runs are written.
    """
    given = SweepOptions.of(**options)
    plan = study if isinstance(study, Study) else read_study(study)
    before = ran = failed = 0
    # the place first: a cluster that does not answer leaves no database behind
    with _place(plan, given) as place, StudyDatabase.writing(plan.database) as database:
        database.plan(plan)
        if given.retry:
            database.forget_failures()
        present, report = database.keys(), progress or (lambda *_: None)
        missing = [run for run in plan.runs if run.key not in present]
        before = len(plan.runs) - len(missing)
        # a cluster has memory of its own
        announce_memory(_large(missing), announce, jobs=1 if given.dask is not None else _jobs(given))
        report(before, len(plan.runs), None, None)
        with _ctrl_c() as events:
            for k, outcome in attempt.as_they_end(place, missing, events):
                database.add(missing[k], outcome)
                ran, failed = ran + 1, failed + (outcome.status != DONE)
                report(before + ran, len(plan.runs), missing[k], outcome)
    counts = {"planned": len(plan.runs), "before": before, "ran": ran, "failed": failed}
    return SweepOutcome(study=plan.path, database=plan.database, interrupted=before + ran < len(plan.runs), **counts)


def _jobs(options: JobsOptions) -> int:
    """The number of runs at a time on this machine."""
    return default_jobs() if options.jobs is None else max(options.jobs, 1)


def _large(runs: Sequence[Run], log: Log | None = None) -> Iterator[tuple[str, Log, RunOptions]]:
    """The runs of filters that may need much memory, with their logs; a log that cannot be read becomes an error row."""
    known = options_of(RunOptions)
    for run in runs:
        if run.estimator in FILTERS and run.options.get("particles", 0) >= MANY:
            of_filter = {name: value for name, value in run.options.items() if known[name].model == "filter"}
            with suppress(SlamError):
                yield run.estimator, log or log_of(run), RunOptions.of(**of_filter)


def _place(study: Study, options: SweepOptions) -> AbstractContextManager[attempt.Place[Run, Outcome]]:
    if options.dask is not None:
        if options.jobs is not None:
            raise OptionError("give --jobs for processes of this machine or --dask for a cluster, not both")
        return dask_cluster(options.dask, study.time_limit)
    estimators, limit = tuple(dict.fromkeys(run.estimator for run in study.runs)), study.time_limit
    late = partial(stopped, limit=limit)
    return attempt.place_of(execute, jobs=options.jobs, estimators=estimators, limit=limit, instead=late)


@contextmanager
def _ctrl_c() -> Iterator[attempt.Events[Outcome]]:
    """A queue into which Ctrl-C puts None, so that it never interrupts between a run's end and its row.

    A second Ctrl-C interrupts as always.
    """
    events: attempt.Events[Outcome] = SimpleQueue()
    if threading.current_thread() is not threading.main_thread():
        yield events
        return
    before = signal.getsignal(signal.SIGINT)

    def stop(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        events.put(None)

    signal.signal(signal.SIGINT, stop)
    try:
        yield events
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass(frozen=True, eq=False)
class ParticleStudy(Displayed):
    """Particle filters with growing numbers of particles and several random seeds on one log.

    Attributes:
        log: the name of the log.
        runs: every run, with the columns of the database of a study; its options have the number of particles.
    """

    log: str
    runs: tuple[Mapping[str, Any], ...]
    shown: ClassVar = {"summary": "summary"}

    @cached_property
    def summary(self) -> Summary:
        """The medians and quartiles over the seeds; a method is a filter with its number of particles."""
        return summarise(self.runs)

    @property
    def methods(self) -> dict[str, dict[int, MethodSummary]]:
        """The summary of each filter and number of particles."""
        of, found = {line.method: line for line in self.summary.methods}, dict[str, dict[int, MethodSummary]]()
        for run in self.runs:
            found.setdefault(run["estimator"], {})[run["options"]["particles"]] = of[run["method"]]
        return found


def study_particles(
    log: Log | str | PathLike[str] | None = None, *, progress: Progress | None = None, announce: Announce | None = None,
    **options: Any,
) -> ParticleStudy:  # fmt: skip
    """Run filters with growing numbers of particles and several random seeds on one log.

    Args:
        log: a log, the file or folder of one, or None for the sample log; with the ground truth the errors are known.
        progress, announce: as for `sweep`.
        options: the fields of `options.ParticleStudyOptions`: filters, particles, seeds, resampling, association, jobs,
            time_limit, and those that read the log. In local processes a filter has one thread; with ``jobs=0`` it has all.

    Raises:
        FormatError: a file cannot be read.
        OptionError: an option has an impossible value.
        SlamError: no run has a result.
    """
    data, _, given = prepare(log, ParticleStudyOptions.of(**options))
    data = data.replace(motion=given.motion, sensor=given.sensor)
    runs = [
        Run(data.name, {}, seed, name, f"{name} particles={n}", given.of_component("filter") | {"particles": n})
        for name, n, seed in product(given.filters, sorted(set(given.particles)), range(given.seeds))
    ]
    announce_memory(_large(runs, data), announce, jobs=_jobs(given))
    of_key, done = {run.key: run for run in runs}, count(1)
    report = None if progress is None else lambda each: progress(next(done), len(runs), of_key[each.key], each)
    outcomes = attempt.rows_of(
        partial(execute, log=data), runs, jobs=given.jobs, progress=report, estimators=given.filters,
        limit=given.time_limit, instead=partial(stopped, limit=given.time_limit),
    )  # fmt: skip
    if all(each.status != DONE for each in outcomes):
        raise SlamError(f"no run has a result: {outcomes[0].error}")
    return ParticleStudy(data.name, tuple(map(row_of, runs, outcomes)))
