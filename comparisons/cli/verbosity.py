"""What every verb understands: ``-q`` and ``-v``.

The two options are added to the verbs here, once, and read where output is made; no verb passes them on.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any, get_type_hints

import typer

OPTIONS = {
    "quiet": Annotated[bool, typer.Option("--quiet", "-q", help="Results only: no progress, no hints.")],
    "verbose": Annotated[
        bool,
        typer.Option(
            "--verbose", "-v", help="Also tell each step of the work, and where in the program an error arose."
        ),
    ],
}


class Verbosity:
    """How much is said.

    Attributes:
        quiet: results only: no progress, no hints about files and next steps.
        verbose: also each step of the work, on a terminal or not, and the traceback of errors.
    """

    quiet = False
    verbose = False


def verb(function: Callable[..., None]) -> Callable[..., None]:
    """A verb of ``slam-compare`` that also takes ``--quiet`` and ``--verbose``."""

    @wraps(function)
    def told(*args: Any, quiet: bool = False, verbose: bool = False, **kwargs: Any) -> None:
        Verbosity.quiet, Verbosity.verbose = quiet, verbose
        function(*args, **kwargs)

    # typer reads options off the signature; with real types, because it does not look up names for a function of ours
    hints = get_type_hints(function, include_extras=True) | OPTIONS
    parameters = [
        parameter.replace(annotation=hints[name]) for name, parameter in inspect.signature(function).parameters.items()
    ]
    ours = [inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=OPTIONS[n]) for n in OPTIONS]
    told.__signature__ = inspect.Signature([*parameters, *ours])  # type: ignore[attr-defined]
    told.__annotations__ = hints
    return told
