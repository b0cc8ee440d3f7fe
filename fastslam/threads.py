"""Several threads for one kernel: each takes a range of particles, so the result does not depend on their number.

The kernels release Python's lock. Rejected: numba's ``prange``. Its default threads end the process when two Python
threads use them at once, and a process that has used them cannot be forked.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from graphslam.threads import available_threads

from .blocks import CHUNK

#: with fewer particles than this per thread, waking the thread costs more than it saves
MINIMUM = 4096
#: the same for light work of a few ns per particle
MINIMUM_LIGHT = 32_768

#: a function work(lo, hi, *arguments) and its arguments
Job = tuple[Callable[..., Any], tuple[Any, ...]]


class Threads:
    """Runs ``work(lo, hi)`` over particles 0 to N in one or several threads; None takes all available cores."""

    def __init__(self, particles: int, threads: int | None) -> None:
        count = max(1, min(available_threads() if threads is None else threads, particles // MINIMUM))
        chunks = -(-particles // CHUNK)
        edges = [min(chunks * k // count * CHUNK, particles) for k in range(count + 1)]
        self._first, *self._others = list(zip(edges[:-1], edges[1:], strict=True))
        self._all, self._light_in_parallel = (0, particles), particles // MINIMUM_LIGHT >= count
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    @property
    def count(self) -> int:
        """The number of working threads, including the caller's."""
        return 1 + len(self._others)

    def run(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Call work(lo, hi, *arguments) for ranges of whole chunks that together cover 0 to N."""
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
        """Do the same for work that takes only a few ns per particle: several threads only for many particles."""
        if self._light_in_parallel:
            self.run(work, *arguments)
        else:
            work(*self._all, *arguments)

    def run_all(self, jobs: Sequence[Job]) -> None:
        """Do jobs (work, arguments) in order; each thread does all of them for its own particles.

        One thread may be a job ahead of another: no job may write what an earlier one reads of other particles.
        """
        self.run(_in_order, jobs)


def _in_order(lo: int, hi: int, jobs: Sequence[Job]) -> None:
    for work, arguments in jobs:
        work(lo, hi, *arguments)
