"""Help, and errors of the command line itself, in the language that is asked for.

Typer makes them of texts of its own and of ours. Ours are translated where the verbs are made (`verb.add_verb`), Typer's
here. For English this module is loaded only when help is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
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
    """While a command runs, replace the fixed texts of Typer, such as titles, and how its tables break lines."""
    texts = {name: text for name, text in vars(rich_utils).items() if name.isupper() and isinstance(text, str)}
    texts = {name: translated(text, language) for name, text in texts.items()}
    return _changed({**texts, "Columns": _Wrapped, "Table": _Wrapping})


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


class _Wrapping(Table):
    """A table whose texts are broken as `_Wrapped`."""

    def add_row(self, *cells: Any, **options: Any) -> None:
        super().add_row(*(_Wrapped([each]) if isinstance(each, Text) else each for each in cells), **options)


class _Wrapped:
    """The help of an option and its default, broken into lines where Japanese allows it: Rich breaks at spaces only."""

    def __init__(self, texts: list[Text]) -> None:
        self.text = Text(" ").join(texts)

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(min(20, options.max_width), min(self.text.cell_len, options.max_width))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in self.text.divide(line_breaks(self.text.plain, options.max_width)):
            line.rstrip()
            line.overflow = "fold"
            yield line


def line_breaks(text: str, width: int) -> list[int]:
    """Where to break a text into lines of a width: after a space, and beside wide letters, but not before a mark."""
    breaks: list[int] = []
    possible = column = 0
    for k, letter in enumerate(text):
        beside = k > 0 and (text[k - 1] == " " or cell_len(letter) == 2 or cell_len(text[k - 1]) == 2)
        if beside and letter not in " :,.)]、。，）」・ー％ゃゅょっャュョッ" and text[k - 1] not in "([（「":
            possible = k
        if column + cell_len(letter.strip()) > width and possible > (breaks or [0])[-1]:
            breaks.append(possible)
            column = cell_len(text[possible:k])
        column += cell_len(letter)
    return breaks


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
