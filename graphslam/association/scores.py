"""An association against the true ids: precision, recall, and landmarks found, missed, doubled and invented."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..errors import OptionError
from ..log import UNIDENTIFIED


@dataclass(frozen=True)
class AssociationScore:
    """The comparison of an association with the true ids.

    Each landmark of the association is matched with at most one true landmark, so that as many sightings as possible have
    the right id; these are the correct ones.

    Attributes:
        precision: correct sightings over sightings that were given a landmark.
        recall: correct sightings over sightings that truly are of a landmark.
        found: true landmarks that are matched.
        missed: true landmarks without a match.
        doubled: further landmarks that consist mostly of sightings of a true landmark that another one has been matched to.
        invented: landmarks that consist mostly of clutter.
        matches: the true landmark of each landmark that is matched, {id: true id}.
    """

    precision: float | None
    recall: float | None
    found: int
    missed: int
    doubled: int
    invented: int
    matches: Mapping[int, int]


def score(ids: np.ndarray, true_ids: np.ndarray) -> AssociationScore:
    """Compare ids (M,) with true ids (M,); `UNIDENTIFIED` is clutter in both.

    Raises:
        OptionError: the shapes differ.
    """
    ids, true_ids = np.asarray(ids), np.asarray(true_ids)
    if ids.shape != true_ids.shape or ids.ndim != 1:
        raise OptionError(f"ids and true_ids must be arrays of one shape (M,), not {ids.shape} and {true_ids.shape}")
    names, which = np.unique(ids, return_inverse=True)
    truths, truth = np.unique(true_ids, return_inverse=True)
    table = np.zeros((len(names), len(truths)), dtype=np.int64)
    np.add.at(table, (which, truth), 1)
    given = names != UNIDENTIFIED
    clutter = table[given][:, truths == UNIDENTIFIED].sum(axis=1)
    among = table[given][:, truths != UNIDENTIFIED]
    rows, columns = linear_sum_assignment(among, maximize=True)
    matched = among[rows, columns] > 0
    rows, columns = rows[matched], columns[matched]
    correct = int(among[rows, columns].sum())
    assigned, seen = int(np.sum(ids != UNIDENTIFIED)), int(np.sum(true_ids != UNIDENTIFIED))
    most = among.max(axis=1, initial=0)
    matches = dict(zip(names[given][rows].tolist(), truths[truths != UNIDENTIFIED][columns].tolist(), strict=True))
    unmatched = np.setdiff1d(np.arange(len(among)), rows)
    return AssociationScore(
        precision=correct / assigned if assigned else None,
        recall=correct / seen if seen else None,
        found=len(rows),
        missed=among.shape[1] - len(rows),
        doubled=int(np.sum(most[unmatched] >= np.maximum(clutter[unmatched], 1))),
        invented=int(np.sum(most[unmatched] < clutter[unmatched])),
        matches=matches,
    )
