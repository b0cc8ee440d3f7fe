"""The output of a verb: tables and sentences on standard output, progress on standard error, and JSON.

Messages spell options as Python does; `in_flags` writes them as the command line has them, and `hint_of_import` says what to
do next where only another verb has them.
"""

from __future__ import annotations

import errno
import os
import re
import shlex
import shutil
import sys
import textwrap
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from json import dumps
from pathlib import Path
from typing import Any, Protocol

import typer

from graphslam.errors import SlamError, printable

#: exit statuses
DIFFERENT, WRONG_INPUT, INTERRUPTED = 1, 2, 130
#: where a figure cannot have the letters of a language
NO_FONT = (
    "Figures are in English, because no font with Japanese letters is installed; install one, such as fonts-noto-cjk."
)
#: the width of tables that are not written to a terminal
WIDTH = 140


class Advance(Protocol):
    """Moves a progress bar."""

    def __call__(self, steps: int, doing: str = "", total: int | None = None) -> None:
        """Move the bar by ``steps``, name the current work, and set the total where it is known only now."""


@contextmanager
def sentences(verbose: bool, options: Collection[str] | None = None, lang: str | None = None) -> Iterator[None]:
    """Turn user errors into one sentence and exit status 2, and Ctrl-C into 130; other errors keep their traceback.

    Args:
        verbose: also the traceback of user errors.
        options: names of those of the verb; None before they are known.
        lang: the language that was asked for; None for that of the environment.
    """
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        if _by_interrupt(error):
            typer.echo("interrupted", err=True)
            raise typer.Exit(INTERRUPTED) from None
        if isinstance(error, OSError) and error.errno != errno.EPIPE:
            where = "the output" if error.filename is None else error.filename
            error = SlamError(f"{where} cannot be read or written: {error.strerror or error}")
        if isinstance(error, MemoryError):
            error = SlamError(f"there is not enough memory for this ({error or 'no size given'}); ask for less")
        if not isinstance(error, SlamError):
            raise
        if verbose:
            traceback.print_exc()
        more = None if options is None else hint_of_import(str(error), options)
        language = _spoken(lang, sys.stderr)
        said = str(error) if more is None else f"{error}. {more}"
        text = in_language(said, language)
        # by itself: templates that begin with a place would take "error" for a part of it
        text = in_language("error: {}", "en" if text == said else language).format(in_flags(text, options or ()))
        typer.echo(text if not sys.stderr.isatty() else _wrapped(text), err=True)
        raise typer.Exit(WRONG_INPUT) from None


def _wrapped(text: str) -> str:
    """A sentence in lines of the terminal's width, broken only between words."""
    width = shutil.get_terminal_size().columns
    return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False, subsequent_indent="  ")


def _spoken(lang: str | None, stream: Any) -> str:
    """The language that is asked for, else that of the environment.

    English where the stream has no codes for the letters, or where there is no such language, which the verb then says.
    """
    from ..show.language import language_of

    try:
        language = language_of(lang)
    except SlamError:
        return "en"
    return language if encodable("日本", stream) else "en"


