"""The verb ``particles``: how many particles are enough."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    OUTPUT,
    Association,
    BearingStd,
    Epsilon,
    JsonFile,
    KeepEvery,
    LogFile,
    LogFormat,
    MaxRange,
    Nn,
    No,
    On,
    Oo,
    OrientationStd,
    RangeRate,
    RangeStd,
    Resampling,
    Robot,
    SensorOffset,
    SigmaOmega,
    SigmaV,
    Stride,
)
from .parsing import numbers
from .support import Output, models, read_log, sentences

if TYPE_CHECKING:
    from ..particles import ParticleRun


def particles(
    log: LogFile = None,
    format: LogFormat = None,
    robot: Robot = None,
    keep_every: KeepEvery = None,
    stride: Stride = 1,
    max_range: MaxRange = None,
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
    sigma_v: SigmaV = None,
    sigma_omega: SigmaOmega = None,
    epsilon: Epsilon = None,
    range_rate: RangeRate = None,
    range_std: RangeStd = None,
    bearing_std: BearingStd = None,
    orientation_std: OrientationStd = None,
    sensor_offset: SensorOffset = None,
    figure: Annotated[
        Path | None, typer.Option(help="Also draw medians and quartiles (.png, .pdf, .svg).", rich_help_panel=OUTPUT)
    ] = None,
    json: JsonFile = None,
) -> None:
    """Error, effective sample size, ancestors and time over the number of particles, many seeds."""
    with sentences():
        from graphslam import OptionError

        from ..particles import particles_figure, study_particles
        from ..plots import save_figure
        from ..saving import check_can_draw
        from ..tables import particles_table

        output = Output(json)
        if figure is not None:
            check_can_draw(figure)
        counts = numbers("--particles", particles)
        if any(count != int(count) for count in counts):
            raise OptionError(f"--particles takes whole numbers, not {particles!r}")
        data, _ = read_log(log, format, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range)
        motion, sensor = models(
            data, nn=nn, no=no, on=on, oo=oo, sigma_v=sigma_v, sigma_omega=sigma_omega, epsilon=epsilon,
            range_rate=range_rate, range_std=range_std, bearing_std=bearing_std, orientation_std=orientation_std,
            sensor_offset=sensor_offset,
        )  # fmt: skip
        kinds = [name.strip() for name in filters.split(",") if name.strip()]
        with output.bar("runs", len(kinds) * len(counts) * seeds) as advance:

            def told(run: ParticleRun) -> None:
                advance(1, f"{run.name} N={run.particles}")
                output.detail(f"{run.name} N={run.particles} seed {run.seed}: {run.seconds:.2f} s")

            outcome = study_particles(
                data, filters=kinds, particles=[int(count) for count in counts], seeds=seeds, motion=motion,
                sensor=sensor, resampling=resampling, association=association, progress=told,
            )  # fmt: skip
        output.console.print(particles_table(outcome))
        output.json(outcome.to_json())
        if figure is not None:
            save_figure(particles_figure(outcome), [figure])
            output.hint(f"Wrote {figure}.")
