"""Formulas as HTML, rendered by KaTeX when the site is built: pages need its style sheet and fonts, but no JavaScript.

`katex/` has KaTeX 0.19.1 as its authors publish it (npm package `katex`, MIT licence in `katex/LICENSE`).
"""

from __future__ import annotations

import atexit
import html
import re
from collections.abc import Callable
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


def replace(page: str, mark: Callable[[str], str] = str) -> str:
    """Replace the formulas of a page, as `pymdownx.arithmatex` marks them; `mark` may mark symbols of a formula.

    Raises:
        FormulaError: a formula has a command that is not known.
    """

    def rendered(found: re.Match[str]) -> str:
        formula = html.unescape(found[3])
        return render(formula, found[2] == "[", mark(formula))

    return _FORMULA.sub(rendered, page)


@cache
def render(formula: str, block: bool, marked: str | None = None) -> str:
    """Return one formula as HTML, with MathML for screen readers and its source for copying.

    Args:
        formula: in LaTeX, with our abbreviations.
        block: whether it stands on a line of its own.
        marked: the formula with marks on its symbols, see `symbols`.
    """
    source, drawn = _expanded(formula), _expanded(marked or formula)
    options = {"displayMode": block, "macros": {r"\arraystretch": "1.2"}, "trust": True, "strict": "ignore"}
    try:
        made = _katex().call("katex.renderToString", drawn, options)
    except JSEvalException as error:
        raise FormulaError(f"formula {formula.strip()!r}: {str(error).splitlines()[0]}") from None
    made = made.replace(html.escape(drawn), html.escape(source))
    return f'<div class="formula" tabindex="0">{made}</div>' if block else f'<span class="formula">{made}</span>'


def _expanded(formula: str) -> str:
    expanded = formula.strip()
    for pattern, replacement in MACROS:
        expanded = re.sub(pattern, replacement, expanded)
    return expanded


@cache
def _katex() -> MiniRacer:
    engine = MiniRacer()
    # at the end of the program, when the engine is collected, its thread no longer runs, and closing waits for that forever
    atexit.register(engine.close)
    engine.eval(_KATEX.read_text())
    return engine
