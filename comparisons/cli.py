"""The command line ``slam-compare``, also ``python -m comparisons``.

Everything heavy (NumPy, numba, GTSAM, matplotlib, the framework itself) is imported inside the verbs, so that
``--help`` answers at once. Exit status: 0 all well, 1 solvers differ, 2 wrong input or option, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .cli_animate import animate
from .cli_backends import backends
from .cli_config import ConfigFile, config_of
from .cli_consistency import consistency
from .cli_datasets import datasets
from .cli_options import (
    GRAPH,
    OUTPUT,
    Association,
    BearingStd,
    Dimensions,
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
    Seed,
    SensorOffset,
    SigmaOmega,
    SigmaV,
    Stride,
)
from .cli_parse import numbers
from .cli_particles import particles
from .cli_simulate import simulate
from .cli_study import study
from .cli_support import DIFFERENT, INTERRUPTED, Output, examples, models, read_log, sentences
from .cli_sweep import sweep

if TYPE_CHECKING:
    from .estimator import EstimatorResult
    from .run import Progress, Skipped

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"slam-compare {version('virtual-motion-slam')}")
        except PackageNotFoundError:
            typer.echo("slam-compare, not installed (run from its source)")
        raise typer.Exit


@app.callback(epilog=examples("slam-compare run", "slam-compare run LOG --estimators graph,fastslam1"))
def _app(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Compare planar SLAM on one log: a hand-written graph solver, GTSAM, FastSLAM and dead reckoning."""


