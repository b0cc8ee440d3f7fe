"""The verbs that come before a run: import, show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import Output
from .verb import LogFile, command

if TYPE_CHECKING:
    from ..options import FigureOptions, ImportOptions, ReadingOptions


def import_(
    output: Output,
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SOURCE] [OUT.npz]",
            help="The folder of tables or the bag, and the log to write; without it, only what was found is listed.",
            show_default=False,
        ),
    ] = None,
    *,
    options: ImportOptions,
) -> None:
    """Make a log of your own tables (CSV, TSV, Parquet) or bag (ROS 1, ROS 2, MCAP): odometry and sightings with times.

    Columns and topics are recognised by their names and types; without OUT the choice is only listed.
    """
    from graphslam import LogError, save

    from ..importing import imported
    from ..saving import check_can_write

    source, out = source_and_out(words or [])
    if out is not None:
        check_can_write(out)
    found = imported(source, options)
    output.show(found)
    if found.log is None:
        raise LogError(found.reason)
    if out is None:
        target = Path(f"{found.log.name}.npz")
        output.hint(f"Nothing was written. Next: {command('import', source, target, options=options)}")
    else:
        save(found.log, out)
        output.say(f"Wrote {out}.")
        output.hint(f"Next: {command('run', out)}")
    output.json(found.to_json(out))


def source_and_out(words: list[str]) -> tuple[Path | None, Path | None]:
    """The folder or bag, or None, and the log to write, or None, of the words '[SOURCE] [OUT]'.

    Raises:
        OptionError: there are more words, or none of them is a source.
    """
    from graphslam import OptionError

    if len(words) > 2:
        raise OptionError("give at most a folder or bag, and a log to write: slam-compare import SOURCE OUT.npz")
    places = [Path(word) for word in words]
    if len(places) == 2:
        return places[0], places[1]
    if not places:
        return None, None
    return (None, places[0]) if places[0].suffix == ".npz" else (places[0], None)


def show(output: Output, log: LogFile = None, *, reading: ReadingOptions, drawing: FigureOptions) -> None:
    """Look at a log before it is solved: times, rates, landmarks, histograms, and what is probably wrong."""
    from ..option import options_of
    from ..options import ReadingOptions
    from ..overview import inspect_log
    from ..saving import FIGURE_FORMATS, check_can_write
    from .hints import hint_of_import

    if drawing.figure is not None:
        check_can_write(drawing.figure, endings=FIGURE_FORMATS)
    found = inspect_log(log, **reading.keywords())
    output.show(found)
    output.draw(found, drawing.figure)
    if advice := hint_of_import(
        " ".join([*found.log.notes, *(finding.message for finding in found.findings)]), options_of(ReadingOptions)
    ):
        output.hint(f"{advice}.")
    output.hint(f"Next: {command('run', log, options=reading)}")
    output.json(found.to_json())
