"""Tables in text files: separator, decimal mark and header are recognised by the first lines.

`Grid`: the cells of a large, regular text table, read as numbers by NumPy instead of line by line.

The sources of tables: text files, Parquet files, data frames, mappings and arrays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, named, quoted
from ..files import check_file, read_text
from ..se2 import Array
from .table import Columns, Table

#: rows that are read at once, so that their digits stay in the cache of the processor
_ROWS = 1 << 15
#: floating-point numbers hold whole numbers up to the first, and powers of ten up to the second, exactly
_EXACT, _POWERS = 2**53, 22
#: whole numbers of so many digits fit into 64 bits without a sign
_DIGITS = 19
#: no number is written in more letters
_LONGEST_NUMBER = 400
#: cells that stand for a number that is not known
MISSING = (b"", b"na", b"n/a", b"null", b"none", b"-")


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of a text in which every row has the same number of columns; made by `grid_of`.

    Attributes:
        text: its bytes.
        begins, ends: (N, k) where each cell begins and ends.
        mark: the decimal point or comma.
    """

    text: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    mark: str

    def numbers(self, column: int) -> Array:
        """A column (N,) as the floating-point numbers that are nearest to the decimal ones.

        A whole number m below 2^53 and a power of ten up to 10^22 are exact, so that m / 10^k is rounded once.

        Raises:
            ValueError: a cell is no number.
        """
        whole, places, negative, simple = self._decimals(column)
        values = whole / 10.0 ** np.minimum(places, _POWERS)
        # not of an integer, which has no -0
        values[negative] *= -1.0
        if (rest := np.flatnonzero(~simple | (whole >= _EXACT) | (places > _POWERS))).size:
            # more digits, exponents, words
            if np.max(self.ends[rest, column] - self.begins[rest, column]) > _LONGEST_NUMBER:
                raise ValueError  # every cell would take as much memory as the longest one
            cells = np.char.strip(self._cells(column, rest))
            if np.any(np.char.find(cells, b"_") >= 0):
                raise ValueError  # Python reads 1_0 as 10, other programs do not
            cells[np.isin(np.char.lower(cells), MISSING)] = b"nan"
            values[rest] = cells.astype(float)
        return values

    def decimals(self, column: int) -> tuple[np.ndarray, np.ndarray] | None:
        """A column as whole numbers m (N,) and decimal places k (N,): each number is m / 10^k. None where one is not."""
        whole, places, negative, simple = self._decimals(column)
        if not simple.all():
            return None
        signed = whole.astype(np.int64)
        return np.where(negative, -signed, signed), places

    def _decimals(self, column: int) -> tuple[np.ndarray, ...]:
        """Absolute values without the mark, decimal places, signs, and which cells have only sign, digits and mark; (N,)."""
        begins, ends = self.begins[:, column], self.ends[:, column]
        parts = [self._digits(begins[k : k + _ROWS], ends[k : k + _ROWS]) for k in range(0, len(begins), _ROWS)]
        return tuple(map(np.concatenate, zip(*parts)))

    def _digits(self, begins: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, ...]:
        n, lengths = len(begins), ends - begins
        negative = (self.text.take(begins, mode="clip") == ord("-")) & (lengths > 0)
        whole, places, digits = np.zeros(n, dtype=np.uint64), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        marked, simple = np.zeros(n, dtype=bool), lengths <= _DIGITS + 2
        for k in range(min(int(lengths.max()), _DIGITS + 2)):
            letter = self.text.take(begins + k, mode="clip")
            within, digit = lengths > k, letter - np.uint8(ord("0"))
            counts = within & (digit < 10)
            mark = within & (letter == ord(self.mark)) & ~marked
            whole = np.where(counts, np.uint64(10) * whole + digit, whole)
            digits += counts
            places += counts & marked
            marked |= mark
            simple &= counts | mark | ~within | (negative & (k == 0))
        return whole, places, negative, simple & (digits > 0) & (digits <= _DIGITS) & (whole < 2**63)

    def _cells(self, column: int, rows: np.ndarray) -> np.ndarray:
        """Some cells of a column as bytes."""
        begins, lengths = self.begins[rows, column], (self.ends - self.begins)[rows, column]
        longest = max(3, int(lengths.max()))
        letters = self.text.take(begins[:, None] + np.arange(longest), mode="clip")
        letters[np.arange(longest) >= lengths[:, None]] = 0
        letters[letters == ord(self.mark)] = ord(".")
        return letters.view(f"S{longest}").ravel()


