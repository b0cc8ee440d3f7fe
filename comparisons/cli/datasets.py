"""The verb ``datasets``: which well-known data sets can be read, and which are at hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import JsonFile
from .support import DIFFERENT, Output, sentences


def datasets(
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Where to look.", show_default="the folder named by SLAM_DATA, or ../shared/data"
        ),
    ] = None,
    json: JsonFile = None,
) -> None:
    """List the known data sets, where they are published and how they must look; find and check those at hand."""
    with sentences():
        from graphslam import OptionError

        from ..datasets import survey
        from ..tables import datasets_remarks, datasets_table

        output = Output(json)
        if folder is not None and not folder.is_dir():
            raise OptionError(f"--folder {folder}: there is no such folder")
        with output.bar("data sets", None) as advance:

            def told(path: Path) -> None:
                advance(1, path.name)
                output.detail(f"reading {path}")

            outcome = survey(folder, progress=told)
        output.say(*datasets_remarks(outcome))
        output.console.print(datasets_table(outcome))
        output.json(outcome.to_json())
        if outcome.problems:
            output.say(*(f"CANNOT BE READ: {problem}" for problem in outcome.problems))
            raise typer.Exit(DIFFERENT)
