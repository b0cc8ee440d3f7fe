"""The matches of an estimator: the sightings of each landmark by the ids that it gave them."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from graphslam import Log
from graphslam.association import AssociationScore
from graphslam.log import UNIDENTIFIED

from .documents import AssociationDocument, DoubtDocument, VerdictDocument, document
from .results import EstimatorResult

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
