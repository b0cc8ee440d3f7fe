"""Measured results in pages, from the files that `benchmarks/recording.py` writes: docs/measured/NAME.json.

A page may have these, within a line, and the last one on a line of its own:

    {{ measured FILE ROW FIELD }}                   a value of a row, as `columns.toml` shows the field
    {{ measured FILE ROW FIELD FORMAT }}            in a format of `shown`
    {{ measured FILE ROW FIELD FORMAT OTHER }}      the value over that of another row
    {{ when FILE ... }}                             the dates and machines of the measurements
    {{ table FILE key=value|value COLUMN ... }}     the rows with these values; the columns are those of `columns.toml`
"""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path
from string import Formatter
from typing import Any

FOLDER = Path(__file__).parents[1] / "measured"
COLUMNS = tomllib.loads(Path(__file__).with_name("columns.toml").read_text(encoding="utf-8"))
#: Japanese for values that are words
WORDS = COLUMNS.pop("words")
_INLINE = re.compile(r"\{\{ (measured|when) (.+?) \}\}")
_TABLE = re.compile(r"^([ \t]*)\{\{ table (.+?) \}\}$", re.MULTILINE)

Row = Mapping[str, Any]


class MeasuredError(ValueError):
    """A marker that names what no file has; the message says what there is."""


def filled(page: str, name: str, language: str = "en") -> str:
    """A page with measured values in the place of their markers.

    Raises:
        MeasuredError: a file, row, field or column does not exist; with the name of the page and the marker.
    """

    def text(found: re.Match[str]) -> str:
        try:
            words = shlex.split(found[2])
            if found.re is _TABLE:
                return "\n".join(found[1] + line for line in _table(language, *words))
            return _when(language, *words) if found[1] == "when" else _value(language, *words)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise MeasuredError(f"{name}: {found[0].strip()}: {error}") from None

    return _TABLE.sub(text, _INLINE.sub(text, page))


def shown(value: Any, how: str = "") -> str:
    """A value as text: text as it is, "–" for None, "yes" or "no", and a number in a format.

    Args:
        value: from a file.
        how: a format of Python; "2r" for two significant digits; "1/" before a format for the reciprocal, as in 1/7.8; "time"
            for seconds, in ms below one second; nothing for whole numbers.
    """
    if value is None or isinstance(value, bool | str):
        return {None: "–", True: "yes", False: "no"}.get(value, value)
    if how.startswith("1/"):
        return f"1/{shown(1 / value, how[2:])}"
    if how == "time":
        number, unit = (value, "s") if value >= 1 else (1e3 * value, "ms")
        return f"{shown(number, '2r' if number < 100 else ',.0f')} {unit}"
    if digits := re.fullmatch(r"(\d)r", how):
        places = int(digits[1]) - 1 - int(f"{value:.{int(digits[1]) - 1}e}".partition("e")[2])
        return f"{round(value, places):,.{max(places, 0)}f}"
    if not how and not isinstance(value, int):
        raise MeasuredError("the field is not in columns.toml; the marker needs a format, such as .2f")
    return format(value, how or ",d")


def rows(file: str) -> dict[str, Row]:
    """The rows of a file by name, each with its command, date and machine."""
    path = FOLDER / f"{file}.json"
    if not path.exists():
        raise MeasuredError(
            f"no file {file!r}; there are {_names(each.stem for each in sorted(FOLDER.glob('*.json')))}"
        )
    run = json.loads(path.read_text(encoding="utf-8"))
    listed = run.pop("rows")
    return {row["name"]: run | row for row in listed}


def _value(language: str, file: str, name: str, field: str, how: str = "", other: str = "") -> str:
    row, *others = (_of(rows(file), each, f"{file}.json has no row") for each in (name, other) if each)
    how = how or COLUMNS.get(field, {}).get("show", "")
    if not others:
        return _cell(row, field, how, language)
    value, below = (_of(each, field, f"the row {each['name']!r} has no field") for each in (row, *others))
    return shown(value / below, how)


def _table(language: str, file: str, *words: str) -> list[str]:
    """The lines of a table; rows stand in the order of the values that are asked for, the first key first."""
    chosen = list(rows(file).values())
    for key, asked in reversed([word.split("=", 1) for word in words if "=" in word]):
        values = asked.split("|")
        there = {str(row.get(key)): None for row in chosen}
        if missing := [value for value in values if value not in there]:
            raise MeasuredError(f"no row has {key} {_names(missing)}; there are {_names(there)}")
        chosen = sorted(
            (row for row in chosen if str(row.get(key)) in values), key=lambda row: values.index(str(row[key]))
        )
    columns = {word: _of(COLUMNS, word, "columns.toml has no column") for word in words if "=" not in word}
    heads = [column.get(language) or column["en"] for column in columns.values()]
    cells = [[_cell(row, name, column.get("show", ""), language) for name, column in columns.items()] for row in chosen]
    return [f"| {' | '.join(line)} |" for line in (heads, ["---"] * len(heads), *cells)]


def _cell(row: Row, name: str, show: str, language: str) -> str:
    """A cell; ``show`` is the format of a field or, with braces, a text with several."""
    text = _Text().vformat(show if "{" in show else f"{{{name}:{show}}}", (), row)
    return WORDS.get(text, text) if language == "ja" else text


class _Text(Formatter):
    """Texts with the fields of a row in braces."""

    def get_value(self, key: int | str, args: Any, kwargs: Any) -> Any:
        return _of(kwargs, str(key), f"the row {kwargs['name']!r} has no field")

    def format_field(self, value: Any, format_spec: str) -> str:
        return shown(value, format_spec)


def _when(language: str, *files: str) -> str:
    """The days of the measurements of files, and on which machines."""
    listed = [row for file in files for row in rows(file).values()]
    # "seconds_date" where the times of a row are older than its other figures
    dates = {row[key] for row in listed for key in ("date", "seconds_date") if key in row}
    first, last = (date.fromisoformat(day(dates)) for day in (min, max))
    if language == "ja":
        days = f"{first.year}年{first.month}月{first.day}日"
        if first != last:
            days += f"から{f'{last.year}年' * (first.year != last.year)}{last.month}月{last.day}日"
    else:
        days = f"{last.day} {last:%B %Y}"
        if first != last:
            more = " %B %Y" if first.year != last.year else " %B" if first.month != last.month else ""
            days = f"{first.day}{first.strftime(more)} to {days}"
    return f"{days} ({'; and '.join(dict.fromkeys(row['machine'] for row in listed))})"


def _of(there: Mapping[str, Any], name: str, what: str) -> Any:
    """What has a name, or an error that says which names there are."""
    if name not in there:
        raise MeasuredError(f"{what} {name!r}; there are {_names(there)}")
    return there[name]


def _names(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))
