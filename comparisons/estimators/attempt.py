"""Work in processes: the tasks of studies and checks, and, with a time limit, the estimators of a comparison.

Neither the engine nor GTSAM can be interrupted in this process. `graphslam.processes` starts the processes; here they also
load the modules of estimators before their first task. `rows_of` executes tasks, `attempt` runs one estimator of a
comparison, whose error becomes a `Skipped`.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import islice
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import cloudpickle  # type: ignore[import-untyped]
import numpy as np
from pebble import ProcessExpired

from graphslam import Log, OptionError, SlamError
from graphslam.processes import default_jobs, how_it_ended, processes

from ..options import RunOptions
from ..results import EstimatorResult, sentence
from . import BUILT_IN, ESTIMATORS, warm_up

Task = TypeVar("Task")
Row = TypeVar("Row")


def loading(estimators: Iterable[str], prepare: Callable[[], object] = list) -> Callable[[], None]:
    """What a process does before its first task: it loads the modules of estimators, and calls ``prepare``."""
    return partial(_warm_up, tuple(estimators), added_estimators(), prepare)


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
            why = f"the estimator {name!r} cannot be sent to another process ({sentence(error)})"
            advice = "let its function use only what can be pickled, or run in this process (a study: jobs=0)"
            raise OptionError(f"{why}: {advice}") from None
    return cloudpickle.dumps(added) if added else b""


@lru_cache(maxsize=8)
def add_estimators(added: bytes) -> None:
    """Register what `added_estimators` made, in another process."""
    if added:
        ESTIMATORS.update(pickle.loads(added))


def _warm_up(estimators: Sequence[str], added: bytes, prepare: Callable[[], object]) -> None:
    add_estimators(added)
    of_kinds = (partial(warm_up, name, simulated=each) for name in estimators for each in (True, False))
    loads: list[Callable[[], object]] = [*of_kinds, prepare]
    for load in loads:
        with suppress(Exception):  # it shows again, with its message, in the run
            load()


def too_long(limit: float | None) -> str:
    """A sentence on a task that was stopped at its time limit [s]."""
    return f"it was stopped at the time limit of {limit:g} s"


def ended(
    future: Future[Row], task: Task, limit: float | None, instead: Callable[[Task, str], Row] | None = None
) -> Row:
    """The row of a task in a pool, or what ``instead`` makes of the reason: it took longer, or its process died."""
    try:
        return future.result()
    except TimeoutError:
        reason = too_long(limit)
    except ProcessExpired as error:
        reason = how_it_ended(error)
    if instead is None:
        raise SlamError(reason)
    return instead(task, reason)


@dataclass(frozen=True)
class Place(Generic[Task, Row]):
    """An executor of the tasks of a study.

    Attributes:
        room: how many tasks may be there at a time, executing or waiting.
        submit: begins a task.
        row: what a task gives whose future is done; raises `SlamError` where the place is lost.
    """

    room: int
    submit: Callable[[Task], Future[Row]]
    row: Callable[[Future[Row], Task], Row]


@contextmanager
def place_of(
    work: Callable[[Task], Row], *, jobs: int | None = None, estimators: Sequence[str] = (),
    prepare: Callable[[], object] = list, limit: float | None = None, instead: Callable[[Task, str], Row] | None = None,
) -> Iterator[Place[Task, Row]]:  # fmt: skip
    """Processes of this machine. Starting one and loading its modules do not count towards the limit, reading a log does.

    Args:
        work: of a module, so that it can be named to a process; tasks are plain data.
        jobs: how many processes; None for one on each core; 0 for this process, for a debugger and for tests: each task is
            then done as it is submitted, without a limit.
        estimators: whose modules are loaded before the first task.
        prepare: called in each process after that.
        limit: of the time of each task [s]; None for no limit.
        instead: makes the row of a task that took longer, or whose process died, from the task and the reason. Without
            it they are errors.

    Raises:
        SlamError: a process died, or a task took too long, where nothing stands instead of its row.
    """
    if jobs == 0:
        for name in estimators:
            warm_up(name)
        yield Place(1, partial(_done, work), lambda future, _: future.result())
        return
    jobs = jobs or default_jobs()
    with processes(jobs, loading(estimators, prepare)) as pool:
        # a task that waits in the pool keeps its process from waiting for the next one
        yield Place(
            jobs + 1, lambda task: pool.schedule(work, (task,), timeout=limit),
            lambda future, task: ended(future, task, limit, instead),
        )  # fmt: skip


def _done(work: Callable[[Task], Row], task: Task) -> Future[Row]:
    future: Future[Row] = Future()
    future.set_result(work(task))
    return future


#: futures that are done, and None, which ends the work
Events = SimpleQueue[Future[Row] | None]


def as_they_end(place: Place[Task, Row], tasks: Iterable[Task], events: Events[Row]) -> Iterator[tuple[int, Row]]:
    """The number of each task among all, and its row, as they end; after None among the events those that have ended."""
    waiting = enumerate(tasks)
    pending: dict[Future[Row], tuple[int, Task]] = {}

    def submit(count: int) -> None:
        for k, task in islice(waiting, count):
            future = place.submit(task)
            pending[future] = k, task
            future.add_done_callback(events.put)

    submit(place.room)
    while pending:
        event = events.get()
        for future in [event] if event is not None else [future for future in pending if future.done()]:
            k, task = pending.pop(future)
            yield k, place.row(future, task)
        if event is None:
            return
        submit(1)


def rows_of(
    work: Callable[[Task], Row], tasks: Iterable[Task], *, jobs: int | None,
    progress: Callable[[Row], object] | None = None, **keywords: Any,
) -> list[Row]:  # fmt: skip
    """``map(work, tasks)`` in a place, rows in the order of the tasks.

    Args:
        work, jobs, keywords: see `place_of`.
        progress: called with each row as its task ends.

    Raises:
        OptionError: there is a limit and no process to stop.
        SlamError: see `place_of`, or ``work`` raised it.
    """
    if jobs == 0 and keywords.get("limit") is not None:
        raise OptionError("time_limit needs local processes, which can be stopped: jobs must be at least 1, not 0")
    rows: dict[int, Row] = {}
    with place_of(work, jobs=jobs, **keywords) as place:
        for k, rows[k] in as_they_end(place, tasks, SimpleQueue()):
            if progress is not None:
                progress(rows[k])
    return [rows[k] for k in sorted(rows)]


@dataclass(frozen=True)
class Skipped:
    """An estimator without a result on this log, and why; ``error`` is what it raised, if it began to run."""

    name: str
    reason: str
    error: Exception | None = field(default=None, compare=False, repr=False)

    @property
    def outcome(self) -> str:
        """'left out' where it cannot run on this log, or 'failed' where something unforeseen happened."""
        return "left out" if self.error is None or isinstance(self.error, SlamError) else "failed"


def attempt(name: str, log: Log, options: RunOptions) -> EstimatorResult | Skipped:
    """The result of an estimator with its warnings as notes, or the sentence of its error."""
    warm_up(name, simulated=log.simulated)
    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            result = _checked(name, ESTIMATORS[name].run(log, options), log)
    except Exception as error:
        return Skipped(name, sentence(error), error)
    if log.identified and not options.filter.uses_ids and result.association is None:
        result = replace(result, notes=(*result.notes, "the ids of the log were used all the same"))
    return _with_warnings(result, caught)


def _checked(name: str, result: object, log: Log) -> EstimatorResult:
    """The result of an estimator under the name that it is registered by, if tables and figures can use it.

    Raises:
        ResultError: a part of it has another type or shape; the message names the part and what was expected.
    """

    def wrong(part: str, expected: str, value: object) -> ResultError:
        found = (
            f"an array of shape {value.shape} and type {value.dtype}" if isinstance(value, np.ndarray) else repr(value)
        )
        return ResultError(f"{name} returned {part} that cannot be used: expected {expected}, not {found[:80]}")

    if not isinstance(result, EstimatorResult):
        raise wrong("a result", "an EstimatorResult", result)
    T = log.num_poses
    poses, known = result.poses, result.estimated
    if not isinstance(poses, np.ndarray) or poses.shape != (T, 3) or poses.dtype.kind != "f":
        raise wrong("poses", f"an array of numbers ({T}, 3), a row (x, y, theta) for each pose of the log", poses)
    if not isinstance(known, np.ndarray) or known.shape != (T,) or known.dtype != bool:
        raise wrong("estimated", f"an array of bool ({T},)", known)
    if not np.isfinite(poses[known]).all():
        raise wrong("poses", "finite numbers wherever estimated is true", poses)
    if result.association is not None and np.shape(result.association) != (len(log.steps),):
        raise wrong("association", f"an id for each of the {len(log.steps)} sightings", result.association)
    for what, shapes in (("landmarks", [(2,), (3,)]), ("landmark_covariances", [(2, 2), (3, 3)])):
        values = getattr(result, what)
        if not isinstance(values, Mapping):
            raise wrong(what, f"a mapping of ids to arrays {shapes[0]} or {shapes[1]}", values)
        for id, value in values.items():
            if np.shape(value) not in shapes:
                raise wrong(f"{what}[{id!r}]", f"an array {shapes[0]} or {shapes[1]}", value)
            if what == "landmarks" and not np.isfinite(value).all():
                raise wrong(f"landmarks[{id!r}]", "finite numbers, or no landmark where its place is not known", value)
    return result if result.name == name else replace(result, name=name)


class ResultError(TypeError):
    """An estimator returned something that is no result."""


#: the name of an estimator, the log and the options
Attempted = tuple[str, Log, RunOptions]
#: makes the outcome of an estimator, given the same
Attempt = Callable[[str, Log, RunOptions], EstimatorResult | Skipped]


@contextmanager
def attempts(names: Sequence[str], limit: float | None) -> Iterator[Attempt]:
    """`attempt`, or the same with a limit of the time of each estimator [s]."""
    if limit is None:
        yield attempt
        return

    def skipped(task: Attempted, reason: str) -> Skipped:
        return Skipped(task[0], reason, None if reason == too_long(limit) else RuntimeError(reason))

    with place_of(_elsewhere, jobs=1, estimators=names, limit=limit, instead=skipped) as place:
        yield lambda *task: place.row(place.submit(task), task)


def _elsewhere(task: Attempted) -> EstimatorResult | Skipped:
    """`attempt` in a process, whose errors must be of classes that can be sent."""
    outcome = attempt(*task)
    if isinstance(outcome, Skipped) and outcome.error is not None:
        kind = next((k for k in (OptionError, SlamError) if isinstance(outcome.error, k)), RuntimeError)
        outcome = replace(outcome, error=kind(outcome.reason))
    return outcome


def _with_warnings(result: EstimatorResult, caught: Sequence[warnings.WarningMessage]) -> EstimatorResult:
    """The result with the warnings of its estimator as notes; warnings meant for programmers are raised again."""
    ours = [w for w in caught if issubclass(w.category, (UserWarning, RuntimeWarning))]
    for warning in caught:
        if warning not in ours:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    texts = dict.fromkeys(str(warning.message) for warning in ours)
    return replace(result, notes=(*result.notes, *texts)) if texts else result
