"""`run`: what ``slam-compare run`` does, as a function; the other verbs' functions are named in `comparisons`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any

from graphslam import Log, OptionError, load, sample_log_path

from .comparison import Comparison, Progress, compare
from .estimator import RunOptions
from .toml_files import nearest


def run(
    log: Log | str | PathLike[str] | None = None,
    estimators: Sequence[str] | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Comparison:
    """Run estimators on a log: ``run().table``, ``run("my.npz", ["graph", "gtsam"], edges="virtual").figure()``.

    Args:
        log: a log, the file or folder of one, or None for the sample log.
        estimators: which, see `comparison.compare`; default: all that can run on the log.
        progress: see `comparison.compare`.
        options: the fields of `estimator.RunOptions`: edges, weight, robust, particles, seed, motion, sensor, ...

    Raises:
        FormatError: the file is not a log.
        OptionError: an option or estimator is unknown or impossible.
        SlamError: a named estimator, or ``graph``, cannot run on this log.
    """
    known = [field.name for field in fields(RunOptions)]
    for name in options:
        if name not in known:
            raise OptionError(f"there is no option {name!r}; did you mean {nearest(name, known)!r}?")
    source = None
    if not isinstance(log, Log):
        source = sample_log_path() if log is None else Path(log)
        with warnings.catch_warnings():
            # what a reader warns of is among the notes of the log, too, which are shown
            warnings.simplefilter("ignore", UserWarning)
            log = load(source)
    return compare(log, estimators, RunOptions(**options), source=source, progress=progress)
