"""The executors of a study: this process, local processes, or a Dask cluster (`cluster`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass

from pebble import ProcessExpired, ProcessPool

from graphslam import OptionError

from ..pool import add_estimators, default_jobs, how_it_ended, processes
from .execute import execute
from .outcome import ERROR, TIMEOUT, Outcome
from .plan import Run


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

    ``added`` are estimators of the user that the processes of the pool may not have, see `pool.added_estimators`.
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
