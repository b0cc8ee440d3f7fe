"""The verb ``animate``: the film of an estimator at work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .options import (
    GRAPH,
    OUTPUT,
    Association,
    BearingStd,
    Dimensions,
    Epsilon,
    JsonFile,
    KeepEvery,
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
    Seed,
    SensorOffset,
    SigmaOmega,
    SigmaV,
    Stride,
)
from .support import Output, log_and_output, models, quoted, read_log, sentences


def animate(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="[LOG] OUT",
            help="The log (default: the sample log of the package), and the film: .gif, .mp4 (needs ffmpeg) or .html.",
        ),
    ],
    estimator: Annotated[
        str, typer.Option(help="Whose film: graph, fastslam1, fastslam2, mcl or isam2.")
    ] = "graph",
    particles: Annotated[int, typer.Option(help="Of the particle filters.", min=1)] = 1000,
    seed: Seed = 0,
    resampling: Resampling = "systematic",
    association: Association = "known",
    format: LogFormat = None,
    robot: Robot = None,
    keep_every: KeepEvery = None,
    stride: Stride = 1,
    max_range: MaxRange = None,
    dimensions: Dimensions = None,
    edges: Annotated[
        str | None,
        typer.Option(
            help="virtual, virtual+motion or landmark+motion.", show_default="what suits the log",
            rich_help_panel=GRAPH,
        ),
    ] = None,
    frame: Annotated[str, typer.Option(help="Of the residuals: body or world.", rich_help_panel=GRAPH)] = "body",
    weight: Annotated[
        str, typer.Option(help="Of virtual edges: pairs (the book's), tempered or marginal.", rich_help_panel=GRAPH)
    ] = "pairs",
    motion_weight: Annotated[
        float, typer.Option(help="lambda, the factor on the motion edges.", rich_help_panel=GRAPH)
    ] = 1.0,
    robust: Annotated[
        str,
        typer.Option(help="Against wrong sightings: none, huber, cauchy or geman-mcclure.", rich_help_panel=GRAPH),
    ] = "none",
    initialize: Annotated[
        str,
        typer.Option(
            help="Where the graph starts: given, dead-reckoning, rotation-first, or auto: given if that ends well.",
            rich_help_panel=GRAPH,
        ),
    ] = "auto",
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
    fps: Annotated[
        float | None,
        typer.Option(
            help="Pictures per second.", show_default="2 for iterations, 10 for steps", rich_help_panel=OUTPUT
        ),
    ] = None,
    max_frames: Annotated[
        int, typer.Option(help="The most pictures; longer runs are thinned out evenly.", min=2, rich_help_panel=OUTPUT)
    ] = 200,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Film an estimator at work: a graph relaxing, particles and their maps, ISAM2 correcting as it drives."""
    with sentences():
        from graphslam import OptionError
        from graphslam.checks import check_positive

        from ..films.animate import FILMED
        from ..films.writers import check_can_film

        output = Output(json)
        source, out = log_and_output(words, "slam-compare animate LOG OUT")
        # all that can be wrong with the options, before any work begins
        check_can_film(out)
        if estimator not in FILMED:
            raise OptionError(f"there are films of {', '.join(FILMED)}, and none of {estimator!r}")
        if fps is not None:
            check_positive(fps=fps)
        _film(
            output, source, out, estimator, fps, max_frames,
            reading={
                "format": format, "dimensions": dimensions, "robot": robot, "keep_every": keep_every, "stride": stride,
                "max_range": max_range,
            },
            noise={
                "nn": nn, "no": no, "on": on, "oo": oo, "sigma_v": sigma_v, "sigma_omega": sigma_omega,
                "epsilon": epsilon, "range_rate": range_rate, "range_std": range_std, "bearing_std": bearing_std,
                "orientation_std": orientation_std, "sensor_offset": sensor_offset,
            },
            told={
                "edges": edges, "frame": frame, "weight": weight, "motion_weight": motion_weight, "robust": robust,
                "initialize": initialize, "particles": particles, "seed": seed, "resampling": resampling,
                "association": association,
            },
        )  # fmt: skip


def _film(
    output: Output, source: Path | None, out: Path, estimator: str, fps: float | None, max_frames: int, *,
    reading: dict[str, Any], noise: dict[str, Any], told: dict[str, Any],
) -> None:  # fmt: skip
    import time

    from ..comparison import describe
    from ..estimator import RunOptions
    from ..films import animate as films

    begin = time.perf_counter()
    data, path = read_log(source, **reading)
    motion, sensor = models(data, **noise)
    options = RunOptions(**told, motion=motion, sensor=sensor)
    with output.bar(estimator, None if estimator == "graph" else data.num_poses) as advance:
        film = films.animate(data, estimator, options, max_frames=max_frames, fps=fps, progress=lambda: advance(1))
    with output.bar("drawing", len(film)) as advance:
        film.save(out, progress=lambda: advance(1))
    seconds = time.perf_counter() - begin
    size = out.stat().st_size
    what = "iterations" if estimator == "graph" else "steps"
    thinned = "" if len(film) == film.steps else f", of the start and {film.steps - 1} {what}"
    output.say(*film.notes)
    output.hint(f"Wrote {out}: {len(film)} pictures{thinned}, {film.fps:g} a second, {size / 1e6:.1f} MB.")
    other = "graph" if estimator.startswith("fastslam") or data.controls is None else "fastslam1"
    if other != estimator:
        words = quoted(source, f"{other}{out.suffix}")
        output.hint(f"Next: slam-compare animate {words} --estimator {other}")
    output.json({
        "file": str(out), "log": describe(data, path), "estimator": estimator, "pictures": len(film),
        "steps": film.steps, "fps": film.fps, "bytes": size, "seconds": seconds, "notes": list(film.notes),
        "poses": film.frames[-1].poses,
    })  # fmt: skip
