"""The pool of local processes in which studies, solver checks and the studies of filters do their work.

`graphslam.processes` starts the processes; here they also load the modules of estimators before their first task.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from functools import lru_cache, partial
from typing import TypeVar

import cloudpickle  # type: ignore[import-untyped]
from pebble import ProcessExpired, ProcessPool

from graphslam import OptionError, SlamError
from graphslam import processes as local
from graphslam.processes import default_jobs, how_it_ended

from .estimators import BUILT_IN, ESTIMATORS, warm_up
from .failures import sentence

Task = TypeVar("Task")
Result = TypeVar("Result")


def process_pool(jobs: int, estimators: Sequence[str]) -> ProcessPool:
    """A `graphslam.processes.process_pool` whose processes load the modules of estimators first."""
    return local.process_pool(jobs, partial(_warm_up, tuple(estimators), added_estimators()))


def processes(jobs: int, estimators: Sequence[str]) -> AbstractContextManager[ProcessPool]:
    """The same, for a block: `graphslam.processes.processes`."""
    return local.processes(jobs, partial(_warm_up, tuple(estimators), added_estimators()))


def added_estimators() -> bytes:
    """The estimators that the user has added to `ESTIMATORS`, for another process; empty where there are none.

    A process does not import the user's script, so a function of the script travels with its code.

    Raises:
        OptionError: one cannot be sent to another process.
    """
    added = {name: estimator for name, estimator in ESTIMATORS.items() if BUILT_IN.get(name) is not estimator}
    for name, estimator in added.items():
        try:
            cloudpickle.dumps(estimator)
        except Exception as error:
            raise OptionError(
                f"the estimator {name!r} cannot be sent to another process ({sentence(error)}): let its function use only "
                "what can be pickled, or run in this process (a study: jobs=0)"
            ) from None
    return cloudpickle.dumps(added) if added else b""


@lru_cache(maxsize=8)
def add_estimators(added: bytes) -> None:
    """Register what `added_estimators` made, in another process."""
    if added:
        ESTIMATORS.update(pickle.loads(added))


def _warm_up(estimators: Sequence[str], added: bytes) -> None:
    add_estimators(added)
    for name in estimators:
        with suppress(Exception):  # it shows again, with its message, in the run
            warm_up(name)


def results(
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    *,
    jobs: int | None,
    estimators: Sequence[str] = (),
    limit: float | None = None,
    instead: Callable[[Task, str], Result] | None = None,
) -> Iterator[Result]:
    """``map(function, tasks)`` over local processes, results in the order of the tasks.

    Args:
        function: of a module, so that it can be named to a process.
        tasks: plain data.
        jobs: how many processes; 0 for this process, None for one on each core.
        estimators: whose modules are loaded before the first task.
        limit: of the time of each task [s]; None for no limit.
        instead: makes the result of a task that took longer, or whose process died, from the task and the reason. Without
            it they are errors.

    Raises:
        OptionError: there is a limit and no process to stop.
        SlamError: a process died, a task took too long, or the function raised it.
    """
    if jobs == 0:
        if limit is not None:
            raise OptionError("time_limit needs local processes, which can be stopped: jobs must be at least 1, not 0")
        for name in estimators:
            warm_up(name)
        yield from map(function, tasks)
        return
    with processes(jobs or default_jobs(), estimators) as pool:
        for task, future in [(task, pool.schedule(function, (task,), timeout=limit)) for task in tasks]:
            try:
                result: Result = future.result()
            except (TimeoutError, ProcessExpired) as error:
                reason = how_it_ended(error) if isinstance(error, ProcessExpired) else too_long(limit)
                if instead is None:
                    raise SlamError(reason) from None
                result = instead(task, reason)
            yield result


def too_long(limit: float | None) -> str:
    """A sentence on a task that was stopped at its time limit [s]."""
    return f"it was stopped at the time limit of {limit:g} s"
