"""The verb ``sweep``: execute a study, or what is missing of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import JsonFile
from .support import DIFFERENT, INTERRUPTED, Advance, Output, sentences

if TYPE_CHECKING:
    from ..studies.sweep import Progress


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
        from ..studies.plan import read_study
        from ..studies.sweep import sweep as execute

        output = Output(json)
        plan = read_study(study)
        with output.bar("runs", None) as advance:
            outcome = execute(plan, jobs=jobs, dask=dask, retry=retry, progress=_told(advance, output))
        rows = outcome.before + outcome.ran
        output.say(
            f"{outcome.database}: {rows} of {outcome.planned} runs, {outcome.ran} done now"
            + (f", {outcome.failed} of these failed." if outcome.failed else ".")
        )
        again = f"slam-compare sweep {study}"
        if outcome.interrupted:
            output.say(f"Interrupted; finished runs are kept. To go on: {again}")
        elif outcome.failed:
            output.hint(f"To do the failed runs again: {again} --retry")
        output.hint(f"Next: slam-compare study {outcome.database}")
        output.json({
            "study": str(study), "database": str(outcome.database), "planned": outcome.planned,
            "before": outcome.before, "ran": outcome.ran, "failed": outcome.failed, "missing": outcome.missing,
            "interrupted": outcome.interrupted,
        })  # fmt: skip
        if outcome.interrupted:
            raise typer.Exit(INTERRUPTED)
        if outcome.failed:
            raise typer.Exit(DIFFERENT)


def _told(advance: Advance, output: Output) -> Progress:
    from ..studies.outcome import DONE, Outcome
    from ..studies.plan import Run

    failed = 0

    def report(done: int, planned: int, run: Run | None, outcome: Outcome | None) -> None:
        nonlocal failed
        if run is None or outcome is None:
            # rows of earlier sweeps took no time of this one
            advance(0, total=planned - done)
            return
        failed += outcome.status != DONE
        advance(1, f"{failed} failed" if failed else "")
        output.detail(
            f"{run.log} {run.method} seed {run.seed}: {outcome.status}"
            + (f", {outcome.error}" if outcome.error else "")
        )

    return report
