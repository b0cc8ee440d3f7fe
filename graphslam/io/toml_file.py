"""A TOML file whose keys know their lines, so that messages about them can name these."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from ..errors import FormatError, OptionError, quoted, shortened
from ..errors.checks import suggestion
from ..files import read_text

T = TypeVar("T")

#: how messages name the types that a key may have
TYPE_NAMES = {str: "text in quotes", int: "a whole number", float: "a number", bool: "true or false", list: "a list [..]",
              dict: "a table"}  # fmt: skip


class TomlFile:
    """A TOML file and its content, which can name the line of a key.

    Args:
        path: of the file.

    Attributes:
        path, text, table: the file, its text, and its content.

    Raises:
        FormatError: there is no such file, or it is not valid TOML; with the line.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.text = path, read_text(path)
        try:
            self.table: dict[str, Any] = tomllib.loads(self.text)
        except RecursionError:
            raise FormatError(path, None, "lists or tables are nested more deeply than any option is") from None
        except tomllib.TOMLDecodeError as error:
            found = re.search(r"\(at line (\d+), column \d+\)$", str(error))
            message = re.sub(r" \(at .*\)$", "", str(error))
            raise FormatError(path, int(found[1]) if found else None, f"not valid TOML: {shortened(message)}") from None
        except ValueError:
            # Python reads whole numbers of at most 4,300 digits
            long = re.search(r"[0-9_]{4000}", self.text)
            line = self.text.count("\n", 0, long.start()) + 1 if long else None
            raise FormatError(path, line, "a whole number has thousands of digits, more than can be read") from None

    def error(self, key: str, message: str) -> FormatError:
        """The error of a key, "table.key" where it stands in a table, with its line where it can be determined."""
        return FormatError(self.path, self.line_of(key), message)

    def line_of(self, key: str) -> int | None:
        """The line on which the statement begins that sets a key, "table.key" or "tables[1].key"; None if there is none.

        The first lines that have the key are found by bisection.
        """
        path, lines = re.findall(r"[^.\[\]]+", key), self.text.split("\n")
        if not _holds(self.table, path):
            return None
        end = bisect_left(range(len(lines)), True, key=lambda end: _holds(_whole(lines, end)[0], path))
        # one statement, perhaps below comments
        begin = _whole(lines, end - 1)[1]
        return next(k for k in range(begin, end) if lines[k].strip() and lines[k].lstrip()[0] != "#") + 1

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], where: str = "") -> None:
        """Raise `FormatError` for the first key that is not known; the message names the nearest one that is.

        Args:
            table: whose keys are checked.
            known: the keys that may be there.
            where: the name of the table, for the message.
        """
        for key in table:
            if key not in known:
                place = f" in [{where}]" if where else ""
                raise self.error(
                    f"{where}.{key}" if where else key,
                    f"unknown key {quoted(key)}{place}" + (suggestion(key, known) or f"; known are {', '.join(known)}"),
                )

    def value(self, table: Mapping[str, Any], key: str, *types: type, where: str = "") -> Any:
        """The value of a key, None where it is absent. A whole number may stand for a float.

        Raises:
            FormatError: it is of none of the types.
        """
        value = table.get(key)
        if value is None or (type(value) in types):
            return value
        place = f"{where}.{key}" if where else key
        if float in types and type(value) is int:
            try:
                return float(value)
            except OverflowError:
                raise self.error(place, f"{place} has {len(str(value))} digits, more than a number can have") from None
        raise self.error(place, f"{place} should be {' or '.join(TYPE_NAMES[t] for t in types)}, not {quoted(value)}")

    def attempt(self, make: Callable[[], T], where: str = "") -> T:
        """The result of a function; its `OptionError` becomes a `FormatError` with the line of the option.

        Args:
            make: its error message begins with the name of the option.
            where: the table of the option.
        """
        try:
            return make()
        except OptionError as error:
            name = str(error).split()[0].rstrip(":")
            raise self.error(f"{where}.{name}" if where else name, str(error)) from None


def _whole(lines: Sequence[str], end: int) -> tuple[dict[str, Any], int]:
    """The content of the whole statements among the first lines up to ``end``, and the number of lines that these take."""
    while True:
        with suppress(tomllib.TOMLDecodeError):
            return tomllib.loads("\n".join(lines[:end])), end
        end -= 1


def _holds(value: Any, path: Sequence[str]) -> bool:
    """Whether a table has the key of a path; digits count the tables of an array."""
    for part in path:
        if isinstance(value, list):
            if not part.isdigit() or int(part) >= len(value):
                return False
            value = value[int(part)]
        elif isinstance(value, Mapping) and part in value:
            value = value[part]
        else:
            return False
    return True
