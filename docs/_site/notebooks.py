"""Write pages with cells as notebooks, with the outputs that the page shows.

Text becomes Markdown cells, each marker of a cell a code cell with what it printed and drew, each marker of code a block.
A page may show its cells in another order than that in which they run; a cell then follows those that it may need.
Boxes and exercises lose their indentation, because notebooks have no boxes. Links to other pages become plain text. The first
cell installs the project where the notebook runs in Colab.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import exercises
import formulas
from cells import Cell

_MARKER = re.compile(r"^[ \t]*\{\{ (code|cell|output|figure|ask|slides)(?: (.+?))? \}\}$", re.MULTILINE)
#: figures that need the engine in the page
_LIVE = re.compile(r"^[ \t]*\{\{ live .+ \}\}\n", re.MULTILINE)
#: where Colab installs the project from, and finds the notebooks; the workflow that publishes the site sets it
REPOSITORY = os.environ.get("SITE_REPOSITORY", "")
INSTALL = f'''%matplotlib inline
import sys

if "google.colab" in sys.modules:  # Colab does not have the project yet
    %pip install --quiet "virtual-motion-slam @ git+{REPOSITORY or "https://github.com/OWNER/REPOSITORY"}"'''
#: what the site gives to cells, for a notebook
SLIDER = '''def slider(label, values, draw):
    """Draw one figure for each value."""
    for value in values:
        draw(value)'''


def notebook(
    markdown: str, results: Mapping[str, Cell], folder: Path, code: Callable[[str], str], language: str = "en"
) -> dict[str, Any]:
    """Return a page as a notebook.

    Args:
        markdown: the page with its markers.
        results: of its cells, whose figures are in ``folder``.
        code: makes the block for the arguments of a marker of code.
        language: of the answers to exercises.
    """
    questions = {name: cell.question for name, cell in results.items() if cell.question}
    checks = f"\n\n{exercises.notebook_cell(questions, language)}" if questions else ""
    made = [_code_cell(INSTALL + checks, [])]
    made[0]["metadata"] = {"jupyter": {"source_hidden": True}}
    if any("slider(" in cell.code for cell in results.values()):
        made.append(_code_cell(SLIDER, []))
    end, waiting = 0, list(results)
    markdown = _LIVE.sub("", markdown)
    for found in _MARKER.finditer(markdown):
        made += _text(markdown[end : found.start()])
        end = found.end()
        if found[1] == "code":
            made += _text(code(found[2]))
        elif found[1] != "slides":
            name = shlex.split(found[2])[0]
            while name in waiting and not (found[1] == "ask" and name == waiting[0]):
                cell = results[waiting.pop(0)]
                made.append(_code_cell(exercises.shown(cell.code), _outputs(cell, folder)))
            if found[1] == "ask":
                made += _text(shlex.split(found[2])[1])
                made.append(_code_cell(exercises.with_gaps(name, results[name].code), []))
    made += _text(markdown[end:])
    for number, cell in enumerate(made):
        cell["id"] = f"cell-{number}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def write(place: Path, content: dict[str, Any]) -> None:
    """Write a notebook, with its folder."""
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(json.dumps(content, ensure_ascii=False, indent=1) + "\n")


def _text(markdown: str) -> list[dict[str, Any]]:
    if not markdown.strip():
        return []
    if markdown.startswith("```"):
        # notebooks show no titles of blocks
        markdown = re.sub(r'^```python title="(\S+), .*"$', r"```python\n# \1", markdown, flags=re.MULTILINE)
    else:
        markdown = re.sub(r"^[ \t]*(?:!!!|\?\?\?)\+? \w+ \"(.+?)\"$", r"**\1**", markdown, flags=re.MULTILINE)
        markdown = re.sub(r"^(?: {4})+(?=\S)", "", markdown, flags=re.MULTILINE)
        markdown = re.sub(r" \{ ?#[\w-]+ ?\}$", "", markdown, flags=re.MULTILINE)
        markdown = re.sub(r"!?\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", markdown)
        for pattern, replacement in formulas.MACROS:
            markdown = re.sub(pattern, replacement, markdown)
    return [{"cell_type": "markdown", "metadata": {}, "source": markdown.strip("\n")}]


def _code_cell(code: str, outputs: list[dict[str, Any]]) -> dict[str, Any]:
    source = re.sub(r"  # noqa.*$", "", code, flags=re.MULTILINE)
    return {"cell_type": "code", "execution_count": None, "metadata": {}, "source": source, "outputs": outputs}


def _outputs(cell: Cell, folder: Path) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = []
    if cell.output:
        made.append({"output_type": "stream", "name": "stdout", "text": cell.output})
    for label, file in cell.figures:
        path = folder / file
        if path.suffix == ".svg":
            data = {"image/svg+xml": path.read_text()}
        else:
            data = {"image/png": base64.b64encode(path.read_bytes()).decode()}
        data["text/plain"] = label or "figure"
        made.append({"output_type": "display_data", "metadata": {}, "data": data})
    return made
