"""The verb ``study``: what came out of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import OUTPUT, JsonFile
from .support import Output, sentences


def study(
    words: Annotated[
        list[str],
        typer.Argument(metavar="[show] DATABASE", help="The database of a study, or the study file that names it."),
    ],
    baseline: Annotated[
        str | None,
        typer.Option(metavar="METHOD", help="Compare the others with this one.", show_default="graph, or the first"),
    ] = None,
    metric: Annotated[
        str, typer.Option(help="Of the figure: ate_m, rpe_m, rpe_rad, landmark_rmse_m, iterations or seconds.")
    ] = "ate_m",
    figure: Annotated[
        Path | None,
        typer.Option(help="Draw medians and differences (.png, .pdf, .svg).", rich_help_panel=OUTPUT),
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Write every run as CSV.", rich_help_panel=OUTPUT)] = None,
    jsonl: Annotated[Path | None, typer.Option(help="Write every run as a line of JSON.", rich_help_panel=OUTPUT)] = None,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Summarise a study: medians with bootstrap intervals, and paired differences on the same seeds.

    Works on a finished study, a stopped one, and one that is running.
    """
    with sentences():
        from graphslam.checks import check_choice

        from ..saving import check_can_draw, check_can_write
        from ..studies.database import StudyDatabase
        from ..studies.summary import METRICS, summarise
        from ..studies.tables import differences_table, remarks, summary_table

        output = Output(json)
        check_choice("--metric", metric, tuple(METRICS))
        if figure is not None:
            check_can_draw(figure)
        for path in (csv, jsonl):
            if path is not None:
                check_can_write(path)
        with StudyDatabase.reading(_database(words)) as database:
            rows, (planned, others), about = database.rows(), database.counts(), database.about()
        summary = summarise(rows, planned, baseline)
        output.console.print(summary_table(summary))
        if summary.differences:
            output.console.print()
            output.console.print(differences_table(summary))
        output.say(*remarks(summary))
        if others:
            output.say(f"{others} rows of runs that the study file no longer has are kept, and not shown.")
        written = []
        if figure is not None and rows:
            from ..plots import save_figure
            from ..studies.figure import study_figure

            save_figure(study_figure(summary, metric), [figure])
            written.append(figure)
        if csv is not None:
            from ..studies.export import write_csv

            write_csv(rows, csv)
            written.append(csv)
        if jsonl is not None:
            from ..studies.export import write_json_lines

            write_json_lines(rows, jsonl)
            written.append(jsonl)
        if written:
            output.hint(f"Wrote {', '.join(map(str, written))}.")
        output.json({"database": str(database.path), "study": about.get("study"), **summary.to_json()})
        if summary.done < summary.planned:
            output.hint(f"Next: slam-compare sweep {about.get('study')} (runs the other {planned - summary.done})")
        elif figure is None:
            output.hint(f"Next: slam-compare study {database.path} --figure study.png --csv runs.csv")


def _database(words: list[str]) -> Path:
    """The database that is meant by 'DATABASE', 'show DATABASE', or the study file in its place."""
    from graphslam import OptionError

    from ..studies.plan import read_study

    if len(words) == 2 and words[0].lower() == "show":
        words = words[1:]
    if len(words) != 1:
        raise OptionError("give one database: slam-compare study study.sqlite")
    path = Path(words[0])
    return read_study(path).database if path.suffix == ".toml" else path
