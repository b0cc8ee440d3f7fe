"""Tables in text files: separator, decimal mark and header are recognised by the first lines.

`table_of` makes a table of a text file, a Parquet file, a data frame, a mapping or an array.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import chain, takewhile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, named, quoted
from ..files import check_file, path_of, read_text
from ..se2 import Array
from .table import Columns, Table

#: cells that stand for a number that is not known
MISSING = (b"", b"na", b"n/a", b"null", b"none", b"-")
#: separators; None is any white space
_SEPARATORS = ("\t", ";", ",", "|", None)
#: the first letters of lines that are comments, or empty
_NO_ROW = ("", "#")
#: how many lines decide
_HEAD = 50
#: the longest word in a column of ids, classes or dates
_LONGEST = 1000
#: the longest line with quotation marks; the module csv refuses cells of more than 131,072 letters
_LONGEST_QUOTED = 100_000
#: a number with a mark between thousands
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3})+(?:\.\d*)?|(?:\.\d{3})+(?:,\d*)?)")


class TextTable(Table):
    """A file with one row per line. ``#`` begins a comment; a comment or a line of words above the rows names columns.

    Separators are commas, semicolons, tabs, bars or spaces. Where they are not commas, a comma may be the decimal mark.

    Args:
        path: of the file.
        columns: the names of the columns of a file without a header, whose separators are spaces and tabs. It may be empty,
            and comments may end its lines.

    Attributes:
        path: of the file.
        notes: what the reader changed, one sentence each.

    Raises:
        FormatError: the file cannot be read, is empty, or has no columns.
    """

    def __init__(self, path: Path, columns: tuple[str, ...] = ()) -> None:
        self.path, self.source = path, str(path)
        text = read_text(path)
        if columns:
            # comments may follow the numbers of a line
            text = re.sub(r"[ \t]*#[^\n]*", "", text)
        elif not text.strip():
            raise FormatError(path, None, "the file is empty; a table with a header and rows is needed here")
        text = text.strip("\n")
        lines: list[str] = []
        if "#" in text or re.search(r"\n[^\S\n]*(\n|\Z)", text) or not text.partition("\n")[0].strip():
            lines = text.split("\n")
            # as `_is_comment`, without a call for each line
            text = "\n".join([line for line in lines if line.lstrip()[:1] not in _NO_ROW])
        if not text and not columns:
            raise FormatError(path, None, "the file has comments only; a table with a header and rows is needed here")
        if '"' in text:
            _check_length(path, text)
        head = text.split("\n", _HEAD + 1)[: _HEAD + 1]
        self._separator, self._decimal_comma = (None, False) if columns else _form(path, head[1:] or head)
        first = list(columns) or self._cells(head[0])
        # the index that pandas writes has an empty title
        self._header = not columns and not self._holds_numbers([cell for cell in first if cell])
        # above the rows a comment with as many words may name the columns, as in the files of TUM
        self.names = columns or tuple(first if self._header else self._titles_in_comments(lines, len(first)))
        self.width = len(first)
        other = re.search("[;,\t]", first[0]) if self._header and self.width == 1 else None
        if other is not None:
            message = f"the header has {quoted(other[0])} between its columns, and the rows below have not"
            advice = "use one separator in all lines, and no commas at the thousands of numbers"
            raise FormatError(path, 1, f"{message}: {advice}")
        if self._header:
            _, below, text = text.partition("\n")
            if not below:
                raise FormatError(path, 1, "there is a header, but no row below it")
        if self._decimal_comma:
            _check_thousands(path, text)
        self._text, self._length = text, text.count("\n") + bool(text)
        self._known: dict[int, Array] = {}
        if '"' in text:
            self._check_quotes()
        self.notes = (f"{path.name}: commas were read as decimal points",) * self._decimal_comma

    def __len__(self) -> int:
        return self._length

    @cached_property
    def _rows(self) -> list[str]:
        return self._text.split("\n") if self._text else []

    def numbers(self, columns: Sequence[int]) -> Array:
        new = [column for column in columns if column not in self._known]
        try:
            self._known |= dict(zip(new, self._loaded(new, float).T)) if new else {}
        except ValueError:
            self._known |= {column: self._column(column) for column in new}
        return np.column_stack([self._known[column] for column in columns])

    def _column(self, column: int) -> Array:
        """A column cell by cell, which takes longer, knows empty cells and says what is wrong."""
        values = np.empty(len(self))
        for row, line in enumerate(self._even):
            cells = self._cells(line)
            try:
                values[row] = _number(cells[column], self._decimal_comma)
            except ValueError:
                message = f"{self.title(column)} should be a number, not {quoted(cells[column])}"
                if tuple(cells) == self.names:
                    message += "; this line repeats the header, as where files were joined; delete it"
                elif re.fullmatch(r"[\d.,'’\s]*[.,'’\s][\d.,]*", cells[column]):
                    message += "; write decimals with a point, and thousands without a mark"
                raise self.error(row, message) from None
        return values

    def _loaded(self, columns: Sequence[int], kind: Any) -> np.ndarray:
        """Columns (N, k) by NumPy's reader, for numbers with points for decimal commas.

        Raises:
            ValueError: a cell is none of this kind.
        """
        # without a choice of columns NumPy's reader refuses uneven rows itself
        every = kind is float and list(columns) == list(range(self.width))
        rows = self._rows if every else self._even
        if not rows:
            return np.empty((0, len(columns)), dtype=kind)
        if self._decimal_comma and kind is not str:
            rows = [row.replace(",", ".") for row in rows]
        chosen = None if every else columns
        found = np.loadtxt(rows, kind, None, self._separator, usecols=chosen, ndmin=2, quotechar='"')
        if found.shape[1] != len(columns):
            raise ValueError
        return found

    def words(self, column: int) -> np.ndarray:
        # every row of an array of text takes as much memory as the longest one
        for row, line in enumerate(self._rows):
            if len(line) > _LONGEST and len(cells := self._cells(line)) > column and len(cells[column]) > _LONGEST:
                message = f"{self.title(column)} has {len(cells[column]):,} letters; a word has at most {_LONGEST}"
                raise self.error(row, message)
        return np.char.strip(self._loaded([column], str)[:, 0])

    def texts(self, column: int) -> np.ndarray:
        return self._loaded([column], "S40")[:, 0]

    def error(self, row: int | None, message: str) -> FormatError:
        return FormatError(self.path, None if row is None else self._line(row), message)

    def _check_quotes(self) -> None:
        """Raise `FormatError` for the first row in which a text in quotation marks does not end."""
        for row, line in enumerate(self._rows):
            if '"' in line:
                reader = csv.reader([line, ""], delimiter=self._separator or " ")
                next(reader)
                # it has read on
                if reader.line_num > 1:
                    message = "a quotation mark is opened and not closed in this line; each row is one line"
                    raise self.error(row, message)

    def _line(self, row: int) -> int:
        """The line, counted from 1, of a row."""
        lines = enumerate(read_text(self.path).split("\n"), start=1)
        return [number for number, line in lines if not _is_comment(line)][row + self._header]

    def _cells(self, line: str) -> list[str]:
        return _split(line, self._separator)

    def _holds_numbers(self, cells: list[str]) -> bool:
        return any(_is_number(cell, self._decimal_comma) for cell in cells)

    def _titles_in_comments(self, lines: list[str], width: int) -> list[str]:
        above: list[str] = []
        for line in takewhile(_is_comment, lines):
            text = line.strip().lstrip("#").strip()
            for separator in (self._separator, None, ","):
                words = _split(text, separator)
                if len(words) == width and not self._holds_numbers(words):
                    above = words
        return above

    @cached_property
    def _even(self) -> list[str]:
        """The rows, which all have the same number of columns, or a `FormatError` for the first one that has not."""
        separator, simple = self._separator or " ", self._separator is not None and '"' not in self._text
        for row, line in enumerate(self._rows):
            count = line.count(separator) + 1 if simple else len(self._cells(line))
            if count == self.width:
                continue
            titles = f" ({named(self.names)})" if self.names else ""
            message = f"expected {self.width} columns{titles}, found {count}"
            if count == 2 * self.width and self._separator == ",":
                message += "; does the file have decimal commas? Separate its columns by ; or tabs"
            elif row == len(self._rows) - 1 and count < self.width:
                message += " in the last line; was the file cut short?"
            raise self.error(row, message)
        return self._rows


def _check_thousands(path: Path, text: str) -> None:
    """Raise `FormatError` where all numbers with commas, or all with points, have these between thousands."""
    for mark, other in (",.", ".,") if "." in text else ():
        found = (each[0] for each in re.finditer(rf"(?<![\w.,:])[+-]?\d+\{mark}[\d.,]*(?![\w.,:])", text))
        number = next(found, "")
        grouped = all(map(_GROUPED.fullmatch, chain([number], found)))
        # the other mark is that of decimals in a cell that is a number, not a date, an address or a version
        if grouped and re.search(rf"(?<![\w.,:])[+-]?[\d{mark}]*\d\{other}\d+(?![\w.,:])", text):
            message = f"numbers such as {number} seem to have a mark between thousands: write them without it"
            raise FormatError(path, None, message)


def _check_length(path: Path, text: str) -> None:
    """Raise `FormatError` for a line that the module csv, which reads quotation marks, cannot read."""
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _LONGEST_QUOTED:
            most = f"with quotation marks it may have {_LONGEST_QUOTED:,}"
            raise FormatError(path, None, f"row {number} has {len(line):,} letters; {most}")


def _is_comment(line: str) -> bool:
    """Whether a line is a comment, or empty."""
    return line.lstrip()[:1] in _NO_ROW


def _split(line: str, separator: str | None) -> list[str]:
    if '"' in line:
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


def _is_number(cell: str, decimal_comma: bool = False) -> bool:
    """Whether a cell is a number, or empty."""
    try:
        _number(cell, decimal_comma)
    except ValueError:
        return False
    return True


def _form(path: Path, head: list[str]) -> tuple[str | None, bool]:
    """The separator of the columns, and whether numbers have decimal commas."""
    best: tuple[float, str | None, bool] = (0.0, ",", False)
    for separator in _SEPARATORS:
        cells = [_split(line, separator) for line in head]
        if (width := max(map(len, cells))) < 2:
            continue
        same = sum(len(row) == width for row in cells) / len(cells)
        words = [cell for row in cells for cell in row]
        marked = separator != "," and any("," in word for word in words)
        for comma in (False, True) if marked else (False,):
            # words alone, as in a header without rows, have columns, too
            score = same * max(sum(_is_number(word, comma) for word in words) / len(words), 1e-3)
            if score > best[0] + 1e-9:
                best = (score, separator, comma)
    if best[0] == 0.0:
        message = f"cannot find columns in {quoted(head[0])}; separate them by commas, semicolons, tabs or spaces"
        raise FormatError(path, None, message)
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
        path = path_of(source)
        return _parquet(path) if path.suffix.lower() in PARQUET else TextTable(path)
    if isinstance(source, Mapping):
        for column, values in source.items():
            if np.ndim(values) != 1:
                raise LogError(f"{name}: column {quoted(column)} should be an array (N,), not {quoted(values)}")
        return Columns(name, source)
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):
        index = getattr(getattr(source, "index", None), "name", None)
        if index is not None and index not in source.columns:
            # pandas keeps a column apart that was made the index, often the times
            source = source.reset_index()
        return Columns(name, {str(column): np.asarray(source[column]) for column in source.columns})
    try:
        array = np.asarray(source)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.dtype.names:
        return Columns(name, {column: array[column] for column in array.dtype.names})
    if array.ndim != 2:
        wanted = "the path of a table, a data frame, a mapping of columns or an array (N, k)"
        raise LogError(f"{name} should be {wanted}, not {type(source).__name__}")
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
