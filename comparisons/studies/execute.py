"""One run, from its description to its row's figures: what every executor calls, in whatever process."""

from __future__ import annotations

import hashlib
import json
import time
import warnings
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from graphslam import Log, LogError, SlamError, load, simulate

from ..comparison import compare
from ..config import run_options, sha256_of
from ..estimator import RunOptions
from ..estimators import ESTIMATORS
from .outcome import ERROR, Outcome
from .plan import Run


def execute(run: Run) -> Outcome:
    """Do a run. Whatever it raises becomes an outcome with the error's sentence.

    Args:
        run: what to do.
    """
    begin = time.perf_counter()
    try:
        outcome = _execute(run)
    except Exception as error:
        outcome = {"status": ERROR, "error": sentence(error)}
    return Outcome(key=run.key, total_seconds=time.perf_counter() - begin, **outcome)


def sentence(error: BaseException) -> str:
    """An exception in one line: the user's mistakes as they are, all others with their type."""
    text = " ".join(str(error).split())
    return text if isinstance(error, SlamError) else f"{type(error).__name__}: {text}"


def warm(estimator: str) -> None:
    """Let an estimator compile or load its kernels, on a few simulated steps; what goes wrong there shows in the run."""
    with suppress(Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ESTIMATORS[estimator].run(simulate(steps=6), RunOptions(particles=10))


def log_of(run: Run) -> Log:
    """The log of a run, read or simulated; the last few are kept, because neighbouring runs share theirs.

    Raises:
        LogError: the file has changed since the study was begun, or has not what is asked for.
        SlamError: it cannot be read or simulated.
    """
    return _log(json.dumps(dict(run.source), sort_keys=True), run.log, run.seed if "simulate" in run.source else None)


@lru_cache(maxsize=4)
def _log(source: str, name: str, seed: int | None) -> Log:
    told = json.loads(source)
    if seed is not None:
        from .simulated import simulated_log

        return simulated_log(told["simulate"], seed, name)
    path = Path(told["file"])
    log = load(path, format=told["format"])
    if told["sha256"] is not None and sha256_of(path) != told["sha256"]:
        raise LogError(f"{path} has changed since the study was begun; start the sweep again to take it as it is")
    if told["dimensions"] == 3 and not log.has_orientation:
        raise LogError(f"{path}: the sightings have no psi, but the study asks for dimensions = 3")
    return log.without_orientation() if told["dimensions"] == 2 else log


def _execute(run: Run) -> dict[str, Any]:
    options = run_options({**run.options, "seed": run.seed})
    comparison = compare(log_of(run), [run.estimator], options)
    (row,) = comparison.table
    digest = hashlib.sha256(comparison.results[0].poses.tobytes()).hexdigest()[:16]
    return {
        "converged": row.converged,
        "iterations": row.iterations,
        "cost": row.cost,
        "ate_m": row.ate_m,
        "rpe_m": row.rpe_m,
        "rpe_rad": row.rpe_rad,
        "landmark_rmse_m": row.landmark_rmse_m,
        "seconds": row.seconds,
        "poses_sha256": digest,
    }
