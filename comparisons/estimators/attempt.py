"""One estimator of a comparison, in this process or, with a time limit, in one of a pool; an error becomes a `Skipped`.

Neither the engine nor GTSAM can be interrupted in this process. Studies and solver checks use the same pool.

`graphslam.processes` starts the processes; here they also load the modules of estimators before their first task.
"""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TypeVar

import cloudpickle  # type: ignore[import-untyped]
import numpy as np
from pebble import ProcessExpired, ProcessPool

from graphslam import Log, OptionError, SlamError
from graphslam.processes import how_it_ended, processes

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
    loads: list[Callable[[], object]] = [*(partial(warm_up, name) for name in estimators), prepare]
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
    warm_up(name)
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
        found = repr(value)
        if isinstance(value, np.ndarray):
            found = f"an array of shape {value.shape} and type {value.dtype}"
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
    return result if result.name == name else replace(result, name=name)


class ResultError(TypeError):
    """An estimator returned something that is no result."""


#: makes the outcome of an estimator, given its name, the log and the options
Attempt = Callable[[str, Log, RunOptions], EstimatorResult | Skipped]


@contextmanager
def attempts(names: Sequence[str], limit: float | None) -> Iterator[Attempt]:
    """`attempt`, or the same with a limit of the time of each estimator [s]."""
    if limit is None:
        yield attempt
        return
    with processes(1, loading(names)) as pool:
        yield partial(_within, pool, limit)


def _within(pool: ProcessPool, limit: float, name: str, log: Log, options: RunOptions) -> EstimatorResult | Skipped:
    def skipped(name: str, reason: str) -> Skipped:
        return Skipped(name, reason, None if reason == too_long(limit) else RuntimeError(reason))

    return ended(pool.schedule(_elsewhere, (name, log, options), timeout=limit), name, limit, skipped)


def _elsewhere(name: str, log: Log, options: RunOptions) -> EstimatorResult | Skipped:
    """`attempt` in a process, whose errors must be of classes that can be sent."""
    outcome = attempt(name, log, options)
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
