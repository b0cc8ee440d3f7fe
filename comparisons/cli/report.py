"""The verb ``report``: takes the options of ``run`` and leaves behind one page."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from .compared import compared
from .support import Output, log_and_output, quoted, reread, sentences

#: parameters of ``run`` that say where its files go, and its argument LOG, which is one of the words here
NOT_SHARED = ("log", "out", "html", "figures")

Words = Annotated[
    list[str],
    typer.Argument(metavar="[LOG] OUT.html", help="The log (default: the sample log of the package), and the page."),
]


def report_like(run: Callable[..., None]) -> Callable[..., None]:
    """The verb, with the very options of ``run``: written once, they cannot come to differ.

    Typer reads them off the signature, which is therefore put together here.
    """
    signature = inspect.signature(run, eval_str=True)
    shared = [p for name, p in signature.parameters.items() if name not in (*NOT_SHARED, "ctx")]
    ctx, words = (
        inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=kind)
        for name, kind in (("ctx", typer.Context), ("words", Words))
    )

    def report(ctx: typer.Context, words: list[str], json: str | None, **told: Any) -> None:
        """Run all estimators on one log and write a page about it: one HTML file, to be opened from disk, offline."""
        with sentences():
            from ..report import check_page, write_report
            from ..tables import comparison_remarks, comparison_table

            output = Output(json)
            log, page = _log_and_page(words, ctx)
            check_page(page)
            comparison, config = compared(ctx, output, log=log, **told)
            write_report(comparison, page, config)
            output.console.print(comparison_table(comparison.table))
            output.say(*comparison_remarks(comparison))
            output.json(comparison.to_json({"html": page}))
            output.hint(f"Wrote {page}: open it in a browser.")
            read = {name: told.get(name) for name in ("format", "robot", "keep_every", "stride", "max_range")}
            words = reread(log, **read)
            output.hint(f"Next: slam-compare solvers{quoted(*words, before=' ')} checks the solver against GTSAM")

    parameters = [ctx, words, *shared]
    report.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    report.__annotations__ = {p.name: p.annotation for p in parameters} | {"return": None}
    return report


def _log_and_page(words: list[str], ctx: typer.Context) -> tuple[Path | None, Path]:
    """The log and the page that 'LOG OUT.html' or 'OUT.html' name; without a log that of the configuration counts.

    Raises:
        OptionError: there are more words.
    """
    log, page = log_and_output(words, "slam-compare report LOG OUT.html")
    configured = (ctx.default_map or {}).get("log")
    return Path(configured) if log is None and configured is not None else log, page
