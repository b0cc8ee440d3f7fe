"""One estimator of a comparison: whatever goes wrong in it becomes a `Skipped`, and the other estimators go on."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from graphslam import Log, SlamError

from .estimators import ESTIMATORS
from .failures import sentence
from .kernels import warm_up
from .options import RunOptions
from .results import EstimatorResult


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
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = ESTIMATORS[name].run(log, options)
    except Exception as error:
        return Skipped(name, sentence(error), error)
    return _with_warnings(result, caught)


def _with_warnings(result: EstimatorResult, caught: Sequence[warnings.WarningMessage]) -> EstimatorResult:
    """The result with the warnings of its estimator as notes; warnings meant for programmers are raised again."""
    ours = [w for w in caught if issubclass(w.category, (UserWarning, RuntimeWarning))]
    for warning in caught:
        if warning not in ours:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    texts = dict.fromkeys(str(warning.message) for warning in ours)
    return replace(result, notes=(*result.notes, *texts)) if texts else result
