"""Bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3, or their folder); `graphslam.bags` reads them.

A recipe beside the bag, ``drive.toml`` for ``drive.mcap``, names topics, fields, units and clocks (`tables.recipe`).
"""

from __future__ import annotations

from pathlib import Path

from ..bags.bag import is_bag
from ..bags.read import drive_of_bag
from ..log import Log
from ..reading import ReadOptions
from ..tables.recipe import Recipe, read_recipe
from .base import Format


def recipe_beside(path: Path) -> Recipe:
    """The recipe beside a bag, or an empty one.

    Raises:
        FormatError: it has a mistake.
    """
    beside = path.with_suffix(".toml")
    return read_recipe(beside) if beside.is_file() else Recipe()


def _read(path: Path, options: ReadOptions) -> Log:
    return Log(**drive_of_bag(path, recipe_beside(path).strictly(options.strict)).parts(options, path.resolve().stem))


FORMAT = Format("bag", is_bag, _read, separate_times=True)
