"""The threads of this process."""

from __future__ import annotations

import os


def available_threads() -> int:
    """The number of threads that this process may use: the cores it may run on, at most ``OMP_NUM_THREADS``."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(cores, int(limit)) if limit.isdigit() else cores)
