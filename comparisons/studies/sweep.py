"""Execute the runs that a study lacks, and write a row as each run ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, dataclass
from itertools import islice
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from graphslam import Log, OptionError, SlamError

from ..filters import FILTERS
from ..memory import Announce, announce_memory
from ..options import RunOptions, SweepOptions
from ..pool import default_jobs
from ..saving import jsonable
from .database import StudyDatabase
from .execute import filter_options, log_of
from .outcome import DONE, Outcome
from .places import Place, local_processes, this_process
from .plan import Run, Study, read_study

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
    planned: int
    before: int
    ran: int
    failed: int
    interrupted: bool

    @property
    def missing(self) -> int:
        """The number of runs without a row."""
        return self.planned - self.before - self.ran

    def to_json(self) -> dict[str, Any]:
        """The outcome as plain data: the attributes, and "missing"."""
        return jsonable(asdict(self) | {"missing": self.missing})


#: called with (number of rows, runs planned, the run and its outcome) after each row, and once before the first
Progress = Callable[[int, int, Run | None, Outcome | None], None]


def sweep(
    study: Study | str | PathLike[str],
    *,
    progress: Progress | None = None,
    announce: Announce | None = None,
    **options: Any,
) -> SweepOutcome:
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
    interrupted = False
    # the place first: a cluster that does not answer leaves no database behind
    with _place(plan, given) as place, StudyDatabase.writing(plan.database) as database:
        database.plan(plan)
        if given.retry:
            database.forget_failures()
        present = database.keys()
        missing = [run for run in plan.runs if run.key not in present]
        before = len(plan.runs) - len(missing)
        # a cluster has memory of its own
        jobs = 1 if given.dask is not None else default_jobs() if given.jobs is None else max(given.jobs, 1)
        announce_memory(_large(missing), announce, jobs=jobs)
        if progress is not None:
            progress(before, len(plan.runs), None, None)
        with _ctrl_c() as events:
            for run, outcome in _outcomes(place, missing, plan.time_limit, events):
                if run is None or outcome is None:
                    interrupted = True
                    break
                database.add(run, outcome)
                ran, failed = ran + 1, failed + (outcome.status != DONE)
                if progress is not None:
                    progress(before + ran, len(plan.runs), run, outcome)
    return SweepOutcome(
        study=plan.path, database=plan.database, planned=len(plan.runs), before=before, ran=ran, failed=failed,
        interrupted=interrupted,
    )  # fmt: skip


def _large(runs: Sequence[Run]) -> Iterator[tuple[str, Log, RunOptions]]:
    """The runs of filters that may need much memory, with their logs; a log that cannot be read becomes an error row."""
    for run in runs:
        if run.estimator in FILTERS and run.options.get("particles", 0) >= MANY:
            with suppress(SlamError):
                yield run.estimator, log_of(run), filter_options(run)


def _place(study: Study, options: SweepOptions) -> AbstractContextManager[Place]:
    if options.dask is not None:
        if options.jobs is not None:
            raise OptionError("give --jobs for processes of this machine or --dask for a cluster, not both")
        from .cluster import dask_cluster

        return dask_cluster(options.dask)
    estimators = tuple(dict.fromkeys(run.estimator for run in study.runs))
    return this_process() if options.jobs == 0 else local_processes(options.jobs, estimators)


#: futures that are done, and None for Ctrl-C
Events = SimpleQueue[Future[Outcome] | None]


def _outcomes(
    place: Place, runs: Sequence[Run], limit: float, events: Events
) -> Iterator[tuple[Run, Outcome] | tuple[None, None]]:
    """Every run with its outcome, as they end; at Ctrl-C those that have ended, and a last pair of None."""
    waiting = iter(runs)
    pending: dict[Future[Outcome], Run] = {}

    def submit(count: int) -> None:
        for run in islice(waiting, count):
            future = place.submit(run, limit)
            pending[future] = run
            future.add_done_callback(events.put)

    submit(place.room)
    while pending:
        event = events.get()
        for future in [event] if event is not None else [future for future in pending if future.done()]:
            run = pending.pop(future)
            yield run, place.outcome(future, run, limit)
        if event is None:
            yield None, None
            return
        submit(1)


@contextmanager
def _ctrl_c() -> Iterator[Events]:
    """A queue into which Ctrl-C puts None, so that it never strikes between a run's end and its row.

    A second Ctrl-C interrupts as always.
    """
    events: Events = SimpleQueue()
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
