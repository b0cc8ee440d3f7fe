"""Random command lines: exit status 0, 1 or 2, and never a traceback."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import chdir
from functools import cache
from pathlib import Path
from typing import Any

import typer
from numpy.random import default_rng
from typer.testing import CliRunner

import comparisons.options as declared
from comparisons.cli import make_app
from comparisons.options.declaration import Options, options_of
from graphslam import SlamError

from .attempt import Case
from .files import originals


def command_case(seed: int, number: int) -> Case:
    """A random command line, mostly of possible words: exit status 0, 1 or 2, and never a traceback."""
    rng = default_rng([seed, 2, number])

    def one_of(values: Sequence[str]) -> str:
        return str(rng.choice(values))

    verb = one_of(sorted(typer.main.get_command(app()).commands))  # type: ignore[attr-defined]
    options = _flags(verb)
    words = [verb, *ARGUMENTS.get(verb, ["log.npz"])]
    # three of four command lines have possible values only; these may still contradict each other
    possible = bool(rng.random() < 0.75)
    if not possible and rng.random() < 0.5:
        words[1:] = [one_of(WORDS)] if rng.random() < 0.7 else []
    for _ in range(int(rng.integers(0, 3 if possible else 5))):
        flag = one_of([f for f in sorted(options) if options[f] != []] if possible else sorted(options))
        words.append(flag)
        if (values := options[flag]) is not None:
            words.append(one_of(values if values and (possible or rng.random() < 0.5) else VALUES))
    # what keeps a case short
    small = {"run": "--estimators=dead-reckoning,graph", "report": "--estimators=dead-reckoning",
             "particles": "--particles=5", "consistency": "--logs=2", "animate": "--max-frames=2",
             "solvers": "--motion-weights=1 --edges=landmark+motion", "simulate": "--steps=9"}  # fmt: skip
    for option in small.get(verb, "").split():
        if not any(word.startswith(option.split("=")[0]) for word in words):
            words.append(option)
    if verb in ("particles", "sweep", "consistency", "solvers"):
        words += ["--jobs=1" if verb == "sweep" else "--jobs=0"]

    def check() -> list[str]:
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            shutil.copytree(originals()["tables"], "tables")
            for name, original in originals().items():
                if original.is_file() and name in ("npz", "g2o", "config", "noise", "study"):
                    Path({"npz": "log"}.get(name, "graph" if name == "g2o" else name) + original.suffix).write_bytes(
                        original.read_bytes()
                    )
            Path("empty.txt").touch()
            warnings.simplefilter("ignore")
            result = CliRunner().invoke(app(), words)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        if "Traceback" in result.output or result.exit_code not in (0, 1, 2):
            return [f"exit status {result.exit_code}: {result.output[-200:]}"]
        if result.exit_code == 2:
            raise SlamError(result.output.strip().split("error: ")[-1].replace("\n", " ") or "no sentence")
        return []

    return f"command {number}: {' '.join(words)}", check


#: the arguments of a verb, where they are not a log
ARGUMENTS = {
    "backends": ["graph.g2o"], "sweep": ["study.toml"], "study": ["study.toml"], "simulate": ["out.npz"],
    "report": ["log.npz", "out.html"], "animate": ["log.npz", "out.html"], "import": ["tables"], "datasets": [],
    "consistency": [],
}  # fmt: skip
#: arguments that may be wrong
WORDS = ["log.npz", "graph.g2o", "config.toml", "study.toml", "nowhere", "empty.txt", "."]
#: values of options, most of them impossible for most options
VALUES = [
    "0",
    "-1",
    "1e-9",
    "1e9",
    "nan",
    "inf",
    "1e400",
    "",
    "x",
    "1,2",
    "a,b",
    "-",
    "/nowhere/x",
    "99999999999999999999",
    "true",
    "$$",
    "ü",
    "log.npz",
]
#: possible values by the type of the option
POSSIBLE = {int: ["1", "2", "3", "7"], float: ["0.5", "1", "2.5", "0.01"]}
#: and by the name of those that are texts or lists
TEXTS = {
    "--estimators": ["graph", "dead-reckoning,fastslam1", "mcl", "isam2", "textbook,gtsam"],
    "--filters": ["fastslam1", "mcl,fastslam2"], "--particles": ["1", "10,20"], "--figures": ["png", "pdf,svg"],
    "--motion-weights": ["1", "1,10"], "--json": ["out.json", "-"], "--baseline": ["graph"], "--noise": ["noise.toml"],
    "--way-points": ["4,-3 4,3"], "--start": ["1,1,0"], "--offset": ["0.1", "0.1,0.2"], "--config": ["config.toml"],
    "--figure": ["out.png", "out.pdf"], "--html": ["page.html"], "--out": ["folder"],
}  # fmt: skip


@cache
def app() -> Any:
    """The whole command line."""
    return make_app()


@cache
def _flags(verb: str) -> dict[str, list[str] | None]:
    """The options of a verb with possible values, as far as they are known; None for those that take none."""
    groups = [g for g in vars(declared).values() if isinstance(g, type) and issubclass(g, Options)]
    known = {o.flag: [*o.choices] or POSSIBLE.get(o.each, []) for group in groups for o in options_of(group).values()}
    flags: dict[str, list[str] | None] = {}
    for option in typer.main.get_command(app()).commands[verb].params:  # type: ignore[attr-defined]
        for flag in (*option.opts, *option.secondary_opts):
            # with --verbose a traceback is wanted, and a help ends the case
            if flag.startswith("--") and flag not in ("--verbose", "--help"):
                flags[flag] = None if option.is_flag else TEXTS.get(flag) or known.get(flag, [])
    return flags
