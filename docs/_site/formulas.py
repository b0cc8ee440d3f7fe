"""Formulas as HTML, rendered by KaTeX when the site is built: pages need its style sheet and fonts, but no JavaScript.

`katex/` has KaTeX 0.19.1 as its authors publish it (npm package `katex`, MIT licence in `katex/LICENSE`).
"""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path

from py_mini_racer import JSEvalException, MiniRacer

#: our abbreviations, as in the slides: \\V for a vector, \\T for transposed
MACROS = [
    (r"\\V\{((?:[^{}]|\{[^{}]*\})*)\}", r"\\boldsymbol{\1}"),
    (r"\\V\s*(\w)", r"\\boldsymbol{\1}"),
    (r"\^\\T(?![a-zA-Z])", r"^{\\top}"),
]
_KATEX = Path(__file__).with_name("katex") / "katex.min.js"
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


class FormulaError(ValueError):
    """A formula that cannot be shown."""


def replace(page: str) -> str:
    """Replace the formulas of a page, as `pymdownx.arithmatex` marks them.

    Raises:
        FormulaError: a formula has a command that is not known.
    """
    return _FORMULA.sub(lambda found: render(html.unescape(found[3]), found[2] == "["), page)


@cache
def render(formula: str, block: bool) -> str:
    """Return one formula as HTML, with MathML for screen readers and its source for copying."""
    expanded = formula.strip()
    for pattern, replacement in MACROS:
        expanded = re.sub(pattern, replacement, expanded)
    try:
        made = _katex().call(
            "katex.renderToString", expanded, {"displayMode": block, "macros": {r"\arraystretch": "1.2"}}
        )
    except JSEvalException as error:
        raise FormulaError(f"formula {formula.strip()!r}: {str(error).splitlines()[0]}") from None
    return f'<div class="formula" tabindex="0">{made}</div>' if block else f'<span class="formula">{made}</span>'


@cache
def _katex() -> MiniRacer:
    engine = MiniRacer()
    engine.eval(_KATEX.read_text())
    return engine
