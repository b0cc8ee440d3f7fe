"""Run the cells of one file and write what they print and draw: ``run_cells.py FILE FOLDER``."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import labels
import matplotlib.pyplot as plt
import numpy as np
from cells import split
from matplotlib.figure import Figure
from matplotlib.text import Text

from comparisons.show.canvas import font_of, translate_texts

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

        asked: list[dict[str, Any]] = []

        def ask(*arguments: Any, asked: list[dict[str, Any]] = asked, **options: Any) -> None:
            """Ask the reader for the numbers that this cell has computed, see `question`."""
            asked.append(question(*arguments, **options))

        namespace["slider"], namespace["ask"], printed = slider, ask, io.StringIO()
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
        results[name]["question"] = asked[-1] if asked else None
    (target / "cells.json").write_text(json.dumps(results))


def execute(code: str, place: str, namespace: dict[str, Any]) -> Any:
    """Execute a cell and return the value of its last line, where that is an expression, as a notebook does."""
    tree = ast.parse(code, place)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, place, "exec"), namespace)
    return eval(compile(ast.Expression(last.value), place, "eval"), namespace) if last else None


def save(target: Path, name: str, figure: Figure | None = None) -> str:
    """Save a figure, or else the first open one, close it, and return the name of its file.

    The same with Japanese labels is beside it, named .ja.svg or .ja.png.
    """
    figure = figure or plt.figure(plt.get_fignums()[0])
    file = target / f"{name}.svg"
    figure.savefig(file, metadata={"Date": None})
    if file.stat().st_size > LARGEST_SVG:
        file.unlink()
        file = target / f"{name}.png"
        texts = (text.get_text() for text in figure.findobj(Text))
        # a test reads the labels
        figure.savefig(file, dpi=120, metadata={"Description": "\n".join(text for text in texts if text.strip())})
    font = font_of("ja")
    if font is not None or file.suffix == ".svg":
        # an SVG has its labels as text, whose font is the reader's; without a font here, places are less exact
        translate_texts(figure, labels.in_japanese, font or "sans-serif")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        options = {"metadata": {"Date": None}} if file.suffix == ".svg" else {"dpi": 120}
        figure.savefig(file.with_suffix(f".ja{file.suffix}"), **options)
    plt.close(figure)
    return file.name


def question(
    right: Any, mistakes: Mapping[tuple[str, str], Any] | None = None, *, unit: str = "", within: float = 0.02
) -> dict[str, Any]:
    """What a page needs to judge an answer; `exercises.py` writes it into the page.

    Args:
        right: a number, a vector, which is written as a row, or a matrix.
        mistakes: sentences in English and Japanese, with the wrong answer that each explains.
        unit: shown beside the fields; with rad in it, answers in degrees are recognised.
        within: how far a number may be off, in relation to it, or to a tenth of the largest number where that is more.
    """
    rows = np.atleast_2d(np.asarray(right, dtype=float))
    slack = within * np.maximum(np.abs(rows), 0.1 * np.abs(rows).max()) + 1e-9
    told = []
    for text, value in (mistakes or {}).items():
        wrong = np.broadcast_to(np.atleast_2d(np.asarray(value, dtype=float)), rows.shape)
        assert (np.abs(wrong - rows) > slack).any(), f"this mistake is right: {text[0]}"
        told.append({"value": wrong.tolist(), "text": text})
    return {"right": rows.tolist(), "slack": slack.tolist(), "mistakes": told, "unit": unit}


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
