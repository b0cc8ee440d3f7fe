"""Columns of ids and classes: whole numbers, words, or nothing where a landmark was not identified."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from ..checks import first
from ..errors import LogError, named
from ..reading import MOST_CLASSES, NO_CLASS, NO_ID, UNIDENTIFIED, Fault
from ..se2 import Array
from .grid import MISSING
from .table import Table

#: cells without an id or a class, in small letters
EMPTY = (*(cell.decode() for cell in MISSING), "nan", "<na>")

#: whole numbers of so many digits fit into 64 bits
_MOST_DIGITS = 18


@dataclass(frozen=True)
class Ids:
    """The ids of the rows of a table.

    Attributes:
        numbers: (N,) of the landmarks; `UNIDENTIFIED` where the cell is empty.
        names: {name: number} where the names of landmarks contain no number.
        notes: one sentence each.
    """

    numbers: np.ndarray
    names: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def ids_of(table: Table, column: int, known: Mapping[str, int] | None = None) -> Ids:
    """The ids in a column of a table.

    Args:
        table: of sightings, or of the true map.
        column: its number.
        known: numbers of landmarks that have names in another table, which stay.

    Raises:
        LogError: an id is a number, but not a whole one.
    """
    try:
        values = table.numbers([column])[:, 0]
    except LogError:
        words = table.words(column)
        empty = np.isin(np.char.lower(words), EMPTY)
        numbers, names = _of_names(words[~empty], known or {})
    else:
        names, empty = {}, np.isnan(values)
        fault = id_fault(table, column, values)
        if (k := first(fault.rows)) is not None:
            raise table.error(k, fault.message(k))
        numbers = _whole(table, column, values)[~empty]
    ids = np.full(len(table), UNIDENTIFIED)
    ids[~empty] = numbers
    notes: tuple[str, ...] = ()
    if empty.any():
        notes = (f"{table.source}: {empty.sum()} of {len(table)} rows have no id",)
    if np.any(none := ids == NO_ID):
        ids[none] = UNIDENTIFIED
        have = "row has" if none.sum() == 1 else "rows have"
        notes = (*notes, f"{table.source}: {none.sum():,} of {len(table):,} {have} the id -1, taken as no id")
    if names:
        listed = named(f"{number} = {name}" for name, number in names.items())
        notes = (*notes, f"{table.source}: landmarks have names, ids count them: {listed}")
    return Ids(ids, names, notes)


def id_fault(table: Table, column: int, values: np.ndarray) -> Fault:
    """The rows whose id (N,), NaN where it is empty, is no whole number of 64 bits."""
    order = "" if table.names else ": is the order of the columns t, id, range, bearing?"
    wrong = ~np.isnan(values) & ((values % 1 != 0) | (np.abs(values) >= 2.0**63))
    return Fault(
        wrong, "an id that is no whole number of 64 bits",
        lambda k: f"the id {table.title(column)} is {values[k]:g}, but ids are whole numbers "
        + ("of less than 64 bits or words" if abs(values[k]) >= 2.0**63 else f"or words{order}"),
    )  # fmt: skip


def _whole(table: Table, column: int, values: Array) -> np.ndarray:
    """The whole numbers (N,) of a column of ids whose floating-point numbers are ``values``; 0 where it is NaN.

    Raises:
        LogError: a number does not fit into 64 bits, where the smallest one stands for `UNIDENTIFIED`.
    """
    if (k := first(np.abs(values) >= 2.0**63)) is not None:
        raise table.error(
            k,
            f"the id {table.title(column)} is {values[k]:g}, but ids are words, or whole numbers of less than 64 bits",
        )
    whole = np.where(np.isnan(values), 0.0, values).astype(np.int64)
    large = np.flatnonzero(np.abs(values) >= 2.0**53)
    if large.size:
        # their last digits are in the text only
        words = table.words(column)[large]
        for k, word in zip(large.tolist(), words.tolist()):
            with suppress(ValueError, OverflowError):  # 1e17, and what rounds up to 2^63
                whole[k] = int(word)
    return whole


def _of_names(words: np.ndarray, known: Mapping[str, int]) -> tuple[np.ndarray, dict[str, int]]:
    """Numbers (N,) of landmarks that have names, and their names where these contain no number.

    They are the number at the end of each name where these differ, and else count the names. Names that are known keep
    their number, and others get the next ones.
    """
    unique, which = np.unique(words, return_inverse=True)
    listed = [str(name) for name in unique]
    ends = [name[len(name.rstrip("0123456789")) :] for name in listed]
    short = all(0 < len(end) <= _MOST_DIGITS for end in ends)
    if not known and short and len({int(end) for end in ends}) == len(listed):
        return np.array([int(end) for end in ends], dtype=np.int64)[which], {}
    begin = max(known.values(), default=-1) + 1
    new = {name: begin + k for k, name in enumerate(name for name in listed if name not in known)}
    names = {**known, **new}
    return np.array([names[name] for name in listed], dtype=np.int64)[which], names


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
