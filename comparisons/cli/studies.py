"""The verbs that run many times and summarise: particles, consistency, sweep, study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import DIFFERENT, INTERRUPTED, Advance, Output
from .verb import LogFile, argument, command

if TYPE_CHECKING:
    from ..options import ConsistencyOptions, FigureOptions, ParticleStudyOptions, SummaryOptions, SweepOptions
    from ..studies.execute import Outcome
    from ..studies.plan import Run
    from ..studies.sweep import Progress


def particles(output: Output, log: LogFile = None, *, options: ParticleStudyOptions, drawing: FigureOptions) -> None:
    """Error, effective sample size, ancestors and time over the number of particles, for many random seeds.

    Examples:
        slam-compare particles --particles 10,100,1000 --seeds 5
        slam-compare particles LOG --figure particles.png --json particles.json
    """
    from ..studies.sweep import study_particles

    with output.bar("runs") as advance:
        report = _progress(advance, output)
        outcome = study_particles(log, progress=report, announce=output.progress, **options.keywords())
    output.result(outcome, drawing.figure)


def consistency(output: Output, *, options: ConsistencyOptions, drawing: FigureOptions) -> None:
    """Average normalised errors (ANEES) over many simulated logs, for each estimator and weight, with the 95 % band.

    Examples:
        slam-compare consistency
        slam-compare consistency --noise 1 --figure anees.png --json anees.json
        slam-compare consistency --estimators 'landmark nodes,fastslam2' --logs 50
    """
    from ..options import ConsistencyOptions
    from ..studies.consistency import study_consistency

    with output.bar("logs", options.logs) as advance:
        outcome = study_consistency(progress=lambda _: advance(1), **options.keywords())
    output.result(outcome, drawing.figure)
    if options.noise == ConsistencyOptions().noise:
        output.hint(
            f"The effect of the models' curvature: {command('consistency', options=replace(options, noise=0.5))}"
        )


def sweep(
    output: Output,
    study: Annotated[Path, argument("STUDY", "The study file, TOML (examples/study.toml, docs/studies.md).")],
    *,
    options: SweepOptions,
) -> None:
    """Run a study: logs x simulator settings x seeds x estimators x options, one database row for each run.

    It can be stopped at any time, by Ctrl-C or otherwise: the same command continues it. Exit status 1 if runs failed.

    Examples:
        slam-compare sweep examples/study.toml
        slam-compare sweep study.toml --jobs 8
        slam-compare sweep study.toml --dask tcp://head-node:8786
    """
    from ..studies.sweep import sweep as execute

    with output.bar("runs") as advance:
        outcome = execute(study, progress=_progress(advance, output), announce=output.progress, **options.keywords())
    output.say(
        f"{outcome.database}: {outcome.before + outcome.ran} of {outcome.planned} runs, {outcome.ran} done now"
        + (f", {outcome.failed} of these failed." if outcome.failed else ".")
    )
    if outcome.interrupted:
        output.hint(f"Interrupted; finished runs are kept. To continue: {command('sweep', study, options=options)}")
    elif outcome.failed:
        output.hint(f"Repeat the failed runs: {command('sweep', study, options=replace(options, retry=True))}")
    output.hint(f"Next: {command('study', outcome.database)}")
    output.json(outcome.to_json())
    if outcome.interrupted:
        raise typer.Exit(INTERRUPTED)
    if outcome.failed:
        raise typer.Exit(DIFFERENT)


def study(
    output: Output,
    words: Annotated[list[str], argument("DATABASE", "The database of a study, or the study file that names it.")],
    *,
    options: SummaryOptions,
) -> None:
    """Summarise a study: medians with bootstrap intervals, and paired differences on the same seeds.

    Works on a finished study, an interrupted one, and one that is running.

    Examples:
        slam-compare study study.sqlite
        slam-compare study study.sqlite --baseline fastslam1 --figure study.pdf
        slam-compare study study.sqlite --csv runs.csv --jsonl runs.jsonl
    """
    from graphslam import OptionError

    from ..show.tables import write_latex
    from ..studies.database import StudyDatabase
    from ..studies.plan import read_study
    from ..studies.summary import summarise, write_csv, write_json_lines, write_summary_csv

    if len(words) == 2 and words[0].lower() == "show":
        words = words[1:]
    if len(words) != 1:
        raise OptionError("give one database: slam-compare study study.sqlite")
    path = Path(words[0])
    with StudyDatabase.reading(read_study(path).database if path.suffix == ".toml" else path) as database:
        rows, (_, others) = database.rows(), database.counts()
        summary = summarise(database, baseline=options.baseline)
    output.show(summary)
    if others:
        output.say(f"{others} rows of runs that are no longer part of the study file are kept, and not shown.")
    for target, write in ((options.csv, write_csv), (options.jsonl, write_json_lines)):
        if target is not None:
            write(rows, target)
            output.hint(f"Wrote {target}.")
    if options.summary is not None:
        write_summary = write_latex if options.summary.suffix.lower() == ".tex" else write_summary_csv
        write_summary(summary, options.summary)
        output.hint(f"Wrote {options.summary}.")
    if rows:
        output.draw(summary, options.figure, metric=options.metric)
    output.json(summary.to_json())
    if missing := summary.planned - summary.done:
        output.hint(f"To execute the other {missing} runs: {command('sweep', summary.study)}")
    elif options.figure is None:
        output.hint(f"Next: {command('study', database.path, '--figure', 'study.png', '--csv', 'runs.csv')}")


def _progress(advance: Advance, output: Output) -> Progress:
    from ..studies.execute import DONE

    failed = 0

    def report(done: int, planned: int, run: Run | None, outcome: Outcome | None) -> None:
        nonlocal failed
        if run is None or outcome is None:
            # rows of earlier sweeps took no time of this one
            advance(0, total=planned - done)
            return
        failed += outcome.status != DONE
        advance(1, f"{failed} failed" if failed else "")
        how = outcome.error or ("" if outcome.seconds is None else f"{outcome.seconds:.2f} s")
        output.detail(f"{run.log} {run.method} seed {run.seed}: {outcome.status}, {how}")

    return report
