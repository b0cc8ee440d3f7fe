"""One run, from its description to the figures of its row: the task of every process, wherever it is."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from graphslam import Log, LogError
from graphslam.parameters.declared import CORRECTIONS

from ..comparison import compare
from ..failures import sentence
from ..option import options_of
from ..options import NoiseOptions, ReadingOptions, RunOptions
from ..reading import read_log, sha256_of
from .outcome import ERROR, Outcome
from .plan import Run
from .simulated import simulated_log


def execute(run: Run) -> Outcome:
    """Do a run. Any exception becomes an outcome with the sentence of the error."""
    begin = time.perf_counter()
    try:
        outcome = _execute(run)
    except Exception as error:
        outcome = {"status": ERROR, "error": sentence(error)}
    return Outcome(key=run.key, total_seconds=time.perf_counter() - begin, **outcome)


@lru_cache(maxsize=4)
def _log(source: str, reading: str, name: str, seed: int | None) -> Log:
    """A log, read or simulated; the last few are kept, because neighbouring runs use the same one."""
    description = json.loads(source)
    log: Log | Path
    if seed is not None:
        log = simulated_log(description["simulate"], seed, name)
    else:
        log = Path(description["file"])
        if description["sha256"] is not None and description["sha256"] != sha256_of(log):
            raise LogError(f"{log} has changed since the study was begun; start the sweep again to take it as it is")
    return read_log(log, ReadingOptions.of(**json.loads(reading)))[0]


def log_of(run: Run) -> Log:
    """The log of a run.

    Raises:
        SlamError: it cannot be read or made.
    """
    reading = {name: run.options[name] for name in options_of(ReadingOptions) if name in run.options}
    return _log(
        json.dumps(dict(run.source)), json.dumps(reading), run.log, run.seed if "simulate" in run.source else None
    )


def filter_options(run: Run) -> RunOptions:
    """The options of the particle filters among those of a run."""
    known = options_of(RunOptions)
    return RunOptions.of(**{name: value for name, value in run.options.items() if known[name].model == "filter"})


def _execute(run: Run) -> dict[str, Any]:
    log = log_of(run)
    options = {name: value for name, value in run.options.items() if name not in options_of(ReadingOptions)}
    if isinstance(options.get("noise"), Mapping):
        # single numbers take precedence over those of the noise file, and those over the log's
        noise = NoiseOptions.of(**options.pop("noise"))
        motion, sensor = noise.models(log.motion, log.sensor)
        corrections = {name: getattr(noise, name) for name in CORRECTIONS}
        options = {**corrections, **options, "motion": motion, "sensor": sensor}
    comparison = compare(log, RunOptions.of(**options, seed=run.seed), estimators=[run.estimator])
    result = comparison.results[0]
    # not the rows of the table: they have NEES, too, for which covariances would be computed
    sources = (result, comparison.metrics[result.name])
    figures = {f.name: getattr(each, f.name) for each in sources for f in fields(Outcome) if hasattr(each, f.name)}
    certificate = result.certificate
    if certificate is not None and certificate.applicable:
        figures["proven"] = certificate.proven
    return figures | {"poses_sha256": hashlib.sha256(result.poses.tobytes()).hexdigest()[:16]}
