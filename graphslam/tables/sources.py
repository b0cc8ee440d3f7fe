"""The sources of tables: text files, Parquet files, data frames, mappings and arrays."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, quoted
from ..files import check_file
from .table import Columns, Table
from .text_table import TextTable

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