def grid_of(text: str, separator: str, width: int, mark: str) -> Grid | None:
    """The grid of lines of cells; None where a line has not ``width`` cells, or there are quotation marks.

    Args:
        text: the rows.
        separator: one character between cells.
        width: the number of columns.
        mark: the decimal point or comma.
    """
    if '"' in text:
        return None
    letters = np.frombuffer(f"{text}\n".encode(), dtype=np.uint8)
    ends = np.flatnonzero(letters == ord("\n"))
    between = np.flatnonzero(letters == ord(separator))
    if len(between) != (width - 1) * len(ends):
        return None
    bounds = np.empty((len(ends), width + 1), dtype=np.int64)
    bounds[0, 0], bounds[1:, 0], bounds[:, -1] = -1, ends[:-1], ends
    bounds[:, 1:-1] = between.reshape(len(ends), width - 1)
    # separators of another line would not increase
    if np.any(np.diff(bounds, axis=1) <= 0):
        return None
    begins = bounds[:, :-1] + 1
    begins += letters.take(begins, mode="clip") == ord(" ")
    return Grid(letters, begins, bounds[:, 1:], mark)


#: separators; None is any white space
_SEPARATORS = ("\t", ";", ",", "|", None)
#: how many lines decide
_HEAD = 50
#: the longest word in a column of ids, classes or dates
_LONGEST = 1000
#: the longest line with quotation marks; the module csv refuses cells of more than 131,072 letters
_LONGEST_QUOTED = 100_000


