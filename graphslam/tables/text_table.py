"""Tables in text files: separator, decimal mark and header are recognised by the first lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..files import read_text
from ..se2 import Array
from .table import Table

#: separators; None is any white space
_SEPARATORS = ("\t", ";", ",", "|", None)
#: how many lines decide
_HEAD = 50
#: cells that stand for a number that is not known
_MISSING = ("", "na", "n/a", "null", "none", "-")


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
            raise FormatError(path, None, "the file is empty; a table with a row for each time is needed here")
        lines = text.strip("\r\n").splitlines()
        comments, self._quoted = "#" in text, '"' in text
        blank = re.search(r"\n[ \t\r\f\v]*\n", text) or lines[0].isspace()
        rows = [line for line in lines if line and not line.isspace()] if blank else lines
        if comments:
            rows = [line for line in rows if not line.lstrip().startswith("#")]
        if not rows:
            raise FormatError(path, None, "the file has comments only; a table with a row for each time is needed here")
        self._separator, self._decimal_comma = _form(path, rows[1 : _HEAD + 1] or rows)
        first = self._cells(rows[0])
        self._header = not any(map(self._is_number, first))
        # above the rows a comment with as many words may name the columns, as in the files of TUM
        titles = first if self._header else self._titles_in_comments(lines, len(first)) if comments else []
        self.names: tuple[str, ...] = tuple(titles)
        self._rows = rows[1:] if self._header else rows
        self.width = len(first)
        if not self._rows:
            raise FormatError(path, 1, "there is a header, but no row below it")
        self._known: dict[int, Array] = {}
        self._checked = False
        decimal = f"{path.name}: commas were read as decimal points"
        self.notes = (decimal,) if self._decimal_comma else ()

    def __len__(self) -> int:
        return len(self._rows)

    def prepare(self, columns: Sequence[int]) -> None:
        try:
            numbers = self._loaded(columns)
        except ValueError:
            return  # `numbers` reads column by column, and says what is wrong
        self._known = dict(zip(columns, numbers.T))

    def _loaded(self, columns: Sequence[int]) -> Array:
        rows = [row.replace(",", ".") for row in self._rows] if self._decimal_comma else self._rows
        return np.loadtxt(rows, delimiter=self._separator, usecols=columns, ndmin=2, quotechar='"')

    def numbers(self, columns: Sequence[int]) -> Array:
        self._check_widths(columns)
        if self._known.keys() >= set(columns):
            return np.column_stack([self._known[column] for column in columns])
        try:
            return self._loaded(columns)
        except ValueError:
            self._refuse(columns)
            # what loadtxt refuses though every cell is a number: missing cells, and words for NaN
            return np.array([[self._number(self._cells(row)[k]) for k in columns] for row in self._rows])

    def _check_widths(self, columns: Sequence[int]) -> None:
        """Raise the error of a row with other columns, which loadtxt ignores where they are more."""
        if self._separator is None or self._quoted or self._checked:
            return
        if {row.count(self._separator) for row in self._rows} != {self.width - 1}:
            self._refuse(columns)
        self._checked = True

    def words(self, column: int) -> np.ndarray:
        texts = np.loadtxt(
            self._rows, delimiter=self._separator, usecols=[column], ndmin=1, quotechar='"', dtype=str,
        )  # fmt: skip
        return np.char.strip(texts)

    def texts(self, column: int) -> np.ndarray:
        return np.loadtxt(self._rows, delimiter=self._separator, usecols=[column], ndmin=1, quotechar='"', dtype="S40")

    def error(self, row: int | None, message: str) -> FormatError:
        return FormatError(self.path, None if row is None else self._line(row), message)

    def _line(self, row: int) -> int:
        """The line, counted from 1, of a row."""
        found = -1 - self._header
        for number, line in enumerate(read_text(self.path).splitlines(), start=1):
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
                    raise self.error(row, f"{self.title(column)} should be a number, not {cells[column]!r}")

    def _named(self) -> str:
        return f" ({', '.join(self.names)})" if self.names else ""


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
    if cell.lower() in _MISSING:
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
            path, None, f"cannot find columns in {head[0][:60]!r}; separate them by commas, semicolons, tabs or spaces"
        )
    return best[1], best[2]
