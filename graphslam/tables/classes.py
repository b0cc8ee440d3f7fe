"""The column of a table that says what each sighting looks like: words such as colours, or whole numbers."""

from __future__ import annotations

import numpy as np

from ..reading import MOST_CLASSES, NO_CLASS, UNIDENTIFIED
from .ids import EMPTY
from .table import Table


def classes_of(table: Table, column: int, *, stated: bool) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """The class (N,) of each sighting as words, or as integers where all are whole numbers; and notes.

    Args:
        table: of the sightings.
        column: the number of the column.
        stated: whether the user says that it holds classes; else one that cannot is left out, with a note.

    Raises:
        LogError: a stated column holds no classes.
    """
    words = table.words(column)
    if words.dtype.kind not in "iu":
        words = np.char.strip(words)
        words = np.where(np.isin(np.char.lower(words), EMPTY), NO_CLASS, words)
    names, which = np.unique(words, return_inverse=True)
    numbers = _numbers([name for name in names.tolist() if name != NO_CLASS])
    known = np.ones(len(words), dtype=bool) if words.dtype.kind in "iu" else words != NO_CLASS
    reason = ""
    if not known.any():
        reason = "all its cells are empty"
    elif numbers is not None and np.any(numbers % 1 != 0):
        reason = f"it holds numbers that are not whole, such as {numbers[np.argmax(numbers % 1 != 0)]:g}"
    elif len(names) > MOST_CLASSES:
        reason = f"it has {len(names)} different entries, more than {MOST_CLASSES}"
    if reason:
        message = f"{table.title(column)} holds no classes of sightings: {reason}"
        if stated:
            raise table.error(None, message)
        return None, (f"{table.source}: {message}; it is left out",)
    notes: tuple[str, ...] = ()
    if not known.all():
        notes = (f"{table.source}: {np.sum(~known)} of {len(known)} sightings have no class, and may be of any",)
    if numbers is None:
        return words, notes
    of_names = np.full(len(names), UNIDENTIFIED)
    of_names[len(names) - len(numbers) :] = numbers.astype(np.int64)
    return of_names[which], notes


def _numbers(names: list[str | int]) -> np.ndarray | None:
    """The names as numbers, None where one is none."""
    try:
        numbers = np.array([float(name) for name in names])
    except ValueError:
        return None
    return numbers if np.all(np.abs(numbers) < 2.0**53) else None
