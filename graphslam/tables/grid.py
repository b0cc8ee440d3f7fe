"""`Grid`: the cells of a large, regular text table, read as numbers by NumPy instead of line by line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..se2 import Array

#: rows that are read at once, so that their digits stay in the cache of the processor
_ROWS = 1 << 15
#: floating-point numbers hold whole numbers up to the first, and powers of ten up to the second, exactly
_EXACT, _POWERS = 2**53, 22
#: whole numbers of so many digits fit into 64 bits without a sign
_DIGITS = 19
#: no number is written in more letters
_LONGEST = 400
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
            if np.max(self.ends[rest, column] - self.begins[rest, column]) > _LONGEST:
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
