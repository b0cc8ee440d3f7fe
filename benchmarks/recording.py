"""Measured results in files, one for each benchmark, from which the site makes its tables: docs/measured/NAME.json.

A file has the command, the date and the machine of a run, and its rows: raw numbers, and a "name" that identifies the row.
Rows that a run has not measured stay as they were, with the command, date and machine of then.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Mapping
from datetime import date
from importlib import metadata
from pathlib import Path
from typing import Any

from comparisons.results.documents import jsonable
from graphslam.files import write_text


def add_option(parser: argparse.ArgumentParser) -> None:
    """Give a command line the option ``--record``; the parser takes whole names of options, as `command` does."""
    parser.allow_abbrev = False
    parser.add_argument(
        "--record", type=_folder, metavar="FOLDER", help="keep the results there; the site: docs/measured"
    )


def _folder(text: str) -> Path:
    """A folder that exists: a long run should not end without a place for its results."""
    if not Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"there is no folder {text!r}")
    return Path(text)


def record(folder: Path | None, name: str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the rows of a run into the file of a name, whole; nothing without a folder."""
    if folder is None:
        return
    path, before = folder / f"{name}.json", dict[str, Any]()
    run = {"command": command(), "date": date.today().isoformat(), "machine": machine()}
    if path.exists():
        old = json.loads(path.read_text(encoding="utf-8"))
        before = {row["name"]: {key: old[key] for key in run} | row for row in old["rows"]}
    after = before | {row["name"]: jsonable(dict(row)) for row in rows}
    # what a row shares with the file stands there alone
    lines = [
        {key: value for key, value in row.items() if key not in run or run[key] != value} for row in after.values()
    ]
    text = json.dumps(run, indent=1, ensure_ascii=False).removesuffix("\n}")
    listed = ",\n  ".join(json.dumps(line, ensure_ascii=False) for line in lines)
    write_text(path, f'{text},\n "rows": [\n  {listed}\n ]\n}}\n')


def command() -> str:
    """The command line of this process, without ``--record``."""
    words = iter(sys.argv[1:])
    kept = [word for word in words if not word.startswith("--record=") and (word != "--record" or not [next(words)])]
    return shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *kept])


def machine() -> str:
    """The processor, its cores, and the versions on which times depend."""
    listed = Path("/proc/cpuinfo")  # of Linux
    known = listed.exists() and re.search(r"^model name\s*: (.+)$", listed.read_text(encoding="utf-8"), re.MULTILINE)
    programs = [f"Python {platform.python_version()}"]
    for package in ("gtsam", "g2opy"):
        try:
            programs.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return f"{known[1] if known else platform.machine()}, {os.cpu_count()} cores; {', '.join(programs)}"
