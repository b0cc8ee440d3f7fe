"""The matches of an estimator: the sightings of each landmark by the ids that it gave them.

Several logs of one place that were solved together: the errors of each log, and its rows of trajectories.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphslam import Log
from graphslam.association import AssociationScore
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import Session
from graphslam.metrics import Metrics, evaluate, position_errors
from graphslam.se2 import Array

from .documents import (
    AssociationDocument,
    DoubtDocument,
    SessionDocument,
    SessionErrorsDocument,
    VerdictDocument,
    document,
)
from .results import EstimatorResult

if TYPE_CHECKING:
    from ..comparison import Comparison

#: what a sighting is to an estimator that gave it an id itself
CONFIRMED, UNCONFIRMED, CLUTTER = "confirmed", "unconfirmed", "clutter"
SIGHTING_COLUMNS = ("step", "range", "bearing", "orientation", "class", "landmark", "status", "true_id")


@dataclass(frozen=True, eq=False)
class SeenLandmark:
    """A landmark and its sightings: ``rows`` (k,) of the log, the class that most of them show, and the share that do.

    Where no class of a sighting is known both are None.
    """

    landmark: int
    rows: np.ndarray
    of_class: int | str | None
    share: float | None


def sightings_of(log: Log, ids: np.ndarray) -> list[SeenLandmark]:
    """The landmarks to which sightings with ids (M,) belong, in the order of the ids."""
    found = []
    for j in np.setdiff1d(ids, [UNIDENTIFIED]).tolist():
        rows = np.flatnonzero(ids == j)
        if log.classes is None or not np.any(known := log.classified[rows]):
            found.append(SeenLandmark(j, rows, None, None))
            continue
        names, counts = np.unique(log.classes[rows[known]], return_counts=True)
        best = int(np.argmax(counts))
        found.append(SeenLandmark(j, rows, names[best].item(), float(counts[best] / len(rows))))
    return found


def status_of(result: EstimatorResult) -> np.ndarray:
    """Whether the landmark that an estimator gave each sighting (M,) is confirmed, unconfirmed, or none (clutter)."""
    assert result.association is not None
    doubtful = np.zeros(len(result.association), dtype=bool) if result.unconfirmed is None else result.unconfirmed
    given = result.association != UNIDENTIFIED
    return np.where(given, np.where(doubtful, UNCONFIRMED, CONFIRMED), CLUTTER)


def sightings_text(log: Log, result: EstimatorResult) -> str:
    """A table of all sightings with the ids that an estimator gave them; what is not known, or none, stays empty."""
    assert result.association is not None
    status, known = status_of(result).tolist(), log.classified
    classes = [] if log.classes is None else log.classes.tolist()
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(SIGHTING_COLUMNS)
    for k, z in enumerate(log.sightings.tolist()):
        ids = ["" if j == UNIDENTIFIED else j for j in (int(result.association[k]), int(log.landmarks[k]))]
        shown = classes[k] if known[k] else ""
        table.writerow([int(log.steps[k]), *z, *[""] * (3 - len(z)), shown, ids[0], status[k], ids[1]])
    return text.getvalue()


def association_document(log: Log, result: EstimatorResult, scores: AssociationScore | None) -> dict[str, Any] | None:
    """The ids that an estimator gave sightings itself, as plain data; None where it used those of the log."""
    if result.association is None:
        return None
    given, found = result.association != UNIDENTIFIED, result.found
    of_truth = dict.fromkeys(AssociationScore.__dataclass_fields__) if scores is None else asdict(scores)
    classes = {each.landmark: each.of_class for each in sightings_of(log, result.association)}
    return document(
        AssociationDocument,
        **of_truth,
        landmarks=len(classes),
        clutter=int(np.sum(~given)),
        classes=None if log.classes is None else classes,
        unconfirmed=None if result.unconfirmed is None else int(np.sum(result.unconfirmed & given)),
        evidence=None if found is None else found.evidence,
        doubts=None if found is None else [document(DoubtDocument, each) for each in found.ambiguities],
        verdict=None if found is None else document(VerdictDocument, found.verdict),
    )


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
