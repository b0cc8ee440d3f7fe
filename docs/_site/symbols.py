"""Symbols that explain themselves: the symbols of `symbols.toml` are marked in formulas, and pages end with their table.

The marks are `data-sym` on the spans of KaTeX. `symbols.js` shows a row of the table where the reader points or taps, and
the rows of a formula that has the focus. Without JavaScript the table remains.
"""

from __future__ import annotations

import html
import re
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cells

LANGUAGES = ("en", "ja")
WORDS = {
    "en": {
        "title": "Symbols on this page",
        "symbol": "Symbol",
        "meaning": "Meaning",
        "unit": "Unit",
        "where": "Defined in",
    },
    "ja": {"title": "このページの記号", "symbol": "記号", "meaning": "意味", "unit": "単位", "where": "定義"},
}
#: commands whose argument is no place for marks: text, names, letters with an accent that the table does not have, and
#: (in \mathnormal, which looks the same) letters that have another meaning where they stand
_CLOSED = re.compile(
    r"\\(?:begin|end|text|textbf|operatorname|mathrm|mathcal|mathnormal|boldsymbol|V|hat|bar|tilde|dot|vec)(?![a-zA-Z])"
    r"\s*(?:\{|\\[a-zA-Z]+|.)"
)
_COMMAND = re.compile(r"\\(?:[a-zA-Z]+|.)")


@cache
def table() -> list[dict[str, Any]]:
    """All symbols, in the order of the file: where two fit a page, the first is meant."""
    entries: list[dict[str, Any]] = tomllib.loads((Path(__file__).with_name("symbols.toml")).read_text())["symbol"]
    return entries


@cache
def heads(page: str) -> tuple[tuple[str, int], ...]:
    """How symbols begin on a page, the longest first, with their numbers in the table."""
    found: dict[str, int] = {}
    for number, entry in enumerate(table()):
        if any(page.startswith(start) for start in entry["pages"]):
            for head in entry["latex"]:
                found.setdefault(head, number)
    return tuple(sorted(found.items(), key=lambda item: -len(item[0])))


def marked(formula: str, page: str) -> str:
    """A formula in which each symbol that the page knows is an argument of `\\htmlData`.

    Scripts belong to their symbol. What stands in scripts, in text and in names is left alone.
    """
    made, at = [], 0
    while at < len(formula):
        number, end = _head(formula, at, page)
        if end:
            end = _scripts(formula, end)
            made.append(rf"\htmlData{{sym={number}}}{{{formula[at:end]}}}")
        elif formula[at] in "_^":
            end = _scripts(formula, at)
            made.append(formula[at:end])
        elif closed := _CLOSED.match(formula, at):
            end = _group(formula, closed.end() - 1) if closed[0].endswith("{") else closed.end()
            made.append(formula[at:end])
        else:
            command = _COMMAND.match(formula, at)
            end = command.end() if command else at + 1
            made.append(formula[at:end])
        at = end
    return "".join(made)


def _head(formula: str, at: int, page: str) -> tuple[int, int]:
    """The number of the symbol that begins here and where its head ends, or zeros."""
    for head, number in heads(page):
        end = at + len(head)
        if formula.startswith(head, at) and not (
            head[-1].isalpha() and "\\" in head and formula[end : end + 1].isalpha()
        ):
            return number, end
    return 0, 0


def _scripts(formula: str, at: int) -> int:
    """Where the subscripts, superscripts and primes end that begin here."""
    while found := re.compile(r"\s*([_^]\s*|'+)").match(formula, at):
        at = found.end()
        if found[1][0] in "_^":
            if formula[at] == "{":
                at = _group(formula, at)
            else:
                command = re.compile(r"\\[a-zA-Z]+(\{)?|.").match(formula, at)
                assert command
                at = _group(formula, command.end() - 1) if command[1] else command.end()
    return at


def _group(formula: str, at: int) -> int:
    """Where the group in braces ends that begins here."""
    depth = 0
    for k in range(at, len(formula)):
        depth += {"{": 1, "}": -1}.get(formula[k], 0) * (formula[k - 1 : k] != "\\")
        if depth == 0:
            return k + 1
    raise ValueError(f"braces of {formula!r}")


def explained(page: str, content: str, language: str, render: Callable[[str], str], link: Callable[[str], str]) -> str:
    """The table of the symbols that a page has, as HTML.

    Args:
        page: its name without language and ending.
        content: its HTML with the marks.
        render: makes HTML of a formula.
        link: makes an address of the name of a page with an anchor.
    """
    used = sorted({int(number) for number in re.findall(r'data-sym="(\d+)"', content)})
    if not used:
        return ""
    words = WORDS[language]
    titles = "".join(f"<th>{words[name]}</th>" for name in ("symbol", "meaning", "unit", "where"))
    rows = []
    for number in used:
        entry = table()[number]
        where, _, anchor = entry["where"].partition("#")
        source = cells.DOCS / f"{where}{'.ja' if language == 'ja' else ''}.md"
        title = re.sub(r"\s*\{#.*", "", source.read_text().split("\n", 1)[0].lstrip("# "))
        address = html.escape(link(f"{where}.md#{anchor}" if anchor else f"{where}.md"))
        rows.append(
            f'<tr id="symbol-{number}"><td>{render(entry["latex"][0])}</td><td>{html.escape(entry[language])}</td>'
            f'<td>{html.escape(entry.get("unit", ""))}</td><td><a href="{address}">{html.escape(title)}</a></td></tr>'
        )
    return (
        f'\n<details class="symbols" data-search-exclude><summary>{words["title"]}</summary>'
        f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table></details>\n"
    )
