"""Help, and errors of the command line itself, in the language that is asked for.

Typer makes them of texts of its own and of ours. Ours are translated where the verbs are made (`verb.add_verb`), Typer's
here. For English this module is loaded only when help is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from rich.table import Table
from rich.text import Text
from typer import rich_utils
from typer.core import TyperCommand, TyperGroup

from ..show.language import catalogue, key_of, translated


def classes_of(language: str) -> tuple[type[TyperGroup], type[TyperCommand]]:
    """Classes for the command line and for its verbs, whose help and errors are in a language."""

    class Verbs(_with_help(TyperGroup, language)):  # type: ignore[misc]
        """The command line: it holds the verbs, and parses."""

        def main(self, *arguments: Any, **options: Any) -> Any:
            with _texts_of_typer(language):
                return super().main(*arguments, **options)

        def make_context(self, *arguments: Any, **options: Any) -> Any:
            with _errors(language):
                return super().make_context(*arguments, **options)

        def invoke(self, ctx: Any) -> Any:
            with _errors(language):
                return super().invoke(ctx)

    return Verbs, _with_help(TyperCommand, language)


def _with_help(base: Any, language: str) -> Any:
    """A class of Typer with usage, arguments, and options such as --help, which all verbs have, in the language."""

    class Translated(base):
        def get_usage(self, ctx: Any) -> str:
            head, colon, forms = super().get_usage(ctx).partition(":")
            return translated(head + colon, language) + forms

        def get_params(self, ctx: Any) -> Any:
            parameters = super().get_params(ctx)
            for parameter in parameters:
                for name in ("help", "show_default"):
                    # what `verb` has translated is not in the catalogue, and a single word is a value
                    text = str(getattr(parameter, name, ""))
                    if " " in text and key_of(text) in catalogue(language):
                        setattr(parameter, name, translated(text, language))
            return parameters

    return Translated


def folded() -> AbstractContextManager[None]:
    """While help is written, break names that are too long for a narrow terminal, instead of cutting them."""
    return _changed({"Table": _Folding})


def _texts_of_typer(language: str) -> AbstractContextManager[None]:
    """While a command runs, replace the fixed texts of Typer, such as titles."""
    texts = {name: text for name, text in vars(rich_utils).items() if name.isupper() and isinstance(text, str)}
    texts = {name: translated(text, language) for name, text in texts.items()}
    return _changed({**texts, "Columns": _joined, "Table": _Folding})


@contextmanager
def _changed(changed: dict[str, Any]) -> Iterator[None]:
    """Replace names in the part of Typer that writes help."""
    before = {name: getattr(rich_utils, name) for name in changed if hasattr(rich_utils, name)}
    try:
        for name in before:
            setattr(rich_utils, name, changed[name])
        yield
    finally:
        for name, value in before.items():
            setattr(rich_utils, name, value)


class _Folding(Table):
    """A table whose words are broken where they are longer than a line."""

    def add_row(self, *cells: Any, **options: Any) -> None:
        for cell in cells:
            if isinstance(cell, Text):
                cell.overflow = "fold"
        super().add_row(*cells, **options)


def _joined(texts: list[Text]) -> Text:
    """The help of an option and its default as one text, broken anywhere where Rich finds no space."""
    return Text(" ", overflow="fold").join(texts)


@contextmanager
def _errors(language: str) -> Iterator[None]:
    """Translate the message of an error of the parser: a missing argument, an unknown option, a value of another type."""
    try:
        yield
    except Exception as error:
        if hasattr(error, "format_message"):
            text = translated(error.format_message(), language)
            error.format_message = lambda: text
        raise
