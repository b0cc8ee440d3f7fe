"""The present source of functions and classes, for pages that explain it."""

from __future__ import annotations

import ast
import re
import textwrap
import tomllib
from functools import cache
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
        shown = lines[first - 1 : node.end_lineno]
        if language == "ja":
            shown = in_japanese(path, name, node, shown, first)
        made += [f'```python title="{title}"', *shown, "```", ""]
    return "\n".join(made)


@cache
def docstrings() -> dict[str, dict[str, str]]:
    """{file: {name: Japanese docstring}}, and {English comment: Japanese comment} under "comments"."""
    return tomllib.loads((cells.DOCS / "_site" / "docstrings.toml").read_text())


def in_japanese(path: str, name: str, node: Any, lines: list[str], first: int) -> list[str]:
    """The lines of a function or class from line ``first`` on, with Japanese docstrings and comments where there are some."""
    lines, known = list(lines), docstrings().get(path, {})
    inner = [(name, node), *((f"{name}.{each.name}", each) for each in node.body if isinstance(each, ast.FunctionDef))]
    # from the end, so that the numbers of the lines before do not change
    for its, each in reversed(inner):
        string = each.body[0]
        if its in known and ast.get_docstring(each) is not None:
            indent = " " * string.col_offset
            text = [indent + line if line else "" for line in known[its].strip().splitlines()]
            text[0] = f'{indent}"""{text[0].strip()}'
            text = [*text, f'{indent}"""'] if len(text) > 1 else [f'{text[0]}"""']
            lines[string.lineno - first : string.end_lineno - first + 1] = text
    comments = docstrings()["comments"]
    return [re.sub(r"# (.*)$", lambda found: f"# {comments.get(found[1], found[1])}", line) for line in lines]


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
