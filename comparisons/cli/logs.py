"""The verbs about logs and their ground truth: simulate, calibrate, evaluate, datasets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .output import DIFFERENT, Output
from .verb import LogFile, command

if TYPE_CHECKING:
    from ..options import OUTPUT, CalibrationOptions, EvaluationOptions, FigureOptions, SimulationOptions


def simulate(
    output: Output,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write (.npz keeps everything).")],
    *,
    options: SimulationOptions,
    format: Annotated[str | None, typer.Option(help="npz or lnpr.", show_default="by the suffix of OUT")] = None,
    truth: Annotated[bool, typer.Option(help="Keep the true poses and landmarks (lnpr cannot).")] = True,
) -> None:
    """Write a simulated log with its ground truth.

    The robot has the book's faults, each of which can be changed. With --clean the robot has no faults, only the noise of
    the models.
    """
    import graphslam

    from ..documents import SimulateDocument, describe, document
    from ..saving import check_can_write

    check_can_write(out)
    log = graphslam.simulate(**options.keywords_of_simulate(), name=out.stem)
    graphslam.save(log if truth else log.replace(true_poses=None, true_landmarks=None, notes=()), out, format=format)
    sizes = f"{log.num_poses} poses, {log.seen}"
    output.say(f"Wrote {out}: {sizes}.")
    output.hint(f"Next: {command('run', out)}")
    output.json(document(SimulateDocument, file=str(out), log=describe(log, out)))


def calibrate(
    output: Output,
    log: LogFile = None,
    others: Annotated[
        list[Path] | None,
        typer.Argument(metavar="LOG ...", help="More logs of the same kind of robot.", show_default=False),
    ] = None,
    *,
    options: CalibrationOptions,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write the noise models there (TOML), for run --noise.", rich_help_panel=OUTPUT
        ),
    ] = None,
) -> None:
    """Estimate motion and sensor noise, and scales and biases of sightings and odometry, by maximum likelihood.

    Noise for a log without ground truth is best calibrated from the ground truth of other robots of the same kind.
    """
    from ..noise_files import write_noise
    from ..reading import calibrate as estimate
    from ..saving import check_can_write

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
        Path,
        typer.Argument(metavar="TRUTH", help="The true poses: a table (.csv, .tum, ...), or a log with ground truth."),
    ],
    estimates: Annotated[list[Path], typer.Argument(metavar="ESTIMATE ...", help="Tables of estimated poses.")],
    *,
    options: EvaluationOptions,
    drawing: FigureOptions,
) -> None:
    """Compare trajectories and maps of any program with the ground truth.

    A trajectory is a table with columns t, x, y and theta, or a quaternion; TUM files are read as they are. Covariances of
    the poses in the columns var_x, cov_xy, var_y, cov_x_heading, cov_y_heading and var_heading give the NEES. The options of
    tables hold for all of them, or with truth=... and estimates=... for one kind.
    """
    from ..evaluation import evaluate as compare
    from ..saving import FIGURE_FORMATS, check_can_write

    if drawing.figure is not None:
        check_can_write(drawing.figure, endings=FIGURE_FORMATS)
    found = compare(truth, *estimates, options=options)
    output.show(found)
    output.json(found.to_json())
    output.draw(found, drawing.figure)


def datasets(
    output: Output,
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Where to look.", show_default="the folder named by SLAM_DATA, or ../shared/data"
        ),
    ] = None,
) -> None:
    """List the known data sets, where they are published and how they must be laid out; find and check local copies."""
    from graphslam import OptionError
    from graphslam.files import check_path

    from ..datasets import survey

    if folder is not None:
        check_path(folder)
    if folder is not None and not folder.is_dir():
        raise OptionError(f"--folder {folder}: there is no such folder")
    with output.bar("data sets") as advance:

        def progress(path: Path) -> None:
            advance(1, path.name)
            output.detail(f"reading {path}")

        outcome = survey(folder, progress=progress)
    output.show(outcome)
    output.json(outcome.to_json())
    if outcome.problems:
        raise typer.Exit(DIFFERENT)
