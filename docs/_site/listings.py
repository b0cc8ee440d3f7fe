"""The present source of functions and classes, for pages that explain it."""

from __future__ import annotations

import ast
from typing import Any

import cells

LINES = {"en": "lines", "ja": "行"}


class ListingError(ValueError):
    """A function or class that a page shows does not exist."""


def listing(path: str, *names: str, language: str) -> str:
    """Return the source of functions or classes as blocks of code, with file and lines as the title.

    Raises:
        ListingError: the file has no such function or class.
    """
    file = cells.ROOT / path
    lines, tree = file.read_text().splitlines(), ast.parse(file.read_text())
    made = []
    for name in names:
        nodes: list[Any] = [tree]
        for part in name.split("."):
            nodes = [node for parent in nodes for node in parent.body if getattr(node, "name", None) == part]
        if not nodes:
            raise ListingError(f"{path} has no {name}; functions that pages show must not be renamed without the page")
        node = nodes[0]
        first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
        title = f"{path}, {LINES[language]} {first}-{node.end_lineno}"
        made += [f'```python title="{title}"', *lines[first - 1 : node.end_lineno], "```", ""]
    return "\n".join(made)
