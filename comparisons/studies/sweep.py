"""Execute what a study lacks, and write a row as each run ends."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from graphslam import OptionError, SlamError

from .database import StudyDatabase
from .execute import sentence
from .executors import Place, here, local_processes
from .outcome import DONE, ERROR, Outcome
from .plan import Run, Study

#: the largest number of runs that travel together
MOST = 32


@dataclass(frozen=True)
class SweepOutcome:
    """What a sweep did.

    Attributes:
        database: where the rows are.
        planned: how many runs the study has.
        before: how many of them had a row already.
        ran: how many were done now.
        failed: how many of those done now ended in an error or took too long.
        interrupted: whether Ctrl-C ended it.
    """

    database: Path
    planned: int
    before: int
    ran: int
    failed: int
    interrupted: bool

    @property
    def missing(self) -> int:
        """How many runs have no row yet."""
        return self.planned - self.before - self.ran


#: called with (rows there are, runs planned, the run and its outcome) after each row, and once before the first
Progress = Callable[[int, int, Run | None, Outcome | None], None]


def sweep(
    study: Study,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    retry: bool = False,
    progress: Progress | None = None,
) -> SweepOutcome:
    """Execute the runs of a study that have no row in its database yet.

    Args:
        study: from `plan.read_study`.
        jobs: local processes; default: one for each core; 0: in this process itself.
        dask: the address of a Dask scheduler, to run there instead.
        retry: do those again that failed.
        progress: called after each row.

    Returns:
        what was done; Ctrl-C ends a sweep early (in the main thread), with all finished runs written.

    Raises:
        FormatError: the database is in use, no study's, damaged, or cannot be written.
        OptionError: the cluster cannot be reached, or jobs and dask are both given.
        SlamError: the cluster is gone before the study's end; finished runs are written.
    """
    if dask is not None and jobs is not None:
        raise OptionError("give --jobs for processes of this machine or --dask for a cluster, not both")
    # the place first: a cluster that does not answer leaves no database behind
    with _place(jobs, dask) as place, StudyDatabase.writing(study.database) as database:
        database.plan(study)
        if retry:
            database.forget_failures()
        present = database.keys()
        missing = [run for run in study.runs if run.key not in present]
        before = len(study.runs) - len(missing)
        done = failed = 0
        interrupted = False
        if progress is not None:
            progress(before, len(study.runs), None, None)
        if missing:
            with _ctrl_c() as events:
                for found in _outcomes(place, missing, study.time_limit, events):
                    if found is None:
                        interrupted = True
                        break
                    run, outcome = found
                    database.add(run, outcome)
                    done, failed = done + 1, failed + (outcome.status != DONE)
                    if progress is not None:
                        progress(before + done, len(study.runs), run, outcome)
    return SweepOutcome(study.database, len(study.runs), before, done, failed, interrupted)


def _place(jobs: int | None, dask: str | None) -> AbstractContextManager[Place]:
    if dask is not None:
        from .cluster import dask_cluster

        return dask_cluster(dask)
    return here() if jobs == 0 else local_processes(jobs)


#: futures that are done, and None for Ctrl-C
Events = SimpleQueue[Future[Any] | None]


def _outcomes(place: Place, runs: Sequence[Run], limit: float, events: Events) -> Iterator[tuple[Run, Outcome] | None]:
    """Every run with its outcome, as they end; None where Ctrl-C was pressed, and nothing after it."""
    waiting = deque(_batches(runs, place.slots))
    pending: dict[Future[Any], list[Run]] = {}
    while waiting or pending:
        while waiting and len(pending) < place.slots + place.ahead:
            batch = waiting.popleft()
            submitted = place.executor.submit(place.task, batch, limit)
            pending[submitted] = batch
            submitted.add_done_callback(events.put)
        happened = [events.get()]
        while not events.empty():
            happened.append(events.get())
        for future in happened:
            if future is not None:
                batch = pending.pop(future)
                outcomes = _result(place, future, batch)
                yield from zip(batch, outcomes, strict=False)
                if left := batch[len(outcomes) :]:
                    waiting.appendleft(left)
        if None in happened:
            yield None
            return


def _result(place: Place, future: Future[Any], batch: Sequence[Run]) -> list[Outcome]:
    try:
        outcomes: list[Outcome] = future.result()
    except place.gave_up as error:
        # the rest of the batch gets its own chance
        return [Outcome(key=batch[0].key, status=ERROR, error=f"given up by {place.name}: {sentence(error)}")]
    except place.lost as error:
        raise SlamError(
            f"{place.name} is gone ({type(error).__name__}); finished runs are kept, and the same command goes on"
        ) from None
    return outcomes


def _batches(runs: Sequence[Run], slots: int) -> Iterator[list[Run]]:
    """Neighbours with one log and seed, few enough that every slot gets several batches."""
    most = max(1, min(MOST, len(runs) // (4 * slots)))
    batch: list[Run] = []
    for run in runs:
        if batch and (len(batch) == most or (run.log, run.seed) != (batch[0].log, batch[0].seed)):
            yield batch
            batch = []
        batch.append(run)
    if batch:
        yield batch


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
