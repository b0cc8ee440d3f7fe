"""Several threads for one kernel: each takes a range of particles, so the result is that of one thread.

The kernels release Python's lock. Rejected: numba's own ``prange``. Its default threads end the process when two
Python threads use them at once, and the process that has used them cannot be forked.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from graphslam.errors import OptionError

from .arguments import whole
from .motion_kernels import CHUNK

#: with fewer particles than this per thread, waking the thread costs more than it saves
WORTHWHILE = 4096
#: the same for light work, a few ns per particle
WORTHWHILE_LIGHT = 32_768


def available_threads() -> int:
    """How many threads this process may use: the cores it may run on, at most ``NUMBA_NUM_THREADS``."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, min(cores, int(limit)) if limit.isdigit() else cores)


#: a function work(lo, hi, *arguments) and its arguments
Job = tuple[Callable[..., Any], tuple[Any, ...]]


class Crew:
    """Runs ``work(lo, hi)`` over 0 to N in one or several threads.

    Raises:
        OptionError: threads is not a whole number above 0.
    """

    def __init__(self, particles: int, threads: int | None) -> None:
        expected = "a whole number of at least 1, or None for all"
        wanted = available_threads() if threads is None else whole("threads", threads, expected)
        if wanted < 1:
            raise OptionError(f"threads must be {expected}, not {threads!r}")
        count = max(1, min(wanted, particles // WORTHWHILE))
        chunks = -(-particles // CHUNK)
        edges = [min(chunks * k // count * CHUNK, particles) for k in range(count + 1)]
        self._first, *self._others = list(zip(edges[:-1], edges[1:], strict=True))
        self._everybody, self._light_in_parallel = (0, particles), particles // WORTHWHILE_LIGHT >= count
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    @property
    def threads(self) -> int:
        """How many threads work, the caller's included."""
        return 1 + len(self._others)

    def run(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Call work(lo, hi, *arguments) for ranges that make up 0 to N, whole chunks of particles each."""
        if not self._others:
            work(*self._first, *arguments)
            return
        if self._pool is None or self._process != os.getpid():
            # a forked child has none of its parent's threads
            self._pool, self._process = ThreadPoolExecutor(len(self._others)), os.getpid()
        waiting = [self._pool.submit(work, lo, hi, *arguments) for lo, hi in self._others]
        work(*self._first, *arguments)
        for future in waiting:
            future.result()

    def run_light(self, work: Callable[..., Any], *arguments: Any) -> None:
        """The same for work that takes only a few ns per particle."""
        if self._light_in_parallel:
            self.run(work, *arguments)
        else:
            work(*self._everybody, *arguments)

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Do jobs (work, arguments) in order; each thread does all of them for its own particles.

        One thread may be a job ahead of another: no job may write what an earlier one reads of other particles.
        """
        self.run(_one_after_the_other, jobs)


def _one_after_the_other(lo: int, hi: int, jobs: Sequence[Job]) -> None:
    for work, arguments in jobs:
        work(lo, hi, *arguments)
