"""The verbs that run estimators: run, report and animate on a log; particles, consistency, sweep and study many times."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import DIFFERENT, INTERRUPTED, Advance, Output
from .verb import LogFile, argument, command, places

if TYPE_CHECKING:
    from .. import options as declared
    from ..comparison import Comparison, Progress
    from ..estimators.attempt import Skipped
    from ..results import EstimatorResult
    from ..studies.execute import Outcome
    from ..studies.plan import Run
    from ..studies.sweep import Progress as ProgressOfStudy

#: options that name further files of a run: module below ``show``, check of its packages, and the function that writes
FURTHER = {
    "html": ("report", "check_plotly", "write_report"),
    "mcap": ("recordings", "check_mcap", "write_mcap"),
    "rerun": ("recordings", "check_rerun", "write_rerun"),
}
PAGE = "Wrote the interactive report {}: open it in a browser."


def run(
    output: Output, log: LogFile = None,
    others: Annotated[list[Path] | None, argument("LOG ...", "More logs of the same place, solved together.")] = None, *,
    chosen: declared.EstimatorOptions, options: declared.RunOptions, saving: declared.OutputOptions,
) -> None:  # fmt: skip
    """Run all estimators on one log, or on several logs of one place: a table, a figure and the results as JSON.

    Examples:
        slam-compare run
        slam-compare run LOG --estimators graph,fastslam1 --particles 5000
        slam-compare run LOG --edges virtual --frame world --json -
        slam-compare run LOG --noise noise.toml --kernel huber
        slam-compare run MONDAY TUESDAY WEDNESDAY
        slam-compare run --config results/latest/config.toml
    """
    from ..results import noted
    from ..results.files import RESULTS, check_can_make

    check_can_make(RESULTS if saving.out is None else saving.out)
    writers = {kind: (path, _writer(kind)) for kind in FURTHER if (path := getattr(saving, kind)) is not None}
    logs = [log, *others] if others else log
    if saving.live:
        _draw_live(output, logs, options)
    outcome = _compared(output, logs, chosen, options)
    language = output.language_of_figures() if saving.figures else "en"
    files = outcome.save(saving.out, figures=saving.figures, language=language)
    output.show(outcome, brief=True)
    for kind, (path, write) in writers.items():
        with noted(files.notes, "there is no interactive report" if kind == "html" else f"there is no {path}"):
            write(outcome, path, **({"language": output.language} if kind == "html" else {}))
            files |= {kind: path}
            output.hint(PAGE.format(path) if kind == "html" else f"Wrote {path}.")
    output.say(*(f"{note[0].upper()}{note[1:]}." for note in files.notes))
    if output.wants_json:
        output.json(outcome.to_json(files))
    folder = files["json"].parent
    in_groups = (".tum", ".csv", ".g2o", "-map.npz")
    named = [p.name for kind, p in files.items() if not kind.endswith(in_groups) and kind not in FURTHER]
    named += ["trajectories (*.tum)", "maps (*-map.csv, *-map.npz)"]
    named += ["associations (*-sightings.csv)"] * any(name.endswith("-sightings.csv") for name in files)
    named += ["graph.g2o"] * ("graph.g2o" in files)
    output.hint_at_import(outcome)
    output.hint(f"Wrote {', '.join(named)} into {folder}{os.sep}")
    if "config" in files:
        output.hint(f"Repeat this run:     {command('run', '--config', files['config'])}")
    if find_spec("plotly") is None:
        output.hint("The interactive report needs plotly: pip install -e '.[report]' in the clone.")
    if not others:
        output.hint(f"Interactive report:  {command('report', log, 'report.html', options=(chosen, options))}")
    if not outcome.log.sessions and (advice := _noise_advice(outcome, log, options)) is not None:
        output.hint(advice)
    if "graph-map.npz" in files:
        output.hint(f"Localise in this map: {command('run', 'OTHER_LOG', '--map', files['graph-map.npz'])}")
    if options.kernel != "gnc" and not outcome.log.sessions:
        output.hint(f"Animation:           {command('animate', log, 'animation.gif', options=options)}")


def _noise_advice(outcome: Comparison, log: Path | None, options: declared.RunOptions) -> str | None:
    """The command that finds better noise models, where those of the book do not fit a log in which nothing is suspicious."""
    from graphslam.identification.robot import FEWEST

    from ..options import DOUBTFUL, ReadingOptions, options_of

    fits = outcome.noise_ratio is None or 1 / DOUBTFUL <= outcome.noise_ratio[1] <= DOUBTFUL
    of_book = set(outcome.noise_source.values()) == {"book"}
    if fits or options.noise is not None or outcome.findings or not of_book or outcome.log.controls is None:
        return None
    partial = None if len(outcome.log.steps) else outcome.log.partial_sightings
    if partial is not None and (len(partial) < FEWEST["sightings"] or outcome.log.num_poses < FEWEST["poses"]):
        return (
            "The noise of so few ranges or bearings alone is not estimated; give it by --range-rate and --range-std, or "
            "--bearing-std"
        )
    # `calibrate` takes whole sightings
    if outcome.log.true_poses is not None and partial is None:
        # of a data set of several robots it needs to know which one
        reading = ReadingOptions.of(**{name: getattr(options, name) for name in options_of(ReadingOptions)})
        return f"Noise of this robot: {command('calibrate', log, '--out', 'noise.toml', options=reading)}"
    return f"Noise of this robot: {command('run', log, '--noise', 'auto', options=options)}"


def report(
    output: Output,
    words: Annotated[
        list[str], argument("[LOG] OUT.html", "The log (default: the sample log of the package), and the page.")
    ],
    *,
    chosen: declared.EstimatorOptions,
    options: declared.RunOptions,
) -> None:
    """Run all estimators on one log and write an interactive report: one HTML file that works offline.

    Examples:
        slam-compare report report.html
        slam-compare report LOG report.html --estimators graph,fastslam1
        slam-compare report report.html --config results/latest/config.toml
    """
    from ..show.report import check_page, write_report

    log, page = places(words, "a log and a file to write: slam-compare report LOG OUT.html")
    check_page(page)
    outcome = _compared(output, log, chosen, options)
    output.show(outcome, brief=True)
    write_report(outcome, page, language=output.language)
    output.hint(PAGE.format(page))
    output.json(outcome.to_json({"html": page}))
    output.hint(f"Next: {command('run', log, options=(chosen, options))}")


def associate(
    output: Output,
    words: Annotated[
        list[str], argument("[LOG] OUT.npz", "The log (default: the sample log of the package), and the log to write.")
    ],
    *,
    options: declared.RunOptions,
) -> None:
    """Find which landmark each sighting of a log without ids is of, and write the log with these ids.

    It is what run does before it solves a graph. Ids that some sightings have are kept.

    Examples:
        slam-compare associate LOG named.npz
        slam-compare associate LOG named.npz --association maximum-likelihood --front-end batch --json -
    """
    from graphslam import OptionError, save

    from ..options import EstimatorOptions
    from ..results.files import check_can_write

    log, out = places(words, "a log and a log to write: slam-compare associate LOG OUT.npz")
    check_can_write(out)
    outcome = _compared(output, log, EstimatorOptions(estimators=("graph",)), options)
    found = outcome.results[0].found if outcome.results else None
    if found is None:
        have = "all sightings have ids; --association maximum-likelihood finds new ones"
        raise OptionError(f"{outcome.log.name}: {next((each.reason for each in outcome.skipped), have)}")
    save(found.log, out)
    output.show(outcome, brief=True)
    output.say(f"Wrote {out}.")
    output.hint(f"Next: {command('run', out)}")
    output.json(outcome.to_json({"log": out}))


def animate(
    output: Output,
    words: Annotated[
        list[str],
        argument(
            "[LOG] OUT",
            "The log (default: the sample log of the package), and the animation: .gif, .mp4 (needs ffmpeg) or .html.",
        ),
    ],
    *,
    animation: declared.AnimationOptions,
    options: declared.RunOptions,
) -> None:
    """Animate an estimator: a graph as it is solved, particles and their maps, ISAM2 as the robot drives, sampled paths.

    Examples:
        slam-compare animate relaxing.gif
        slam-compare animate LOG particles.mp4 --estimator fastslam1 --particles 200
        slam-compare animate LOG moving.gif --estimator fastslam1 --stage motion
        slam-compare animate LOG growing.html --estimator isam2 --max-frames 100
        slam-compare animate LOG samples.gif --estimator particle-gibbs --gibbs-iterations 60
    """
    from ..results.documents import AnimateDocument, describe
    from ..show.films import animate as film_of
    from ..show.films import check_can_film

    log, out = places(words, "a log and a file to write: slam-compare animate LOG OUT")
    check_can_film(out)
    begin = time.perf_counter()
    with output.bar(animation.estimator) as advance:
        film = film_of(log, progress=lambda: advance(1), **animation.keywords(), **options.keywords())
    film = replace(film, language=output.language_of_figures())
    with output.bar("drawing", len(film)) as advance:
        film.save(out, progress=lambda: advance(1))
    seconds, size = time.perf_counter() - begin, out.stat().st_size
    output.say(*film.notes)
    output.hint(f"Wrote {out}: {len(film)} of {film.steps} frames, {film.fps:g} per second, {size / 1e6:.1f} MB.")
    output.json(
        AnimateDocument(
            file=out, log=describe(film.log, film.source), estimator=animation.estimator, pictures=len(film),
            steps=film.steps, fps=film.fps, bytes=size, seconds=seconds, notes=film.notes, poses=film.frames[-1].poses,
        )
    )  # fmt: skip


def _compared(
    output: Output,
    log: Path | list[Path | None] | None,
    chosen: declared.EstimatorOptions,
    options: declared.RunOptions,
) -> Comparison:
    from ..comparison import compare
    from ..estimators import default_estimators

    with output.bar("estimators", len(chosen.estimators or default_estimators())) as advance:
        return compare(
            log, options, estimators=chosen.estimators, time_limit=chosen.time_limit, progress=_progress(output, advance),
            announce=output.progress,
        )  # fmt: skip


def _progress(output: Output, advance: Advance) -> Progress:
    def report(name: str, outcome: EstimatorResult | Skipped | None) -> None:
        from ..results import EstimatorResult

        advance(0 if outcome is None else 1, name)
        if isinstance(outcome, EstimatorResult):
            output.detail(f"{name}: {outcome.seconds:.3g} s" + (f", {outcome.reason}" if outcome.reason else ""))

    return report


def _draw_live(output: Output, log: Path | list[Path | None] | None, options: declared.RunOptions) -> None:
    from ..options.reading import prepare
    from ..results import noted
    from ..show.log_tables import pictures

    prepared, _, filled = prepare(log, options, together=True)
    notes: list[str] = []
    with noted(notes, "The live picture ends here"), output.picture() as (draw, size):
        for lines in pictures(prepared, filled, width=size[0], height=size[1]):
            draw(lines)
    output.say(*notes)


def _writer(kind: str) -> Callable[..., None]:
    """What writes one of `FURTHER`.

    Raises:
        OptionError: a package is missing.
    """
    module, check, write = FURTHER[kind]
    found = import_module(f"..show.{module}", __package__)
    getattr(found, check)()
    writer: Callable[..., None] = getattr(found, write)
    return writer


def particles(
    output: Output, log: LogFile = None, *, options: declared.ParticleStudyOptions, drawing: declared.FigureOptions
) -> None:
    """Error, effective sample size, ancestors and time over the number of particles, for many random seeds.

    Examples:
        slam-compare particles --particles 10,100,1000 --seeds 5
        slam-compare particles LOG --figure particles.png --json particles.json
    """
    from ..studies.sweep import study_particles

    with output.bar("runs") as advance:
        report = _progress_of_study(advance, output)
        outcome = study_particles(log, progress=report, announce=output.progress, **options.keywords())
    output.result(outcome, drawing.figure)


def consistency(output: Output, *, options: declared.ConsistencyOptions, drawing: declared.FigureOptions) -> None:
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
        noisier = command("consistency", options=replace(options, noise=0.5))
        output.hint(f"The effect of the models' curvature: {noisier}")


def sweep(
    output: Output,
    study: Annotated[Path, argument("STUDY", "The study file, TOML (examples/study.toml, docs/studies.md).")],
    *,
    options: declared.SweepOptions,
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
        report = _progress_of_study(advance, output)
        outcome = execute(study, progress=report, announce=output.progress, **options.keywords())
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
    path: Annotated[Path, argument("DATABASE", "The database of a study, or the study file that names it.")],
    *,
    options: declared.SummaryOptions,
) -> None:
    """Summarise a study: medians with bootstrap intervals, and paired differences on the same seeds.

    Works on a finished study, an interrupted one, and one that is running.

    Examples:
        slam-compare study study.sqlite
        slam-compare study study.sqlite --baseline fastslam1 --figure study.pdf
        slam-compare study study.sqlite --csv runs.csv --jsonl runs.jsonl
    """
    from ..show.tables import write_latex
    from ..studies.execute import StudyDatabase
    from ..studies.plan import read_study
    from ..studies.summary import summarise, write_csv, write_json_lines, write_summary_csv

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
    elif options.figure is not None:
        output.say("There is no figure: the study has no executed run.")
    output.json(summary.to_json())
    if missing := summary.planned - summary.done:
        output.hint(f"To execute the other {missing} runs: {command('sweep', summary.study)}")
    elif options.figure is None:
        output.hint(f"Next: {command('study', database.path, '--figure', 'study.png', '--csv', 'runs.csv')}")


def _progress_of_study(advance: Advance, output: Output) -> ProgressOfStudy:
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
