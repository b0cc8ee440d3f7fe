"""What the verbs have in common: errors as sentences, JSON to a file or standard output, models from options."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import typer
from rich.console import Console

from ..shown import WIDTH
from .verbosity import Verbosity

if TYPE_CHECKING:
    from graphslam import Log, MotionModel, SensorModel

#: exit statuses
DIFFERENT, WRONG_INPUT, INTERRUPTED = 1, 2, 130


class Advance(Protocol):
    """Moves a bar on by so many steps, and says what is being done and how many steps there will be."""

    def __call__(self, steps: int, doing: str = "", total: int | None = None) -> None:
        """Move the bar."""


@contextmanager
def sentences() -> Iterator[None]:
    """Turn the user's mistakes into one sentence and exit status 2, and Ctrl-C into 130; bugs keep their traceback."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except Exception as error:
        from graphslam.errors import SlamError

        if not isinstance(error, SlamError):
            raise
        if Verbosity.verbose:
            traceback.print_exc()
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(WRONG_INPUT) from None


class Output:
    """Where a verb writes: tables and sentences to standard output, unless the JSON goes there.

    Raises:
        FormatError: the JSON file could not be written later.
    """

    def __init__(self, json: str | None) -> None:
        self._to_stdout, self._file = json == "-", None if json in (None, "-") else Path(str(json))
        if self._file is not None:
            from ..saving import check_can_write

            check_can_write(self._file)
        stream = sys.stderr if self._to_stdout else sys.stdout
        self.console = Console(file=stream, width=None if stream.isatty() else WIDTH, highlight=False)
        self._errors = Console(stderr=True, highlight=False)

    def say(self, *sentences: str) -> None:
        """Write sentences, one a line; nothing in them is taken for markup."""
        for sentence in sentences:
            self.console.print(sentence, markup=False, soft_wrap=True)

    def json(self, payload: Mapping[str, Any]) -> None:
        """Write the JSON where it was asked for, if anywhere."""
        from ..saving import json_text, write_json

        if self._to_stdout:
            typer.echo(json_text(payload), nl=False)
        elif self._file is not None:
            write_json(payload, self._file)
            self.hint(f"Wrote {self._file}.")

    def hint(self, *sentences: str) -> None:
        """Where files are and what comes next; not with --quiet. ``slam-compare`` is named so that it is found."""
        if not Verbosity.quiet:
            self.say(*(sentence.replace("slam-compare ", f"{program()} ") for sentence in sentences))

    def detail(self, sentence: str) -> None:
        """A line on standard error about a step of the work, with --verbose."""
        if Verbosity.verbose:
            self._errors.print(sentence, style="dim", markup=False, soft_wrap=True)

    @contextmanager
    def bar(self, what: str, total: int | None) -> Iterator[Advance]:
        """A bar with the time left on standard error, where that is a terminal; yields what to call at each step.

        ``total`` is None where nobody knows how many steps there will be. Not with --quiet.
        """
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
            TimeRemainingColumn(),
        )  # fmt: skip
        hidden = Verbosity.quiet or not self._errors.is_terminal
        with Progress(*columns, console=self._errors, transient=True, disable=hidden) as progress:
            task = progress.add_task(what, total=total)

            def advance(steps: int, doing: str = "", total: int | None = None) -> None:
                progress.update(task, advance=steps, description=f"{what}: {doing}" if doing else what)
                if total is not None:
                    progress.update(task, total=total)

            yield advance


def read_log(
    path: Path | None,
    format: str | None,
    dimensions: int | None = None,
    *,
    robot: int | None = None,
    keep_every: float | None = None,
    stride: int = 1,
    max_range: float | None = None,
) -> tuple[Log, Path]:
    """The log and the file or folder it came from: the sample log where no path is given.

    Raises:
        FormatError: the file is not a log.
        LogError: 3-D sensor values are asked for, and the log has none.
        OptionError: an option is not for this log.
    """
    import numpy as np

    from graphslam import LogError, load, sample_log_path
    from graphslam.checks import check_positive

    source = sample_log_path() if path is None else path
    with warnings.catch_warnings():
        # what a reader warns of is among the notes of the log, too, which are shown
        warnings.simplefilter("ignore", UserWarning)
        log = load(source, format=format, robot=robot, keep_every=keep_every)
    if dimensions == 3 and not log.has_orientation:
        raise LogError(f"{source}: the sightings have no psi, but 3-D sensor values were asked for; use --dimensions 2")
    if stride > 1:
        log = log.at_steps(np.arange(0, log.num_poses, stride))
    if max_range is not None:
        check_positive(max_range=max_range)
        log = log.nearer_than(max_range)
    return (log.without_orientation() if dimensions == 2 else log), source


