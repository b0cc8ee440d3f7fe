"""Ids that some sightings of a log have: sightings with one id are of one landmark, and no landmark has two.

All other labels are found as where no sighting has an id, and then changed to agree with the ids.
"""

from __future__ import annotations

import numpy as np

from ..log import UNIDENTIFIED


def numbered(landmarks: np.ndarray) -> np.ndarray:
    """The ids (M,) numbered from 0, -1 where there is none."""
    ids, which = np.unique(landmarks, return_inverse=True)
    return which - np.count_nonzero(ids == UNIDENTIFIED)


def id_of_each(labels: np.ndarray, known: np.ndarray, count: int) -> np.ndarray:
    """The id (count,) that most sightings with each label have, of labels (m,) and ids ``known`` (m,); -1 for none."""
    fixed = (known >= 0) & (labels >= 0)
    pairs, votes = np.unique(np.column_stack([labels[fixed], known[fixed]]), axis=0, return_counts=True)
    order = np.argsort(votes, kind="stable")
    ids = np.full(count, -1)
    ids[pairs[order, 0]] = pairs[order, 1]
    return ids


def held(labels: np.ndarray, known: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The labels (M,) changed to agree with the ids ``known`` (M,), -1 for none.

    A landmark of which some sightings have ids gets the id that most of them have. Other sightings of
    the scan, by their ``steps`` (M,), are then not of it.
    """
    fixed = known >= 0
    if not fixed.any():
        return labels
    base = int(labels.max(initial=-1)) + 1
    of_label = id_of_each(labels, known, base + 1)
    # the last entry is for label -1
    renamed = np.where(of_label < 0, np.append(np.arange(base), -1), base + of_label)[labels]
    renamed[fixed] = base + known[fixed]
    place = steps * (int(renamed.max()) + 2) + renamed
    renamed[~fixed & np.isin(place, place[fixed])] = -1
    return renamed


def agree(labels: np.ndarray, known: np.ndarray) -> bool:
    """Whether all sightings with one id ``known`` (M,) that have labels (M,) have the same one, and no label has two ids."""
    fixed = (known >= 0) & (labels >= 0)
    pairs = np.unique(np.column_stack([labels[fixed], known[fixed]]), axis=0)
    return len(pairs) == len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1]))


def names(labels: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """The id (L,) of each label 0 to L - 1 (M,): that of its sightings in ``landmarks`` (M,), else one above all of these."""
    fixed = (landmarks != UNIDENTIFIED) & (labels >= 0)
    count = int(labels.max(initial=-1)) + 1
    found = np.full(count, UNIDENTIFIED)
    found[labels[fixed]] = landmarks[fixed]
    new = found == UNIDENTIFIED
    found[new] = max(int(landmarks[fixed].max(initial=-1)), -1) + 1 + np.arange(np.count_nonzero(new))
    return found


def may_be_one(first: int, second: int) -> bool:
    """Whether landmarks with these ids, -1 for none, can be one."""
    return first < 0 or second < 0 or first == second
