"""The present source of functions and classes, for pages that explain it."""

from __future__ import annotations

import ast
import re
import textwrap
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
    if file.suffix in (".hpp", ".cpp"):
        return "\n".join(_in_cxx(path, file.read_text().splitlines(), name, language) for name in names)
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


def _in_cxx(path: str, lines: list[str], name: str, language: str) -> str:
    """A function of C++ with the comment above it, which begins with /// and ends where its braces close."""
    start = next((k for k, line in enumerate(lines) if re.search(rf"\b{name}\(.*{{", line)), None)
    if start is None:
        raise ListingError(f"{path} has no {name}; functions that pages show must not be renamed without the page")
    end, depth = start, 0
    for end in range(start, len(lines)):
        depth += lines[end].count("{") - lines[end].count("}")
        if depth == 0:
            break
    while lines[start - 1].strip().startswith("///"):
        start -= 1
    title = f'```cpp title="{path}, {LINES[language]} {start + 1}-{end + 1}"'
    return "\n".join([title, *textwrap.dedent("\n".join(lines[start : end + 1])).splitlines(), "```", ""])
