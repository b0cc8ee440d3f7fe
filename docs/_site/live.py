"""Figures that the reader moves: `{{ live KIND LOG key=value "text" }}` in a page.

The scripts are in `live/`, the computation is the engine's as WebAssembly. The log goes into the page as JSON, as `vmslam.js`
takes it. The text says what the figure shows; it is all that readers without JavaScript see.
"""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import cells
import markdown
import numpy as np

from graphslam import Log, load, simulate
from graphslam.edges.robust import Cauchy
from graphslam.log import table as columns

KINDS = {path.stem for path in (Path(__file__).parent / "live").glob("*.js")} - {"stage", "tables", "words"}
#: what `make engine-wasm` builds
ENGINE = [cells.ROOT / "build" / "wasm" / name for name in ("vmslam.wasm", "vmslam.js")]

TABLES = [cells.ROOT / "examples" / "own_robot" / name for name in ("odometry.csv", "sightings.csv")]


class LiveError(ValueError):
    """A figure that cannot be made, with the reason."""


@cache
def log(name: str) -> Log:
    """A log of the figures by its name."""
    if name == "three_poses":
        return load(cells.ROOT / "examples" / "three_poses.txt")
    if name == "loop":
        # a closed loop of ten poses, so that single edges can be seen
        landmarks = ((2.6, -2.4, 0.0), (2.2, 1.8, 0.0), (-2.4, 1.6, 0.0), (-2.2, -2.2, 0.0))
        return simulate(
            seed=25, steps=9, dt=4.0, speed=0.35, turn_rate=2 * np.pi / 36, start=(0.0, -2.0, 0.0),
            landmarks=landmarks, max_range=5.0, clean=True,
        )  # fmt: skip
    if name == "drive":
        return simulate(seed=3, clean=True)
    raise LiveError(f"there is no log {name!r}")


def rows(log: Log) -> dict[str, Any]:
    """A log as `vmslam.js` takes it, with the widths of its kernel, and the truth."""
    assert log.controls is not None and log.dt is not None
    truth = {}
    if log.true_poses is not None and log.true_landmarks is not None:
        truth = {"truth": log.true_poses.round(3).tolist()}
        # x, y, heading and id
        truth |= {"landmarks": [[*place.round(3).tolist(), int(j)] for j, place in log.true_landmarks.items()]}
    return truth | {
        "start": log.initial_poses[0].tolist(),
        "controls": np.column_stack([log.controls, log.dt]).tolist(),
        "sightings": np.column_stack([log.steps, log.landmarks, log.sightings]).tolist(),
        "widths": widths(),
    }


def widths() -> list[float | None]:
    """The default widths of Cauchy's kernel without and with psi."""
    return [Cauchy().of_dimension(d).width for d in (2, 3)]


def table_names() -> dict[str, Any]:
    """The names of columns and units that `graphslam` recognises, for the page that reads tables."""
    roles = ("t", "nu", "omega", "id", "range", "bearing", "orientation")
    names = {role: columns.NAMES[role] for role in roles}
    return {"names": names, "units": columns.UNITS, "whole": columns.WHOLE, "widths": widths()}


def figure(arguments: list[str]) -> str:
    """The figure with its text, which may be Markdown.

    Raises:
        LiveError: there is no such kind of figure, or no such log.
    """
    kind, *options, text = arguments
    if kind not in KINDS:
        raise LiveError(f"there is no live figure {kind!r}; there are {', '.join(sorted(KINDS))}")
    names = [option for option in options if "=" not in option]
    data = "".join(f' data-{key}="{value}"' for key, value in (o.split("=") for o in options if "=" in o))
    given = rows(log(names[0])) if names else table_names() if kind == "own" else {}
    script = f'<script type="application/json">{json.dumps(given)}</script>' if given else ""
    caption = markdown.markdown(text).removeprefix("<p>").removesuffix("</p>")
    return f'<figure class="live" data-kind="{kind}"{data}><figcaption>{caption}</figcaption>{script}</figure>'


def copy_files(site: Path) -> None:
    """Copy the engine into the site, where it has been built, and the tables of the example."""
    for folder, files in (("engine", ENGINE), ("examples", TABLES)):
        (site / folder).mkdir(parents=True, exist_ok=True)
        for file in files:
            if file.exists():
                shutil.copy(file, site / folder)
