"""Formulas as pictures: what KaTeX draws has every sign where it belongs, with the marks of symbols and without."""

from __future__ import annotations

import re
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from chromium import Chromium, Quiet, find_browser
from test_pages import CHAPTERS, DOCS, FORMULA

SITE = DOCS / "_site"
sys.path.insert(0, str(SITE))
pytest.importorskip("py_mini_racer", reason="needs the packages of the site: pip install -e '.[docs]'")
import formulas  # noqa: E402
import symbols  # noqa: E402

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium"),
]
#: for each formula, plain and with marks, its signs and their places relative to its own [px]
BOXES = """(async () => {
    await document.fonts.ready;
    const boxes = (katex) => {
        const origin = katex.getBoundingClientRect(), found = [];
        const walker = document.createTreeWalker(katex, NodeFilter.SHOW_TEXT);
        while (walker.nextNode()) {
            const node = walker.currentNode;
            for (let k = 0; k < node.length; ++k) {
                const range = document.createRange();
                range.setStart(node, k);
                range.setEnd(node, k + 1);
                const box = range.getBoundingClientRect();
                found.push([node.data[k], box.x - origin.x, box.y - origin.y]);
            }
        }
        return found;
    };
    return [...document.querySelectorAll("p")].map((pair) => [...pair.querySelectorAll(".katex-html")].map(boxes));
})()"""


def pairs() -> Iterator[tuple[str, str, str]]:
    """Each formula of the English chapters once, and its HTML without and with marks."""
    seen = set()
    for page in CHAPTERS:
        name = str(page.relative_to(DOCS)).removesuffix(".md")
        for found in FORMULA.finditer(re.sub(r"`[^`]*`", "", page.read_text())):
            formula, block = found[1] or found[2], bool(found[1])
            if (formula, name) not in seen:
                seen.add((formula, name))
                marked = symbols.marked(formula, name)
                yield formula, formulas.render(formula, block), formulas.render(formula, block, marked)


def test_marks_move_no_sign(tmp_path: Path) -> None:
    cases = list(pairs())
    assert len(cases) > 500
    style = '<link rel="stylesheet" href="_site/katex/katex.min.css"><link rel="icon" href="data:,">'
    lines = "".join(f"<p style='width: 60rem'>{plain} {marked}</p>" for _, plain, marked in cases).replace(
        "div", "span"
    )
    (tmp_path / "index.html").write_text(f"<!doctype html><meta charset='utf-8'>{style}{lines}")
    (tmp_path / "_site").symlink_to(SITE)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    assert BROWSER is not None
    with Chromium(BROWSER, tmp_path / "profile") as browser:
        browser.send("Page.navigate", url=f"http://127.0.0.1:{server.server_port}/index.html")
        browser.wait_for("document.readyState === 'complete' && document.querySelector('.katex') !== null")
        boxes = browser.evaluate(BOXES)
    server.shutdown()
    server.server_close()
    assert len(boxes) == len(cases)
    moved = []
    for (formula, *_), (plain, marked) in zip(cases, boxes, strict=True):
        same = [sign for sign, *_ in plain] == [sign for sign, *_ in marked]
        if not same or not np.allclose([b[1:] for b in plain], [b[1:] for b in marked], atol=0.25):
            moved.append(formula)
    assert moved == []
