"""A folder of tables of your own robot: ``odometry.csv``, ``sightings.csv``, and ``truth.csv``, ``map.csv`` where known.

``relations.csv`` and ``positions.csv`` hold what other sensors measured, loop closures and GPS for example.

The endings may be .csv, .tsv, .txt, .tum, .dat or .parquet. Columns are recognised by common names (`Log.from_tables`).
``import.toml`` in the folder states units, columns, clocks and other names of files (`tables.recipe`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..files import check_unpacked
from ..log import Log
from ..reading import ReadOptions
from ..tables.join import Drive, read_drive
from ..tables.options import TABLES
from ..tables.recipe import Recipe, read_recipe
from ..tables.sources import PARQUET, TEXT
from .base import Format, errors_name

RECIPE = "import.toml"
_NAMES = {"truth": ("truth", "groundtruth", "ground_truth"), "map": ("map", "landmarks")}


def _recognises(path: Path, _: bytes) -> bool:
    return path.is_dir() and any(_candidates(path, table) for table in ("odometry", "sightings"))


def _candidates(folder: Path, table: str) -> list[Path]:
    names = _NAMES.get(table, (table,))
    return sorted(
        path for path in folder.iterdir() if path.stem.lower() in names and path.suffix.lower() in (*TEXT, *PARQUET)
    )


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
            raise FormatError(
                folder,
                None,
                f"{names} could both hold {holds}; name one in {RECIPE}, as in [{table}] file = {paths[0].name!r}",
            )
        if paths:
            found[table] = paths[0]
        elif table in ("odometry", "sightings"):
            for packed in sorted(folder.glob(f"{table}.*.*")):
                with packed.open("rb") as stream:
                    check_unpacked(packed, stream.read(16))
            message = (
                f"this file is missing; it would hold {holds}. A file of another name can be named in {RECIPE}, as in "
                f"[{table}] file = 'NAME.csv'"
            )
            raise FormatError(folder / f"{table}.csv", None, message)
    return found


def drive_of(folder: Path, recipe: Recipe | None = None) -> Drive:
    """The streams of the tables of a folder.

    Args:
        folder: with the tables.
        recipe: units, columns and names; default: that of the folder.

    Raises:
        LogError: a file is missing, or breaks a rule of its table.
    """
    recipe = recipe_of(folder) if recipe is None else recipe
    tables: dict[str, Any] = dict(find_tables(folder, recipe))
    return read_drive(**tables, options=recipe.options)


def recipe_of(folder: Path) -> Recipe:
    """The recipe in a folder, or an empty one.

    Raises:
        FormatError: it has a mistake.
    """
    path = folder / RECIPE
    return read_recipe(path) if path.is_file() else Recipe()


def _read(folder: Path, options: ReadOptions) -> Log:
    if not folder.is_dir():
        raise FormatError(folder, None, "a log of tables is a folder with odometry.csv and sightings.csv, not a file")
    with errors_name(folder):
        return Log(**drive_of(folder, recipe_of(folder).strictly(options.strict)).parts(options, folder.resolve().name))


FORMAT = Format("tables", _recognises, _read, separate_times=True)