def _by_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an exception: a compiled module that is interrupted while it loads raises ImportError from it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class Output:
    """The output of a verb.

    Args:
        json: the file of the JSON; "-" for standard output, which then carries nothing else; None for no JSON.
        quiet: results only: no progress, no hints.
        verbose: also each step of the work, and the traceback of errors.
        lang: the language of tables and sentences; None for that of the environment.
        options: names of those of the verb.

    Raises:
        FormatError: the JSON file could not be written later.
        OptionError: there is no such language.
    """

    def __init__(
        self,
        json: str | None,
        *,
        quiet: bool = False,
        verbose: bool = False,
        lang: str | None = None,
        options: Collection[str] = (),
    ) -> None:
        from rich.console import Console

        from ..results.files import check_can_write
        from ..show.language import language_of

        self._to_stdout, self._file = json == "-", None if json in (None, "-") else Path(str(json))
        self.quiet, self.verbose, self._options = quiet, verbose, options
        if self._file is not None:
            check_can_write(self._file)
        stream = sys.stderr if self._to_stdout else sys.stdout
        language = language_of(lang)
        #: English where the stream has no codes for the letters of the language
        self.language = language if encodable("日本", stream) else "en"
        # without a terminal the width is that of the variable COLUMNS, if it is set
        width = None if stream.isatty() or "COLUMNS" in os.environ else WIDTH
        self.console = Console(file=stream, width=width, highlight=False)
        self._errors = Console(stderr=True, highlight=False)

    def show(self, result: Any, **options: Any) -> None:
        """Write the tables of a result and the remarks below them."""
        from ..show.language import translated_table
        from ..show.tables import tables_of

        tables, remarks = tables_of(result, **options)
        for k, table in enumerate(tables):
            if k:
                self.console.print()
            self.console.print(translated_table(table, self.language))
        self.say(*remarks)

    def result(self, result: Any, figure: Path | None = None) -> None:
        """Write the tables of a result, its JSON, and its figure, if they are asked for."""
        self.show(result)
        self.json(result.to_json())
        self.draw(result, figure)

    def draw(self, result: Any, path: Path | None, **options: Any) -> None:
        """Write the figure of a result, if it is asked for."""
        if path is not None:
            result.save_figure([path], language=self.language_of_figures(), **options)
            self.hint(f"Wrote {path}.")

    def language_of_figures(self) -> str:
        """The language of figures: English, with a hint, where no font has the letters of another one."""
        from ..show.canvas import font_of

        if self.language == "en" or font_of(self.language) is not None:
            return self.language
        self.hint(NO_FONT)
        return "en"

    def say(self, *lines: str) -> None:
        """Write sentences without markup; a terminal gets them broken between words, anything else one a line.

        Commands are not broken, so that they can be copied, and ``slam-compare`` is named so that it runs.
        """
        for line in lines:
            text = in_flags(in_language(printable(line), self.language), self._options)
            if "slam-compare " in text:
                text = text.replace("slam-compare ", f"{program()} ")
            elif self.console.is_terminal:
                text = _wrapped(text)
            self.console.print(text, markup=False, soft_wrap=True)

    @property
    def wants_json(self) -> bool:
        """Whether JSON was asked for."""
        return self._to_stdout or self._file is not None

    def json(self, payload: object) -> None:
        """Write the JSON where it was asked for, if anywhere."""
        from ..results.documents import json_text, write_json

        if self._to_stdout:
            text = json_text(payload)
            if not encodable(text):
                # JSON may hold any letter as an escape in ASCII
                text = re.sub(r"[^\x00-\x7f]", lambda letter: dumps(letter[0])[1:-1], text)
            typer.echo(text, nl=False)
        elif self._file is not None:
            write_json(payload, self._file)
            self.hint(f"Wrote {self._file}.")

    def hint(self, *lines: str) -> None:
        """Where the files are and what could come next; not with --quiet."""
        if not self.quiet:
            self.say(*lines)

    def hint_at_import(self, found: Any) -> None:
        """Hint at ``import`` where notes or findings of a log name options that the verb does not have."""
        texts = [*found.log.notes, *(finding.message for finding in found.findings)]
        if advice := hint_of_import(" ".join(texts), self._options):
            self.hint(f"{advice}.")

    def detail(self, line: str) -> None:
        """A line on standard error about a step of the work, with --verbose."""
        if self.verbose:
            self._errors.print(printable(line), style="dim", markup=False, soft_wrap=True)

    def progress(self, line: str) -> None:
        """A line on standard error about work that takes a while; not with --quiet."""
        if not self.quiet:
            self._errors.print(in_language(printable(line), self.language), markup=False, soft_wrap=True)

    @contextmanager
    def picture(self) -> Iterator[tuple[Callable[[list[str]], None], tuple[int, int]]]:
        """What draws lines on standard error again and again in the same place, and the width and height there is room for.

        Where standard error is no terminal, only the last picture is written.
        """
        from rich.live import Live
        from rich.text import Text

        def said(line: str) -> str:
            """A line in the language; the plan itself has no small letters."""
            return in_language(printable(line), self.language) if re.search("[a-z]", line) else line

        width, height = self._errors.size
        room = min(width, 140) - 1, max(min(height, 50) - 4, 5)
        with Live(console=self._errors, auto_refresh=False) as live:
            yield lambda lines: live.update(Text("\n".join(map(said, lines))), refresh=True), room
        if not self._errors.is_terminal:
            self._errors.print()

    @contextmanager
    def bar(self, what: str, total: int | None = None) -> Iterator[Advance]:
        """A progress bar with the remaining time on standard error, where that is a terminal; not with --quiet.

        Args:
            what: the work.
            total: the number of steps; None where it is unknown.
        """
        from rich import progress as bars

        what = in_language(what, self.language)
        columns = (
            bars.TextColumn("{task.description}", markup=False), bars.BarColumn(), bars.MofNCompleteColumn(),
            bars.TimeElapsedColumn(), bars.TextColumn(in_language("remaining", self.language)), bars.TimeRemainingColumn(),
        )  # fmt: skip
        hidden = self.quiet or not self._errors.is_terminal
        with bars.Progress(*columns, console=self._errors, transient=True, disable=hidden) as progress:
            task = progress.add_task(what, total=total)

            def advance(steps: int, doing: str = "", total: int | None = None) -> None:
                description = printable(f"{what}: {doing}") if doing else what
                progress.update(task, advance=steps, total=total, description=description)

            yield advance


