"""A pool of local processes.

It is the package ``pebble``, because Python cannot interrupt a compiled kernel or GTSAM: only a process of its own can be
stopped at a time limit, or die without taking the others along. Its processes are started like this:

- with one thread each, so that there are as many as cores, and so that results do not depend on the number of cores;
- without importing the caller's script again: notebooks have none, and scripts need no ``if __name__ == "__main__"``;
- without a reaction to Ctrl-C: they ignore it, and stop when the parent process stops.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

from pebble import ProcessExpired, ProcessPool

from .errors import SlamError

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                             "VECLIB_MAXIMUM_THREADS", "TBB_NUM_THREADS"), "1")  # fmt: skip


class _Process(SpawnProcess):
    def start(self) -> None:
        environment, main = os.environ.copy(), sys.modules["__main__"]
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        os.environ.update(_ONE_THREAD)
        # Dask sets this for its workers; with it, runs of thousands of particles take half as long again
        os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = main
            for name in (*_ONE_THREAD, "MALLOC_TRIM_THRESHOLD_"):
                os.environ.pop(name, None)
                if name in environment:
                    os.environ[name] = environment[name]
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class _Context(SpawnContext):
    """Keeps the locks of a pool until the pool is gone.

    pebble drops them before it ends its processes, and one that is still starting would not find them: it would write a
    traceback to standard error.
    """

    Process = _Process

    def __init__(self) -> None:
        self._locks: list[Any] = []

    def RLock(self) -> Any:
        lock = super().RLock()
        self._locks.append(lock)
        return lock


def default_jobs() -> int:
    """One for each core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def process_pool(jobs: int, prepare: Callable[[], None] | None = None) -> ProcessPool:
    """A pool of processes, which end with this process at the latest.

    Args:
        jobs: how many.
        prepare: each process calls it before its first task, outside of any time limit.
    """
    return ProcessPool(jobs, initializer=_begin, initargs=(os.getpid(), prepare), context=_Context())


@contextmanager
def processes(jobs: int, prepare: Callable[[], None] | None = None) -> Iterator[ProcessPool]:
    """A `process_pool` whose processes end with the block, however it ends.

    Raises:
        SlamError: the processes die before they begin a task.
    """
    pool = process_pool(jobs, prepare)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise SlamError(f"the local processes cannot work ({error}); their messages stand above") from None
    finally:
        pool.stop()
        pool.join()


def how_it_ended(error: ProcessExpired) -> str:
    """A sentence on a process that died in the middle of a task."""
    code: int = error.exitcode
    return f"the process ended with {f'signal {signal.Signals(-code).name}' if code < 0 else f'exit status {code}'}"


def _begin(parent: int, prepare: Callable[[], None] | None) -> None:
    """The first call in every process."""
    # Python's own handler, which pebble sets, would wait for the end of a compiled kernel
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # standard output belongs to the parent's JSON
    os.dup2(2, 1)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with(parent: int) -> None:
    """End at once when the parent is gone, also in the middle of a long task."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
