"""The verbs about logs and their ground truth, and those that check solvers.

simulate, calibrate, evaluate and datasets are about logs and their ground truth; import and show come before a run; solvers
and backends check and time solvers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import DIFFERENT, Output
from .verb import LogFile, argument, command, places

if TYPE_CHECKING:
    from .. import options as declared
    from ..studies.backends import BackendRow
    from ..studies.solvers import VariantResult


def simulate(
    output: Output,
    out: Annotated[Path, argument("OUT", "The file to write (.npz keeps everything).")],
    *,
    options: declared.SimulationOptions,
    format: Annotated[str | None, typer.Option(help="npz or lnpr.", show_default="by the suffix of OUT")] = None,
    truth: Annotated[bool, typer.Option(help="Keep the true poses, landmarks and noise models (lnpr cannot).")] = True,
) -> None:
    """Write a simulated log with its ground truth.

    The robot has the book's faults, each of which can be changed. With --clean the robot has no faults, only the noise of
    the models.

    Examples:
        slam-compare simulate my.npz --seed 7
        slam-compare simulate room.npz --way-points '4,-3 4,3 -4,3' --landmarks 20
        slam-compare simulate clean.npz --clean --no-orientation
    """
    import graphslam

    from ..options import MODELS, NoiseOptions, options_of
    from ..results.documents import SimulateDocument, describe
    from ..results.files import check_can_write

    check_can_write(out)
    settings = options.keywords_of_simulate()
    log = graphslam.simulate(**settings, name=out.stem)
    # the models that were given are those of the log, so that `run` takes them
    own = {name: settings[name] for name in MODELS if options.of_component(name)}
    graphslam.save(
        log.replace(**own) if truth else log.replace(true_poses=None, true_landmarks=None, notes=()), out, format=format
    )
    output.say(f"Wrote {out}: {log.sizes}.")
    of_noise = {name: value for name, value in options.numbers.items() if name in options_of(NoiseOptions)}
    output.hint(f"Next: {command('run', out, options=() if truth else NoiseOptions.of(**of_noise))}")
    output.json(SimulateDocument(out, describe(log, out)))


def calibrate(
    output: Output, log: LogFile = None,
    others: Annotated[list[Path] | None, argument("LOG ...", "More logs of the same kind of robot.")] = None, *,
    options: declared.CalibrationOptions,
    out: Annotated[Path | None, typer.Option(
        metavar="FILE", help="Write the noise models there (TOML), for run --noise.", rich_help_panel=declared.OUTPUT,
    )] = None,
) -> None:  # fmt: skip
    """Estimate motion and sensor noise, and scales and biases of sightings and odometry, by maximum likelihood.

    Noise for a log without ground truth is best calibrated from the ground truth of other robots of the same kind.

    Examples:
        slam-compare calibrate LOG --out noise.toml
        slam-compare calibrate ../shared/data/mrclam6 --robot 1 --out noise.toml
        slam-compare calibrate LOG1 LOG2 --source truth --out noise.toml
        slam-compare calibrate LOG --source residuals --json -
        slam-compare run LOG --noise noise.toml --kernel huber
    """
    from ..options.reading import calibrate as estimate
    from ..options.toml_files import write_noise
    from ..results.files import check_can_write

    if out is not None:
        check_can_write(out)
    with output.bar("calibration"):
        result = estimate(log, *(others or ()), **options.keywords())
    name = ", ".join(result.logs)
    output.show(result, name=name)
    output.json(result.to_json())
    if out is not None:
        write_noise(result, out, name)
        output.hint(f"Wrote {out}.")
    if result.doubts:
        output.hint(
            "Next: calibrate the logs one by one, or from the ground truth of other robots of the same kind (calibrate LOG "
            "LOG ... --source truth)."
        )
    elif out is not None:
        leave_out = ("source", "gaussian", "robots")
        output.hint(f"Next: {command('run', log, '--noise', out, options=options, leave_out=leave_out)}")


def evaluate(
    output: Output,
    truth: Annotated[
        Path, argument("TRUTH", "The true poses: a table (.csv, .tum, ...), BAG:TOPIC, or a log with ground truth.")
    ],
    estimates: Annotated[list[Path], argument("ESTIMATE ...", "Estimated poses: tables, bags or BAG:TOPIC, or .npz.")],
    *,
    options: declared.EvaluationOptions,
    drawing: declared.FigureOptions,
) -> None:
    """Compare trajectories and maps of any program with the ground truth.

    A trajectory is a table with columns t, x, y and theta, or a quaternion; TUM files are read as they are. Covariances of
    the poses in the columns var_x, cov_xy, var_y, cov_x_heading, cov_y_heading and var_heading give the NEES. It is also a
    topic of a bag, BAG:TOPIC, or an .npz archive of the arrays times, poses and covariances. The options of tables hold for
    all of them, or with truth=... and estimates=... for one kind.

    Examples:
        slam-compare evaluate truth.tum mine.tum theirs.csv --figure errors.png
        slam-compare evaluate LOG mine.tum --map mine-map.csv
        slam-compare evaluate LOG run.mcap:/graph/pose --json -
        slam-compare evaluate truth.csv mine.csv --angles truth=degrees --json -
    """
    from ..evaluation import evaluate as compare

    output.result(compare(truth, *estimates, **options.keywords()), drawing.figure)


def datasets(
    output: Output,
    folder: Annotated[Path | None, typer.Option(
        metavar="DIR", help="Where to look.", show_default="the folder named by SLAM_DATA, or ../shared/data",
    )] = None,
) -> None:  # fmt: skip
    """List the known data sets, where they are published and how they must be laid out; find and check local copies.

    Examples:
        slam-compare datasets
        SLAM_DATA=~/data slam-compare datasets --json -
    """
    from graphslam import OptionError

    from ..datasets import survey

    if folder is not None and not folder.is_dir():
        raise OptionError(f"--folder {folder}: there is no such folder")
    with output.bar("data sets") as advance:

        def progress(path: Path) -> None:
            advance(1, path.name)
            output.detail(f"reading {path}")

        outcome = survey(folder, progress=progress)
    output.result(outcome)
    if outcome.problems:
        raise typer.Exit(DIFFERENT)


def import_(
    output: Output,
    words: Annotated[list[str] | None, argument(
        "[SOURCE] [OUT.npz]",
        "The folder of tables or the bag, and the log to write; without it, only what was found is listed.",
    )] = None,
    *,
    options: declared.ImportOptions,
) -> None:  # fmt: skip
    """Make a log of your own tables (CSV, TSV, Parquet) or bag (ROS 1, ROS 2, MCAP): odometry and sightings with times.

    Columns and topics are recognised by their names and types; without OUT the choice is only listed.

    Examples:
        slam-compare import folder drive.npz
        slam-compare import --odometry wheels.csv --sightings tags.csv --angles degrees drive.npz
        slam-compare import drive.mcap
        slam-compare import drive.mcap drive.npz --odometry /odom --sightings /tags
    """
    from graphslam import LogError, save

    from ..importing import import_log
    from ..results.files import check_can_write

    source: Path | None = None
    out: Path | None = None
    if words:
        source, out = places(words, "a folder or bag, and a log to write: slam-compare import SOURCE OUT.npz")
        if source is None and out.suffix != ".npz":
            source, out = out, None
    if out is not None:
        check_can_write(out)
    found = import_log(source, **options.keywords())
    output.show(found)
    if found.log is None:
        output.json(found.to_json())
        raise LogError(found.reason)
    if out is None:
        target = Path(f"{found.log.name}.npz")
        output.hint(f"Nothing was written. Next: {command('import', source, target, options=options)}")
    else:
        save(found.log, out)
        output.say(f"Wrote {out}.")
        output.hint(f"Next: {command('run', out)}")
    output.json(replace(found, file=out).to_json())


def show(
    output: Output, log: LogFile = None, *, reading: declared.ReadingOptions, drawing: declared.FigureOptions
) -> None:
    """Look at a log before it is solved: times, rates, landmarks, histograms, and what is probably wrong.

    Examples:
        slam-compare show
        slam-compare show drive.npz --figure drive.png
        slam-compare show folder --json -
    """
    from ..importing import inspect_log

    found = inspect_log(log, **reading.keywords())
    output.show(found)
    output.draw(found, drawing.figure)
    output.hint_at_import(found)
    output.hint(f"Next: {command('run', log, options=reading)}")
    output.json(found.to_json())


def solvers(output: Output, log: LogFile = None, *, options: declared.SolverCheckOptions) -> None:
    """Check the hand-written solver against GTSAM on every graph that a log allows; exit status 1 if they differ.

    Examples:
        slam-compare solvers
        slam-compare solvers LOG --motion-weights 1,10,100 --json differences.json
        slam-compare solvers LOG --kernel none,huber,cauchy
    """
    from ..studies.solvers import SkippedVariant, compare_solvers

    with output.bar("variants") as advance:

        def progress(each: VariantResult | SkippedVariant) -> None:
            advance(1, each.name)
            # those that are left out stand below the table
            if not isinstance(each, SkippedVariant):
                # GTSAM calls factors in Python, which takes almost all of the time
                output.progress(f"{each.name}: graphslam {each.seconds:.2g} s, gtsam {each.gtsam_seconds:.2g} s")

        outcome = compare_solvers(log, progress=progress, **options.keywords())
    output.show(outcome)
    if not outcome.problems:
        output.say(f"The solvers agree in all {len(outcome.variants)} variants.")
        output.hint("To test whether the covariances are consistent: slam-compare consistency")
    output.json(outcome.to_json())
    if outcome.problems:
        raise typer.Exit(DIFFERENT)


def backends(
    output: Output,
    files: Annotated[list[Path], argument("FILE...", "Pose graphs: g2o, TORO or iSAM text.")],
    *,
    options: declared.BackendOptions,
    drawing: declared.FigureOptions,
) -> None:
    """Time this solver, GTSAM and g2o on pose graphs; the same function computes the chi2 of every solver's result.

    Examples:
        slam-compare backends M3500.g2o
        slam-compare backends *.g2o --figure cost.png --json rows.json
    """
    from ..studies.backends import BACKENDS, SkippedBackend, compare_backends

    with output.bar("backends", len(files) * len(options.backends or BACKENDS)) as advance:

        def progress(row: BackendRow | SkippedBackend) -> None:
            advance(1, f"{Path(row.file).name} {row.backend}")
            if isinstance(row, SkippedBackend):
                return
            chi2 = f"chi2 {row.chi2:.6g}, {row.seconds:.3g} s, " if row.seconds == row.seconds else ""
            output.progress(f"{Path(row.file).name} {row.backend}: {chi2}{row.reason}")

        outcome = compare_backends(files, progress=progress, **options.keywords())
    output.result(outcome, drawing.figure)
