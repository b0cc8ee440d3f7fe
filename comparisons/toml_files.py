"""Configuration files in TOML: read with a clear word for what is wrong in them, and written again.

Reading is the standard library's `tomllib`; it has no writer, and the few kinds of value that are written here need
no further package.
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from graphslam import FormatError
from graphslam.files import check_file

#: what TOML calls the types that Python reads from it
_NAMES = {str: "text in quotes", int: "a whole number", float: "a number", bool: "true or false", list: "a list [..]",
          dict: "a table"}  # fmt: skip
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class TomlFile:
    """A TOML file and what it holds, able to say on which line a key stands.

    Args:
        path: of the file.

    Attributes:
        path, text, table: the file, its text, and what it holds.

    Raises:
        FormatError: there is no such file, or it is no TOML; with the line.
    """

    def __init__(self, path: Path) -> None:
        check_file(path)
        self.path = path
        try:
            self.text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise FormatError(path, None, "this is not text in UTF-8; a TOML file is needed here") from None
        try:
            self.table: dict[str, Any] = tomllib.loads(self.text)
        except tomllib.TOMLDecodeError as error:
            found = re.search(r"\(at line (\d+), column \d+\)$", str(error))
            message = re.sub(r" \(at .*\)$", "", str(error))
            raise FormatError(path, int(found[1]) if found else None, f"not valid TOML: {message}") from None

    def error(self, key: str, message: str) -> FormatError:
        """The error of a key, ``table.key`` where it stands in a table, with its line where it is found."""
        return FormatError(self.path, self.line_of(key), message)

    def line_of(self, key: str) -> int | None:
        """The first line that sets the last part of ``key`` (or opens a table of that name), or None."""
        last = re.escape(key.rsplit(".", 1)[-1])
        pattern = re.compile(rf"""^\s*(\[+[^\]]*\b{last}\s*\]|([\w.-]+\.)?["']?{last}["']?\s*(=|\.))""")
        for number, line in enumerate(self.text.splitlines(), start=1):
            if pattern.match(line):
                return number
        return None

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], where: str = "") -> None:
        """Raise `FormatError` for the first key that is not known, naming the nearest one that is.

        Args:
            table: whose keys are checked.
            known: the keys that may be there.
            where: the name of the table, for the message.
        """
        for key in table:
            if key not in known:
                place = f" in [{where}]" if where else ""
                raise self.error(key, f"unknown key {key!r}{place}; did you mean {nearest(key, known)!r}?")

    def value(self, table: Mapping[str, Any], key: str, *types: type, where: str = "") -> Any:
        """The value of a key, None where it is absent.

        A whole number stands for a float where a float is allowed; true and false stand for no number.

        Raises:
            FormatError: it is of none of the types.
        """
        value = table.get(key)
        if value is None or (type(value) in types):
            return value
        if float in types and type(value) is int:
            return float(value)
        place = f"{where}.{key}" if where else key
        raise self.error(key, f"{place} should be {' or '.join(_NAMES[t] for t in types)}, not {value!r}")


def nearest(word: str, known: Collection[str]) -> str:
    """The known word that is most like a mistyped one."""
    return difflib.get_close_matches(word, list(known), n=1, cutoff=0.0)[0]


def to_toml(table: Mapping[str, Any], comment: str = "") -> str:
    """A table as TOML that `tomllib` reads back equal: texts, numbers, true and false, lists of these, and tables.

    Args:
        table: keys with None are left out, because TOML has no such value.
        comment: lines for the head of the file.
    """
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + "".join(_lines(table, ()))


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [f"\n[{'.'.join(map(_key, path))}]\n"] if path else []
    present = {key: value for key, value in table.items() if value is not None}
    # plain values first: what follows a [table] belongs to it
    lines += [f"{_key(k)} = {_value(v)}\n" for k, v in present.items() if not isinstance(v, Mapping)]
    for key, value in present.items():
        if isinstance(value, Mapping):
            lines += _lines(value, (*path, key))
    return lines


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return _text(str(value))


def _text(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML also wants the delete character escaped
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