def in_language(text: str, language: str) -> str:
    """A text in a language; the catalogue is loaded only where it is needed."""
    if language == "en":
        return text
    from ..show.language import translated

    return translated(text, language)


def language_of_words(words: Sequence[str]) -> str:
    """The language of a command line before it is parsed: that of --lang, else of the environment."""
    given = None
    for word, following in zip(words, [*words[1:], None]):
        if word == "--lang" or word.startswith("--lang="):
            given = following if word == "--lang" else word.partition("=")[2]
    return _spoken(given, sys.stdout)


def encodable(text: str, stream: Any = None) -> bool:
    """Whether a stream, standard output by default, has a code for every letter of a text."""
    try:
        text.encode(getattr(stream or sys.stdout, "encoding", None) or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def program() -> str:
    """The command that starts this program: its name, or its path where the shell does not find the name."""
    called = Path(sys.argv[0])
    if called.name != "slam-compare" or shutil.which(called.name) is not None:
        return "slam-compare"
    return shlex.quote(os.path.relpath(called))


#: an option of a command with its value; or one as Python spells it, with a text, numbers, or capitals for any value
_SPELLED = re.compile(
    r"--[\w-]+[ =]\S+|(?<![\w.\]'-])(?P<name>[a-z][a-z_]*)=(?P<value>'[^']*'|\[[^]']*\]|-?\d[\d.]*|[A-Z]+\b)", re.ASCII
)


@cache
def _names() -> tuple[frozenset[str], frozenset[str]]:
    """The names of the options of tables, and of those of ``run``."""
    # options are not imported until a sentence needs them, so that help is shown at once
    from graphslam.log.rows import TableOptions

    from ..options import RunOptions, options_of

    return frozenset(options_of(TableOptions)), frozenset(options_of(RunOptions))


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def in_flags(text: str, known: Collection[str]) -> str:
    """A text with options as the command line has them: name='text', as Python spells it, becomes --name text.

    Options of tables that the verb, with the options ``known``, does not have become lines of import.toml, name = "text".
    """

    def spelled(option: re.Match[str]) -> str:
        if not (name := option["name"]):
            return option[0]
        value, (of_tables, of_run) = option["value"], _names()
        if name in of_tables and name not in known:
            return f"{name} = " + value.replace("'", '"')
        # particles=100 is a label of a study, and f(kernel='cauchy') a call in Python
        label = value[-1].isdigit() and name not in of_tables and name != "dimensions"
        call = re.search(r"\w\([^()]*$", text[: option.start()])
        if (name in known or name in of_run) and not label and not call:
            return f"{_flag(name)} " + shlex.quote(value.strip("'[]").replace(", ", ","))
        return option[0]

    return _SPELLED.sub(spelled, text)


def hint_of_import(text: str, known: Collection[str] = ()) -> str | None:
    """Where options of tables that a sentence names stand for a verb that does not have them; None where it names none.

    Args:
        text: the sentence, with options as Python spells them.
        known: names of the options of the verb.
    """
    names = dict.fromkeys(option["name"] for option in _SPELLED.finditer(text))
    if not (flags := [_flag(name) for name in names if name and name in _names()[0] and name not in known]):
        return None
    return (
        f"slam-compare import has {', '.join(flags)}; other verbs read such options from import.toml in the folder of the "
        "tables, or from the TOML file of the bag's name (docs/own_robot.md)"
    )
