"""The command line ``slam-compare``, also ``python -m comparisons``.

NumPy, GTSAM, matplotlib and the estimators are imported inside the verbs, so that ``--help`` answers at once.
Exit status: 0 success, 1 a comparison found a difference or a run failed, 2 wrong input or option, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Collection
from typing import Annotated

import typer

from .logs import backends, calibrate, datasets, evaluate, import_, show, simulate, solvers
from .run import animate, report, run
from .studies import consistency, particles, study, sweep
from .verb import add_verb, list_verb, name_of


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"slam-compare {version('virtual-motion-slam')}")
        except PackageNotFoundError:
            typer.echo("slam-compare, not installed (run from its source)")
        raise typer.Exit


def _app(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Compare planar SLAM on one log: a hand-written graph solver, GTSAM, FastSLAM and dead reckoning."""


#: the verbs, and the examples in their help
VERBS: dict[Callable[..., None], tuple[str, ...]] = {
    run: (
        "slam-compare run",
        "slam-compare run LOG --estimators graph,fastslam1 --particles 5000",
        "slam-compare run LOG --edges virtual --frame world --json -",
        "slam-compare run LOG --noise noise.toml --kernel huber",
        "slam-compare run MONDAY TUESDAY WEDNESDAY",
        "slam-compare run --config results/latest/config.toml",
    ),
    report: (
        "slam-compare report report.html",
        "slam-compare report LOG report.html --estimators graph,fastslam1",
        "slam-compare report report.html --config results/latest/config.toml",
    ),
    import_: (
        "slam-compare import folder drive.npz",
        "slam-compare import --odometry wheels.csv --sightings tags.csv --angles degrees drive.npz",
        "slam-compare import drive.mcap",
        "slam-compare import drive.mcap drive.npz --odometry /odom --sightings /tags",
    ),
    show: (
        "slam-compare show",
        "slam-compare show drive.npz --figure drive.png",
        "slam-compare show folder --json -",
    ),
    evaluate: (
        "slam-compare evaluate truth.tum mine.tum theirs.csv --figure errors.png",
        "slam-compare evaluate LOG mine.tum --maps mine-map.csv",
        "slam-compare evaluate truth.csv mine.csv --angles truth=degrees --json -",
    ),
    solvers: (
        "slam-compare solvers",
        "slam-compare solvers LOG --motion-weights 1,10,100 --json differences.json",
        "slam-compare solvers LOG --kernel none,huber,cauchy",
    ),
    simulate: (
        "slam-compare simulate my.npz --seed 7",
        "slam-compare simulate room.npz --way-points '4,-3 4,3 -4,3' --landmarks 20",
        "slam-compare simulate clean.npz --clean --no-orientation",
    ),
    backends: (
        "slam-compare backends M3500.g2o",
        "slam-compare backends *.g2o --figure cost.png --json rows.json",
    ),
    particles: (
        "slam-compare particles --particles 10,100,1000 --seeds 5",
        "slam-compare particles LOG --figure particles.png --json particles.json",
    ),
    calibrate: (
        "slam-compare calibrate LOG --out noise.toml",
        "slam-compare calibrate ../shared/data/mrclam6 --robot 1 --out noise.toml",
        "slam-compare calibrate LOG1 LOG2 --source truth --out noise.toml",
        "slam-compare calibrate LOG --source residuals --json -",
        "slam-compare run LOG --noise noise.toml --kernel huber",
    ),
    datasets: (
        "slam-compare datasets",
        "SLAM_DATA=~/data slam-compare datasets --json -",
    ),
    consistency: (
        "slam-compare consistency",
        "slam-compare consistency --noise 1 --figure anees.png --json anees.json",
        "slam-compare consistency --estimators 'landmark nodes,fastslam2' --logs 50",
    ),
    sweep: (
        "slam-compare sweep examples/study.toml",
        "slam-compare sweep study.toml --jobs 8",
        "slam-compare sweep study.toml --dask tcp://head-node:8786",
    ),
    study: (
        "slam-compare study study.sqlite",
        "slam-compare study study.sqlite --baseline fastslam1 --figure study.pdf",
        "slam-compare study study.sqlite --csv runs.csv --jsonl runs.jsonl",
    ),
    animate: (
        "slam-compare animate relaxing.gif",
        "slam-compare animate LOG particles.mp4 --estimator fastslam1 --particles 200",
        "slam-compare animate LOG moving.gif --estimator fastslam1 --stage motion",
        "slam-compare animate LOG growing.html --estimator isam2 --max-frames 100",
        "slam-compare animate LOG samples.gif --estimator particle-gibbs --gibbs-iterations 60",
    ),
}


def make_app(complete: Collection[str] | None = None) -> typer.Typer:
    """The command line.

    Args:
        complete: the verbs that have all their options; the others are only listed. Default: all.
    """
    app = typer.Typer(
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    app.callback(epilog="Examples:\n\n  slam-compare run\n\n  slam-compare run LOG --estimators graph,fastslam1")(_app)
    for verb, examples in VERBS.items():
        if complete is None or name_of(verb) in complete:
            add_verb(app, verb, *examples)
        else:
            list_verb(app, verb)
    return app


def __getattr__(name: str) -> typer.Typer:
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    app: typer.Typer = globals().setdefault("app", make_app())
    return app


def main() -> None:
    """The command line on the words of ``sys.argv``."""
    # only the verb that is called needs its options; completion in a shell needs those of all
    words = None if "_SLAM_COMPARE_COMPLETE" in os.environ else sys.argv[1:]
    make_app(words)(prog_name="slam-compare")
