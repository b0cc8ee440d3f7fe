"""Run the code cells of a page of the site, and keep what they print and draw.

A page ``information.md`` takes its code from ``information.py`` beside it, in cells that begin with ``# %% name``. The
translations of the page share this file. All cells of a page run in one process of their own, in order, in the root of
the repository. The results are kept under a hash of the cells and of the packages, so that only changed pages run again.

With ``SITE_SECONDS`` in the environment, no page begins after this time. Pages that have not run then show their code alone.
The present commit decides the order, so that other pages run at the next commit. This is for a quick check of a change.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CACHE = ROOT / ".cache" / "docs"
#: the longest time that the cells of one page may take [s]
LIMIT = 300
#: the time after which no further page begins [s]
SECONDS = float(os.environ.get("SITE_SECONDS", "inf"))
HURRIED = "SITE_SECONDS" in os.environ
_BEGUN = time.monotonic()


@dataclass(frozen=True)
class Cell:
    """A cell: its code, what it printed, and the files that it drew with their labels (for a slider, one per value)."""

    name: str
    code: str
    output: str
    figures: list[tuple[str, str]]
    #: what the cell asks the reader, see `exercises`
    question: dict[str, Any] | None = None


class CellError(RuntimeError):
    """A cell of a page failed."""


def sources() -> list[Path]:
    """Return the files with cells below ``docs``."""
    return [path for path in sorted(DOCS.rglob("*.py")) if "# %% " in path.read_text() and "_site" not in path.parts]


def split(source: str) -> dict[str, str]:
    """Return the code of each cell by its name, in order."""
    parts = re.split(r"^# %% (\S+)\n", source, flags=re.MULTILINE)
    return {name: code.strip("\n") for name, code in zip(parts[1::2], parts[2::2], strict=True)}


#: a cell as pages in the repository show it: a comment with its marker, its code, and the end
_READABLE = re.compile(
    r"^<!-- ((?:cell|output|figure) .+?) -->\n```python\n(.*?)```\n<!-- end -->$", re.MULTILINE | re.DOTALL
)


def markers(page: str) -> str:
    """Return a page with a marker for each cell whose code it repeats."""
    return _READABLE.sub(r"{{ \1 }}", page)


def with_code(page: str, codes: Mapping[str, str]) -> str:
    """Return a page with the present code of its cells, where it repeats the code so that the file can be read."""
    return _READABLE.sub(
        lambda found: f"<!-- {found[1]} -->\n```python\n{codes[found[1].split()[1]]}\n```\n<!-- end -->", page
    )


def folder(path: Path) -> Path:
    """Return the folder with the results of a file with cells, which need not exist yet."""
    digest = hashlib.sha256(_version_of_the_packages() + path.read_bytes()).hexdigest()[:16]
    return CACHE / f"{_name(path)}-{digest}"


def _name(path: Path) -> str:
    return "-".join(path.relative_to(DOCS).with_suffix("").parts)


@cache
def _version_of_the_packages() -> bytes:
    files = [path for name in ("graphslam", "fastslam", "comparisons") for path in sorted((ROOT / name).rglob("*.py"))]
    files += [Path(__file__).with_name(name) for name in ("run_cells.py", "labels.py", "labels.toml")]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).digest()


def results(path: Path) -> dict[str, Cell]:
    """Return the results of a file; where time did not suffice to run it, its code without results."""
    if not HURRIED or (folder(path) / "cells.json").exists():
        return run(path)
    return {name: Cell(name, code, "", []) for name, code in split(path.read_text()).items()}


@cache
def run(path: Path) -> dict[str, Cell]:
    """Run the cells of a file, or take their results from the cache.

    Raises:
        CellError: a cell failed; the message has the page, the cell and the traceback.
    """
    target = folder(path)
    if not (target / "cells.json").exists():
        with tempfile.TemporaryDirectory() as scratch:
            command = [sys.executable, str(Path(__file__).with_name("run_cells.py")), str(path), scratch]
            environment = {**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": str(ROOT), "COLUMNS": "80"}
            done = subprocess.run(
                command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
            )
            if done.returncode:
                raise CellError(f"{path.relative_to(ROOT)}: {done.stderr.strip() or done.stdout.strip()}")
            for old in CACHE.glob(f"{_name(path)}-{16 * '?'}"):
                shutil.rmtree(old, ignore_errors=True)
            shutil.copytree(scratch, target)
    return {name: Cell(**cell) for name, cell in json.loads((target / "cells.json").read_text()).items()}


def run_all(processes: int = 2) -> None:
    """Run the cells of all pages, two pages at a time, as far as the time suffices.

    Raises:
        CellError: cells failed; the message names all of them.
    """
    paths, end = sources(), _BEGUN + SECONDS  # this is called once for each language
    if HURRIED:
        commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, check=False).stdout
        random.Random(commit).shuffle(paths)

    def run_in_time(path: Path) -> str:
        try:
            if time.monotonic() < end:
                run(path)
        except CellError as error:
            return str(error)
        return ""

    with ThreadPoolExecutor(processes) as pool:
        errors = [error for error in pool.map(run_in_time, paths) if error]
    if errors:
        raise CellError("\n\n".join(errors))
    if HURRIED:
        ran = sum((folder(path) / "cells.json").exists() for path in paths)
        print(f"code of {ran} of {len(paths)} pages has run", flush=True)