class TextTable(Table):
    """A file with one row per line. ``#`` begins a comment; a comment or a line of words above the rows names columns.

    Separators are commas, semicolons, tabs, bars or spaces. Where they are not commas, a comma may be the decimal mark.

    Attributes:
        path: of the file.
        notes: what the reader changed, one sentence each.

    Raises:
        FormatError: the file cannot be read, is empty, or has no columns.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.source = path, str(path)
        text = read_text(path)
        if not text.strip():
            raise FormatError(path, None, "the file is empty; a table with a header and rows is needed here")
        text = text.strip("\n")
        lines: list[str] = []
        if "#" in text or re.search(r"\n[ \t\r\f\v]*\n", text) or not text.partition("\n")[0].strip():
            lines = text.split("\n")
            text = "\n".join(line for line in lines if line.strip() and not line.lstrip().startswith("#"))
        if not text:
            raise FormatError(path, None, "the file has comments only; a table with a header and rows is needed here")
        if '"' in text:
            _check_length(path, text)
        head = text.split("\n", _HEAD + 1)[: _HEAD + 1]
        self._separator, self._decimal_comma = _form(path, head[1:] or head)
        first = self._cells(head[0])
        self._header = not any(map(self._is_number, first))
        # above the rows a comment with as many words may name the columns, as in the files of TUM
        self.names = tuple(first if self._header else self._titles_in_comments(lines, len(first)))
        self.width = len(first)
        if self._header:
            _, below, text = text.partition("\n")
            if not below:
                raise FormatError(path, 1, "there is a header, but no row below it")
        self._text, self._length = text, text.count("\n") + 1
        self._grid = grid_of(text, self._separator or " ", self.width, "," if self._decimal_comma else ".")
        self._known: dict[int, Array] = {}
        if '"' in text:
            self._check_quotes()
        decimal = f"{path.name}: commas were read as decimal points"
        self.notes = (decimal,) if self._decimal_comma else ()

    def __len__(self) -> int:
        return self._length

    @cached_property
    def _rows(self) -> list[str]:
        return self._text.split("\n")

    def numbers(self, columns: Sequence[int]) -> Array:
        for column in columns:
            if column not in self._known:
                self._known[column] = self._column(column)
        return np.column_stack([self._known[column] for column in columns])

    def _column(self, column: int) -> Array:
        if self._grid is not None:
            with suppress(ValueError):
                return self._grid.numbers(column)
        elif self._separator is None or '"' in self._text:
            rows = [row.replace(",", ".") for row in self._rows] if self._decimal_comma else self._rows
            with suppress(ValueError):
                return np.loadtxt(rows, delimiter=self._separator, usecols=[column], ndmin=1, quotechar='"')
        # line by line, which takes longer and says what is wrong
        self._refuse([column])
        return np.array([self._number(self._cells(row)[column]) for row in self._rows])

    def decimals(self, column: int) -> tuple[np.ndarray, np.ndarray] | None:
        return None if self._grid is None else self._grid.decimals(column)

    def words(self, column: int) -> np.ndarray:
        # every row of an array of text takes as much memory as the longest one
        for row, line in enumerate(self._rows):
            if len(line) > _LONGEST and len(cells := self._cells(line)) > column and len(cells[column]) > _LONGEST:
                raise self.error(
                    row, f"{self.title(column)} has {len(cells[column]):,} letters; a word has at most {_LONGEST}"
                )
        try:
            texts = np.loadtxt(
                self._rows, delimiter=self._separator, usecols=[column], ndmin=1, quotechar='"', dtype=str,
            )  # fmt: skip
        except ValueError:
            self._refuse([])
            raise
        return np.char.strip(texts)

    def texts(self, column: int) -> np.ndarray:
        return np.loadtxt(self._rows, delimiter=self._separator, usecols=[column], ndmin=1, quotechar='"', dtype="S40")

    def error(self, row: int | None, message: str) -> FormatError:
        return FormatError(self.path, None if row is None else self._line(row), message)

    def _check_quotes(self) -> None:
        """Raise `FormatError` for the first row in which a text in quotation marks does not end."""
        import csv

        for row, line in enumerate(self._rows):
            if '"' in line:
                reader = csv.reader([line, ""], delimiter=self._separator or " ")
                next(reader)
                # it has read on
                if reader.line_num > 1:
                    raise self.error(
                        row, "a quotation mark is opened and not closed in this line; each row is one line"
                    )

    def _line(self, row: int) -> int:
        """The line, counted from 1, of a row."""
        found = -1 - self._header
        for number, line in enumerate(read_text(self.path).split("\n"), start=1):
            found += bool(line.strip()) and not line.lstrip().startswith("#")
            if found == row:
                return number
        raise AssertionError("every row has a line")

    def _cells(self, line: str) -> list[str]:
        return _split(line, self._separator)

    def _number(self, cell: str) -> float:
        return _number(cell, self._decimal_comma)

    def _is_number(self, cell: str) -> bool:
        try:
            self._number(cell)
        except ValueError:
            return False
        return True

    def _titles_in_comments(self, lines: list[str], width: int) -> list[str]:
        above: list[str] = []
        for line in lines:
            if not line.lstrip().startswith("#"):
                if line.strip():
                    break
                continue
            text = line.strip().lstrip("#").strip()
            for separator in (self._separator, None, ","):
                words = _split(text, separator)
                if len(words) == width and not any(map(self._is_number, words)):
                    above = words
        return above

    def _refuse(self, columns: Sequence[int]) -> None:
        """Raise the error of the first row that is wrong."""
        for row, line in enumerate(self._rows):
            cells = self._cells(line)
            if len(cells) != self.width:
                message = f"expected {self.width} columns{self._named()}, found {len(cells)}"
                if len(cells) == 2 * self.width and self._separator == ",":
                    message += "; does the file have decimal commas? Separate its columns by ; or tabs"
                elif row == len(self._rows) - 1 and len(cells) < self.width:
                    message += " in the last line; was the file cut short?"
                raise self.error(row, message)
            for column in columns:
                if not self._is_number(cells[column]):
                    message = f"{self.title(column)} should be a number, not {quoted(cells[column])}"
                    if tuple(cells) == self.names:
                        message += "; this line repeats the header, as where files were joined; delete it"
                    raise self.error(row, message)

    def _named(self) -> str:
        return f" ({named(self.names)})" if self.names else ""


def _check_length(path: Path, text: str) -> None:
    """Raise `FormatError` for a line that the module csv, which reads quotation marks, cannot read."""
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _LONGEST_QUOTED:
            raise FormatError(
                path,
                None,
                f"row {number} has {len(line):,} letters; with quotation marks it may have {_LONGEST_QUOTED:,}",
            )


def _split(line: str, separator: str | None) -> list[str]:
    if '"' in line:
        import csv

        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator or " "))]
    return [cell.strip() for cell in line.split(separator)]


def _number(cell: str, decimal_comma: bool = False) -> float:
    """A cell as a number; NaN where it is empty or a word for that.

    Raises:
        ValueError: it is neither.
    """
    cell = cell.strip().strip('"')
    if cell.lower().encode() in MISSING:
        return float("nan")
    if "_" in cell:
        raise ValueError  # Python reads 1_0 as 10, other programs do not
    return float(cell.replace(",", ".") if decimal_comma else cell)


def _form(path: Path, head: list[str]) -> tuple[str | None, bool]:
    """The separator of the columns, and whether numbers have decimal commas."""
    best: tuple[float, str | None, bool] = (0.0, ",", False)
    for separator in _SEPARATORS:
        cells = [_split(line, separator) for line in head]
        if (width := max(map(len, cells))) < 2:
            continue
        same = sum(len(row) == width for row in cells) / len(cells)
        for comma in (False, True) if separator != "," else (False,):
            numeric, count, marked = 0, 0, False
            for row in cells:
                for cell in row:
                    count += 1
                    marked |= "," in cell
                    try:
                        _number(cell, comma)
                        numeric += 1
                    except ValueError:
                        pass
            # words alone, as in a header without rows, have columns, too
            score = same * max(numeric / count, 1e-3)
            if score > best[0] + 1e-9 and (marked or not comma):
                best = (score, separator, comma)
    if best[0] == 0.0:
        raise FormatError(
            path, None, f"cannot find columns in {quoted(head[0])}; separate them by commas, semicolons, tabs or spaces"
        )
    return best[1], best[2]


#: endings of the files that are text
TEXT = (".csv", ".tsv", ".txt", ".tum", ".dat")
PARQUET = (".parquet", ".pq")


def table_of(source: Any, name: str) -> Table:
    """The table of a path, a data frame (pandas or alike), a mapping of columns, or an array.

    Args:
        source: what holds the table.
        name: of the table, for messages about one that is no file.

    Raises:
        LogError: it holds no table.
    """
    if isinstance(source, Table):
        return source
    if isinstance(source, (str, PathLike)):
        path = Path(source)
        return _parquet(path) if path.suffix.lower() in PARQUET else TextTable(path)
    if isinstance(source, Mapping):
        for column, values in source.items():
            if np.ndim(values) != 1:
                raise LogError(f"{name}: column {quoted(column)} should be an array (N,), not {quoted(values)}")
        return Columns(name, source)
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):
        return Columns(name, {str(column): np.asarray(source[column]) for column in source.columns})
    try:
        array = np.asarray(source)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.dtype.names:
        return Columns(name, {column: array[column] for column in array.dtype.names})
    if array.ndim != 2:
        raise LogError(
            f"{name} should be the path of a table, a data frame, a mapping of columns or an array (N, k), not "
            f"{type(source).__name__}"
        )
    return Columns(name, array)


def _parquet(path: Path) -> Table:
    check_file(path)
    try:
        import pandas
    except ImportError:
        raise FormatError(path, None, "Parquet files are read by pandas: pip install pandas pyarrow") from None
    try:
        frame = pandas.read_parquet(path)
    except ImportError:
        raise FormatError(path, None, "Parquet files are read by pyarrow: pip install pyarrow") from None
    except (OSError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise FormatError(path, None, f"not a readable Parquet file ({first}); was it cut short?") from None
    return Columns(str(path), {str(column): frame[column].to_numpy() for column in frame.columns})
