"""The command line ``slam-compare``, also ``python -m comparisons``.

Everything heavy (NumPy, numba, GTSAM, matplotlib, the framework itself) is imported inside the verbs, so that
``--help`` answers at once. Exit status: 0 all well, 1 solvers differ, 2 wrong input or option, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from inspect import unwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .animate import animate
from .backends import backends
from .calibrate import calibrate
from .compared import compared
from .config_file import ConfigFile
from .consistency import consistency
from .datasets import datasets
from .options import (
    GRAPH,
    OUTPUT,
    Association,
    BearingStd,
    Dimensions,
    Epsilon,
    FigureFormats,
    JsonFile,
    KeepEvery,
    LogFile,
    LogFormat,
    MaxRange,
    Nn,
    No,
    NoiseFile,
    On,
    Oo,
    OrientationStd,
    RangeBias,
    RangeRate,
    RangeScale,
    RangeStd,
    Resampling,
    Robot,
    Seed,
    SensorOffset,
    SigmaOmega,
    SigmaV,
    Stride,
)
from .parsing import figure_formats, numbers
from .particles import particles
from .report import report_like
from .simulate import simulate
from .study import study
from .support import DIFFERENT, INTERRUPTED, Output, examples, models, quoted, read_log, reread, sentences
from .sweep import sweep
from .verbosity import verb

if TYPE_CHECKING:
    from ..solvers import SkippedVariant, VariantResult

app = typer.Typer(
    no_args_is_help=True,
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
        "slam-compare run LOG --noise noise.toml --robust huber",
        "slam-compare run --config results/latest/config.toml",
    ),
)
@verb
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
    noise: NoiseFile = None,
    range_scale: RangeScale = None,
    range_bias: RangeBias = None,
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
            metavar="DIR", help="Folder for the results.", show_default="results/<time>", rich_help_panel=OUTPUT
        ),
    ] = None,
    figures: FigureFormats = "png,pdf",
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also write the report page, one HTML file.", show_default=False, rich_help_panel=OUTPUT
        ),
    ] = None,
    json: JsonFile = None,
) -> None:  # fmt: skip
    """Run all estimators on one log: a table, a figure and the numbers as JSON."""
    with sentences():
        from ..saving import RESULTS, check_can_make
        from ..tables import comparison_remarks, comparison_table

        output = Output(json)
        check_can_make(RESULTS if out is None else out)
        formats = figure_formats(figures)
        if html is not None:
            from ..report import check_page, write_report

            check_page(html)
        outcome, effective = compared(
            ctx, output, log=log, noise=noise, config=config, estimators=estimators, format=format, dimensions=dimensions,
            robot=robot, keep_every=keep_every, stride=stride, max_range=max_range,
            edges=edges, frame=frame, weight=weight, motion_weight=motion_weight, robust=robust, initialize=initialize,
            particles=particles, seed=seed, resampling=resampling, association=association,
            nn=nn, no=no, on=on, oo=oo, sigma_v=sigma_v, sigma_omega=sigma_omega, epsilon=epsilon,
            range_rate=range_rate, range_std=range_std, bearing_std=bearing_std, orientation_std=orientation_std,
            sensor_offset=sensor_offset, range_scale=range_scale, range_bias=range_bias,
        )  # fmt: skip
        files = outcome.save(out, formats=formats, config=effective)
        output.console.print(comparison_table(outcome.table))
        output.say(*comparison_remarks(outcome))
        page = {}
        if html is not None:
            write_report(outcome, html, effective)
            page["html"] = html
        output.json(outcome.to_json(files | page))
        folder = files["json"].parent
        exchanged = ["trajectories (*.tum)", "maps (*-map.csv)"] + ["graph.g2o"] * ("graph.g2o" in files)
        named = [path.name for kind, path in files.items() if not kind.endswith((".tum", ".csv", ".g2o"))]
        output.hint(f"Wrote {', '.join([*named, *exchanged])} into {folder}{os.sep}")
        if html is not None:
            output.hint(f"Wrote {html}: open it in a browser.")
        words = reread(log, format=format, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range)
        output.hint(f"Again, bit for bit: slam-compare run --config {quoted(files['config'])}")
        output.hint(
            f"Next: slam-compare report {quoted(*words, 'page.html')} is a page to look into"
            + ("" if find_spec("plotly") else " (after: pip install plotly)")
            + f", slam-compare animate {quoted(*words, 'film.gif')} a film"
        )


app.command(
    "report",
    epilog=examples(
        "slam-compare report page.html",
        "slam-compare report LOG page.html --estimators graph,fastslam1",
        "slam-compare report page.html --config results/latest/config.toml",
    ),
)(verb(report_like(unwrap(run))))


@app.command(
    epilog=examples(
        "slam-compare solvers",
        "slam-compare solvers LOG --motion-weights 1,10,100 --json differences.json",
        "slam-compare solvers LOG --kernels none,huber,cauchy",
    ),
)
@verb
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

        from ..solvers import compare_solvers, variants
        from ..tables import solvers_remarks, solvers_table, variant_line

        output = Output(json)
        weights = numbers("--motion-weights", motion_weights)
        kinds = EDGES if edges is None else tuple(kind.strip() for kind in edges.split(","))
        data, _ = read_log(log, format, robot=robot, keep_every=keep_every, stride=stride, max_range=max_range)
        motion, sensor = models(
            data, nn=nn, no=no, on=on, oo=oo, sigma_v=sigma_v, sigma_omega=sigma_omega, epsilon=epsilon,
            range_rate=range_rate, range_std=range_std, bearing_std=bearing_std, orientation_std=orientation_std,
            sensor_offset=sensor_offset,
        )  # fmt: skip
        robust = tuple(name.strip() for name in kernels.split(","))
        with output.bar("variants", sum(1 for _ in variants(data, weights, kinds, robust))) as advance:

            def told(variant: VariantResult | SkippedVariant) -> None:
                advance(1, variant.name)
                output.detail(variant_line(variant))

            outcome = compare_solvers(
                data, motion=motion, sensor=sensor, motion_weights=weights, edges=kinds, kernels=robust,
                jobs=jobs or min(os.cpu_count() or 1, 8), progress=told,
            )  # fmt: skip
        output.console.print(solvers_table(outcome, f"{data.name}: hand-written solver against GTSAM"))
        output.say(*solvers_remarks(outcome))
        if not outcome.problems:
            output.say(f"The solvers agree in all {len(outcome.variants)} variants.")
            output.hint("Next: slam-compare consistency asks whether their covariances are true")
        output.json(outcome.to_json())
        if outcome.problems:
            raise typer.Exit(DIFFERENT)


app.command(
    epilog=examples(
        "slam-compare simulate my.npz --seed 7",
        "slam-compare simulate room.npz --way-points '4,-3 4,3 -4,3' --landmarks 20",
        "slam-compare simulate clean.npz --clean --no-orientation",
    ),
)(verb(simulate))


app.command(
    epilog=examples(
        "slam-compare backends M3500.g2o", "slam-compare backends *.g2o --figure cost.png --json rows.json"
    ),
)(verb(backends))


app.command(
    epilog=examples(
        "slam-compare particles --particles 10,100,1000 --seeds 5",
        "slam-compare particles LOG --figure particles.png --json particles.json",
    ),
)(verb(particles))


app.command(
    epilog=examples(
        "slam-compare calibrate LOG --out noise.toml",
        "slam-compare calibrate ../shared/data/mrclam6 --robot 1 --out noise.toml",
        "slam-compare calibrate LOG --source residuals --json -",
        "slam-compare run LOG --noise noise.toml --robust huber",
    )
)(verb(calibrate))


app.command(epilog=examples("slam-compare datasets", "SLAM_DATA=~/data slam-compare datasets --json -"))(verb(datasets))


app.command(
    epilog=examples(
        "slam-compare consistency",
        "slam-compare consistency --noise 1 --figure anees.png --json anees.json",
        "slam-compare consistency --estimators 'landmark nodes,fastslam2' --logs 50",
    ),
)(verb(consistency))


app.command(
    epilog=examples(
        "slam-compare sweep examples/study.toml",
        "slam-compare sweep study.toml --jobs 8",
        "slam-compare sweep study.toml --dask tcp://head-node:8786",
    ),
)(verb(sweep))


app.command(
    epilog=examples(
        "slam-compare study study.sqlite",
        "slam-compare study show study.sqlite --baseline fastslam1 --figure study.pdf",
        "slam-compare study study.sqlite --csv runs.csv --jsonl runs.jsonl",
    ),
)(verb(study))


app.command(
    epilog=examples(
        "slam-compare animate relaxing.gif",
        "slam-compare animate LOG particles.mp4 --estimator fastslam1 --particles 200",
        "slam-compare animate LOG growing.html --estimator isam2 --max-frames 100",
    )
)(verb(animate))


def main() -> None:
    """Entry point of ``slam-compare``."""
    try:
        app(prog_name="slam-compare")
    except KeyboardInterrupt:
        # before a verb began or while the interpreter was busy importing
        sys.exit(INTERRUPTED)
