"""The notebooks in ``examples/`` and the code in the tutorials: ``python docs/_site/bundled.py`` writes both from cells.

The site has a notebook of every page with cells. These few are kept in the repository, where Colab and GitHub can open them.
The tutorials repeat the code of their cells, so that they can be read in the repository, too.
A test fails when a page has changed and its notebook has not, or a cell has changed and its tutorial has not.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cells
import listings
import measured
import notebooks

EXAMPLES = cells.ROOT / "examples"
PAGES = ("tutorials/first-picture", "method/graph/information", "method/fastslam/weights")
LANGUAGES = {"en": ".md", "ja": ".ja.md"}


def make(source: Path, language: str, results: Mapping[str, cells.Cell], folder: Path) -> dict[str, Any]:
    """Return the notebook of a page in one language."""
    page = source.with_suffix(LANGUAGES[language])
    text = measured.filled(cells.markers(page.read_text()), str(page.relative_to(cells.DOCS)), language)
    return notebooks.notebook(
        text, results, folder, lambda arguments: listings.listing(*shlex.split(arguments), language=language), language
    )


def bundled() -> list[tuple[Path, Path, str]]:
    """Return each bundled notebook: its file, the file with the cells of its page, and the language."""
    return [
        (EXAMPLES / f"{Path(page).name}.{language}.ipynb", cells.DOCS / f"{page}.py", language)
        for page in PAGES
        for language in LANGUAGES
    ]


def tutorials() -> list[tuple[Path, str]]:
    """Return each page that repeats code, with its text as the cells are now."""
    found = [*(cells.DOCS / "tutorials").glob("*.md"), *cells.DOCS.glob("*.md")]
    pages = [page for page in sorted(found) if "<!-- end -->" in page.read_text()]
    codes = [cells.split((page.parent / f"{page.name.split('.')[0]}.py").read_text()) for page in pages]
    return [(page, cells.with_code(page.read_text(), code)) for page, code in zip(pages, codes, strict=True)]


def sources(notebook: Mapping[str, Any]) -> list[str]:
    """The text and code of a notebook without its outputs and without the cell that installs."""
    return [cell["source"] for cell in notebook["cells"][1:]]


if __name__ == "__main__":
    for page, text in tutorials():
        page.write_text(text)
    for file, source, language in bundled():
        notebooks.write(file, make(source, language, cells.run(source), cells.folder(source)))
        print(f"{file.relative_to(cells.ROOT)}: {len(json.loads(file.read_text())['cells'])} cells")
