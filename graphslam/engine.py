"""The compiled engine, or one sentence where it is missing; and how many threads it may use."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

NAME = f"{__package__}._engine"
try:
    engine: Any = import_module(NAME)
except ImportError as error:
    raise ImportError(
        f"the compiled module {NAME} cannot be loaded ({error}); build it with: pip install --editable .", name=NAME
    ) from error


def available_threads() -> int:
    """The number of threads that this process may use: the cores it may run on, at most ``OMP_NUM_THREADS``."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(cores, int(limit)) if limit.isdigit() else cores)
