"""The memory that particle filters will need, said before they start."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import fastslam
from fastslam.memory import GIGABYTE, Forecast, available_memory, forecast
from graphslam import Log, OptionError

from .filters import FILTERS
from .options import RunOptions

#: what may be needed without a word [bytes]
UNSAID = 1e9
#: called with a sentence before work that needs much memory
Announce = Callable[[str], None]


def announce_memory(runs: Iterable[tuple[str, Log, RunOptions]], announce: Announce | None, *, jobs: int = 1) -> None:
    """Say what the largest of several runs needs, where that is much.

    Args:
        runs: estimator, log and options of each run; those of other estimators than particle filters do not count.
        announce: called with one sentence; None to only check.
        jobs: how many runs there are at a time.

    Raises:
        OptionError: a single run has room in the memory there is, but not so many at a time.
    """
    needs: list[tuple[Forecast, str]] = []
    for name, log, options in runs:
        if name in FILTERS:
            need = forecast(log, options.filter, maps=getattr(fastslam, FILTERS[name]).HAS_MAPS)
            needs.append((need, f"{name} with {options.filter.particles:,} particles on {log.name}"))
    if not needs:
        return
    need, what = max(needs, key=lambda entry: entry[0].most)
    jobs, there = min(jobs, len(needs)), available_memory()
    if there is not None and need.least <= there < jobs * need.least:
        raise OptionError(
            f"{what} needs {need} of memory, {jobs} runs at a time need more than the {there / GIGABYTE:.2g} GB that are "
            f"available; use --jobs {int(there / need.least)}"
        )
    if announce is not None and jobs * need.most > UNSAID:
        times = f", and {jobs} runs are executed at a time" if jobs > 1 else ""
        announce(f"{what} needs {need} of memory{times}.")
