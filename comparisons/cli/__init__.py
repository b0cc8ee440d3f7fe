"""The command line ``slam-compare``, also ``python -m comparisons``.

NumPy, GTSAM, matplotlib and the estimators are imported inside the verbs, so that ``--help`` answers at once.
Exit status: 0 success, 1 a comparison found a difference or a run failed, 2 wrong input or option, 130 interrupted.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Collection
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from .logs import backends, calibrate, datasets, evaluate, import_, show, simulate, solvers
from .output import in_language, language_of_words, sentences
from .run import animate, associate, consistency, particles, report, run, study, sweep
from .verb import Lang, add_verb, epilog_of, list_verb, name_of


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"slam-compare {version('virtual-motion-slam')}")
        except PackageNotFoundError:
            typer.echo("slam-compare, not installed (run from its source)")
        raise typer.Exit


def _app(
    ctx: typer.Context,
    version: Annotated[  # noqa: ARG001
        bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)
    ] = False,
    lang: Lang = None,
) -> None:
    """Compare planar SLAM on one log: a hand-written graph solver, GTSAM, FastSLAM and dead reckoning."""
    if lang is not None:
        with sentences(verbose=False):
            from ..show.language import language_of

            ctx.obj = language_of(lang)


#: the verbs, in the order of the help
VERBS = (
    run, report, import_, show, associate, evaluate, solvers, simulate, backends, particles, calibrate, datasets, consistency,
    sweep, study, animate,
)  # fmt: skip


class _Verb(TyperCommand):
    """A verb whose help is cut nowhere."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from .help import folded

        with folded():
            super().format_help(ctx, formatter)


def make_app(complete: Collection[str] | None = None, language: str = "en") -> typer.Typer:
    """The command line.

    Args:
        complete: the verbs that have all their options; the others are only listed. Default: all.
        language: of the help, and of what the parser says.
    """
    group: type[TyperGroup] = TyperGroup
    command: type[TyperCommand] = _Verb
    if language != "en":
        from .help import classes_of

        group, command = classes_of(language)
    app = typer.Typer(
        cls=group, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )  # fmt: skip
    examples = ("slam-compare run", "slam-compare run LOG --estimators graph,fastslam1")
    app.callback(help=in_language(inspect.getdoc(_app) or "", language), epilog=epilog_of(examples, language))(_app)
    for verb in VERBS:
        if complete is None or name_of(verb) in complete:
            add_verb(app, verb, command, language)
        else:
            list_verb(app, verb, language)
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
    language = language_of_words(sys.argv[1:])
    make_app(words, language)(prog_name="slam-compare", obj=language)
