"""The verb ``calibrate``: noise models from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    OUTPUT,
    Dimensions,
    JsonFile,
    KeepEvery,
    LogFile,
    LogFormat,
    MaxRange,
    Robot,
    SensorOffset,
    Stride,
)
from .support import Output, models, quoted, read_log, reread, sentences


def calibrate(
    log: LogFile = None,
    source: Annotated[
        str,
        typer.Option(
            help="Where the noise is seen: truth, residuals of the solved graph, or auto, the truth where there is one."
        ),
    ] = "auto",
    gaussian: Annotated[
        bool,
        typer.Option("--gaussian", help="Every residual counts in full, wrong sightings too; default: Student's t."),
    ] = False,
    format: LogFormat = None,
    robot: Robot = None,
    keep_every: KeepEvery = None,
    stride: Stride = 1,
    max_range: MaxRange = None,
    dimensions: Dimensions = None,
    sensor_offset: SensorOffset = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the noise models there (TOML), for run --noise.", rich_help_panel=OUTPUT),
    ] = None,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Estimate motion and sensor noise, range scale and range bias from a log, by maximum likelihood."""
    with sentences():
        from graphslam.calibration import calibrate as estimate

        from ..noise_files import write_noise
        from ..results import check_can_write
        from ..tables import calibration_remarks, calibration_table

        output = Output(json)
        if out is not None:
            check_can_write(out)
        data, _ = read_log(
            log, format, dimensions, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range
        )  # fmt: skip
        _, sensor = models(data, sensor_offset=sensor_offset)
        found = estimate(data, source=source, sensor=sensor, degrees=float("inf") if gaussian else None)
        output.console.print(calibration_table(found, data.name))
        output.say(*calibration_remarks(found))
        output.json(found.to_json())
        if out is not None:
            write_noise(found, out, data.name)
            words = reread(log, format=format, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range)
            output.hint(f"Wrote {out}.", f"Next: slam-compare run {quoted(*words, '--noise', out)}")
