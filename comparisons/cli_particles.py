"""The verb ``particles``: how many particles are enough."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .cli_options import (
    OUTPUT,
    Association,
    BearingStd,
    JsonFile,
    LogFile,
    LogFormat,
    Nn,
    No,
    On,
    Oo,
    OrientationStd,
    RangeRate,
    Resampling,
)
from .cli_parse import numbers
from .cli_support import Output, models, read_log, sentences


def particles(
    log: LogFile = None,
    format: LogFormat = None,
    filters: Annotated[
        str, typer.Option(metavar="NAME,...", help="Which to run: mcl, fastslam1, fastslam2.")
    ] = "fastslam1,fastslam2",
    particles: Annotated[
        str, typer.Option(metavar="N,...", help="Numbers of particles.")
    ] = "10,32,100,316,1000,3162,10000,31623,100000",
    seeds: Annotated[int, typer.Option(help="How many seeds, from 0.", min=1)] = 10,
    resampling: Resampling = "systematic",
    association: Association = "known",
    nn: Nn = None,
    no: No = None,
    on: On = None,
    oo: Oo = None,
    range_rate: RangeRate = None,
    bearing_std: BearingStd = None,
    orientation_std: OrientationStd = None,
    figure: Annotated[
        Path | None, typer.Option(help="Also draw medians and quartiles (.png, .pdf, .svg).", rich_help_panel=OUTPUT)
    ] = None,
    json: JsonFile = None,
) -> None:
    """Error, effective sample size, ancestors and time over the number of particles, many seeds."""
    with sentences():
        from graphslam import OptionError

        from .particles import particles_figure, study
        from .plots import save_figure
        from .results import check_can_write
        from .tables import particles_table

        output = Output(json)
        if figure is not None:
            check_can_write(figure)
        counts = numbers("--particles", particles)
        if any(count != int(count) for count in counts):
            raise OptionError(f"--particles takes whole numbers, not {particles!r}")
        motion, sensor = models(nn, no, on, oo, range_rate, bearing_std, orientation_std)
        data, _ = read_log(log, format)
        outcome = study(
            data, filters=[name.strip() for name in filters.split(",") if name.strip()],
            particles=[int(count) for count in counts], seeds=seeds, motion=motion, sensor=sensor,
            resampling=resampling, association=association,
            progress=lambda run: output.progress(f"{run.name} N={run.particles} seed {run.seed}: {run.seconds:.2f} s"),
        )  # fmt: skip
        output.console.print(particles_table(outcome))
        if figure is not None:
            save_figure(particles_figure(outcome), [figure])
            output.say(f"Wrote {figure}.")
        output.json(outcome.to_json())
