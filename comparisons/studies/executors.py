"""Where runs are done: in this process, in local processes, on a Dask cluster. All are `concurrent.futures.Executor`s.

Each is given the same kind of task: `Crew.attempt` (or `attempt_here`), a batch of runs and the limit of each. The task
returns the outcomes of the first runs of the batch: all of them, or as many as were done when its patience ended, so that
long runs come back one by one and short ones do not pay for the way of each.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from graphslam import OptionError

from .child import Child, ChildDied, TimeLimit
from .execute import execute, warm
from .outcome import ERROR, TIMEOUT, Outcome
from .plan import Run

#: (batch, limit of each run [s]) -> the outcomes of its first runs, one at least
Task = Callable[[Sequence[Run], float], list[Outcome]]

#: compiling an estimator's kernels may take so long whatever the limit of a run [s]
COMPILING = 600.0


@dataclass(frozen=True)
class Place:
    """Where a sweep runs.

    Attributes:
        executor: takes ``submit(task, batch, limit)``.
        task: what to submit.
        slots: how many tasks run at a time.
        ahead: how many more may wait there, so that no slot waits for the way of a task.
        name: for sentences: "2 local processes".
        gave_up: exceptions of a task by which the executor says that it tried the task several times in vain.
        lost: exceptions of a task by which it says that it is no longer there.
    """

    executor: Executor
    task: Task
    slots: int
    ahead: int
    name: str
    gave_up: tuple[type[BaseException], ...] = ()
    lost: tuple[type[BaseException], ...] = ()


class Crew:
    """Child processes, one for each thread that asks: runs are done in them, within a limit of time each."""

    def __init__(self, patience: float) -> None:
        self._mine = threading.local()
        self._lock = threading.Lock()
        self._children: set[Child] = set()
        self._closed = False
        self.patience = patience

    def attempt(self, batch: Sequence[Run], limit: float) -> list[Outcome]:
        """The outcomes of the first runs of a batch, until `patience` [s] has passed.

        A run whose process dies is an outcome with that error, and one that takes longer than ``limit`` [s] one with
        `TIMEOUT`. Reading the log counts, starting the process and compiling do not.

        Raises:
            RuntimeError: the crew has been closed.
        """
        return _patiently(lambda run: self._attempt(run, limit), batch, self.patience)

    def _attempt(self, run: Run, limit: float) -> Outcome:
        begin = time.perf_counter()
        try:
            child = self._child()
            if run.estimator not in child.warmed:
                child.call(warm, run.estimator, limit=max(limit, COMPILING))
                child.warmed.add(run.estimator)
            begin = time.perf_counter()
            outcome: Outcome = child.call(execute, run, limit=limit)
            return outcome
        except TimeLimit:
            return _over(run, limit, time.perf_counter() - begin)
        except ChildDied as error:
            if self._closed:
                raise RuntimeError("the study has been stopped") from None
            return Outcome(key=run.key, status=ERROR, error=str(error), total_seconds=time.perf_counter() - begin)

    def _child(self) -> Child:
        child: Child | None = getattr(self._mine, "child", None)
        if child is not None and child.fresh:
            return child
        with self._lock:
            if self._closed:
                raise RuntimeError("the study has been stopped")
            if child is not None:
                self._children.discard(child)
                child.close()
            self._mine.child = child = Child()
            self._children.add(child)
        return child

    def close(self) -> None:
        """Kill all children; runs in them come to nothing."""
        with self._lock:
            self._closed = True
            for child in self._children:
                child.kill()
            self._children.clear()


class Here(Executor):
    """Does each task when it is submitted, in this process: for looking into runs with a debugger, and for tests."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call the function now; its result or exception is the future's."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def attempt_here(batch: Sequence[Run], limit: float) -> list[Outcome]:
    """Like `Crew.attempt`, without a process: the limit strikes when the run returns to Python, a crash is a crash."""

    def attempt(run: Run) -> Outcome:
        _warm_once(run.estimator)
        begin = time.perf_counter()
        try:
            with _alarm(limit):
                return execute(run)
        except TimeLimit:
            return _over(run, limit, time.perf_counter() - begin)

    return _patiently(attempt, batch, 0.0)


_warm_once = lru_cache(warm)


@contextmanager
def here() -> Iterator[Place]:
    """This process."""
    yield Place(Here(), attempt_here, 1, 0, "this process")


@contextmanager
def local_processes(jobs: int | None = None) -> Iterator[Place]:
    """Processes of this machine.

    Args:
        jobs: how many; default: the cores that this process may use.

    Raises:
        OptionError: jobs is below 1.
    """
    if jobs is None:
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if jobs < 1:
        raise OptionError(f"jobs must be at least 1, not {jobs}")
    crew, threads = Crew(patience=0.05), ThreadPoolExecutor(jobs, thread_name_prefix="study")
    try:
        yield Place(threads, crew.attempt, jobs, 1, "one local process" if jobs == 1 else f"{jobs} local processes")
    finally:
        crew.close()
        threads.shutdown(cancel_futures=True)


def _patiently(attempt: Callable[[Run], Outcome], batch: Sequence[Run], patience: float) -> list[Outcome]:
    end = time.monotonic() + patience
    outcomes = []
    for run in batch:
        outcomes.append(attempt(run))
        if time.monotonic() >= end:
            break
    return outcomes


def _over(run: Run, limit: float, seconds: float) -> Outcome:
    return Outcome(
        key=run.key, status=TIMEOUT, error=f"took longer than the limit of {limit:g} s", total_seconds=seconds
    )


class _Alarm(BaseException):
    """Not an `Exception`, so that no handler inside a run takes it for the run's own error."""


@contextmanager
def _alarm(limit: float) -> Iterator[None]:
    """Raise `TimeLimit` after ``limit`` seconds; in a thread, where Python has no alarm, never."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(*_: object) -> None:
        raise _Alarm

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        yield
    except _Alarm:
        raise TimeLimit from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
