"""Several logs of one place that were solved together: the errors of each log, and its rows of trajectories."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphslam import Log
from graphslam.log_arrays import Session
from graphslam.metrics import Metrics, evaluate, position_errors
from graphslam.se2 import Array

from .documents import SessionDocument, SessionErrorsDocument, document

if TYPE_CHECKING:
    from .comparison import Comparison


@dataclass(frozen=True)
class SessionErrors:
    """The errors of an estimator in one of the logs.

    Attributes:
        alone: after the alignment of this log alone to its ground truth.
        together_m: the ATE [m] of its poses after the common alignment of all logs; None where their truth is not known.
    """

    session: Session
    estimator: str
    alone: Metrics
    together_m: float | None


def errors_of_sessions(comparison: Comparison) -> Iterator[SessionErrors]:
    """The errors of every estimator in each log of a joined one, log by log."""
    log = comparison.log
    truth = np.full((log.num_poses, 3), np.nan) if log.true_poses is None else log.true_poses
    estimates = {r.name: log.at_truth(r.poses) for r in comparison.results}
    off = {
        r.name: position_errors(truth, estimates[r.name], mask=r.estimated)
        for r in comparison.results
        if np.count_nonzero(r.estimated & log.covered) >= 2
    }
    for session, drive in zip(log.sessions, log.drives):
        for r in comparison.results:
            alone, together = Metrics(), None
            if log.covered[drive].any():
                alone = evaluate(truth[drive], None, estimates[r.name][drive], {}, mask=r.estimated[drive])
            if r.name in off and np.isfinite(off[r.name][drive]).any():
                together = float(np.sqrt(np.nanmean(off[r.name][drive] ** 2)))
            yield SessionErrors(session, r.name, alone, together)


def shared_landmarks(log: Log) -> list[tuple[int, int]]:
    """How many landmarks each of the joined logs has seen, and how many of them another one has seen, too."""
    drive = np.searchsorted([each.start for each in log.sessions], log.steps, side="right")
    seen = np.unique(np.column_stack([drive, log.landmarks]), axis=0)
    _, place, count = np.unique(seen[:, 1], return_inverse=True, return_counts=True)
    return [
        (int(np.sum(seen[:, 0] == k)), int(np.sum((seen[:, 0] == k) & (count[place] > 1))))
        for k in range(1, len(log.sessions) + 1)
    ]


def parted(rows: Array, ends: np.ndarray | list[int]) -> Array:
    """Rows (n, ...) with a row of NaN before each of ``ends``, where another log begins: lines break there."""
    return np.insert(rows, ends, np.nan, axis=0)


def documents_of_sessions(comparison: Comparison) -> list[dict[str, Any]] | None:
    """The logs and their errors for JSON; None where there is one log."""
    log = comparison.log
    if not log.sessions:
        return None
    errors: dict[Session, dict[str, Any]] = {each: {} for each in log.sessions}
    for each in errors_of_sessions(comparison):
        errors[each.session][each.estimator] = document(SessionErrorsDocument, each, each.alone)
    source = comparison.source
    files = source if isinstance(source, tuple) else (source,) * len(log.sessions)
    return [
        document(
            SessionDocument, session, file=None if file is None else str(Path(file)), poses=drive.stop - drive.start,
            sightings=int(np.sum((log.steps >= drive.start) & (log.steps < drive.stop))), landmarks=seen, shared=shared,
            estimators=errors[session],
        )
        for session, drive, file, (seen, shared) in zip(log.sessions, log.drives, files, shared_landmarks(log))
    ]  # fmt: skip