@app.command(
    epilog=examples(
        "slam-compare run",
        "slam-compare run LOG --estimators graph,fastslam1 --particles 5000",
        "slam-compare run LOG --edges virtual --frame world --json -",
        "slam-compare run --config results/latest/config.toml",
    )
)
def run(
    ctx: typer.Context,
    log: LogFile = None,
    config: ConfigFile = None,
    estimators: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Which to run: dead-reckoning, textbook, graph, gtsam, isam2, mcl, fastslam1, fastslam2.",
            show_default="all that can run on the log",
        ),
    ] = None,
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
        str,
        typer.Option(
            help="Of virtual edges: pairs (the book's), tempered or marginal (each sighting once).",
            rich_help_panel=GRAPH,
        ),
    ] = "pairs",
    motion_weight: Annotated[
        float, typer.Option(help="lambda, the factor on the motion edges.", rich_help_panel=GRAPH)
    ] = 1.0,
    robust: Annotated[
        str,
        typer.Option(
            help="Against wrong sightings: none, huber, cauchy, geman-mcclure or gnc.", rich_help_panel=GRAPH
        ),
    ] = "none",
    initialize: Annotated[
        str,
        typer.Option(
            help="Where the graph's solvers start: auto, given, dead-reckoning or rotation-first.", rich_help_panel=GRAPH
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
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for figure and JSON.", show_default="results/<time>", rich_help_panel=OUTPUT
        ),
    ] = None,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Run all estimators on one log: a table, a figure and the numbers as JSON."""
    with sentences():
        from .config import RunConfig, sha256_of
        from .estimator import RunOptions
        from .results import RESULTS, check_can_make
        from .run import compare, with_models
        from .tables import comparison_remarks, comparison_table

        output = Output(json)
        check_can_make(RESULTS if out is None else out)
        config_of(ctx, config, log)
        reading: dict[str, Any] = {"robot": robot, "keep_every": keep_every, "stride": stride, "max_range": max_range}
        data, source = read_log(log, format, dimensions, **reading)
        motion, sensor = models(
            data, nn=nn, no=no, on=on, oo=oo, sigma_v=sigma_v, sigma_omega=sigma_omega, epsilon=epsilon,
            range_rate=range_rate, range_std=range_std, bearing_std=bearing_std, orientation_std=orientation_std,
            sensor_offset=sensor_offset,
        )  # fmt: skip
        options = RunOptions(
            edges=edges, frame=frame, weight=weight, motion_weight=motion_weight, robust=robust, initialize=initialize,
            particles=particles, seed=seed, resampling=resampling, association=association, motion=motion, sensor=sensor,
        )  # fmt: skip
        names = None if estimators is None else [name.strip() for name in estimators.split(",") if name.strip()]
        # the whole path, so that a repeat from another folder writes the same
        source = source.absolute()
        effective = RunConfig(
            log=None if log is None else source, log_sha256=sha256_of(source), format=format, dimensions=dimensions,
            estimators=None if names is None else tuple(names), options=with_models(options, data), **reading,
        )  # fmt: skip
        outcome = compare(data, names, options, source=source, progress=_progress(output))
        files = outcome.save(out, config=effective)
        output.console.print(comparison_table(outcome))
        output.say(*comparison_remarks(outcome))
        output.json(outcome.to_json(files))
        folder = files["figure"].parent
        output.say(f"Wrote {', '.join(path.name for path in files.values())} into {folder}{os.sep}")
        output.say(f"Again, bit for bit: slam-compare run --config {files['config']}")
        output.say(
            "Next: slam-compare simulate my.npz --seed 7 && slam-compare run my.npz"
            if log is None
            else f"Next: slam-compare solvers {log} checks the solver against GTSAM in every variant"
        )


def _progress(output: Output) -> Progress:
    def report(name: str, outcome: EstimatorResult | Skipped | None) -> None:
        from .estimator import EstimatorResult
        from .tables import seconds

        if isinstance(outcome, EstimatorResult):
            output.progress(f"{name}: {seconds(outcome.seconds)}")

    return report


@app.command(
    epilog=examples(
        "slam-compare solvers",
        "slam-compare solvers LOG --motion-weights 1,10,100 --json differences.json",
        "slam-compare solvers LOG --kernels none,huber,cauchy",
    )
)
def solvers(
    log: LogFile = None,
    format: LogFormat = None,
    robot: Robot = None,
    keep_every: KeepEvery = None,
    stride: Stride = 1,
    max_range: MaxRange = None,
    motion_weights: Annotated[
        str, typer.Option(metavar="LAMBDA,...", help="Factors on the motion edges to try.")
    ] = "1,10",
    edges: Annotated[
        str | None, typer.Option(metavar="EDGES,...", help="Kinds of graph to try.", show_default="all")
    ] = None,
    kernels: Annotated[
        str, typer.Option(metavar="KERNEL,...", help="Robust kernels to try: none, huber, cauchy, geman-mcclure.")
    ] = "none",
    jobs: Annotated[
        int | None,
        typer.Option(help="Variants to solve at a time.", min=1, show_default="the number of cores, up to 8"),
    ] = None,
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
    json: JsonFile = None,
) -> None:
    """Check the hand-written solver against GTSAM on every graph that a log allows; exit status 1 if they differ."""
    with sentences():
        from graphslam.graph import EDGES

        from .solvers import compare_solvers
        from .tables import solvers_remarks, solvers_table, variant_line

        output = Output(json)
        weights = numbers("--motion-weights", motion_weights)
        kinds = EDGES if edges is None else tuple(kind.strip() for kind in edges.split(","))
        data, _ = read_log(log, format, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range)
        motion, sensor = models(
            data, nn=nn, no=no, on=on, oo=oo, sigma_v=sigma_v, sigma_omega=sigma_omega, epsilon=epsilon,
            range_rate=range_rate, range_std=range_std, bearing_std=bearing_std, orientation_std=orientation_std,
            sensor_offset=sensor_offset,
        )  # fmt: skip
        outcome = compare_solvers(
            data, motion=motion, sensor=sensor, motion_weights=weights, edges=kinds,
            kernels=tuple(name.strip() for name in kernels.split(",")),
            jobs=jobs or min(os.cpu_count() or 1, 8),
            progress=lambda variant: output.progress(variant_line(variant)),
        )  # fmt: skip
        output.console.print(solvers_table(outcome, f"{data.name}: hand-written solver against GTSAM"))
        output.say(*solvers_remarks(outcome))
        if not outcome.problems:
            output.say(f"The solvers agree in all {len(outcome.variants)} variants.")
        output.json(outcome.to_json())
        if outcome.problems:
            raise typer.Exit(DIFFERENT)


app.command(
    epilog=examples(
        "slam-compare simulate my.npz --seed 7",
        "slam-compare simulate room.npz --way-points '4,-3 4,3 -4,3' --landmarks 20",
        "slam-compare simulate clean.npz --clean --no-orientation",
    )
)(simulate)


app.command(
    epilog=examples("slam-compare backends M3500.g2o", "slam-compare backends *.g2o --figure cost.png --json rows.json")
)(backends)


app.command(
    epilog=examples(
        "slam-compare particles --particles 10,100,1000 --seeds 5",
        "slam-compare particles LOG --figure particles.png --json particles.json",
    )
)(particles)


app.command(epilog=examples("slam-compare datasets", "SLAM_DATA=~/data slam-compare datasets --json -"))(datasets)


app.command(
    epilog=examples(
        "slam-compare consistency",
        "slam-compare consistency --noise 1 --figure anees.png --json anees.json",
        "slam-compare consistency --estimators 'landmark nodes,fastslam2' --logs 50",
    )
)(consistency)


app.command(
    epilog=examples(
        "slam-compare sweep examples/study.toml",
        "slam-compare sweep study.toml --jobs 8",
        "slam-compare sweep study.toml --dask tcp://head-node:8786",
    )
)(sweep)


app.command(
    epilog=examples(
        "slam-compare study study.sqlite",
        "slam-compare study show study.sqlite --baseline fastslam1 --figure study.pdf",
        "slam-compare study study.sqlite --csv runs.csv --jsonl runs.jsonl",
    )
)(study)


app.command(
    epilog=examples(
        "slam-compare animate relaxing.gif",
        "slam-compare animate LOG particles.mp4 --estimator fastslam1 --particles 200",
        "slam-compare animate LOG growing.html --estimator isam2 --max-frames 100",
    )
)(animate)


def main() -> None:
    """Entry point of ``slam-compare``."""
    try:
        app(prog_name="slam-compare")
    except KeyboardInterrupt:
        # before a verb began or while the interpreter was busy importing
        sys.exit(INTERRUPTED)
