"""Formulas as MathML, which browsers show without JavaScript."""

from __future__ import annotations

import html
import re
from functools import cache

from latex2mathml.converter import convert

#: our abbreviations, as in the slides: \\V for a vector, \\T for transposed
MACROS = [
    (r"\\V\{((?:[^{}]|\{[^{}]*\})*)\}", r"\\boldsymbol{\1}"),
    (r"\\V\s*(\w)", r"\\boldsymbol{\1}"),
    (r"\^\\T(?![a-zA-Z])", r"^{\\top}"),
]
#: the same for the converter, which knows only one of them
_CONVERTER = (r"\{aligned\}", "{align*}")
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


_BOLD = re.compile(r'<(mi|mn|mtext) mathvariant="(bold|bold-italic)">([^<]*)</\1>')


def _bold(element: str, variant: str, letters: str) -> str:
    """Return letters as bold characters of Unicode, because browsers do not follow the attribute ``mathvariant``."""
    italic = variant == "bold-italic"
    first = {"A": 0x1D468, "a": 0x1D482, "Α": 0x1D71C, "α": 0x1D736} if italic else {"A": 0x1D400, "a": 0x1D41A}
    made = ""
    for letter in letters:
        start = next((k for k in ("α", "Α", "a", "A") if k in first and ord(k) <= ord(letter) < ord(k) + 26), None)
        digit = 0x1D7CE + int(letter) if letter.isdigit() else None
        made += chr(digit or (first[start] + ord(letter) - ord(start) if start else ord(letter)))
    return f"<{element}>{made}</{element}>"


class FormulaError(ValueError):
    """A formula that cannot be shown."""


def replace(page: str) -> str:
    """Replace the formulas of a page, as `pymdownx.arithmatex` marks them, by MathML.

    Raises:
        FormulaError: a formula has a command that is not known.
    """
    return _FORMULA.sub(lambda found: to_mathml(html.unescape(found[3]), found[2] == "["), page)


@cache
def to_mathml(formula: str, block: bool) -> str:
    """Return one formula as MathML, with its source as text for screen readers and for copying."""
    expanded = formula
    for pattern, replacement in (*MACROS, _CONVERTER):
        expanded = re.sub(pattern, replacement, expanded)
    mathml = convert(expanded.strip(), display="block" if block else "inline")
    unknown = re.search(r"<m[a-z]+[^>]*>(&#x0005C;|\\)\w*", mathml)
    if unknown:
        raise FormulaError(f"formula {formula.strip()!r}: a command is not known ({html.unescape(unknown[0])})")
    mathml = _BOLD.sub(lambda found: _bold(found[1], found[2], html.unescape(found[3])), mathml)
    label = html.escape(" ".join(formula.split()), quote=True)
    mathml = mathml.replace("<math ", f'<math alttext="{label}" ', 1)
    return f'<div class="formula">{mathml}</div>' if block else mathml