def with_noise(
    log: Log, noise: Path | None, range_scale: float | None = None, range_bias: float | None = None
) -> tuple[Log, dict[str, float]]:
    """The log with the models of a noise file and with its ranges corrected, and by which line.

    Args:
        log: as it was read.
        noise: the file, or None.
        range_scale, range_bias: beat those of the file.

    Returns:
        The log, and {"range_scale": ..., "range_bias": ...}.

    Raises:
        FormatError: the file is not a noise file.
        LogError: a corrected range would not be above zero.
        OptionError: an option is impossible.
    """
    said = {}
    if noise is not None:
        from ..noise_files import read_noise

        found = read_noise(noise)
        log = found.apply(log)
        said = {"range_scale": found.range_scale, "range_bias": found.range_bias}
    said |= given({"range_scale": range_scale, "range_bias": range_bias})
    line = {"range_scale": 1.0, "range_bias": 0.0} | said
    return (log.with_corrected_ranges(line["range_scale"], line["range_bias"]) if said else log), line


def models(
    log: Log | None,
    *,
    sensor_offset: str | None = None,
    **noise: float | None,
) -> tuple[MotionModel, SensorModel]:
    """The noise models: the log's own, or else the book's, with what the options (named like the fields) say.

    ``sigma_v`` and ``sigma_omega`` without any of the book's four replace those; so does ``range_std`` ``range_rate``.

    Raises:
        OptionError: a noise is impossible.
    """
    from graphslam import MotionModel, SensorModel

    from .parsing import numbers

    said = given(noise)
    book, timed = ("nn", "no", "on", "oo"), ("sigma_v", "sigma_omega")
    if any(name in said for name in timed) and not any(name in said for name in book):
        said |= dict.fromkeys(book, 0.0)
    elif any(name in said for name in book) and not any(name in said for name in timed):
        said |= dict.fromkeys(timed, 0.0)
    if "range_std" in said:
        said.setdefault("range_rate", 0.0)
    elif "range_rate" in said:
        said["range_std"] = 0.0
    of_motion = {name: said.pop(name) for name in (*book, *timed, "epsilon") if name in said}
    of_log = (None, None) if log is None else (log.motion, log.sensor)
    motion = replace(of_log[0] or MotionModel(), **of_motion)
    if sensor_offset is not None:
        said["offset"] = numbers("--sensor-offset", sensor_offset, count=2)
    return motion, replace(of_log[1] or SensorModel(), **said)


def log_and_output(words: list[str], form: str) -> tuple[Path | None, Path]:
    """The log, or None, and the file to write, of the words '[LOG] OUT'.

    Raises:
        OptionError: there are more words; the message shows the form.
    """
    from graphslam import OptionError

    if len(words) > 2:
        raise OptionError(f"give a log and a file to write, nothing more: {form}")
    return (Path(words[0]) if len(words) == 2 else None), Path(words[-1])


def program() -> str:
    """How the user calls this program: by its name, or by its path where the name is not found (.venv not activated)."""
    called = Path(sys.argv[0])
    if called.name != "slam-compare" or shutil.which(called.name) is not None:
        return "slam-compare"
    return shlex.quote(os.path.relpath(called))


def quoted(*words: Path | str | None, before: str = "") -> str:
    """Words for a command line that can be pasted; None is left out, and ``before`` only stands before something."""
    text = shlex.join(str(word) for word in words if word is not None)
    return before + text if text else ""


def reread(log: Path | None, **reading: Any) -> list[str]:
    """The words that name a log and how it was read, for the next command: LOG --robot 1 --stride 5."""
    usual = {None, 1}
    words = [] if log is None else [str(log)]
    for name, value in reading.items():
        if value not in usual or (name == "robot" and value is not None):
            words += [f"--{name.replace('_', '-')}", str(value)]
    return words


def given(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are not None."""
    return {name: value for name, value in options.items() if value is not None}


def examples(*lines: str) -> str:
    """The end of a verb's help. Blank lines between, because rich joins neighbouring ones."""
    return "\n\n".join(["Examples:", *(f"  {line}" for line in lines)])
