"""`Table`: what every table has, whether its rows are lines of a file, rows of a data frame, or messages of a bag."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, quoted
from ..se2 import Array


class Table(ABC):
    """Columns with names.

    Attributes:
        source: what messages call the table: a file, or a topic of a bag.
        names: of the columns; empty where the table has none.
        width: the number of columns.
        notes: what the reader changed, one sentence each.
    """

    source: str
    names: tuple[str, ...]
    width: int
    notes: tuple[str, ...] = ()

    @abstractmethod
    def __len__(self) -> int:
        """The number of rows."""

    @abstractmethod
    def numbers(self, columns: Sequence[int]) -> Array:
        """Columns (N, k) as floating-point numbers, which may be NaN.

        Raises:
            LogError: a cell is no number; with its place.
        """

    @abstractmethod
    def words(self, column: int) -> np.ndarray:
        """A column (N,) as text, or as whole numbers where the table has these."""

    def texts(self, column: int) -> np.ndarray:
        """A column (N,) as bytes of ASCII, or as whole numbers where the table has these."""
        words = self.words(column)
        return words if words.dtype.kind in "iu" else np.char.encode(words, "ascii", "replace")

    def decimals(self, column: int) -> tuple[np.ndarray, np.ndarray] | None:  # noqa: ARG002  # of tables in text files
        """A column as whole numbers m (N,) and decimal places k (N,), each number m / 10^k; None where it is none."""
        return None

    @abstractmethod
    def error(self, row: int | None, message: str) -> LogError:
        """The error of a row, counted from 0, or of the whole table."""

    def place(self, row: int) -> str:
        """The name of a row in notes."""
        return str(self.error(row, "")).rstrip(": ")

    def title(self, column: int) -> str:
        """The name of a column in messages."""
        return quoted(self.names[column]) if self.names else f"column {column + 1}"


class Columns(Table):
    """A table in memory.

    Args:
        source: its name.
        columns: {name: (N,)}; or without names, an array (N, k).
        rows: what messages call its rows.
    """

    def __init__(self, source: str, columns: Mapping[str, Any] | Array, *, rows: str = "row") -> None:
        self.source, self._rows = source, rows
        if isinstance(columns, Mapping):
            self.names = tuple(map(str, columns))
            self._columns = [np.asarray(column) for column in columns.values()]
        else:
            self.names = ()
            self._columns = list(np.asarray(columns).T)
        self.width = len(self._columns)

    def __len__(self) -> int:
        return len(self._columns[0]) if self._columns else 0

    def numbers(self, columns: Sequence[int]) -> Array:
        numbers = np.empty((len(self), len(columns)))
        for k, column in enumerate(columns):
            values = self._columns[column]
            try:
                numbers[:, k] = values
            except (TypeError, ValueError, OverflowError):
                for row, value in enumerate(values):
                    try:
                        float(value)
                    except (TypeError, ValueError, OverflowError):
                        message = f"{self.title(column)} should be a number, not {quoted(str(value))}"
                        raise self.error(row, message) from None
                rows = f"; it has {len(values)}, and the first column {len(self)}" if len(values) != len(self) else ""
                raise self.error(
                    None, f"{self.title(column)} should hold one number in each {self._rows}{rows}"
                ) from None
        return numbers

    def words(self, column: int) -> np.ndarray:
        values = self._columns[column]
        return values if values.dtype.kind in "iu" else values.astype(str)

    def error(self, row: int | None, message: str) -> LogError:
        if row is None:
            return FormatError(self.source, None, message)
        return FormatError(f"{self.source}, {self._rows} {row + 1}", None, message)


class Kept(Table):
    """Some rows of a table; errors name the rows of the whole.

    Args:
        table: the whole.
        rows: (N,) numbers of the rows that are kept.
        notes: about what is left out.
    """

    def __init__(self, table: Table, rows: np.ndarray, notes: tuple[str, ...]) -> None:
        self.source, self.names, self.width = table.source, table.names, table.width
        self.notes = (*table.notes, *notes)
        self._table, self._rows = table, rows

    def __len__(self) -> int:
        return len(self._rows)

    def numbers(self, columns: Sequence[int]) -> Array:
        return self._table.numbers(columns)[self._rows]

    def words(self, column: int) -> np.ndarray:
        return self._table.words(column)[self._rows]

    def texts(self, column: int) -> np.ndarray:
        return self._table.texts(column)[self._rows]

    def decimals(self, column: int) -> tuple[np.ndarray, np.ndarray] | None:
        parts = self._table.decimals(column)
        return None if parts is None else (parts[0][self._rows], parts[1][self._rows])

    def error(self, row: int | None, message: str) -> LogError:
        return self._table.error(None if row is None else int(self._rows[row]), message)
