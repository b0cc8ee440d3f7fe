"""Rows that come twice and times that several rows share: the numbers can be read, but are probably not what was measured."""

from __future__ import annotations

import numpy as np

from ..reading import UNIDENTIFIED
from ..se2 import Array
from .table import Table

#: name of the check and sentence of something that is probably a mistake, see `Log.doubts`
Doubt = tuple[str, str]
#: rows of odometry or truth, and sightings of one landmark, that share a time and are a larger part of all are a doubt
_SHARE = 0.01


def repeated_times(
    kind: str, table: Table, ns: np.ndarray, rows: Array, numbers: np.ndarray
) -> tuple[tuple[str, ...], tuple[Doubt, ...]]:
    """Notes and doubts about a table in which one row per time belongs: odometry or truth.

    Args:
        kind: of the table.
        table: for messages.
        ns: times (N,) [ns], not decreasing.
        rows: (N, k).
        numbers: (N,) of the rows in the table.
    """
    same = np.diff(ns) == 0
    if not same.any():
        return (), ()
    count = int(np.sum(same))
    which = f"{_first(table, numbers[1:][same], f'{kind} row')} (of {len(ns)}) with the time"
    if 2 * np.sum(same & np.all(rows[1:] == rows[:-1], axis=1)) > count:
        message = f"{which} and numbers of the row before: the rows were probably written twice, or two files joined"
    else:
        message = (
            f"{which} of the row before and other numbers: the times were probably rounded{_rounded(ns)}, and one row per "
            "time is used"
        )
    return ((), ((f"{kind} repeats", message),)) if count > _SHARE * len(ns) else ((message,), ())


def repeated_sightings(
    table: Table, ns: np.ndarray, ids: np.ndarray, rows: Array, numbers: np.ndarray
) -> tuple[Doubt, ...]:
    """Doubts about sightings that are there twice, or are of one landmark at one time; the arguments as above, ids (N,)."""
    order = np.lexsort((numbers, *rows.T[::-1], ids, ns))
    ns, ids, rows, numbers = ns[order], ids[order], rows[order], numbers[order]
    same = (np.diff(ns) == 0) & (np.diff(ids) == 0)
    twice = same & np.all(rows[1:] == rows[:-1], axis=1)
    doubts: list[Doubt] = []
    if twice.any():
        which = f"{_first(table, numbers[1:][twice], 'sighting')} (of {len(ns)}) with the time, id and numbers of another row"
        cause = "the rows were probably written twice, or two files joined, and these sightings count twice"
        doubts.append(("doubled sightings", f"{which}: {cause}"))
    other = same & ~twice & (ids[1:] != UNIDENTIFIED)
    if np.sum(other) > _SHARE * len(ns) and np.ptp(ids) > 0:
        later = np.maximum(numbers[1:], numbers[:-1])[other]
        which = (
            f"{_first(table, later, 'sighting')} (of {len(ns)}) with the time and id of another row and other numbers"
        )
        cause = "several objects have one id, or the times were rounded"
        if rounded := _rounded(ns):
            cause = f"the times were probably rounded{rounded}, or several objects have one id"
        doubts.append(("duplicate ids", f"{which}: {cause}"))
    return tuple(doubts)


def _first(table: Table, rows: np.ndarray, what: str) -> str:
    """The place of the first of some rows, and their number in words."""
    number = f"the only {what}" if len(rows) == 1 else f"the first of {len(rows)} {what}s"
    return f"{table.place(int(rows.min()))}: {number}"


def _rounded(ns: np.ndarray) -> str:
    """ " to seconds" where times (N,) [ns] are whole seconds."""
    return " to seconds" if not np.any(ns % 1_000_000_000) else ""
