"""A folder of tables of your own robot: ``odometry.csv``, ``sightings.csv``, and ``truth.csv``, ``map.csv`` where known.

``relations.csv`` and ``positions.csv`` hold what other sensors measured, loop closures and GPS for example.

The endings may be .csv, .tsv, .txt, .tum, .dat or .parquet. Columns are recognised by common names (`Log.from_tables`).

A recipe is a TOML file, ``import.toml`` in the folder or named by the user, with the options of tables and bags: units,
columns, clocks and other names of files::

    angles = "degrees"              # any field of TableOptions
    [sightings]                     # odometry, sightings, truth, map
    file = "tags.csv"               # of a folder; of a bag: topic = "/tags"
    clock = 0.12                    # seconds to add to its times
    time = "ms"                     # units of this table: time, angles, lengths
    range = "dist"                  # which column is what, by name or by number from 1
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from ..errors import FormatError, checks, quoted
from ..files import TomlFile, check_unpacked, first_bytes
from ..log import Log
from ..log.drive import ROLES
from ..log.join import Drive, read_drive
from ..log.rows import TABLES, ReadOptions, TableOptions
from ..log.text_table import PARQUET, TEXT
from .base import Format, errors_name

#: keys of the table of a stream that are not its columns
_UNITS = ("time", "angles", "lengths")
_WHERE = ("file", "topic", "child", "parent", "use")
#: of topics of relations and positions: standard deviations [m, rad] instead of those of the messages, and the point of the
#: robot that is measured, forward and left [m]
_NUMBERS = {"relations": ("std",), "positions": ("std", "lever")}


@dataclass(frozen=True)
class Recipe:
    """Options, and for each table where it is: {"odometry": {"file": "wheels.csv"}, ...}; of a bag topics and frames.

    ``numbers`` are those of topics of relations and positions, {"positions": {"std": [0.5], "lever": [0.3, 0.0]}}.
    """

    options: TableOptions = field(default_factory=TableOptions)
    places: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    numbers: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)

    def place(self, table: str, what: str) -> str | None:
        """The place of a table in the recipe: its file, topic, frames; None where there is none."""
        return self.places.get(table, {}).get(what)


def read_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises:
        FormatError: it is not TOML, has an unknown key, or an impossible value; with the line.
    """
    file = TomlFile(path)
    known = [f.name for f in fields(TableOptions)]
    file.check_keys(file.table, (*known, *TABLES))
    values = {name: file.table[name] for name in known if name in file.table}
    stated = file.attempt(lambda: TableOptions(**values))
    units: dict[str, dict[str, str]] = {name: stated.by_table(name) for name in _UNITS}
    columns: dict[str, dict[str, Any]] = {table: dict(stated.columns_of(table)) for table in TABLES}
    clocks = stated.by_table("clocks")
    places: dict[str, dict[str, str]] = {}
    numbers: dict[str, dict[str, list[float]]] = {}
    for table in TABLES:
        content = file.value(file.table, table, dict) or {}
        of_topic = _NUMBERS.get(table, ())
        file.check_keys(content, (*_WHERE, *_UNITS, "clock", *of_topic, *ROLES[table]), table)
        for key in content:
            if key in of_topic:
                numbers.setdefault(table, {})[key] = _list_of(file, content, key, table)
            elif key in _WHERE:
                places.setdefault(table, {})[key] = file.value(content, key, str, where=table)
            elif key in _UNITS:
                units.setdefault(key, {})[table] = file.value(content, key, str, where=table)
            elif key == "clock":
                clocks[table] = file.value(content, key, float, where=table)
            else:
                columns.setdefault(table, {})[key] = file.value(content, key, str, int, where=table)
    given: dict[str, Any] = {
        name: value for name, value in {**units, "columns": columns, "clocks": clocks}.items() if value
    }
    return Recipe(file.attempt(lambda: replace(stated, **given)), places, numbers)


def _list_of(file: TomlFile, content: dict[str, Any], key: str, table: str) -> list[float]:
    """One or two numbers, of which standard deviations are positive."""
    value = file.value(content, key, list, where=table)
    wanted = "[METRES] or [METRES, RADIANS]" if key == "std" else "[FORWARD, LEFT]"
    numbers = [float(each) for each in value if type(each) in (int, float)]
    fits = len(numbers) == len(value) and len(value) in ((1, 2) if key == "std" else (2,))
    if not fits or (key == "std" and not min(numbers) > 0):
        raise file.error(f"{table}.{key}", f"{key} should be {wanted}, not {quoted(value)}")
    return numbers


def merged(recipe: Recipe, changes: Mapping[str, Any]) -> Recipe:
    """The recipe with options of the command line or of Python, which take precedence; None is not given."""
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    known = [f.name for f in fields(TableOptions)]
    checks.check_known("the reader of tables", given, known, f"; its options are {', '.join(known)}")
    return replace(recipe, options=replace(recipe.options, **given))


RECIPE = "import.toml"
_NAMES = {"truth": ("truth", "groundtruth", "ground_truth"), "map": ("map", "landmarks")}


def _recognises(path: Path, _: bytes) -> bool:
    return path.is_dir() and any(_candidates(path, table) for table in ("odometry", "sightings"))


def _candidates(folder: Path, table: str) -> list[Path]:
    names, endings = _NAMES.get(table, (table,)), (*TEXT, *PARQUET)
    return sorted(path for path in folder.iterdir() if path.stem.lower() in names and path.suffix.lower() in endings)


def find_tables(folder: Path, recipe: Recipe) -> dict[str, Path]:
    """The files of the tables of a folder, by table.

    Raises:
        FormatError: odometry or sightings are missing, or there are two files for one table.
    """
    found = {}
    for table, holds in TABLES.items():
        named = recipe.place(table, "file")
        paths = [folder / named] if named else _candidates(folder, table)
        if len(paths) > 1:
            names = " and ".join(path.name for path in paths[:2])
            advice = f"name one in {RECIPE}, as in [{table}] file = {paths[0].name!r}"
            raise FormatError(folder, None, f"{names} could both hold {holds}; {advice}")
        if paths:
            found[table] = paths[0]
        elif table in ("odometry", "sightings"):
            for packed in sorted(folder.glob(f"{table}.*.*")):
                check_unpacked(packed, first_bytes(packed))
            message = f"this file is missing; it would hold {holds}"
            other = f"A file of another name can be named in {RECIPE}, as in [{table}] file = 'NAME.csv'"
            raise FormatError(folder / f"{table}.csv", None, f"{message}. {other}")
    return found


def drive_of(folder: Path, recipe: Recipe) -> Drive:
    """The streams of the tables of a folder, with units, columns and names by a recipe.

    Raises:
        LogError: a file is missing, or breaks a rule of its table.
    """
    tables: dict[str, Any] = dict(find_tables(folder, recipe))
    return read_drive(**tables, options=recipe.options)


def recipe_if_any(path: Path) -> Recipe:
    """The recipe with this path, or an empty one where there is no such file.

    Raises:
        FormatError: it has a mistake.
    """
    return read_recipe(path) if path.is_file() else Recipe()


def _read(folder: Path, options: ReadOptions) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "a log of tables is a folder with odometry.csv and sightings.csv, not a file")
    with errors_name(folder):
        recipe = merged(recipe_if_any(folder / RECIPE), {"strict": options.strict or None})
        return drive_of(folder, recipe).log(options, folder.resolve().name)


FORMAT = Format("tables", _recognises, _read, separate_times=True)
