"""Run the cells of one file and write what they print and draw: ``run_cells.py FILE FOLDER``."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from cells import split
from matplotlib.figure import Figure

#: a figure as SVG is replaced by a PNG above this size [bytes], for example one with thousands of particles
LARGEST_SVG = 120_000

STYLE = {
    "figure.figsize": (6.4, 4.0),
    "figure.constrained_layout.use": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "site",
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "savefig.facecolor": "white",
}


def main(path: Path, target: Path) -> None:
    """Run every cell in one namespace; the first that fails ends the program with its traceback."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    results = {}
    for name, code in split(path.read_text()).items():
        figures: list[tuple[str, str]] = []

        def slider(
            label: str,
            values: Iterable[Any],
            draw: Callable[[Any], Any],
            *,
            name: str = name,
            figures: list[tuple[str, str]] = figures,
        ) -> None:
            """Draw one figure for each value; the page shows them with a slider."""
            for value in values:
                draw(value)
                figures.append((f"{label} {value}", save(target, f"{name}-{len(figures)}")))

        namespace["slider"], printed = slider, io.StringIO()
        with plt.rc_context(STYLE), contextlib.redirect_stdout(printed):
            try:
                value = execute(code, f"{path.name}, cell {name}", namespace)
            except Exception:
                sys.exit(f"cell {name!r}:\n{traceback.format_exc()}")
            while plt.get_fignums():
                figures.append(("", save(target, f"{name}-{len(figures)}")))
            if isinstance(value, Figure) and not figures:
                figures.append(("", save(target, f"{name}-0", value)))
        results[name] = {"name": name, "code": code, "output": printed.getvalue(), "figures": figures}
    (target / "cells.json").write_text(json.dumps(results))


def execute(code: str, place: str, namespace: dict[str, Any]) -> Any:
    """Execute a cell and return the value of its last line, where that is an expression, as a notebook does."""
    tree = ast.parse(code, place)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, place, "exec"), namespace)
    return eval(compile(ast.Expression(last.value), place, "eval"), namespace) if last else None


def save(target: Path, name: str, figure: Figure | None = None) -> str:
    """Save a figure, or else the first open one, close it, and return the name of its file."""
    figure = figure or plt.figure(plt.get_fignums()[0])
    file = target / f"{name}.svg"
    figure.savefig(file, metadata={"Date": None})
    if file.stat().st_size > LARGEST_SVG:
        file.unlink()
        file = target / f"{name}.png"
        figure.savefig(file, dpi=120)
    plt.close(figure)
    return file.name


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
