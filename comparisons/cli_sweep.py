"""The verb ``sweep``: execute a study, or what is missing of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .cli_options import JsonFile
from .cli_support import DIFFERENT, INTERRUPTED, Output, sentences

if TYPE_CHECKING:
    from .studies.sweep import Progress


def sweep(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY", help="The study file, TOML (examples/study.toml, docs/studies.md).")
    ],
    jobs: Annotated[
        int | None,
        typer.Option(help="Local processes; 0 runs in this process itself.", min=0, show_default="one for each core"),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on the cluster of this Dask scheduler instead: tcp://host:8786."),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Do runs again that failed or took too long.")] = False,
    json: JsonFile = None,
) -> None:
    """Run a study: logs x simulator settings x seeds x estimators x options, one database row for each run.

    Stop it as you like, with Ctrl-C or worse: the same command goes on where it stopped. Exit status 1 if runs failed.
    """
    with sentences():
        from .studies.plan import read_study
        from .studies.sweep import sweep as execute

        output = Output(json)
        plan = read_study(study)
        with _bar() as progress:
            outcome = execute(plan, jobs=jobs, dask=dask, retry=retry, progress=progress)
        rows = outcome.before + outcome.ran
        output.say(
            f"{outcome.database}: {rows} of {outcome.planned} runs, {outcome.ran} done now"
            + (f", {outcome.failed} of these failed." if outcome.failed else ".")
        )
        again = f"slam-compare sweep {study}"
        if outcome.interrupted:
            output.say(f"Interrupted; finished runs are kept. To go on: {again}")
        elif outcome.failed:
            output.say(f"To do the failed runs again: {again} --retry")
        output.say(f"Next: slam-compare study {outcome.database}")
        output.json({
            "study": str(study), "database": str(outcome.database), "planned": outcome.planned,
            "before": outcome.before, "ran": outcome.ran, "failed": outcome.failed, "missing": outcome.missing,
            "interrupted": outcome.interrupted,
        })  # fmt: skip
        if outcome.interrupted:
            raise typer.Exit(INTERRUPTED)
        if outcome.failed:
            raise typer.Exit(DIFFERENT)


@contextmanager
def _bar() -> Iterator[Progress]:
    """A bar with the time left on standard error, where that is a terminal; nothing elsewhere."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from .studies.outcome import DONE, Outcome
    from .studies.plan import Run

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("runs", total=None)
        failed = 0

        def report(done: int, planned: int, run: Run | None, outcome: Outcome | None) -> None:
            nonlocal failed
            if run is None or outcome is None:
                # rows of earlier sweeps took no time of this one
                bar.reset(task, total=planned - done, description="runs")
                return
            failed += outcome.status != DONE
            words = f"runs, {failed} failed" if failed else "runs"
            bar.update(task, advance=1, description=words)

        yield report
