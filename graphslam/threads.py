"""The threads of this process."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor


def available_threads() -> int:
    """How many threads this process may use: the cores it may run on, at most ``NUMBA_NUM_THREADS``."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, min(cores, int(limit)) if limit.isdigit() else cores)


class Pool:
    """Threads that are started at the first use, and once again in each forked process, which has none of them."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def executor(self) -> ThreadPoolExecutor:
        """The threads of this process."""
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(available_threads()), os.getpid()
        return self._pool


#: the threads that all factorisations share
POOL = Pool()
